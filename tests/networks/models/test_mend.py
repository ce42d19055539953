"""The house network: its curves are the fills', its gaps are what was asked for, and its loop goes on where it was."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest

from motionmend.body.joints import BODY, JOINT
from motionmend.constraints.contacts import STANDING_JOINTS, standing
from motionmend.fills.curves import CARRY_SECONDS
from motionmend.fills.points import FILLS
from motionmend.motion import Motion, runs
from motionmend.networks.gap_curves import MOST, eased
from motionmend.networks.gap_draws import CONTEXT, Shares, draw
from motionmend.networks.gap_space import OUTPUTS, BesideCurves
from motionmend.networks.spaces import mirrored
from motionmend.networks.windows import cut
from walks import walk

FRAMES = 96
LEG = [JOINT["left_shin"], JOINT["left_foot"], JOINT["left_toe"]]


def windows(count: int = 4):
    """Windows of a real walk at 30 fps."""
    take = walk(30.0)
    starts = np.linspace(0, max(0, len(take) - FRAMES), count).astype(int)
    positions = cut(take.positions, starts, FRAMES)
    return positions.copy(), np.ones(positions.shape[:3], bool)


def filled(name: str, positions, observed):
    holed = np.where(observed[..., None], positions, np.float32(np.nan))
    takes = (Motion(each, seen, 30.0, BODY) for each, seen in zip(holed, observed))
    return np.stack([FILLS[name].complete(take).positions for take in takes])


@pytest.mark.parametrize("hole", [
    ("eased", slice(30, 31), slice(None)), ("eased", slice(20, 60), slice(None)), ("eased", slice(4, 90), slice(None)),
    ("eased", slice(70, 96), slice(None)), ("eased", slice(0, 20), slice(None)), ("bones", slice(20, 60), LEG),
])  # fmt: skip
def test_the_curve_is_the_fills(hole):
    name, frames, joints = hole
    positions, observed = windows()
    observed[:, frames, joints] = False
    curve, envelope = eased(positions, observed)
    np.testing.assert_allclose(curve, filled(name, positions, observed), atol=1e-4)
    assert np.array_equal(envelope > 0, ~observed) or (envelope[observed] == 0).all()


def test_seams_with_few_samples_beside_them_are_crossed_as_by_the_fill():
    positions, observed = windows()
    observed[:] = False
    for row, near in enumerate((1, 2, 3, 4)):
        observed[row, 30 - near : 30] = observed[row, 50 : 50 + near] = True
    inside = slice(30, 50)
    curve, reference = eased(positions, observed)[0], filled("eased", positions, observed)
    np.testing.assert_allclose(curve[2:, inside], reference[2:, inside], atol=1e-4)  # where a parabola can be measured
    assert CARRY_SECONDS == 0.75  # what gap_curves was checked with


def test_the_envelope_grows_with_the_gap_and_to_its_middle():
    positions, observed = windows(3)
    observed[0, 40:45], observed[1, 30:60], observed[2, 60:] = False, False, False
    envelope = eased(positions, observed)[1][..., 0]
    assert envelope[0].max() < envelope[1].max() < MOST
    assert envelope[1].argmax() in (44, 45) and envelope[1, 30] < envelope[1, 35] < envelope[1, 44]
    assert (np.diff(envelope[2, 60:]) >= 0).all()  # the farther from the only seam


def test_what_was_never_seen_hangs_on_its_parent_as_usual():
    positions, observed = windows(1)
    observed[:, :, LEG] = False
    curve = eased(positions, observed)[0]
    below = curve[0, :, JOINT["left_foot"]] - positions[0, :, JOINT["left_thigh"]]
    assert (below[:, 1] < -0.6).all() and np.abs(below[:, [0, 2]]).max() < 0.2
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float32)
    np.testing.assert_allclose(eased(positions @ turn.T, observed)[0], curve @ turn.T, atol=1e-5)


def test_an_answer_of_nothing_is_the_curve_wherever_a_body_stands_and_faces():
    positions, observed = windows()
    observed[:, 30:60] = False
    space = BesideCurves()
    inputs, known = space.encode(positions, observed)
    answer = space.decode(np.zeros((4, FRAMES, OUTPUTS), np.float32), known)
    np.testing.assert_allclose(answer, eased(positions, observed)[0], atol=1e-6)
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float32)
    elsewhere, _ = space.encode(positions @ turn.T + np.array([3, 0, -7], np.float32), observed)
    np.testing.assert_allclose(elsewhere["frames"], inputs["frames"], atol=1e-3)


def test_gaps_are_what_was_asked_for():
    observed = np.ones((2000, FRAMES, len(BODY)), bool)
    observed[:100, :20] = False  # before a take begins
    asked, hidden = draw(observed, np.random.default_rng(0), Shares(again=0))
    assert not (asked & ~hidden).any() and not (asked & ~observed).any()
    joints = asked.any(axis=1).sum(axis=1)
    assert 0.5 < (joints == len(BODY)).mean() < 0.7 and (joints > 0).all()
    lengths = asked.any(axis=2).sum(axis=1)
    whole = joints == len(BODY)
    assert lengths[whole].min() == 3 and 60 < lengths[whole].max() <= 72
    assert np.median(lengths) < 25  # short ones are as many as long ones
    seen = observed & ~hidden
    first = asked.any(axis=2).argmax(axis=1)
    assert (seen.any(axis=2).sum(axis=1)[whole] >= 3).all()
    assert first[whole][:50].min() >= CONTEXT
    ends = [not seen[row, first[row] :].any() or not seen[row, : first[row]].any() for row in np.flatnonzero(whole)]
    assert 0.05 < np.mean(ends) < 0.15


def test_gaps_come_again_with_context_between():
    observed = np.ones((500, FRAMES, len(BODY)), bool)
    asked, hidden = draw(observed, np.random.default_rng(0), Shares(again=1, lonely=0, ends=0, throughout=0))
    assert np.array_equal(asked, hidden)
    many = 0
    for row in asked.any(axis=2):
        holes = runs(row)
        assert len({stop - start for start, stop in holes}) == 1  # all as long as the one that was drawn
        seen = [after[0] - before[1] for before, after in pairwise(holes)]
        assert holes[0][0] >= CONTEXT and holes[-1][1] <= FRAMES - CONTEXT and min(seen, default=8) >= 8
        many += len(holes) > 1
    assert many > 250


def test_feet_stand_where_they_do_not_move():
    positions, observed = windows(1)
    stands, known = standing(positions, observed, 30.0)
    left, right = stands[0, :, 1], stands[0, :, 3]
    assert 0.3 < left.mean() < 0.9 and 0.3 < right.mean() < 0.9 and (left | right)[known[0, :, 1]].mean() > 0.6
    still = np.repeat(positions[:, :1], FRAMES, axis=1)
    assert standing(still, observed, 30.0)[0][:, 1:-1, 1].all()
    observed[:, 50, STANDING_JOINTS[1]] = False
    assert not standing(positions, observed, 30.0)[1][0, 49:52, 1].any()


def test_mirrored_twice_is_as_it_was():
    positions, observed = windows()
    which = np.array([True, False, True, False])
    once = mirrored(positions, observed, which)
    assert np.array_equal(once[0][1], positions[1])
    assert np.array_equal(once[0][0, :, JOINT["left_hand"], 0], -positions[0, :, JOINT["right_hand"], 0])
    assert np.array_equal(mirrored(*once, which)[0], positions)


# With torch


@pytest.fixture
def corpus(tmp_path):
    from motionmend.corpora.corpus import ClipInfo
    from motionmend.corpora.writing import write_corpus

    take = walk(30.0)
    there_and_back = np.concatenate([take.positions, take.positions[::-1]])
    take = Motion(there_and_back, np.ones(there_and_back.shape[:2], bool), 30.0, BODY)
    clips = [
        (ClipInfo(f"{split}{number}", split=split), take) for split in ("train", "validation") for number in (0, 1)
    ]
    return write_corpus(tmp_path / "walk.corpus", name="walk", fps=30.0, skeleton=BODY, clips=clips)


def test_moments_are_the_takes_own(corpus):
    pytest.importorskip("torch")
    from motionmend.training.moments import Moments

    moments = Moments([corpus], FRAMES)
    positions, observed = moments.at(np.array([0]), np.arange(-3.0, 20.0)[None])
    assert not observed[0, :3].any() and observed[0, 3:].all()
    assert np.array_equal(positions[0, 3:], corpus.motion(corpus.clips[0]).positions[:20])
    halves, seen = moments.at(np.array([1]), np.arange(4.5, 20.0)[None])
    between = corpus.motion(corpus.clips[1]).positions[4:21]
    assert seen.all() and np.abs(halves[0] - (between[:-1] + between[1:])[: len(halves[0])] / 2).max() < 0.02
    drawn, there = moments.drawn(np.random.default_rng(0).random((4, 64)))
    assert drawn.shape == (64, FRAMES, len(BODY), 3) and there.any(axis=(1, 2)).all()
    assert np.array_equal(np.isfinite(drawn).all(axis=-1), there)


def test_a_network_learns_one_batch():
    torch = pytest.importorskip("torch")
    from motionmend.networks.models.mend import Mend, MendConfig
    from motionmend.training.optimisers import MuonAndAdam

    torch.manual_seed(0)
    network = Mend(MendConfig(width=64, depth=2, aside=32), len(BODY))
    batch = network.batch(*windows(16), np.random.default_rng(0), 0)
    tensors = {name: torch.from_numpy(np.ascontiguousarray(each)) for name, each in batch.items()}
    optimiser = MuonAndAdam(network, lr=3e-3, betas=(0.9, 0.98))
    first = network.loss(tensors, 0)
    for _ in range(40):
        optimiser.zero_grad()
        network.loss(tensors, 0)["loss"].mean().backward()
        optimiser.step()
    last = network.loss(tensors, 0)
    for name, share in {"fill": 0.6, "foretold": 0.8, "standing": 0.9}.items():
        assert last[name].mean() < share * first[name].mean(), name


def test_what_is_said_beside_the_fill_does_not_move_it():
    torch = pytest.importorskip("torch")
    from motionmend.networks.models.mend import Mend, MendConfig

    network = Mend(MendConfig(width=64, depth=1, aside=32), len(BODY))
    batch = network.batch(*windows(4), np.random.default_rng(0), 0)
    tensors = {name: torch.from_numpy(np.ascontiguousarray(each)) for name, each in batch.items()}
    said = network(frames=tensors["frames"], envelope=tensors["envelope"])[..., 3 * len(BODY) :]
    said.sum().backward()
    moved = {
        name.split(".")[0] for name, each in network.named_parameters() if each.grad is not None and each.grad.any()
    }
    assert moved == {"aside"}


def test_it_trains_as_the_others_do_and_goes_on_where_it_was(corpus, tmp_path):
    torch = pytest.importorskip("torch")
    from motionmend.networks.models.mend import Mend
    from motionmend.training import state
    from motionmend.training.config import settle
    from motionmend.training.loop import train
    from toys import no_export

    said = {"corpus": [str(corpus.path)], "batch": 4, "warmup": 1, "precision": "fp32", "validation_windows": 2,
            "network": {"width": 64, "depth": 1, "aside": 32}}  # fmt: skip

    def run(name: str, steps: int, resume: bool = False):
        assert train(settle("mend", Mend, said, {"steps": steps, "schedule": "constant"}), tmp_path / name,
                     resume=resume, export=no_export) == 0  # fmt: skip
        return state.load(tmp_path / name / "last.safetensors")[0]

    whole, _, parts = run("whole", 4), run("parts", 2), run("parts", 4, resume=True)
    assert any("momentum_buffer" in name for name in whole)
    assert whole.keys() == parts.keys() and all(torch.equal(whole[name], parts[name]) for name in whole)
    lines = [json.loads(line) for line in (tmp_path / "parts" / "log.jsonl").read_text().splitlines()]
    scored = [line for line in lines if "mean share" in str(line)]
    assert len(scored) == 2 and 0.5 < json.loads(json.dumps(scored[-1]))["validation"]["mean share"] < 1.5


@pytest.mark.parametrize("shape", [(24, 8), (8, 24), (16, 16)])
def test_muon_is_torchs(shape):
    torch = pytest.importorskip("torch")
    if not hasattr(torch.optim, "Muon"):
        pytest.skip("torch has had Muon since 2.9")
    from motionmend.training.optimisers import DECAY, MOMENTUM, Muon, orthogonal

    torch.manual_seed(0)
    ours, theirs = (torch.nn.Parameter(torch.ones(shape)) for _ in range(2))
    reference = torch.optim.Muon(
        [theirs], lr=0.1, momentum=MOMENTUM, weight_decay=DECAY, adjust_lr_fn="match_rms_adamw"
    )
    optimiser = Muon([ours], 0.1, torch.bfloat16)
    for _ in range(3):
        ours.grad = torch.randn(shape)
        theirs.grad = ours.grad.clone()
        optimiser.step()
        reference.step()
    torch.testing.assert_close(ours, theirs, atol=2e-3, rtol=0)
    values = torch.linalg.svdvals(orthogonal(torch.randn(shape)))
    assert values.min() > 0.2 and values.max() < 1.4 and values.median() > 0.6


def test_the_faster_arithmetic_is_measured():
    torch = pytest.importorskip("torch")
    from motionmend.training import arithmetic

    assert arithmetic.faster(torch.device("cpu")) in ("bf16", "fp32")
