"""What every network must keep, whichever it is: registered ones join by their line in `models.NETWORKS` alone.

A network may name small configurations for this suite in `TRIALS`: name → fields of its Config.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

import onnx
import torch

import motionmend as mm
from motionmend.body.joints import BODY, JOINT
from motionmend.body.mapping import map_rig
from motionmend.errors import InputError
from motionmend.motion import Motion, Skeleton
from motionmend.networks import checkpoints, completers, loading, windows
from motionmend.networks.completers import NetworkCompleter
from motionmend.networks.export import export, halved
from motionmend.networks.loading import load_completer, module_completer
from motionmend.networks.models import NETWORKS, network_class
from tiny import Tiny, TinyDream
from walks import WALK, hidden, spy, walk
from workers import built_once

KINDS = [Tiny, TinyDream, *map(network_class, NETWORKS)]
TRIALS = {f"{kind.name}-{name}".rstrip("-"): (kind, fields) for kind in KINDS for name, fields in kind.TRIALS.items()}
# Variants whose graphs hold nothing that no other's does.
SLOW = {"xmae-small", "xmae-large", "xmae-mae", "xmae-bert", "xmae-letter", "convae-vanilla"}
# What is asked of the export rather than of the network: a plain one, one with attention, one that samples.
PLAIN = {"tiny", "xmae-default", "trajevae"}


def trials(quick) -> list:
    """All trials, those in `quick` for the quick suite."""
    return [pytest.param(name, marks=[] if name in quick else [pytest.mark.slow]) for name in TRIALS]


class Trial:
    def __init__(self, kind, fields):
        self.kind, self.folder = kind, Path()
        torch.manual_seed(0)
        self.network = halved(kind(kind.Config(**fields), len(BODY)))
        self.take = walk(kind.fps)

    def export(self, folder: Path) -> None:
        export(self.network, folder, skeleton=BODY, windows=self.windows(4))

    @cached_property
    def completer(self) -> NetworkCompleter:
        return load_completer(self.folder)

    def windows(self, count: int, seed: int = 0):
        """Real windows, each with another kind of damage: a gap of all joints, a limb, drop-outs, none."""
        rng = np.random.default_rng(seed)
        frames = self.kind.frames
        starts = np.linspace(0, len(self.take) - frames, count).astype(int)
        positions = windows.cut(self.take.positions, starts, frames).copy()
        observed = np.ones(positions.shape[:3], bool)
        for row in range(count):
            match row % 4:
                case 0:
                    observed[row, frames // 3 : 2 * frames // 3] = False
                case 1:
                    observed[row, :, [JOINT["left_forearm"], JOINT["left_hand"]]] = False
                case 2:
                    observed[row] = rng.random((frames, len(BODY))) > 0.5
        if self.kind.generative:
            observed[:, 0] = True
        positions[~observed] = np.nan
        return positions, observed

    def damaged(self, frames: int, fps: float | None = None) -> Motion:
        """A take of this many frames with gaps, a limb that is lost throughout, and drop-outs."""
        whole = windows.resample(walk(60.0), fps or self.kind.fps)
        whole = replace(whole, positions=windows.cut(whole.positions, np.array([0]), frames)[0],
                        observed=np.ones((frames, len(BODY)), bool))  # fmt: skip
        observed = np.random.default_rng(frames).random((frames, len(BODY))) > 0.1
        observed[frames // 4 : frames // 3] = False
        observed[-(frames // 5) :, JOINT["right_foot"]] = False
        observed[:, [JOINT["left_hand"]]] = False
        observed[:, JOINT["hips"]] |= ~observed.any(axis=1) & (np.arange(frames) == 0)
        if self.kind.generative:
            observed[0] = True
        return hidden(whole, observed)


@pytest.fixture(scope="session", params=trials(TRIALS))
def trial(request) -> Trial:
    """A network as training has it."""
    return Trial(*TRIALS[request.param])


@pytest.fixture(scope="session", params=trials(TRIALS.keys() - SLOW))
def exported(request, tmp_path_factory) -> Trial:
    """A network as its users have it, exported by the first worker that needs it."""
    kind, fields = TRIALS[request.param]
    trial = Trial(kind, fields)
    trial.folder = built_once(tmp_path_factory, f"{request.param}/{kind.name}", trial.export)
    return trial


# Training's side


def test_the_config_survives_json(trial):
    config = trial.network.config
    stored = json.loads(json.dumps(asdict(config)))
    again = {name: tuple(value) if isinstance(value, list) else value for name, value in stored.items()}
    assert trial.kind.Config(**again) == config


def test_a_batch_follows_from_its_chance_alone(trial):
    positions, observed = trial.windows(8)
    before = positions.copy(), observed.copy()
    one, same, other = (trial.network.batch(positions, observed, np.random.default_rng(seed), 0) for seed in (1, 1, 2))
    assert all(np.array_equal(one[name], same[name]) for name in one)
    assert any(not np.array_equal(one[name], other[name]) for name in one)
    for name, values in one.items():
        assert isinstance(values, np.ndarray) and len(values) == 8, name
        assert values.dtype != np.float64, f"{name} is float64"
        assert np.isfinite(values).all(), f"{name} holds what was not observed"
    assert np.array_equal(positions, before[0], equal_nan=True) and np.array_equal(observed, before[1])


@pytest.mark.parametrize("seen", ["some", "all", "none"])
def test_losses_are_one_a_row_and_gradients_finite(trial, seen):
    positions, observed = trial.windows(4)
    if seen != "some":
        observed = np.full(observed.shape, seen == "all")
        positions = np.where(observed[..., None], np.nan_to_num(positions), np.float32(np.nan))
    arrays = trial.network.batch(positions, observed, np.random.default_rng(3), 0)
    batch = {name: torch.from_numpy(each) for name, each in arrays.items()}
    network = trial.network.train()
    network.zero_grad()
    losses = network.loss(batch, 0)
    assert "loss" in losses
    assert all(values.shape == (4,) and values.isfinite().all() for values in losses.values())
    losses["loss"].mean().backward()
    gradients = [each.grad for each in network.parameters() if each.grad is not None]
    assert gradients and all(each.isfinite().all() for each in gradients)
    network.zero_grad(set_to_none=True)
    network.eval()


def test_an_answer_does_not_depend_on_what_else_is_asked(trial):
    """One query's loss alone, once beside these other queries and once beside those."""
    positions, observed = trial.windows(4)
    arrays = trial.network.batch(positions, observed, np.random.default_rng(3), 0)
    if arrays.get("asked", observed).ndim != 2:  # (B, Q), as tokens; a mask of samples is no query
        pytest.skip("it answers everything, always")
    asked, tokens = arrays["asked"], observed[0].size
    others = np.array([np.setdiff1d(np.arange(tokens), row)[: len(row) - 1] for row in asked])
    alone = np.zeros_like(arrays["weight"])
    alone[:, 0] = 1
    losses = []
    for rest in (asked[:, 1:], others):
        changed = {**arrays, "weight": alone, "asked": np.concatenate([asked[:, :1], rest], axis=1)}
        with torch.inference_mode():
            losses.append(trial.network.loss({name: torch.from_numpy(each) for name, each in changed.items()}, 0))
    np.testing.assert_allclose(losses[0]["loss"], losses[1]["loss"], rtol=1e-4)


