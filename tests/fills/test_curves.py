"""Curves through whatever is seen, against the fill that crosses one gap at a time."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from motionmend.body.joints import BODY, LIMBS
from motionmend.fills.curves import NEAR, along_bones, between_seen
from motionmend.fills.points import FILLS
from motionmend.motion import Motion, Skeleton


def paths(rng: np.random.Generator, windows: int = 3, frames: int = 40, joints: int = 4) -> np.ndarray:
    return rng.normal(0, 0.05, (windows, frames, joints, 3)).cumsum(axis=1).astype(np.float32)


@given(seed=st.integers(0, 10_000), length=st.integers(1, 55))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_gaps_with_context_are_crossed_as_the_eased_fill_crosses_them(seed, length):
    rng = np.random.default_rng(seed)
    positions = paths(rng, frames=70)
    start = rng.integers(NEAR + 1, 70 - length - NEAR)
    observed = np.ones(positions.shape[:3], bool)
    observed[:, start : start + length, rng.integers(4)] = False
    both = between_seen(np.where(observed[..., None], positions, 0), observed)
    for name, curves in zip(("eased", "linear"), both):
        for window, seen, found in zip(positions, observed, curves):
            motion = Motion(np.where(seen[..., None], window, np.nan), seen, 60.0, Skeleton.cloud(tuple("abcd")))
            np.testing.assert_allclose(found, FILLS[name].complete(motion).positions, atol=1e-5)


@given(seed=st.integers(0, 10_000), shown=st.floats(0, 1))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_what_is_seen_stays_and_all_is_finite(seed, shown):
    rng = np.random.default_rng(seed)
    positions = paths(rng, frames=int(rng.integers(1, 30)))
    observed = rng.random(positions.shape[:3]) < shown
    for curve in between_seen(np.where(observed[..., None], positions, np.float32(1e30)), observed):
        assert curve.dtype == np.float32 and np.isfinite(curve).all() and np.abs(curve).max(initial=0) < 1e3
        assert np.array_equal(curve[observed], positions[observed])


def test_a_straight_path_goes_on_straight_however_little_is_seen():
    line = np.arange(20, dtype=np.float32)[None, :, None, None] * np.array([0.1, -0.2, 0.05], np.float32)
    observed = np.zeros((1, 20, 1), bool)
    observed[0, [2, 9, 10, 17]] = True
    curve, _ = between_seen(np.where(observed[..., None], line, 0), observed)
    np.testing.assert_allclose(curve[0, 2:18], line[0, 2:18], atol=1e-5)


def test_beyond_the_last_sample_a_joint_stands_still_and_one_never_seen_is_nowhere():
    positions = np.zeros((1, 5, 3, 3), np.float32)
    positions[0, :, 0, 0], positions[0, :, 1, 0] = np.arange(5), 10
    observed = np.zeros((1, 5, 3), bool)
    observed[0, 1:3, 0], observed[0, :, 1] = True, True
    curve = between_seen(np.where(observed[..., None], positions, 0), observed)[0][0, :, :, 0]
    assert curve[:, 0].tolist() == [1, 1, 2, 2, 2]
    assert not np.any(curve[:, 2]) and not np.any(between_seen(positions, np.zeros_like(observed)))


@given(seed=st.integers(0, 10_000), limb=st.sampled_from([*LIMBS, ""]))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_along_bones_a_limb_is_crossed_as_the_bones_fill_crosses_it(seed, limb):
    rng = np.random.default_rng(seed)
    positions = paths(rng, windows=1, frames=60, joints=len(BODY))
    observed = np.ones(positions.shape[:3], bool)
    observed[:, 10:50, LIMBS[limb] if limb else slice(None)] = False
    curve, _ = along_bones(np.where(observed[..., None], positions, np.nan), observed, BODY.parents)
    wanted = FILLS["bones"].complete(Motion(positions[0], observed[0], 60.0, BODY)).positions
    np.testing.assert_allclose(curve[0], wanted, atol=2e-5)


def test_along_bones_what_is_never_seen_lies_on_its_parent():
    positions = paths(np.random.default_rng(0), joints=len(BODY))
    observed = np.ones(positions.shape[:3], bool)
    observed[:, :, LIMBS["left_arm"]] = False
    curve, _ = along_bones(positions, observed, BODY.parents)
    above = BODY.parents[LIMBS["left_arm"][0]]
    for joint in LIMBS["left_arm"]:
        np.testing.assert_allclose(curve[:, :, joint], positions[:, :, above], atol=1e-5)
    observed[:, :, 0] = False
    assert np.isfinite(along_bones(np.where(observed[..., None], positions, np.nan), observed, BODY.parents)).all()
