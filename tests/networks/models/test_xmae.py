"""XMAE as its paper has it: sizes, who meets whom, and what training shows."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from learning import losses_of  # noqa: E402
from motionmend.body.standing import STANDING  # noqa: E402
from motionmend.errors import InputError  # noqa: E402
from motionmend.fills.points import FILLS  # noqa: E402
from motionmend.motion import Motion  # noqa: E402
from motionmend.networks.models.xmae import XMAE, XMAEConfig  # noqa: E402
from motionmend.networks.spaces import SPACES  # noqa: E402
from walks import walk  # noqa: E402


def network(**fields) -> XMAE:
    torch.manual_seed(0)
    return XMAE(XMAEConfig(**fields), 21).eval()


def parameters(**fields) -> int:
    return sum(each.numel() for each in network(**fields).parameters())


def windows(count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    take = walk(60.0)
    starts = np.linspace(0, len(take) - 60, count).astype(int)
    positions = take.positions[starts[:, None] + np.arange(60)]
    return positions, np.ones(positions.shape[:3], bool)


def answer(net: XMAE, positions: np.ndarray, observed: np.ndarray) -> np.ndarray:
    inputs, known = SPACES[net.space]().encode(np.where(observed[..., None], positions, np.nan), observed)
    with torch.inference_mode():
        output = net(**{name: torch.from_numpy(np.ascontiguousarray(each)) for name, each in inputs.items()})
    return SPACES[net.space]().decode(output.numpy(), known)


def test_it_has_the_papers_size():
    assert parameters() == 5_664_003
    assert parameters(codes="shared", structured=False) == 5_588_355  # "5.6M parameters", section 4.1, with equation 4
    assert parameters(size="small") < parameters() / 3.9
    assert parameters(size="large") > parameters() * 3.9


def test_an_untrained_network_on_curves_is_the_curve():
    positions, observed = windows(1)
    observed[:, 20:40] = False
    motion = Motion(np.where(observed[0, ..., None], positions[0], np.nan), observed[0], 60.0, walk(60.0).skeleton)
    for curves in ("on", "off"):
        found = answer(network(size="small", curves=curves), positions, observed)[0]
        np.testing.assert_allclose(found, FILLS["hermite"].complete(motion).positions, atol=1e-4)


def test_the_encoder_meets_observed_tokens_only_and_the_decoder_them_only_in_cross_attention():
    net, lengths = network(size="small", encoder_depth=2, decoder_depth=2), {"own": set(), "cross": set()}
    for block in net.encoder:
        block.own.register_forward_pre_hook(lambda _, args: lengths["own"].add(args[1].shape[1]))
    decoder = {"own": set(), "cross": set()}
    for block in net.decoder:
        block.own.register_forward_pre_hook(lambda _, args: decoder["own"].add(args[1].shape[1]))
        assert block.cross is not None
        block.cross.register_forward_pre_hook(lambda _, args: decoder["cross"].add(args[1].shape[1]))
    positions, observed = windows(2)
    observed[:, 10:50] = False
    answer(net, positions, observed)
    assert lengths["own"] == {20 * 21}
    assert decoder == {"own": {60 * 21}, "cross": {20 * 21}}  # all mask tokens, always


def test_nothing_that_was_seen_reaches_the_answer_but_through_cross_attention():
    net = network(size="small", encoder_depth=1)
    for block in net.decoder:
        assert block.cross is not None
        torch.nn.init.zeros_(block.cross.out.weight)
        torch.nn.init.zeros_(block.cross.out.bias)
    positions, observed = windows(2)
    one, two = answer(net, positions, observed)
    np.testing.assert_allclose(one - one[:1], two - two[:1], atol=1e-5)


@pytest.mark.parametrize("decoder", ["cross", "mae", "bert"])
def test_training_on_some_tokens_asks_the_same_of_the_network_as_on_all(decoder):
    """A query alone in the decoder differs, but all of them in another order are the same answers."""
    net = network(size="small", decoder=decoder, encoder_depth=1, decoder_depth=1)
    positions, observed = windows(3)
    arrays = net.batch(positions, observed, np.random.default_rng(0), 0)
    batch = {name: torch.from_numpy(each) for name, each in arrays.items()}
    order = torch.from_numpy(np.random.default_rng(1).permuted(np.tile(np.arange(1260), (3, 1)), axis=1))
    shuffled = {
        **batch, "asked": order, "weight": batch["weight"].gather(1, order),
        "target": batch["target"].gather(1, order[..., None].expand(-1, -1, 3)),
    }  # fmt: skip
    with torch.inference_mode():
        np.testing.assert_allclose(net.loss(batch, 0)["loss"], net.loss(shuffled, 0)["loss"], rtol=1e-4)


@pytest.mark.parametrize(
    "fields", [{}, {"curves": "on", "damage": "takes"}, {"curves": "smooth", "damage": "wrong"}], ids=str
)
def test_who_is_asked_does_not_tell_what_is_wrong(fields):
    """The same damage, all tokens asked and some: as many of those that are asked are displaced as of all."""
    positions, observed = (np.tile(each, (20, *[1] * (each.ndim - 1))) for each in windows(8))
    shares = []
    for asked in (0, 90):
        net = network(size="small", encoder_depth=1, decoder_depth=1, query_attention=False, asked=asked, **fields)
        arrays = net.batch(positions, observed, np.random.default_rng(4), 0)
        shown = arrays["weight"] == 1
        if not fields:  # hidden ones have the same weight there, and everybody sees that they are not there
            place = np.where(arrays["there"], arrays["index"], 1260)
            seen = np.zeros((len(positions), 1261), bool)
            np.put_along_axis(seen, place, True, axis=1)
            shown &= seen[:, :-1] if not asked else np.take_along_axis(seen, arrays["asked"], axis=1)
        shares.append(shown.mean())
    assert shares[0] > 0.04
    assert abs(shares[1] - shares[0]) < 0.12 * shares[0]  # five standard deviations of 160 times 90 draws


def test_some_queries_of_those_that_meet_are_refused():
    net = network(size="small", encoder_depth=1, asked=90)
    with pytest.raises(InputError, match="no-query-attention"):
        net.batch(*windows(2), np.random.default_rng(0), 0)


@pytest.mark.parametrize("meet", [True, False])
def test_in_use_only_what_is_hidden_is_asked(meet):
    """Weights that were trained on some queries that met, as those that shipped first, still run."""
    net, lengths = network(size="small", encoder_depth=1, curves="off", asked=90, query_attention=meet), []
    torch.nn.init.normal_(net.head.weight)  # an untrained one answers nothing anywhere
    positions, observed = windows(3)
    observed[0, 20:40], observed[1, 25:30, 4] = False, False
    for block in net.decoder:
        assert block.cross is not None
        block.cross.register_forward_pre_hook(lambda _, args: lengths.append(args[0].shape[1]))
    together = answer(net, positions, observed)
    assert set(lengths) == {20 * 21}
    np.testing.assert_allclose(together[observed], positions[observed], atol=1e-6)
    curve = answer(network(size="small", curves="off"), positions, observed)
    assert np.abs(together - curve)[~observed].min(axis=-1).max() > 0.01
    for row in range(3):  # what fills up the shorter lists is nobody's business
        alone = answer(net, positions[row : row + 1], observed[row : row + 1])
        np.testing.assert_allclose(together[row : row + 1], alone, atol=1e-5)


@pytest.mark.parametrize("decoder", ["mae", "bert"])
def test_the_other_decoders_are_told_the_curve_too(decoder):
    net = network(size="small", decoder=decoder, curves="on", encoder_depth=1, decoder_depth=1)
    torch.nn.init.normal_(net.head.weight)
    positions, observed = windows(2)
    arrays = net.batch(positions, observed, np.random.default_rng(0), 0)
    batch = {name: torch.from_numpy(each) for name, each in arrays.items()}
    net.loss(batch, 0)["loss"].sum().backward()
    assert net.begin is not None and net.begin.weight.grad is not None and net.begin.weight.grad.abs().max() > 0
    told = {name: batch[name] for name in ("tokens", "index", "there", "curve")}
    with torch.inference_mode():
        moved = net(**{**told, "curve": told["curve"] + 0.1}) - net(**told)
    assert moved.abs().amax(dim=-1).min() > 1e-4  # at every joint of every frame


def test_where_all_tokens_are_there_training_has_no_mask(monkeypatch):
    """Fast attention on GPUs takes none."""
    net, masks = network(size="small", encoder_depth=1), []
    plain = torch.nn.functional.scaled_dot_product_attention

    def spied(*args, attn_mask=None):
        masks.append(attn_mask)
        return plain(*args, attn_mask=attn_mask)

    monkeypatch.setattr(torch.nn.functional, "scaled_dot_product_attention", spied)
    positions, observed = windows(2)
    arrays = net.batch(positions, observed, np.random.default_rng(0), 0)
    batch = {name: torch.from_numpy(each) for name, each in arrays.items()}
    fast = net.loss(batch, 0)["loss"]
    assert masks and all(mask is None for mask in masks)
    padded = {**batch, **{name: torch.nn.functional.pad(batch[name], (0, 0, 0, 1) if name == "tokens" else (0, 1))
                          for name in ("tokens", "index", "there")}}  # fmt: skip
    np.testing.assert_allclose(fast.detach(), net.loss(padded, 0)["loss"].detach(), rtol=1e-5)
    assert masks[-1] is not None


def test_the_loss_is_over_masked_and_displaced_tokens_and_with_bert_over_some_clean_ones():
    positions, observed = windows(2)
    for decoder, counted in (("cross", 0.90), ("mae", 0.90), ("bert", 0.95)):
        net = network(size="small", decoder=decoder, encoder_depth=1)
        arrays = net.batch(positions, observed, np.random.default_rng(0), 0)
        assert arrays["there"].sum(axis=1).tolist() == [189, 189]  # 15 % of 1260, displaced ones among them
        np.testing.assert_allclose(arrays["weight"].mean(axis=1), counted, atol=0.02)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"mirror": True, "resize": 0.2},
        {"curves": "on", "damage": "takes", "mirror": True, "query_attention": False, "asked": 90},
        {"curves": "off", "damage": "gaps", "query_attention": False, "asked": 90},
        {"curves": "smooth", "damage": "wrong", "query_attention": False, "asked": 90},
    ],
    ids=["paper", "augmented", "on curves", "off curves", "smooth curves"],
)
def test_the_target_is_a_body(fields):
    """What the network is to say, put where the loss has it, has bones of one length: no turn or shift is lost."""
    net = network(size="small", encoder_depth=1, **{**fields, "asked": 0})
    positions, observed = windows(3)
    arrays = net.batch(positions, observed, np.random.default_rng(2), 0)
    told = arrays["target"].reshape(3, 60, 21, 3)
    if "curve" in arrays:
        told = told + arrays["curve"][..., :3] / 3 + STANDING
    parents = np.array(walk(60.0).skeleton.parents)
    bones = np.linalg.norm(told[:, :, 1:] - told[:, :, parents[1:]], axis=-1)
    wanted = np.linalg.norm(positions[:, :, 1:] - positions[:, :, parents[1:]], axis=-1)
    assert bones.std(axis=1).max() < 1e-3 + 1.2 * wanted.std(axis=1).max()
    if "asked" in fields:
        some = network(size="small", encoder_depth=1, **fields)
        arrays = some.batch(positions, observed, np.random.default_rng(2), 0)
        assert arrays["asked"].shape == arrays["weight"].shape == (3, 90) and arrays["target"].shape == (3, 90, 3)
        assert (arrays["tokens"].shape[2] == 210) == bool(fields["curves"])


def test_on_a_handful_of_windows_it_learns():
    net = network(size="small", encoder_depth=1, decoder_depth=1).train()
    positions, observed = windows(4)
    arrays = net.batch(positions, observed, np.random.default_rng(0), 0)
    batch = {name: torch.from_numpy(each) for name, each in arrays.items()}
    losses = losses_of(net, batch, 80, 3e-3)
    assert losses[-1] < 0.8 * losses[0]
