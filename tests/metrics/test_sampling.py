"""TrajeVAE's measures against slow twins that follow its definitions word by word, and hand-made cases."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from motionmend.metrics import sampling

PARENTS = (-1, 0, 1, 0)
ROOT = 0


@pytest.fixture
def case():
    """Seven windows of 1 + 5 frames of 4 joints; some start alike; 6 samples for each."""
    rng = np.random.default_rng(0)
    truths = rng.normal(size=(7, 6, 4, 3))
    for window, like in ((1, 0), (4, 0), (5, 3)):
        truths[window, 0] = truths[like, 0] + rng.normal(size=(4, 3)) * 0.05
    truths[2, 0] = truths[0, 0] + [1.0, 2.0, 3.0]  # the same pose in another place
    samples = truths[:, None, 1:] + rng.normal(size=(7, 6, 5, 4, 3)) * 0.3
    return truths.astype(np.float32), samples.astype(np.float32)


def vector(pose):
    """A pose less its root, without the root, one long list."""
    return [float(pose[joint][axis]) - float(pose[ROOT][axis]) for joint in (1, 2, 3) for axis in range(3)]


def l2(a, b):
    return math.sqrt(sum((x - y) ** 2 for x, y in zip(a, b, strict=True)))


def slow_apd(samples):
    flat = [[number for pose in sample for number in vector(pose)] for sample in samples]
    pairs = [l2(a, b) for a, b in itertools.permutations(flat, 2)]
    return sum(pairs) / len(pairs)


def slow_ade(samples, truth):
    return min(sum(l2(vector(p), vector(t)) for p, t in zip(sample, truth)) / len(truth) for sample in samples)


def slow_fde(samples, truth):
    return min(l2(vector(sample[-1]), vector(truth[-1])) for sample in samples)


def slow_scores(truths, samples, window):
    group = [other for other in range(len(truths)) if l2(vector(truths[other][0]), vector(truths[window][0])) < 0.5]
    return {
        "APD": slow_apd(samples[window]),
        "ADE": slow_ade(samples[window], truths[window][1:]),
        "FDE": slow_fde(samples[window], truths[window][1:]),
        "MMADE": sum(slow_ade(samples[window], truths[other][1:]) for other in group) / len(group),
        "MMFDE": sum(slow_fde(samples[window], truths[other][1:]) for other in group) / len(group),
    }, group


def test_the_five_measures_are_their_definitions(case, monkeypatch):
    truths, samples = case
    monkeypatch.setattr(sampling, "MEMBERS", 2)  # a group of several goes in blocks
    scores = sampling.SampleScores(truths)
    assert all(math.isnan(mean) for mean in scores.means().values())
    scores.add([3, 0], samples[[3, 0]])
    scores.add(range(4, 7), samples[4:])
    expected = {window: slow_scores(truths, samples, window) for window in (0, 3, 4, 5, 6)}
    assert expected[0][1] == [0, 1, 2, 4] and expected[6][1] == [6]
    for window, (slow, group) in expected.items():
        assert scores.group(window).tolist() == group
        for name, value in slow.items():
            assert scores.values[name][window] == pytest.approx(value), (window, name)
    for name, mean in scores.means().items():
        assert mean == pytest.approx(sum(slow[name] for slow, _ in expected.values()) / 5)


def test_blocks_do_not_matter(case):
    truths, samples = case
    one, other = sampling.SampleScores(truths), sampling.SampleScores(truths)
    one.add(range(7), samples)
    for window in reversed(range(7)):
        other.add([window], samples[window : window + 1])
    assert one.means() == other.means()


def test_where_the_body_stands_does_not_matter_but_its_root_is_not_a_joint(case):
    truths, samples = case
    rng = np.random.default_rng(5)
    scores, moved = sampling.SampleScores(truths), sampling.SampleScores(truths + rng.normal(size=(7, 6, 1, 3)))
    scores.add(range(7), samples)
    moved.add(range(7), samples + rng.normal(size=(7, 6, 5, 1, 3)))
    for name in sampling.NAMES:
        assert moved.means()[name] == pytest.approx(scores.means()[name], rel=1e-5)


def test_by_hand():
    # Two joints beside the root, one frame past the start; K = 2. Root-relative, joint 1 is off by 3 and 6 along x,
    # joint 2 by 4 and 0: as flattened vectors 5 and 6, which a mean over joints would call 3.5 and 3.
    truths = np.zeros((1, 3, 3, 3))
    samples = np.zeros((1, 2, 2, 3, 3))
    samples[0, 0, :, 1, 0], samples[0, 0, :, 2, 1] = 3, 4
    samples[0, 1, :, 1, 0] = 6
    scores = sampling.SampleScores(truths)
    scores.add([0], samples)
    means = scores.means()
    assert means["ADE"] == means["FDE"] == means["MMADE"] == pytest.approx(5)
    assert means["APD"] == pytest.approx(math.sqrt(2 * (3**2 + 4**2)))  # over both frames at once


def test_fde_may_take_another_sample_than_ade():
    truths, samples = np.zeros((1, 3, 2, 3)), np.zeros((1, 2, 2, 2, 3))
    samples[0, 0, :, 1, 0] = 0, 4  # mean 2, last 4
    samples[0, 1, :, 1, 0] = 9, 1  # mean 5, last 1
    scores = sampling.SampleScores(truths)
    scores.add([0], samples)
    assert scores.means()["ADE"] == pytest.approx(2) and scores.means()["FDE"] == pytest.approx(1)


def test_each_member_of_a_group_has_its_own_best_sample():
    truths = np.zeros((2, 2, 2, 3))
    truths[1, 1, 1, 0] = 10  # both start alike
    samples = np.zeros((1, 2, 1, 2, 3))
    samples[0, :, 0, 1, 0] = 1, 10
    scores = sampling.SampleScores(truths)
    scores.add([0], samples)
    assert scores.means()["ADE"] == pytest.approx(1) and scores.means()["MMADE"] == pytest.approx(0.5)


def test_the_nearest_are_a_group_and_the_edge_is_outside():
    truths = np.zeros((3, 2, 2, 3))
    truths[:, 0, 1, 0] = 0, 0.499, 0.5
    assert sampling.SampleScores(truths).group(0).tolist() == [0, 1]


def test_more_samples_never_score_worse(case):
    truths, samples = case
    few, many = sampling.SampleScores(truths), sampling.SampleScores(truths)
    few.add(range(7), samples[:, :2])
    many.add(range(7), samples)
    for name in ("ADE", "FDE", "MMADE", "MMFDE"):
        assert (many.values[name] <= few.values[name]).all()


def test_one_sample_has_no_diversity_and_a_perfect_one_no_error(case):
    truths, _ = case
    scores = sampling.SampleScores(truths)
    scores.add(range(7), truths[:, None, 1:])
    means = scores.means()
    assert means["APD"] == 0 and means["ADE"] < 1e-6 and means["FDE"] < 1e-6 and means["MMADE"] > 0.1


def test_samples_of_another_shape_are_refused(case):
    truths, samples = case
    with pytest.raises(ValueError, match="suit"):
        sampling.SampleScores(truths).add([0], samples[:1, :, :4])
    with pytest.raises(ValueError, match="zip"):
        sampling.SampleScores(truths).add([0, 1], samples[:1])


def test_control_error_is_in_the_world_over_all_samples(case):
    truths, samples = case
    given = np.zeros((5, 4), bool)
    given[:, 1] = given[2:, 3] = True
    errors = [
        100 * l2(map(float, sample[frame, joint]), map(float, truths[0, 1 + frame, joint]))
        for sample in samples[0]
        for frame, joint in zip(*np.nonzero(given))
    ]
    found = sampling.control_error(samples[0], truths[0, 1:], given)
    assert found == pytest.approx(sum(errors) / len(errors), rel=1e-5)
    shifted = sampling.control_error(truths[0, None, 1:] + np.array([0, 0.07, 0]), truths[0, 1:], given)
    assert shifted == pytest.approx(7, rel=1e-5)
    assert math.isnan(sampling.control_error(samples[0], truths[0, 1:], given & False))


def test_bone_stretch(case):
    truths, samples = case
    pose = truths[0, 0].astype(float)
    changes = [
        100 * abs(l2(place[joint], place[parent]) / l2(pose[joint], pose[parent]) - 1)
        for sample in samples[0].astype(float)
        for place in sample
        for joint, parent in enumerate(PARENTS)
        if parent >= 0
    ]
    mean, worst = sampling.bone_stretch(samples[0], truths[0, 0], PARENTS)
    assert mean == pytest.approx(sum(changes) / len(changes), rel=1e-5)
    assert worst == pytest.approx(max(changes), rel=1e-5)
    turned = samples[0] @ np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    again = sampling.bone_stretch(turned + 5, truths[0, 0], PARENTS)
    assert again == (pytest.approx(mean, rel=1e-4), pytest.approx(worst, rel=1e-4))
    assert all(math.isnan(value) for value in sampling.bone_stretch(samples[0], truths[0, 0], (-1,) * 4))


def test_bone_stretch_by_hand():
    pose = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 2]], float)
    sample = np.array([[[0, 0, 0], [0, 1.1, 0], [0, 1.1, 1.4]]])
    mean, worst = sampling.bone_stretch(sample, pose, (-1, 0, 1))
    assert (mean, worst) == (pytest.approx(20), pytest.approx(30))
