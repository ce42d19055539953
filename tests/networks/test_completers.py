"""A network as a Completer, on one whose answer is known: the straight line through what is observed."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from motionmend.body.joints import BODY, JOINT
from motionmend.motion import Motion, Skeleton
from motionmend.networks import checkpoints, loading
from motionmend.networks.completers import MOST
from walks import hidden, spy, walk


def straight(inputs):
    out = inputs["positions"].copy()
    frames = np.arange(out.shape[1])
    for window, seen in zip(out, inputs["observed"]):
        for joint in np.flatnonzero(seen.any(axis=0)):
            known = seen[:, joint]
            for axis in range(3):
                window[:, joint, axis] = np.interp(frames, frames[known], window[known, joint, axis])
    return out


def line_completer(fps=60.0, frames=60):
    return loading.completer(checkpoints.Description("line", "floor_mean", fps, frames, BODY), straight)


def gliding(seconds: float, fps: float) -> Motion:
    """A body in one pose that moves along a straight line: 0.5 m/s sideways, 0.1 m/s up."""
    pose = walk(30.0).positions[0]
    times = (np.arange(round(seconds * fps)) / fps).astype(np.float32)
    positions = pose + times[:, None, None] * np.array([0.5, 0.1, 0], np.float32)
    return Motion(positions, np.ones(positions.shape[:2], bool), fps, BODY)


@pytest.mark.parametrize("fps", [24.0, 30.0, 50.0, 59.94, 60.0, 100.0, 120.0, 240.0])
def test_filled_samples_belong_to_the_takes_own_times(fps):
    truth = gliding(4, fps)
    observed = truth.observed.copy()
    observed[round(1.1 * fps) : round(1.5 * fps)] = False
    observed[round(2.5 * fps) : round(2.9 * fps), 5:9] = False
    filled = line_completer().complete(hidden(truth, observed))
    assert filled.observed.all()
    np.testing.assert_allclose(filled.positions, truth.positions, atol=2e-4)


@pytest.mark.parametrize("frames", range(1, 12))
def test_the_last_frames_of_a_fast_take_are_filled_too(frames):
    truth = gliding(1, 240.0)
    truth = replace(truth, positions=truth.positions[:frames], observed=truth.observed[:frames])
    observed = truth.observed.copy()
    observed[-1, 4] = False
    filled = line_completer().complete(hidden(truth, observed))
    assert filled.observed.all() == (frames > 1) or filled.observed[:, 4].all()
    assert np.isfinite(filled.positions[filled.observed]).all()


def test_toes_that_a_rig_lacks_cost_no_windows_and_change_nothing():
    truth = gliding(20, 60.0)
    toes = [JOINT["left_toe"], JOINT["right_toe"]]
    kept = [joint for joint in range(len(BODY)) if joint not in toes]
    parents = tuple(-1 if parent < 0 else kept.index(parent) for parent in np.array(BODY.parents)[kept])
    skeleton = Skeleton(tuple(BODY.names[joint] for joint in kept), parents)
    observed = np.ones((len(truth), len(kept)), bool)
    observed[600:620] = False
    ran = []
    completer = loading.completer(line_completer().description, lambda inputs: spy(straight, inputs, ran))
    filled = completer.complete(hidden(Motion(truth.positions[:, kept], observed, 60.0, skeleton), observed))
    assert filled.observed.all() and sum(ran) <= 3
    np.testing.assert_allclose(filled.positions, truth.positions[:, kept], atol=2e-4)


def test_predict_rewrites_what_is_observed_too():
    truth = gliding(3, 60.0)
    description = line_completer().description
    shifted = loading.completer(description, lambda inputs: straight(inputs) + np.float32(0.01))
    raw = shifted.predict(truth)
    np.testing.assert_allclose(raw.positions, truth.positions + 0.01, atol=1e-5)


def test_a_long_take_needs_little_memory():
    truth = gliding(600, 60.0)
    observed = truth.observed.copy()
    observed[100:130] = False
    observed[20_000:20_040, 3:6] = False
    motion = hidden(truth, observed)
    tracemalloc.start()
    filled = line_completer().complete(motion)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert filled.observed.all()
    np.testing.assert_allclose(filled.positions[~observed], truth.positions[~observed], atol=1e-3)
    assert peak < 12 * motion.positions.nbytes


def test_in_a_long_gap_the_way_is_the_coarse_one_and_the_poses_are_those_of_one_crossing():
    """A network that at lower rates makes a detour, nodding, and answers the curve where it sees all at once."""

    def wanders(inputs):
        out, known = inputs["rows"].copy(), inputs["known"][..., -1]
        if out.shape[1] <= 240:
            for rows, there in zip(out, known):
                gap = np.flatnonzero(~there)
                rows[gap, 3 + 3 * JOINT["head"] + 1] -= 0.3
                rows[gap, -3] += 0.02 * np.sign(gap.mean() - gap)
        return out

    description = checkpoints.Description("rows", "body_rows", 60.0, 240, BODY, any_length=True)
    coarse, plain = (loading.completer(description, run) for run in (wanders, lambda inputs: inputs["rows"]))
    truth = gliding(10, 60.0)
    observed = truth.observed.copy()
    observed[180:420] = False
    filled, curve = (each.complete(hidden(truth, observed)).positions for each in (coarse, plain))
    np.testing.assert_allclose(curve, truth.positions, atol=0.01)
    detour = np.linalg.norm((filled - curve)[:, JOINT["hips"], ::2], axis=-1)
    assert detour[300] > 0.5 and detour[[180, 419]].max() < 0.05
    assert np.array_equal(filled[observed], truth.positions[observed])
    over_hips = [each[:, JOINT["head"], 1] - each[:, JOINT["hips"], 1] for each in (filled, curve)]
    np.testing.assert_allclose(*over_hips, atol=0.01)


def test_long_gaps_of_other_joints_are_filled_too():
    """A network that takes any length and knows other joints than a body's."""
    skeleton = Skeleton.cloud(["a", "b", "c"])
    description = checkpoints.Description("line", "floor_mean", 60.0, 60, skeleton, any_length=True)
    truth = gliding(10, 60.0)
    truth = replace(truth, positions=truth.positions[:, :3], observed=truth.observed[:, :3], skeleton=skeleton)
    observed = truth.observed.copy()
    observed[180:420] = False
    filled = loading.completer(description, straight).complete(hidden(truth, observed))
    np.testing.assert_allclose(filled.positions, truth.positions, atol=1e-3)


def test_what_is_too_long_for_one_crossing_is_crossed_in_windows():
    asked = []

    def answers(inputs):
        asked.append(inputs["rows"].shape[1])
        return inputs["rows"]

    description = checkpoints.Description("rows", "body_rows", 60.0, 240, BODY, any_length=True)
    truth = gliding(100, 60.0)
    observed = truth.observed.copy()
    observed[120:-120] = False
    filled = loading.completer(description, answers).complete(hidden(truth, observed))
    assert filled.observed.all() and max(asked) <= MOST
