"""ConvAE, the Vanilla AE and the motion manifold as their paper has them: sizes, what training hides, what is shown."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from learning import losses_of  # noqa: E402
from motionmend.networks import spaces  # noqa: E402
from motionmend.networks.loading import module_completer  # noqa: E402
from motionmend.networks.models.convae import ConvAE, ConvAEConfig  # noqa: E402
from motionmend.networks.models.holden import Holden, HoldenConfig  # noqa: E402
from motionmend.networks.rows import ROWS  # noqa: E402
from motionmend.networks.spaces import SPACES  # noqa: E402
from walks import walk  # noqa: E402

SMALL = {"channels": (4, 6, 8, 8, 8)}


def network(of=ConvAE, config=ConvAEConfig, **fields):
    torch.manual_seed(0)
    return of(config(**fields), 21).eval()


def windows(frames: int = 240, count: int = 2) -> tuple[np.ndarray, np.ndarray]:
    take = walk(60.0)
    starts = np.linspace(0, max(len(take) - frames, 0), count).astype(int)
    positions = take.positions[np.minimum(starts[:, None] + np.arange(frames), len(take) - 1)]
    return positions, np.ones(positions.shape[:3], bool)


def batch_of(net, positions, observed, step=0, seed=0):
    arrays = net.batch(positions, observed, np.random.default_rng(seed), step)
    return {name: torch.from_numpy(np.ascontiguousarray(each)) for name, each in arrays.items()}


def test_it_has_the_papers_size():
    assert sum(each.numel() for each in network().parameters()) == 4_703_425  # the authors' code


def test_the_latent_image_has_the_papers_size():
    """Section 3.2: rows and frames halved five times, rounded up: 69 x 240 to 3 x 8, 256 channels deep."""
    net, seen = network(), []
    for unit in net.down:
        unit.register_forward_hook(lambda _, __, out: seen.append(tuple(out.shape[1:])))
    with torch.inference_mode():
        net(torch.zeros(1, 240, ROWS), torch.zeros(1, 240, ROWS // 3), torch.zeros(1, 240, ROWS // 3))
    assert seen == [(32, 35, 120), (64, 18, 60), (128, 9, 30), (256, 5, 15), (256, 3, 8)]


def test_the_vanilla_network_stops_halving_rows_when_few_are_left():
    net, seen = network(ConvAE, ConvAEConfig, kind="vanilla"), []
    for unit in net.down:
        unit.register_forward_hook(lambda _, __, out: seen.append(tuple(out.shape[1:])))
    with torch.inference_mode():
        net(torch.zeros(1, 240, ROWS), torch.zeros(1, 240, ROWS // 3), torch.zeros(1, 240, ROWS // 3))
    assert seen == [(32, 35, 120), (64, 18, 60), (128, 9, 30), (256, 9, 15), (512, 9, 8)]


@pytest.mark.parametrize("frames", [1, 2, 3, 31, 32, 33, 97, 240, 1000])
@pytest.mark.parametrize("fields", [SMALL, SMALL | {"kind": "vanilla"}, SMALL | {"skips": True}], ids=str)
def test_any_number_of_frames_comes_back_as_many(frames, fields):
    net = network(**fields)
    with torch.inference_mode():
        out = net(torch.randn(1, frames, ROWS), torch.ones(1, frames, ROWS // 3), torch.ones(1, frames, ROWS // 3))
    assert out.shape == (1, frames, ROWS) and out.isfinite().all()


def test_what_is_not_known_is_zero_to_the_paper_s_network():
    net = network(**SMALL)
    rows, known = torch.randn(1, 60, ROWS), torch.rand(1, 60, ROWS // 3) < 0.6
    other = torch.where(known.repeat_interleave(3, dim=2), rows, torch.randn_like(rows))
    with torch.inference_mode():
        assert torch.equal(net(rows, known, known.float()), net(other, known, known.float()))


def test_what_begins_at_the_curve_leaves_what_is_known_as_it_is():
    net = network(**SMALL, begin="curve", skips=True)
    torch.nn.init.normal_(net.up[-1][-1].weight)  # an untrained one answers with the curve everywhere
    positions, observed = windows()
    observed[:, 80:160] = False
    answer = module_completer(net).windows(positions, observed)
    np.testing.assert_allclose(answer[observed], positions[observed], atol=2e-5)
    inputs, known = SPACES["body_rows"]().encode(positions, observed)
    curve = SPACES["body_rows"]().decode(inputs["rows"], known)
    assert np.abs(answer - curve)[~observed].mean() > 0.01


def test_a_share_of_the_answer_counts():
    positions, observed = windows()
    observed[:, 80:160] = False
    inputs, _ = SPACES["body_rows"]().encode(positions, observed)
    tensors = {name: torch.from_numpy(each) for name, each in inputs.items()}
    one, some = (network(**SMALL, begin="curve", skips=True, share=share) for share in ((1.0, 1.0), (0.5, 0.0)))
    torch.nn.init.normal_(one.up[-1][-1].weight)
    some.load_state_dict(one.state_dict())
    with torch.inference_mode():
        whole, half = (each(**tensors) - tensors["rows"] for each in (one, some))
    torch.testing.assert_close(half[..., :-3], whole[..., :-3] / 2, atol=1e-5, rtol=1e-4)
    assert whole[..., -3:].abs().max() > 1e-3 > half[..., -3:].abs().max() * 100


def test_the_curriculum_makes_gaps_longer():
    net = network(**SMALL, curriculum=7000)
    positions, observed = windows(count=64)
    lengths = []
    for step in (0, 1200, 6999):
        gone = ~net.batch(positions, observed, np.random.default_rng(1), step)["known"]
        whole = gone[..., 0]  # the root is gone where the whole body is
        lengths.append(whole.sum(axis=1)[whole.any(axis=1)].mean())
    assert lengths[0] < 35 < lengths[1] < 80 < lengths[2] < 140


def test_without_a_curriculum_all_gaps_have_one_length():
    net = network(**SMALL, curriculum=0, gap=60)
    gone = ~batch_of(net, *windows(count=16))["known"].numpy()
    assert set(gone[..., 0].sum(axis=1)) == {60}


def test_a_network_that_begins_at_zeros_makes_no_curves(monkeypatch):
    """They cost nearly all of a batch and were multiplied by nothing; what is known is as it was with them."""
    positions, observed = windows()
    observed[:, 80:160] = False
    observed[:, :, 5] = False
    rows, known = (SPACES[name]().encode(positions, observed) for name in ("body_rows", "seen_rows"))
    there = rows[0]["known"].repeat(3, axis=2)
    assert np.array_equal(rows[0]["rows"][there], known[0]["rows"][there])
    assert not np.array_equal(rows[0]["rows"], known[0]["rows"])

    def never(*_):
        raise AssertionError("a curve was made")

    monkeypatch.setattr(spaces, "along_bones", never)
    for net in (network(**SMALL), network(Holden, HoldenConfig, features=4, width=5)):
        net.batch(*windows(), np.random.default_rng(0), 3000)
    with pytest.raises(AssertionError, match="a curve was made"):
        network(**SMALL, begin="curve").batch(*windows(), np.random.default_rng(0), 3000)


def test_rows_are_normalised_by_what_was_measured():
    net = network(**SMALL)
    positions, observed = windows(count=4)
    net.measure(positions, observed)
    rows = SPACES["body_rows"]().encode(positions, observed)[0]["rows"].reshape(-1, ROWS)
    moving = rows.std(axis=0) > 0.002
    normal = net.normalised(torch.from_numpy(rows)).numpy()
    np.testing.assert_allclose(normal.mean(axis=0), 0, atol=2e-3)
    np.testing.assert_allclose(normal.std(axis=0)[moving], 1, atol=2e-3)
    assert not normal[:, :3].any()


@pytest.mark.parametrize("fields", [{"error": "l1"}, {"error": "l2"}, {"error": "rms", "begin": "curve"}], ids=str)
def test_training_lowers_every_kind_of_loss(fields):
    net = network(**SMALL, skips=True, **fields).train()
    positions, observed = windows(count=4)
    net.measure(positions, observed)
    batch = batch_of(net, positions, observed, step=7000)
    losses = losses_of(net, batch, 40, 3e-3)
    assert losses[-1] < 0.8 * losses[0]


def test_joints_that_a_take_lacks_are_not_in_the_loss():
    net = network(**SMALL)
    positions, observed = windows()
    observed[:, :, -1] = False
    poisoned = np.where(observed[..., None], positions, np.float32(np.nan))
    batch = batch_of(net, poisoned, observed)
    assert not batch["weight"][..., -2].any() and all(each.isfinite().all() for each in batch.values())


def test_the_manifold_in_use_gives_half_of_each_value_to_both_frames():
    net = network(Holden, HoldenConfig, features=4, width=1)
    rows, known = torch.randn(1, 6, ROWS), torch.ones(1, 6, ROWS // 3)
    inward = net.inward(net.normalised(rows).transpose(1, 2)).relu()
    pooled = torch.maximum(inward[..., ::2], inward[..., 1::2]).repeat_interleave(2, dim=2) / 2
    np.testing.assert_allclose(
        net.answer(rows, known, known).detach(), net.outward(pooled).transpose(1, 2).detach(), atol=1e-6
    )
