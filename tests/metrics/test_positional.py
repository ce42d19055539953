"""The measures against slow, obvious twins and hand-made cases."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motionmend.metrics import positional

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
    assert positional.mpjpe(truth, guess, mask, root) == pytest.approx(sum(errors) / len(errors))


def test_mpjpe_reads_nothing_outside_its_mask(clips):
    truth, guess, mask = clips
    broken = np.where(mask[..., None], guess, np.nan)
    assert positional.mpjpe(truth, broken, mask) == positional.mpjpe(truth, guess, mask)
    assert math.isnan(positional.mpjpe(truth, guess, np.zeros_like(mask)))


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
    assert positional.limb_sigma(points, PARENTS) == pytest.approx(1000 * sum(sigmas) / len(sigmas))
    assert math.isnan(positional.limb_sigma(points, (-1,) * 4))


def test_bone_length_change(clips):
    before, after, _ = clips
    before = before.copy()
    before[:, 3] = np.nan
    worst = 0.0
    for joint in (1, 2):
        lengths = sorted(distance(pose[joint], pose[PARENTS[joint]]) for pose in before)
        usual = (lengths[5] + lengths[6]) / 2
        worst = max(worst, *(abs(distance(pose[joint], pose[PARENTS[joint]]) - usual) for pose in after))
    assert positional.bone_length_change(before, after, PARENTS) == pytest.approx(1000 * worst)
    assert math.isnan(positional.bone_length_change(before * np.nan, after, PARENTS))


def test_jitter_of_a_cubic_is_its_jerk():
    time = np.arange(20) / 50
    points = np.stack([2 * time**3, time**2, time], axis=-1)[:, None]
    assert positional.jitter(points, 50) == pytest.approx(12)
    points[4] = np.nan
    assert positional.jitter(points, 50) == pytest.approx(12)
    assert math.isnan(positional.jitter(points[:3], 50))


def test_steps(clips):
    points = clips[0]
    jumps, kinks = positional.steps(points)
    for frame in range(2, 11):
        before, here, after = (points[frame + k, 1] - points[frame + k - 1, 1] for k in (-1, 0, 1))
        assert jumps[frame, 1] == pytest.approx(1000 * distance(here, (before + after) / 2))
        assert kinks[frame, 1] == pytest.approx(1000 * distance(after, before))
    assert np.isnan(jumps[[0, 1, 11]]).all() and np.isnan(kinks[[0, 1, 11]]).all()


def test_a_pop_is_worth_its_size_and_a_kink_its_change_of_velocity():
    points = np.zeros((20, 1, 3))
    points[:, 0, 0] = np.arange(20) * 0.01
    points[10:] += [0, 0.05, 0]
    assert positional.steps(points)[0][10, 0] == pytest.approx(50)
    points = np.zeros((20, 1, 3))
    points[10:, 0, 0] = np.arange(10) * 0.02
    assert np.nanmax(positional.steps(points)[1]) == pytest.approx(20)


def test_foot_skate_is_the_horizontal_speed_in_contact():
    points = np.zeros((5, 1, 3))
    points[:, 0] = np.arange(5)[:, None] * [0.003, 0.5, 0.004]
    contact = np.array([1, 1, 0, 1, 1], bool)[:, None]
    assert positional.foot_skate(points, contact, 100) == pytest.approx(500)
    assert math.isnan(positional.foot_skate(points, ~contact, 100))


def test_stances_are_slow_low_and_not_too_short():
    points = np.zeros((100, 1, 3))
    points[40:60, 0, 0] = np.arange(20) * 0.02  # a swing at 2 m/s
    points[60:, 0, 0] = 0.38
    points[80:, 0, 1] = 0.3  # still, but in the air
    points[20, 0, 1] = np.nan
    found = positional.stances(points, 100)[:, 0]
    assert found[2:18].all() and found[23:38].all() and found[62:78].all()
    assert not found[41:59].any() and not found[82:].any() and not found[20]


@pytest.fixture
def windows():
    """Three windows of 9 frames and 4 joints, some samples missing; and a second motion near the first."""
    rng = np.random.default_rng(1)
    truth = np.cumsum(rng.normal(size=(3, 9, 4, 3)), axis=1).astype(np.float32)
    truth[1, 4, 2] = np.nan
    truth[2, :, 3] = np.nan
    return truth, (truth + rng.normal(size=truth.shape) * 0.1).astype(np.float32)


@pytest.mark.parametrize("root", [None, 1])
def test_distances_and_errors_of_batches(windows, root):
    truth, guess = windows
    found = positional.distances(truth, guess, root)
    mask = np.isfinite(found)
    errors = []
    for window in range(3):
        for frame in range(9):
            for joint in range(4):
                a, b = (motion[window, frame].astype(float) for motion in (truth, guess))
                origins = (a[root], b[root]) if root is not None else (0, 0)
                error = distance(a[joint] - origins[0], b[joint] - origins[1])
                assert found[window, frame, joint] == pytest.approx(error, nan_ok=True)
                if not math.isnan(error):
                    errors.append(error)
    assert positional.mpjpe(truth, guess, mask, root) == pytest.approx(1000 * sum(errors) / len(errors))


def test_joint_error_is_a_mean_and_a_deviation_in_cm(windows):
    truth, guess = windows
    mask = np.isfinite(truth[..., 0])
    mask[:, :3] = False
    errors = [100 * distance(truth[at], guess[at]) for at in zip(*np.nonzero(mask))]
    mean = sum(errors) / len(errors)
    deviation = math.sqrt(sum((error - mean) ** 2 for error in errors) / len(errors))
    assert positional.joint_error(truth, guess, mask) == (pytest.approx(mean, 1e-5), pytest.approx(deviation, 1e-5))
    assert all(math.isnan(value) for value in positional.joint_error(truth, guess, mask & False))


def test_joint_error_by_hand():
    truth = np.zeros((1, 2, 1, 3))
    guess = truth.copy()
    guess[0, 0, 0] = [0.03, 0, 0.04]
    guess[0, 1, 0] = [0, 0.15, 0]
    assert positional.joint_error(truth, guess, np.ones((1, 2, 1), bool)) == (pytest.approx(10), pytest.approx(5))


def test_limb_sigma_of_a_batch_is_the_mean_over_windows_and_bones(windows):
    truth = windows[0]
    sigmas = []
    for window in truth:
        for joint, parent in enumerate(PARENTS):
            lengths = [] if parent < 0 else [distance(pose[joint], pose[parent]) for pose in window.astype(float)]
            lengths = [length for length in lengths if not math.isnan(length)]
            if lengths:
                mean = sum(lengths) / len(lengths)
                sigmas.append(math.sqrt(sum((length - mean) ** 2 for length in lengths) / len(lengths)))
    assert len(sigmas) == 8
    assert positional.limb_sigma(truth, PARENTS) == pytest.approx(1000 * sum(sigmas) / len(sigmas))


def test_bone_length_changes_of_a_batch(windows):
    before, after = windows
    found = positional.bone_length_changes(before, after[:, :5], PARENTS)
    assert found.shape == (3, 5, 4) and np.isnan(found[..., 0]).all() and np.isnan(found[2, :, 3]).all()
    for window, frame, joint in [(0, 0, 1), (0, 3, 2), (1, 2, 2), (2, 4, 1)]:
        parent = PARENTS[joint]
        lengths = sorted(distance(pose[joint], pose[parent]) for pose in before[window].astype(float))
        lengths = [length for length in lengths if not math.isnan(length)]
        half = len(lengths) // 2
        usual = lengths[half] if len(lengths) % 2 else (lengths[half - 1] + lengths[half]) / 2
        now = distance(after[window, frame, joint].astype(float), after[window, frame, parent].astype(float))
        assert found[window, frame, joint] == pytest.approx(1000 * abs(now - usual))
    assert positional.bone_length_change(before, after[:, :5], PARENTS) == np.nanmax(found)


def test_what_is_measured_of_a_batch_is_what_its_windows_say(windows):
    points = windows[0]
    for values, each in zip(positional.steps(points), zip(*[positional.steps(window) for window in points])):
        np.testing.assert_array_equal(values, np.stack(each))
    slow = points * 0.003
    contact = positional.stances(slow, 50)
    np.testing.assert_array_equal(contact, np.stack([positional.stances(window, 50) for window in slow]))
    assert contact.any() and not contact.all()
    speeds, jerks = [], []
    for window in range(3):
        for joint in range(4):
            places = slow[window, :, joint].astype(float)
            for frame in range(1, 9):
                speed = 50 * 1000 * distance(places[frame, [0, 2]], places[frame - 1, [0, 2]])
                if contact[window, frame, joint] and contact[window, frame - 1, joint] and not math.isnan(speed):
                    speeds.append(speed)
            for frame in range(3, 9):
                a, b, c, d = places[frame - 3 : frame + 1]
                jerk = 50**3 * distance(d - 3 * c + 3 * b - a, (0, 0, 0))
                jerks += [] if math.isnan(jerk) else [jerk]
    assert positional.foot_skate(slow, contact, 50) == pytest.approx(sum(speeds) / len(speeds))
    assert positional.jitter(slow, 50) == pytest.approx(sum(jerks) / len(jerks))


def test_seam_jump_is_taken_at_both_ends_of_every_gap(windows):
    points = np.nan_to_num(windows[0])
    hidden = np.zeros((3, 9, 4), bool)
    hidden[0, 3:6, 1] = hidden[1, 2:, 0] = hidden[2, :4, 2] = True
    seams = [(0, 3, 1), (0, 6, 1), (1, 2, 0), (2, 4, 2)]
    assert sorted(zip(*np.nonzero(positional.seams(hidden)))) == seams
    jumps, kinks = [], []
    for window, frame, joint in seams:
        p = points[window, :, joint].astype(float)
        before, here, after = (p[frame + k] - p[frame + k - 1] for k in (-1, 0, 1))
        jumps.append(1000 * distance(here, (before + after) / 2))
        kinks.append(1000 * distance(after, before))
    found = positional.seam_jump(points, hidden)
    assert found == (pytest.approx(sum(jumps) / 4), pytest.approx(sum(kinks) / 4))
    assert all(math.isnan(value) for value in positional.seam_jump(points, np.ones_like(hidden)))


def test_a_planted_pop_and_kink_are_measured_in_mm():
    points = np.zeros((2, 20, 1, 3))
    points[..., 0] = np.arange(20)[:, None] * 0.01
    hidden = np.zeros((2, 20, 1), bool)
    hidden[:, 8:14] = True
    assert positional.seam_jump(points, hidden) == (pytest.approx(0, abs=1e-9), pytest.approx(0, abs=1e-9))
    points[:, 8:14, :, 1] += 0.03
    assert positional.seam_jump(points, hidden) == (pytest.approx(30), pytest.approx(0, abs=1e-9))


def test_moments_of_blocks_are_those_of_the_whole():
    rows = np.random.default_rng(2).normal(3, 2, size=(50, 4)).astype(np.float32)
    moments = positional.Moments()
    assert np.isnan(moments.mean) and np.isnan(moments.std)
    for block in (rows[:7], rows[7:7], rows[7:8], rows[8:]):
        moments.add(block)
    for column in range(4):
        values = [float(value) for value in rows[:, column]]
        mean = sum(values) / 50
        assert moments.mean[column] == pytest.approx(mean)
        assert moments.std[column] == pytest.approx(math.sqrt(sum((value - mean) ** 2 for value in values) / 50))


@pytest.mark.parametrize("shape", [(9, 0, 3), (0, 4, 3), (0, 9, 4, 3), (2, 0, 4, 3), (3, 1, 4, 3)])
def test_of_nothing_nothing_is_said(shape):
    points, mask = np.zeros(shape), np.ones(shape[:-1], bool)
    parents = PARENTS[: shape[-2]]
    assert positional.stances(points, 50).shape == shape[:-1]
    assert positional.steps(points)[0].shape == shape[:-1]
    assert positional.bone_length_changes(points, points, parents).shape == shape[:-1]
    seams = positional.seam_jump(points, mask)
    for number in (positional.jitter(points, 50), positional.foot_skate(points, mask, 50), *seams):
        assert math.isnan(number)
    if not points.size:
        assert math.isnan(positional.mpjpe(points, points, mask)) and math.isnan(positional.limb_sigma(points, parents))
        assert math.isnan(positional.joint_error(points, points, mask)[0])
        assert math.isnan(positional.bone_length_change(points, points, parents))