# Windows


def test_the_graph_answers_as_the_network_does(exported):
    positions, observed = exported.windows(9, seed=5)
    answer = exported.completer.windows(positions, observed)
    assert answer.shape == positions.shape and answer.dtype == np.float32 and np.isfinite(answer).all()
    np.testing.assert_allclose(answer, module_completer(exported.network).windows(positions, observed), atol=1e-4)


@pytest.mark.parametrize("frames", [1, 2, 31, 33, 241, 1000])
def test_a_graph_for_any_length_answers_as_the_network_does(exported, frames):
    if not exported.kind.any_length:
        pytest.skip("its windows have one length")
    positions = windows.cut(exported.take.positions, np.array([0, 20]), frames)
    observed = np.ones(positions.shape[:3], bool)
    observed[0, frames // 3 : frames // 2], observed[1, :, 5] = False, False
    answer = exported.completer.windows(positions, observed)
    np.testing.assert_allclose(answer, module_completer(exported.network).windows(positions, observed), atol=1e-4)


def test_windows_in_one_batch_answer_as_they_do_alone(exported):
    positions, observed = exported.windows(5, seed=6)
    together = exported.completer.windows(positions, observed)
    alone = [exported.completer.windows(positions[row : row + 1], observed[row : row + 1])[0] for row in range(5)]
    np.testing.assert_allclose(together, alone, atol=1e-4)


def test_what_is_not_observed_is_not_read(exported):
    positions, observed = exported.windows(4)
    junk = np.where(observed[..., None], positions, np.float32(1e6))
    assert np.array_equal(exported.completer.windows(positions, observed), exported.completer.windows(junk, observed))


def test_windows_of_another_shape_are_refused_in_words(exported):
    positions, observed = exported.windows(2)
    with pytest.raises(InputError, match=r"knows 21 joints, the windows have 20"):
        exported.completer.windows(positions[:, :, 1:], observed[:, :, 1:])
    if not exported.completer.description.any_length:
        said = rf"windows of {exported.kind.frames} frames, not of {exported.kind.frames - 1}"
        with pytest.raises(InputError, match=said):
            exported.completer.windows(positions[:, 1:], observed[:, 1:])


def test_memory_is_bounded_by_batches(exported, monkeypatch):
    seen = []
    run = exported.completer.run
    completer = loading.completer(exported.completer.description, lambda inputs: spy(run, inputs, seen))
    tokens = exported.kind.frames * (1 if exported.kind.generative else len(BODY))
    monkeypatch.setattr(completers, "TOKENS", 3 * tokens)
    positions, observed = exported.windows(7)
    answer = completer.windows(positions, observed)
    np.testing.assert_allclose(answer, exported.completer.windows(positions, observed), atol=1e-4)
    assert seen == [3, 3, 1]


# Takes


LENGTHS = {
    "1": lambda _: 1, "2": lambda _: 2, "T-1": lambda window: window - 1, "T": lambda window: window,
    "T+1": lambda window: window + 1, "3T+7": lambda window: 3 * window + 7,
}  # fmt: skip


@pytest.mark.parametrize("length", LENGTHS.values(), ids=LENGTHS)
def test_takes_of_any_length_come_back_whole(exported, length):
    motion = exported.damaged(length(exported.kind.frames))
    filled = exported.completer.complete(motion)
    assert filled.observed.all() and np.isfinite(filled.positions).all()
    assert np.array_equal(filled.positions[motion.observed], motion.positions[motion.observed])
    assert filled.fps == motion.fps and filled.skeleton is motion.skeleton


@pytest.mark.parametrize("fps", [24.0, 59.94, 100.0, 240.0])
def test_takes_of_any_rate_come_back_whole(exported, fps):
    motion = exported.damaged(round(1.3 * fps), fps)
    filled = exported.completer.complete(motion)
    assert filled.observed.all() and np.isfinite(filled.positions).all()
    assert np.array_equal(filled.positions[motion.observed], motion.positions[motion.observed])
    assert len(filled) == len(motion) and filled.fps == fps
    raw = exported.completer.predict(motion)
    assert len(raw) == len(motion) and raw.observed.all() and np.isfinite(raw.positions).all()


def test_the_answer_is_the_same_each_time(exported):
    motion = exported.damaged(40)
    first, second = (load_completer(exported.completer.run.path.parent).complete(motion) for _ in range(2))
    assert np.array_equal(first.positions, second.positions)


def test_a_take_with_nothing_missing_or_nothing_there_comes_back_as_it_is(exported):
    def never(inputs):
        raise AssertionError("the network was run")

    completer = loading.completer(exported.completer.description, never)
    motion = exported.damaged(30)
    whole = replace(motion, positions=np.nan_to_num(motion.positions), observed=np.ones_like(motion.observed))
    nothing = hidden(motion, np.zeros_like(motion.observed))
    for take in (whole, nothing):
        back = completer.complete(take)
        assert back is take
    assert completer.predict(nothing) is nothing


def test_joints_that_are_none_of_the_network_stay(exported):
    motion = exported.damaged(35)
    names = (*(f"prop{each}" for each in range(2)), *BODY.names)
    parents = (-1, 0, *(parent + 2 if parent >= 0 else -1 for parent in BODY.parents))
    prop = np.full((35, 2, 3), np.nan, np.float32)
    prop[:, 0] = 7
    positions = np.concatenate([prop, motion.positions], axis=1)
    observed = np.concatenate([np.isfinite(prop).all(-1), motion.observed], axis=1)
    rigged = Motion(positions, observed, motion.fps, Skeleton(names, parents))
    filled = exported.completer.complete(rigged)
    assert np.array_equal(filled.positions[:, :2], prop, equal_nan=True)
    assert filled.observed[:, 0].all() and not filled.observed[:, 1].any()
    np.testing.assert_allclose(filled.positions[:, 2:], exported.completer.complete(motion).positions, atol=1e-5)


def test_a_rig_from_a_file_is_filled_at_its_own_rate(exported):
    take = mm.load(WALK)
    mapping = map_rig(take.skeleton, take.motion.positions)
    observed = np.ones((len(take), len(take.skeleton)), bool)
    observed[40:60] = False
    observed[80:120, mapping.found["right_hand"]] = False
    motion = hidden(take.motion, observed)
    filled = exported.completer.complete(motion)
    ours = np.isin(np.arange(len(take.skeleton)), mapping.joints)
    assert filled.observed[:, ours].all() and np.isfinite(filled.positions[:, ours]).all()
    assert np.array_equal(filled.observed[:, ~ours], observed[:, ~ours])
    assert np.array_equal(filled.positions[observed], motion.positions[observed])
    assert np.array_equal(exported.completer.complete(motion, mapping).positions, filled.positions, equal_nan=True)


def test_a_take_elsewhere_and_higher_is_filled_alike(exported):
    motion = exported.damaged(40)
    moved = np.array([5, 1.5, -7], np.float32)
    elsewhere = exported.completer.complete(replace(motion, positions=motion.positions + moved))
    np.testing.assert_allclose(elsewhere.positions - moved, exported.completer.complete(motion).positions, atol=1e-3)


def test_what_is_no_person_is_refused_in_words(exported):
    motion = exported.damaged(20)
    cloud = replace(motion, skeleton=Skeleton.cloud([f"M{joint}" for joint in range(len(BODY))]))
    cloud = replace(cloud, positions=np.random.default_rng(0).normal(size=cloud.positions.shape).astype(np.float32))
    with pytest.raises(InputError, match="no human body"):
        exported.completer.complete(cloud)


def test_samples_follow_from_their_seed(exported):
    motion = exported.damaged(2 * exported.kind.frames + 3)
    if not exported.kind.generative:
        assert not hasattr(exported.completer, "sample")
        return
    ways, again, others = (exported.completer.sample(motion, 3, seed) for seed in (1, 1, 2))
    assert len(ways) == 3
    for way, same, other in zip(ways, again, others):
        assert np.array_equal(way.positions, same.positions) and not np.array_equal(way.positions, other.positions)
        assert way.observed.all() and np.isfinite(way.positions).all()
        assert np.array_equal(way.positions[motion.observed], motion.positions[motion.observed])
    assert not np.array_equal(ways[0].positions, ways[1].positions)
    with pytest.raises(InputError, match="the first frame lacks hips, left_hand"):
        lacking = motion.observed.copy()
        lacking[0, [JOINT["hips"], JOINT["left_hand"]]] = False
        exported.completer.sample(hidden(motion, lacking), 1, 0)


def test_sampled_windows_are_raw_and_follow_from_their_seed(exported):
    if not exported.kind.generative:
        pytest.skip("one answer only")
    positions, observed = exported.windows(3)
    arguments = positions[:, 0], positions[:, 1:], observed[:, 1:]
    drawn = exported.completer.sample_windows(*arguments, 5, 0)
    assert drawn.shape == (3, 5, exported.kind.frames - 1, len(BODY), 3) and np.isfinite(drawn).all()
    assert np.array_equal(drawn, exported.completer.sample_windows(*arguments, 5, 0))
    assert not np.array_equal(drawn[:, 0], drawn[:, 1])


def test_what_comes_before_the_first_whole_pose_is_left(exported):
    if not exported.kind.generative:
        pytest.skip("needs no whole pose")
    motion = exported.damaged(30)
    observed = motion.observed.copy()
    observed[:4, 3] = False
    observed[4:9] = True
    late = hidden(replace(motion, positions=np.nan_to_num(motion.positions)), observed)
    filled = exported.completer.complete(late)
    assert np.array_equal(filled.observed[:4], late.observed[:4]) and filled.observed[4:].all()


# The checkpoint


def test_stored_and_loaded_weights_are_equal_bit_for_bit(exported):
    again = checkpoints.load_network(exported.folder)
    ours, theirs = exported.network.state_dict(), again.state_dict()
    assert ours.keys() == theirs.keys() and all(torch.equal(ours[name], theirs[name]) for name in ours)
    positions, observed = exported.windows(3)
    assert np.array_equal(*(module_completer(each).windows(positions, observed) for each in (exported.network, again)))


def test_weights_are_stored_in_half_the_bytes(exported):
    weights = exported.network.state_dict()
    full = 4 * sum(each.numel() for each in weights.values())
    stored = sum(len(each.raw_data) for each in onnx.load(exported.folder / "model.onnx").graph.initializer)
    assert stored < 0.6 * full
    assert (exported.folder / "model.safetensors").stat().st_size < 0.6 * full + 200 * len(weights)


def test_nothing_of_this_machine_is_shipped(exported):
    for file in exported.folder.iterdir():
        content = file.read_bytes()
        here = f"{Path.home()}/", str(exported.folder.parent)
        for trace in ("site-packages", "torch/", ".py\"", "stack_trace", *here):
            assert trace.encode() not in content, (file.name, trace)


@pytest.mark.parametrize("exported", trials(PLAIN), indirect=True)
def test_the_same_network_gives_the_same_bytes(exported, tmp_path):
    exported.export(tmp_path / exported.folder.name)
    for file in exported.folder.iterdir():
        assert (tmp_path / exported.folder.name / file.name).read_bytes() == file.read_bytes(), file.name


def test_it_runs_where_torch_is_not(exported, tmp_path):
    motion = exported.damaged(30)
    np.savez(tmp_path / "in.npz", positions=motion.positions, observed=motion.observed)
    expected = exported.completer.complete(motion).positions
    code = (
        "import sys; sys.modules.update(torch=None, onnx=None, safetensors=None)\n"
        "import numpy as np, motionmend as mm; from motionmend.body.joints import BODY\n"
        f"data = np.load({str(tmp_path / 'in.npz')!r})\n"
        f"motion = mm.Motion(data['positions'], data['observed'], {exported.kind.fps}, BODY)\n"
        f"filled = mm.load_completer({str(exported.folder)!r}).complete(motion)\n"
        f"np.save({str(tmp_path / 'out.npy')!r}, filled.positions)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert np.array_equal(np.load(tmp_path / "out.npy"), expected)
