"""A body as rows, and back: planted motions with answers known by hand, and the inverse of each map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionmend.body.joints import JOINT, LIMBS
from motionmend.body.standing import STANDING, UPRIGHT
from motionmend.networks import rows
from motionmend.networks.spaces import SPACES
from walks import walk

FORWARD = STANDING + UPRIGHT  # a standing body facing +Z


def turned(poses, heading):
    """Poses `(T, J, 3)` turned by `heading (T,)` about the vertical, +Z towards +X, by matrices."""
    out = np.empty_like(poses)
    for frame, angle in enumerate(heading):
        matrix = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        out[frame] = poses[frame] @ np.array(matrix).T
    return out


def circling(frames=240, speed=0.02, rate=0.01):
    """A stiff body that goes round in a circle facing where it goes: positions, its root and heading."""
    heading = 0.3 + rate * np.arange(frames)
    step = speed * np.stack([np.sin(heading), np.cos(heading)], axis=1)
    root = np.cumsum(step, axis=0)
    whole = turned(np.broadcast_to(FORWARD, (frames, 21, 3)), heading)
    whole[..., [0, 2]] += root[:, None]
    return whole[None].astype(np.float32), root, heading


def everywhere(positions):
    return np.ones(positions.shape[:3], bool)


def test_a_body_that_goes_round_in_a_circle_stands_still_in_its_own_eyes():
    positions, root, heading = circling()
    found_root, found_heading = rows.path_of(positions, everywhere(positions))
    inner = slice(90, 150)  # a Gaussian of 20 frames sees the window's ends from farther out
    np.testing.assert_allclose(found_root[0, inner], root[inner], atol=2e-3)
    np.testing.assert_allclose(found_heading[0, inner], heading[inner], atol=1e-3)
    poses = rows.seen_from(positions, found_root, found_heading)
    np.testing.assert_allclose(poses[0, inner], np.broadcast_to(FORWARD, (60, 21, 3)), atol=4e-3)
    travel = rows.travel_of(found_root, found_heading)
    np.testing.assert_allclose(travel[0, inner], np.broadcast_to([0, 0.02, 0.01], (60, 3)), atol=1e-3)


def test_seen_from_and_in_world_undo_each_other():
    rng = np.random.default_rng(0)
    positions, root, heading = rng.normal(size=(2, 9, 21, 3)), rng.normal(size=(2, 9, 2)), rng.normal(size=(2, 9))
    back = rows.in_world(rows.seen_from(positions, root, heading), root, heading)
    np.testing.assert_allclose(back, positions, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_a_path_is_its_travel_from_any_one_known_frame(seed, frames):
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(scale=0.2, size=(3, frames)), axis=1)
    root = np.cumsum(rng.normal(scale=0.1, size=(3, frames, 2)), axis=1)
    travel = rows.travel_of(root, heading)
    known = rng.random((3, frames)) < 0.3
    known[:, rng.integers(frames)] = True
    blank = np.where(known, heading, 9.0), np.where(known[..., None], root, 9.0)
    found_root, found_heading = rows.travelled(travel, blank[1], blank[0], known)
    np.testing.assert_allclose(np.exp(1j * found_heading), np.exp(1j * heading), atol=1e-9)
    np.testing.assert_allclose(found_root, root, atol=1e-9)


def test_what_integration_misses_is_spread_over_the_gap_without_a_step_at_its_ends():
    root, heading = np.zeros((1, 60, 2)), np.zeros((1, 60))
    root[0, 40:, 1], heading[0, 40:] = 1.0, 0.5
    known = np.ones((1, 60), bool)
    known[0, 20:40] = False
    found_root, found_heading = rows.travelled(np.zeros((1, 60, 3)), root, heading, known)
    assert found_root[0, 19:41, 1] == pytest.approx(np.sort(found_root[0, 19:41, 1]))
    assert found_root[0, 20, 1] < 0.01 and found_root[0, 39, 1] > 0.99
    assert found_root[0, 29:31, 1].mean() == pytest.approx(0.5)
    assert found_heading[0, 29:31].mean() == pytest.approx(0.25)


def test_a_turn_goes_the_short_way_round():
    heading = np.zeros((1, 30))
    heading[0, 20:] = 2 * np.pi + 0.2
    known = np.ones((1, 30), bool)
    known[0, 10:20] = False
    _, found = rows.travelled(np.zeros((1, 30, 3)), np.zeros((1, 30, 2)), heading, known)
    assert found[0, 10:20].min() >= 0 and found[0, 10:20].max() <= 0.2


@pytest.mark.parametrize("lost", [["hips"], ["hips", "left_thigh", "right_thigh"]], ids=len)
def test_hips_that_are_missing_are_carried_by_what_is_seen(lost):
    motion = walk(60.0)
    observed = np.ones((1, *motion.observed.shape), bool)
    observed[0, 40:140, [JOINT[name] for name in lost]] = False
    found = rows.hips_of(motion.positions[None], observed)[0]
    assert np.linalg.norm(found - motion.positions[:, 0], axis=-1).max() < 0.03
    assert np.array_equal(found[:40], motion.positions[:40, 0])


def test_the_space_gives_back_what_is_seen_and_carries_what_is_not():
    motion, space = walk(60.0), SPACES["body_rows"]()
    positions, observed = motion.positions[None].copy(), everywhere(motion.positions[None])
    observed[0, 60:100] = False
    observed[0, 120:170, LIMBS["left_arm"]] = False
    poisoned = np.where(observed[..., None], positions, np.float32(np.nan))
    inputs, known = space.encode(poisoned, observed)
    assert all(np.isfinite(each).all() for each in inputs.values())
    assert all(each.dtype != np.float64 for each in inputs.values())
    back = space.decode(inputs["rows"], known)
    np.testing.assert_allclose(back[observed], positions[observed], atol=1e-5)
    missed = np.linalg.norm(back - positions, axis=-1)[~observed]
    assert missed.mean() < 0.1 and missed.max() < 0.6
    joints = inputs["known"][..., 1:-1]
    assert np.array_equal(joints, observed) and not inputs["leeway"][inputs["known"]].any()
    assert not inputs["known"][0, 60:101, -1].any() and inputs["known"][0, 101, -1]


def test_poses_seen_from_the_body_do_not_depend_on_where_it_is_or_faces():
    motion, space = walk(60.0), SPACES["body_rows"]()
    positions = motion.positions[None].astype(float)
    moved = turned(positions[0], np.full(len(motion), 2.1))[None] + np.array([5.0, 0, -3])
    one, other = (space.encode(each.astype(np.float32), everywhere(each))[0]["rows"] for each in (positions, moved))
    np.testing.assert_allclose(one, other, atol=2e-5)
