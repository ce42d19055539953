"""TrajeVAE and its recurrent baseline as the paper has them: what is shared, what is seen, and what is drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct as scipy_dct

torch = pytest.importorskip("torch")

from learning import losses_of  # noqa: E402
from motionmend.body.joints import JOINT  # noqa: E402
from motionmend.errors import InputError  # noqa: E402
from motionmend.networks.models import trajevae  # noqa: E402
from motionmend.networks.models.cvae_rnn import CVAERNN, CVAERNNConfig  # noqa: E402
from motionmend.networks.models.trajevae import Layer, TrajeVAE, TrajeVAEConfig, path_batch  # noqa: E402
from motionmend.networks.spaces import FirstPelvis, turned  # noqa: E402
from walks import walk  # noqa: E402

OURS = {"standardised": True, "along": True, "direct": True, "patch": 4, "hips": 1.0, "bones": 2.0}


def network(joints: int = 21, **fields) -> TrajeVAE:
    torch.manual_seed(0)
    return TrajeVAE(TrajeVAEConfig(**{"size": "small", **fields}), joints).eval()


def baseline(**fields) -> CVAERNN:
    torch.manual_seed(0)
    return CVAERNN(CVAERNNConfig(**{"hidden": 16, "wide": (24,), "latent": 8, **fields}), 21).eval()


def parameters(module) -> int:
    return sum(each.numel() for each in module.parameters())


def windows(count: int = 4, joints: int = 21) -> tuple[np.ndarray, np.ndarray]:
    take = walk(50.0)
    starts = np.linspace(0, len(take) - 101, count).astype(int)
    positions = take.positions[starts[:, None] + np.arange(101)][:, :, :joints]
    return positions, np.ones(positions.shape[:3], bool)


def tensors(arrays: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(np.ascontiguousarray(each)) for name, each in arrays.items()}


def batch(net, count: int = 4, seed: int = 0) -> dict[str, torch.Tensor]:
    return tensors(net.batch(*windows(count, net.joints), np.random.default_rng(seed), 0))


def inputs(count: int = 2, joints: int = 21, shown=("left_hand", "right_foot")) -> dict[str, torch.Tensor]:
    positions, observed = windows(count, joints)
    observed[:, 1:] = np.isin(np.arange(joints), [JOINT[name] for name in shown])
    return tensors(FirstPelvis().encode(positions, observed)[0])


@torch.inference_mode()
def answer(net, noise=None, **given) -> np.ndarray:
    given = given or inputs(joints=net.joints)
    rows = len(given["pose"])
    return net(**given, noise=torch.zeros(rows, net.noise_size) if noise is None else noise).numpy()


# Sizes, and who shares what


def test_the_papers_size_and_what_its_encoders_share():
    net = network(size="paper")
    assert net.noise_size == 100 * 512
    assert net.joined[0].in_features == 768  # appendix B
    layer = 4 * 512 * 512 + 4 * 512 + 2 * (512 * 512 + 512) + 4 * 512
    stack = 2 * layer + 2 * 512
    heads = 2 * (512 * 512 + 512)
    assert parameters(net.over_time) == parameters(net.over_coefficients) == parameters(net.decoder) == stack
    assert parameters(net.prior) == parameters(net.posterior) == stack + heads
    encoder = 63 * 256 + 256 + 256 * 256 + 256 + 4 * 256
    around = 768 * 512 + 512 * 512 + 512 * 512 + 512 * 63 + 3 * 512 + 63 + 4 * 512
    assert parameters(net) == 5 * stack + 2 * heads + 2 * encoder + around == 17_955_391
    assert parameters(network(size="paper", prior="standard")) == parameters(net) - stack - heads
    ends = {id(each) for each in net.posterior.parameters()}
    assert not ends & {id(each) for each in net.prior.parameters()}


def test_the_baseline_has_the_papers_size():
    net = CVAERNN(CVAERNNConfig(), 21)
    assert net.noise_size == 256 and net.step.cell.input_size == 2 * 63 + 256 + 128
    assert net.paths.hidden_size * 2 == net.step.cell.hidden_size == 128
    assert parameters(net) == 810_099


def test_a_layer_is_torchs_own():
    torch.manual_seed(0)
    ours = Layer(32, 4, 0.1).eval()
    theirs = torch.nn.TransformerEncoderLayer(32, 4, 32, 0.1, batch_first=True).eval()
    pairs = {"query_key_value": ("self_attn.in_proj_weight", "self_attn.in_proj_bias"),
             "out": ("self_attn.out_proj.weight", "self_attn.out_proj.bias"),
             "inward": ("linear1.weight", "linear1.bias"), "outward": ("linear2.weight", "linear2.bias"),
             "norm_attention": ("norm1.weight", "norm1.bias"), "norm_mlp": ("norm2.weight", "norm2.bias")}  # fmt: skip
    state = ours.state_dict()
    theirs.load_state_dict({other: state[f"{name}.{part}"] for name, others in pairs.items()
                            for part, other in zip(("weight", "bias"), others)})  # fmt: skip
    x = torch.randn(3, 7, 32)
    with torch.no_grad():
        torch.testing.assert_close(ours(x), theirs(x), atol=1e-5, rtol=1e-5)


# Mathematics


def test_attention_begins_as_torchs_own_where_it_is_asked_to():
    torch.manual_seed(0)
    theirs = torch.nn.MultiheadAttention(192, 4)
    for xavier in (False, True):
        net = TrajeVAE(TrajeVAEConfig(size="small", xavier=xavier), 21)
        ours = [each for each in net.modules() if isinstance(each, Layer)]
        spread = float(np.mean([each.query_key_value.weight.detach().std() for each in ours]))
        wanted = float(theirs.in_proj_weight.detach().std())
        assert (abs(spread - wanted) < 0.02 * wanted) == xavier
        assert all(not each.query_key_value.bias.any() and not each.out.bias.any() for each in ours) == xavier


def test_the_cosine_transform_is_scipys_and_orthonormal():
    cosines = trajevae.dct(100)
    x = np.random.default_rng(0).normal(size=(100, 5)).astype(np.float32)
    np.testing.assert_allclose(cosines.numpy() @ x, scipy_dct(x, axis=0, norm="ortho"), atol=1e-5)
    torch.testing.assert_close(cosines.T @ cosines, torch.eye(100), atol=1e-5, rtol=0)
    assert network(coefficients=20).noise_size == 20 * 192
    torch.testing.assert_close(network(dct=False).cosines, torch.eye(100))


def test_the_divergence_is_torchs():
    torch.manual_seed(1)
    q, p = ((torch.randn(4, 5), torch.randn(4, 5)) for _ in range(2))
    normals = [torch.distributions.Normal(mean, (log / 2).exp()) for mean, log in (q, p)]
    torch.testing.assert_close(trajevae.kl(q, p), torch.distributions.kl_divergence(*normals))


def test_codes_of_positions_are_sines_and_cosines_in_turn():
    codes = trajevae.sines(100, 8).numpy()
    np.testing.assert_allclose(codes[7, :4], [np.sin(7), np.cos(7), np.sin(0.7), np.cos(0.7)], atol=1e-6)


# Noise


@pytest.mark.parametrize("net", [network(), network(**OURS)], ids=["paper", "ours"])
def test_noise_of_zeros_decodes_the_priors_mean_and_other_noise_differs(net):
    if net.config.standardised:
        torch.nn.init.normal_(net.offsets[-1].weight, std=0.1)
    given = inputs()
    rng = np.random.default_rng(0)
    noise = torch.from_numpy(rng.standard_normal((2, net.noise_size), dtype=np.float32))
    mean, drawn, again, other = answer(net), answer(net, noise), answer(net, noise), answer(net, noise.flip(1))
    assert np.array_equal(drawn, again)
    assert np.abs(drawn - mean).max() > 1e-3 and np.abs(drawn - other).max() > 1e-3
    net.prior.log_variance.register_forward_hook(lambda _, __, out: torch.full_like(out, -12.0))
    np.testing.assert_allclose(answer(net, noise, **given), mean, atol=0.05)


# What is seen


def seen_by(net, given: dict[str, torch.Tensor]) -> list[torch.Tensor]:
    """What the MLP of frames is told: of trajectories, then of poses."""
    told = []
    hook = net.frame_mlp.register_forward_pre_hook(lambda _, arguments: told.append(arguments[0].detach()))
    net.loss(given, 0)
    hook.remove()
    return told


@pytest.mark.parametrize("mask_future", [True, False])
def test_the_posterior_sees_the_joints_that_are_not_given(mask_future):
    net = network(mask_future=mask_future, given=0.5)
    given = batch(net)
    paths, poses = (each.unflatten(-1, (21, 3)) for each in seen_by(net, given))
    shown = given["given"]
    torch.testing.assert_close(paths, given["trajectories"])
    assert not paths[~shown].any() and paths[shown].any(-1).all()
    assert poses[~shown].any(-1).all()
    assert poses[shown].any() != mask_future


@pytest.mark.parametrize("fields", [{}, OURS], ids=["paper", "ours"])
def test_what_is_not_given_or_not_observed_changes_nothing(fields):
    net = network(given=0.5, **fields)
    positions, observed = windows()
    observed[0, :, 12] = False
    observed[1, 40:60] = False
    observed[2, 0, 5] = False
    hidden = np.where(observed[..., None], positions, np.float32(np.nan))
    made = net.batch(hidden, observed, np.random.default_rng(0), 0)
    junk = net.batch(np.where(observed[..., None], positions, 1e3), observed, np.random.default_rng(0), 0)
    for name, values in made.items():
        np.testing.assert_array_equal(values, junk[name], err_msg=name)
        assert np.isfinite(values).all()
    assert not made["wanted"][~observed[:, 1:]].any()
    assert not made["wanted"][2, :, 5].any()  # nothing that its offsets could be added to
    assert made["wanted"][3].all()
    given = tensors(made)
    given["future"][~given["wanted"]] = 7.0
    losses = []
    for future in (given["future"], given["future"] * given["wanted"][..., None]):
        torch.manual_seed(0)
        losses.append(net.loss({**given, "future": future}, 0)["loss"])
    torch.testing.assert_close(*losses)


@pytest.mark.parametrize("spans", [0.0, 1.0])
def test_joints_are_given_over_the_whole_window_or_a_span(spans):
    config = TrajeVAEConfig(spans=spans, given=0.15)
    positions, observed = windows(64)
    given = path_batch(config, positions, observed, np.random.default_rng(0))["given"]
    ever = given.any(axis=1)
    np.testing.assert_allclose(ever.mean(), 0.15, atol=0.03)
    whole = given.all(axis=1)
    assert (whole == ever).all() if not spans else whole.sum() < 0.1 * ever.sum()
    starts = (np.diff(given.astype(int), axis=1, prepend=0) > 0).sum(axis=1)
    assert starts.max() == 1  # one span, without holes
    share = given.sum(axis=1).max(axis=1)[ever.any(axis=1)] / 100
    np.testing.assert_allclose(share.mean(), 1 / 3 if spans else 1, atol=0.1)


def test_training_turns_whole_windows_about_the_first_pelvis():
    positions, observed = windows(3)
    made = path_batch(TrajeVAEConfig(given=1.0), positions, observed, np.random.default_rng(0))
    plain = FirstPelvis().encode(positions, observed)[0]
    together = [np.concatenate([each["pose"][:, None], each[key]], axis=1)
                for each, key in ((made, "future"), (plain, "trajectories"))]  # fmt: skip
    assert np.abs(together[0] - together[1]).max() > 0.1
    np.testing.assert_allclose(*(np.linalg.norm(each, axis=-1) for each in together), atol=1e-4)
    np.testing.assert_allclose(together[0][..., 1], together[1][..., 1], atol=1e-6)


# Ours


def test_standardised_networks_answer_alike_whichever_way_a_body_faces():
    net = network(**OURS)
    torch.nn.init.normal_(net.offsets[-1].weight, std=0.1)
    given = inputs()
    angles = np.array([0.7, -2.0])
    other = {name: torch.from_numpy(turned(each.numpy(), angles)) if name != "given" else each
             for name, each in given.items()}  # fmt: skip
    np.testing.assert_allclose(answer(net, **other), turned(answer(net, **given), angles), atol=1e-4)


def test_an_untrained_network_of_ours_stands_still_or_goes_along():
    given = inputs()
    pose = given["pose"][:, None].numpy()
    np.testing.assert_allclose(answer(network(standardised=True)), np.broadcast_to(pose, (2, 100, 21, 3)), atol=0.01)
    paths, shown = given["trajectories"].numpy(), given["given"].numpy()
    along = answer(network(**OURS), **given)
    np.testing.assert_allclose(along[shown], paths[shown], atol=1e-6)
    gone = paths - pose
    hand, foot = JOINT["left_hand"], JOINT["right_foot"]
    carried = gone[:, :, [hand, foot]]
    for joint, (nearer, farther) in {"left_forearm": (0, 1), "right_shin": (1, 0)}.items():
        went = (along - pose)[:, :, JOINT[joint]]
        assert (np.linalg.norm(went - carried[:, :, nearer], axis=-1).mean()
                < 0.5 * np.linalg.norm(went - carried[:, :, farther], axis=-1).mean())  # fmt: skip
    alone = {**given, "given": given["given"].clone()}
    alone["given"][..., foot] = False
    went = answer(network(**OURS), **alone) - pose
    np.testing.assert_allclose(went, np.broadcast_to(gone[:, :, [hand]], went.shape), atol=0.01)


def test_joints_are_as_far_apart_as_the_bones_between_them():
    paths = trajevae.bone_paths().numpy()
    knee, foot, toe, hips = (JOINT[name] for name in ("left_shin", "left_foot", "left_toe", "hips"))
    np.testing.assert_allclose(paths, paths.T)
    np.testing.assert_allclose(paths[knee, toe], paths[knee, foot] + paths[foot, toe], rtol=1e-6)
    assert 0.9 < paths[hips, foot] < 1.1 and np.isfinite(paths).all()


def test_the_error_is_also_of_joints_from_each_other():
    missed = torch.zeros(1, 100, 21, 3)
    missed[..., JOINT["left_hand"], 0] = 0.1
    wanted = torch.ones(1, 100, 21, dtype=torch.bool)
    for fields, shares in (({}, 1), ({"hips": 3.0}, 4), ({"bones": 3.0}, 4), ({"hips": 1.0, "bones": 1.0}, 3)):
        error = network(**fields)._error(missed, wanted)
        torch.testing.assert_close(error, torch.tensor([float(shares)]))
    moved = torch.full_like(missed, 0.1)
    torch.testing.assert_close(network(hips=9.0, bones=9.0)._error(moved, wanted), torch.tensor([63.0]))


def test_answers_that_are_no_sums_are_smooth_and_leave_the_first_pose_slowly():
    net = network(standardised=True, direct=True)
    torch.nn.init.normal_(net.offsets[-1].weight)
    gone = answer(net) - inputs()["pose"][:, None].numpy()
    slow = gone / np.minimum(np.arange(1, 101), 25)[:, None, None]
    assert np.abs(scipy_dct(slow, axis=1, norm="ortho")[:, 32:]).max() < 1e-4 * np.abs(slow).max()


def test_patches_make_one_token_of_some_frames():
    net = network(**OURS)
    assert net.noise_size == 25 * 192 and net.frame_mlp[0].in_features == 4 * 7 * 21
    assert net.offsets[-1].out_features == 4 * 63
    with pytest.raises(InputError, match="patches of 3 frames"):
        network(patch=3)


def test_the_divergence_gains_weight_over_the_first_steps():
    net = network(**OURS, climb=1000)
    for step, weight in ((0, 0), (500, 0.005), (5000, 0.01)):
        losses = net.loss(batch(net), step)
        torch.testing.assert_close(losses["loss"], losses["error"] + weight * losses["kl"])


# Training


SWITCHES = {
    "paper": {}, "base": {"prior": "standard", "dct": False, "mask_future": False},
    "+ prior": {"dct": False, "mask_future": False}, "+ DCT": {"mask_future": False},
    "ours": {**OURS, "coefficients": 20, "spans": 0.5, "mirror": True, "resize": 0.1, "dropout": 0.0},
}  # fmt: skip


@pytest.mark.parametrize("fields", SWITCHES.values(), ids=SWITCHES)
def test_every_switch_runs_and_every_parameter_learns(fields):
    net = network(**fields).train()
    if net.config.standardised:  # behind weights of zero nothing learns in the first step
        torch.nn.init.normal_(net.offsets[-1].weight, std=0.1)
    losses = net.loss(batch(net), 0)
    torch.testing.assert_close(losses["loss"], losses["error"] + 0.01 * losses["kl"])
    losses["loss"].mean().backward()
    idle = [name for name, each in net.named_parameters() if each.grad is None or not each.grad.any()]
    assert not idle


@pytest.mark.parametrize("net", [network(17), network(17, dct=False)], ids=["17 joints", "frames"])
def test_other_bodies_have_other_numbers_of_joints(net):
    assert net.loss(batch(net), 0)["loss"].isfinite().all()
    assert answer(net).shape == (2, 100, 17, 3)
    with pytest.raises(InputError, match="17 joints to mirror"):
        network(17, mirror=True)


@pytest.mark.parametrize("net", [network(dropout=0.0), network(**OURS, dropout=0.0), baseline()],
                         ids=["paper", "ours", "baseline"])  # fmt: skip
def test_on_a_handful_of_windows_it_learns(net):
    given = batch(net.train(), count=2)
    losses = losses_of(net, given, 12, 3e-3 if isinstance(net, TrajeVAE) else 2e-2)
    assert losses[-1] < 0.5 * losses[0]


@pytest.mark.parametrize("net", [network(**OURS), baseline()], ids=["ours", "baseline"])
def test_losses_in_half_precision_are_nearly_those_in_single(net):
    given = batch(net)
    losses = []
    for half in (False, True):
        torch.manual_seed(0)
        with torch.autocast("cpu", torch.bfloat16, enabled=half), torch.no_grad():
            losses.append(net.loss(given, 0)["error"])
    torch.testing.assert_close(losses[1], losses[0], rtol=0.02, atol=0.1)


# The baseline


def test_the_baseline_draws_one_vector_and_follows_its_own_poses():
    net = baseline()
    given = inputs()
    assert net.noise_size == 8
    plain, other = answer(net, **given), answer(net, torch.ones(2, 8), **given)
    assert plain.shape == (2, 100, 21, 3) and np.abs(plain - other).max() > 1e-3
    torch.nn.init.zeros_(net.step.pose.weight)
    assert np.allclose(np.diff(answer(net, **given), axis=1), 0)


def test_the_baselines_graph_reads_as_its_torch_does():
    """Scans in the graph, loops and torch's GRU in training: `torch.export` runs the first."""
    net, given = baseline(), inputs()
    arguments = {**given, "noise": torch.ones(2, 8)}
    with torch.no_grad():
        exported = torch.export.export(net, (), arguments).module()(**arguments)
    np.testing.assert_allclose(exported.numpy(), answer(net, torch.ones(2, 8), **given), atol=1e-5)
