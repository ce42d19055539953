"""The measures against slow, obvious twins and hand-made cases."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motionmend import metrics

PARENTS = (-1, 0, 1, 1)


@pytest.fixture
def clips():
    rng = np.random.default_rng(0)
    truth = np.cumsum(rng.normal(size=(12, 4, 3)), axis=0)
    return truth, truth + rng.normal(size=truth.shape) * 0.1, rng.random((12, 4)) < 0.5


def distance(a, b):
    return math.sqrt(sum((float(x) - float(y)) ** 2 for x, y in zip(a, b)))


@pytest.mark.parametrize("root", [None, 2])
def test_mpjpe(clips, root):
    truth, guess, mask = clips
    errors = []
    for frame, joint in zip(*np.nonzero(mask)):
        origins = (0, 0) if root is None else (truth[frame, root], guess[frame, root])
        errors.append(distance(truth[frame, joint] - origins[0], guess[frame, joint] - origins[1]) * 1000)
    assert metrics.mpjpe(truth, guess, mask, root) == pytest.approx(sum(errors) / len(errors))


def test_mpjpe_reads_nothing_outside_its_mask(clips):
    truth, guess, mask = clips
    broken = np.where(mask[..., None], guess, np.nan)
    assert metrics.mpjpe(truth, broken, mask) == metrics.mpjpe(truth, guess, mask)
    assert math.isnan(metrics.mpjpe(truth, guess, np.zeros_like(mask)))


def test_limb_sigma(clips):
    points = clips[0].copy()
    points[3, 2] = np.nan
    sigmas = []
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            lengths = [distance(pose[joint], pose[parent]) for pose in points]
            lengths = [length for length in lengths if not math.isnan(length)]
            mean = sum(lengths) / len(lengths)
            sigmas.append(math.sqrt(sum((length - mean) ** 2 for length in lengths) / len(lengths)))
    assert metrics.limb_sigma(points, PARENTS) == pytest.approx(1000 * sum(sigmas) / len(sigmas))
    assert math.isnan(metrics.limb_sigma(points, (-1,) * 4))


def test_bone_length_change(clips):
    before, after, _ = clips
    before = before.copy()
    before[:, 3] = np.nan
    worst = 0.0
    for joint in (1, 2):
        lengths = sorted(distance(pose[joint], pose[PARENTS[joint]]) for pose in before)
        usual = (lengths[5] + lengths[6]) / 2
        worst = max(worst, *(abs(distance(pose[joint], pose[PARENTS[joint]]) - usual) for pose in after))
    assert metrics.bone_length_change(before, after, PARENTS) == pytest.approx(1000 * worst)
    assert math.isnan(metrics.bone_length_change(before * np.nan, after, PARENTS))


def test_jitter_of_a_cubic_is_its_jerk():
    time = np.arange(20) / 50
    points = np.stack([2 * time**3, time**2, time], axis=-1)[:, None]
    assert metrics.jitter(points, 50) == pytest.approx(12)
    points[4] = np.nan
    assert metrics.jitter(points, 50) == pytest.approx(12)
    assert math.isnan(metrics.jitter(points[:3], 50))


def test_steps(clips):
    points = clips[0]
    jumps, kinks = metrics.steps(points)
    for frame in range(2, 11):
        before, here, after = (points[frame + k, 1] - points[frame + k - 1, 1] for k in (-1, 0, 1))
        assert jumps[frame, 1] == pytest.approx(1000 * distance(here, (before + after) / 2))
        assert kinks[frame, 1] == pytest.approx(1000 * distance(after, before))
    assert np.isnan(jumps[[0, 1, 11]]).all() and np.isnan(kinks[[0, 1, 11]]).all()


def test_a_pop_is_worth_its_size_and_a_kink_its_change_of_velocity():
    points = np.zeros((20, 1, 3))
    points[:, 0, 0] = np.arange(20) * 0.01
    points[10:] += [0, 0.05, 0]
    assert metrics.steps(points)[0][10, 0] == pytest.approx(50)
    points = np.zeros((20, 1, 3))
    points[10:, 0, 0] = np.arange(10) * 0.02
    assert np.nanmax(metrics.steps(points)[1]) == pytest.approx(20)


def test_foot_skate_is_the_horizontal_speed_in_contact():
    points = np.zeros((5, 1, 3))
    points[:, 0] = np.arange(5)[:, None] * [0.003, 0.5, 0.004]
    contact = np.array([1, 1, 0, 1, 1], bool)[:, None]
    assert metrics.foot_skate(points, contact, 100) == pytest.approx(500)
    assert math.isnan(metrics.foot_skate(points, ~contact, 100))


def test_stances_are_slow_low_and_not_too_short():
    points = np.zeros((100, 1, 3))
    points[40:60, 0, 0] = np.arange(20) * 0.02  # a swing at 2 m/s
    points[60:, 0, 0] = 0.38
    points[80:, 0, 1] = 0.3  # still, but in the air
    points[20, 0, 1] = np.nan
    found = metrics.stances(points, 100)[:, 0]
    assert found[2:18].all() and found[23:38].all() and found[62:78].all()
    assert not found[41:59].any() and not found[82:].any() and not found[20]
