"""No pop, bones of one length, planted feet, and checks that see what is wrong."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import motionmend as mm
from motionmend.body.mapping import map_rig
from motionmend.constraints.bones import keep_lengths, reference_lengths
from motionmend.constraints.checks import checks
from motionmend.constraints.feet import legs, plant_feet
from motionmend.constraints.seams import keep_observed, meet_rig_seams, meet_seams
from motionmend.metrics import positional
from motionmend.motion import Motion, Skeleton, Take, Units
from rigs import as_take, random_rig

FPS = 100.0


def curve(frames=200, joints=3):
    time = np.arange(frames)[:, None, None] / FPS
    phase = np.arange(joints)[None, :, None] + np.arange(3) * 0.7
    return np.sin(3 * time + phase) * 0.4


def gaps(frames=200, joints=3):
    known = np.ones((frames, joints), bool)
    known[50:90, 0] = False
    known[120:124, 0] = False
    known[60:61, 1] = False
    known[70:72, 1] = False
    known[:30, 2] = False
    known[170:, 2] = False
    return known


def point_take(positions, observed=None, parents=None):
    joints = positions.shape[1]
    skeleton = Skeleton(tuple(f"p{joint}" for joint in range(joints)), tuple(parents or (-1,) * joints))
    observed = np.ones(positions.shape[:2], bool) if observed is None else observed
    motion = Motion(positions.astype(np.float32), observed, FPS, skeleton)
    return Take(motion, None, None, Units(1.0, "y", "made up"), "npz", "made.npz")


def worst_at_seams(points, known):
    jumps, kinks = positional.steps(points)
    seam = np.zeros_like(known)
    seam[1:] = known[1:] != known[:-1]
    return np.nanmax(jumps[seam]), np.nanmax(kinks[seam])


@pytest.mark.parametrize("own_word", [True, False])
def test_a_known_misfit_is_faded_out_inside_the_gap(own_word):
    truth, known = curve(), gaps()
    drift = 0.03 + 0.05 * np.arange(200)[:, None, None] / FPS  # metres, and metres a second
    filled = truth + drift
    if not own_word:
        filled = np.where(known[..., None], truth, filled)
    met = meet_seams(filled, truth, known, FPS)
    assert np.array_equal(met[known], truth[known])
    cut = np.where(known[..., None], truth, filled)
    for joint, frames in ((0, slice(40, 110)), (2, slice(None))):  # the gaps that are longer than the fade
        part = (frames, slice(joint, joint + 1))
        popped, mended = (worst_at_seams(each[part], known[part]) for each in (cut, met))
        assert popped[0] > 25 and mended[0] < 3 and mended[1] < 6
    short = known[:, 1]
    step = np.linalg.norm(np.diff(met[:, 1], axis=0), axis=-1)
    assert step.max() < np.linalg.norm(np.diff(truth[:, 1], axis=0), axis=-1).max() * (1.01 if not own_word else 10)
    assert np.array_equal(met[short, 1], truth[short, 1])
    # Past the fade the method's answer stands as it was.
    np.testing.assert_allclose(met[65:75, 0], filled[65:75, 0])
    np.testing.assert_allclose(met[:15, 2], filled[:15, 2])
    np.testing.assert_allclose(met[185:, 2], filled[185:, 2])


def test_position_and_velocity_of_a_linear_misfit_are_exact_at_the_seam():
    truth, known = curve(400, 1), np.ones((400, 1), bool)
    known[100:300] = False
    change = np.array([0.1, 0.0, -0.05])
    filled = truth + change + np.arange(400)[:, None, None] * 0.001 * change
    met = meet_seams(filled, truth, known, FPS, fade=1.0)
    correction = met - filled
    misfit = (truth - filled)[99, 0]
    # A slow fade has hardly begun after one frame: the correction goes on as the misfit was going.
    np.testing.assert_allclose(correction[100, 0], 2 * misfit - (truth - filled)[98, 0], atol=1e-5)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_nothing_outside_the_gaps_is_touched_and_what_fits_is_left(seed):
    rng = np.random.default_rng(seed)
    known = rng.random((60, 4)) < rng.choice([0.05, 0.5, 0.95])
    before = rng.normal(size=(60, 4, 3))
    before[~known] = np.nan
    filled = np.where(known[..., None], before, rng.normal(size=before.shape))
    met = meet_seams(filled, before, known, FPS)
    assert np.array_equal(met[known], before[known]) and np.isfinite(met[~known]).all()
    line = np.arange(60)[:, None, None] * rng.normal(size=(1, 4, 3))
    np.testing.assert_allclose(meet_seams(line, line, known, FPS), line, atol=1e-9)


def test_rigs_meet_their_seams_in_turns_and_shifts():
    rig = random_rig(1, frames=120)
    known = np.ones(rig.trusted.shape, bool)
    known[40:80] = False
    wrong = Rotation.from_rotvec([0.2, -0.1, 0.1])
    turned = np.stack([(Rotation.from_quat(q) * wrong).as_quat() for q in np.moveaxis(rig.rotations, 1, 0)], axis=1)
    filled = replace(rig, rotations=turned, translations=rig.translations + 0.1)
    before = replace(rig, trusted=known)
    met = meet_rig_seams(filled, before, FPS)
    assert np.array_equal(met.rotations[known], rig.rotations[known])

    def angles(rotations):
        turns = [Rotation.from_quat(q) for q in np.moveaxis(rotations, 1, 0)]
        return np.stack([(turn[1:].inv() * turn[:-1]).magnitude() for turn in turns], axis=1)

    own = angles(rig.rotations)
    for seam in (39, 79):
        assert np.all(angles(met.rotations)[seam] < own[seam] + 0.03)
    steps = [np.abs(np.diff(each.translations[:, 0], axis=0)).max() for each in (met, rig)]
    assert steps[0] < steps[1] + 0.025
    assert np.array_equal(met.translations[:, 1:][known[:, 1:]], rig.translations[:, 1:][known[:, 1:]])
    np.testing.assert_allclose(met.rotations[60], filled.rotations[60], atol=1e-12)


def test_observed_samples_come_back():
    before = point_take(curve(), gaps()).motion
    after = keep_observed(before, replace(before, positions=before.positions + 1, observed=np.ones((200, 3), bool)))
    assert np.array_equal(after.positions[before.observed], before.positions[before.observed])
    assert np.all(after.positions[~before.observed] == before.positions[~before.observed] + 1) and after.observed.all()


def test_bones_get_their_length_back_from_the_parent_outward():
    rig = random_rig(2, frames=60)
    truth = as_take(rig).motion
    filled = np.zeros((60, len(rig.orders)), bool)
    filled[20:40, 2:5] = True  # an arm to its end
    filled[20:40, 6] = True  # an elbow between known joints
    noise = np.random.default_rng(3).normal(size=truth.positions.shape) * 0.03
    positions = np.where(filled[..., None], truth.positions + noise, truth.positions).astype(np.float32)
    broken = replace(truth, positions=positions)
    lengths = reference_lengths(replace(truth, observed=~filled))
    kept = keep_lengths(replace(broken, observed=np.ones_like(filled)), lengths, filled)
    assert np.array_equal(kept.positions[~filled], truth.positions[~filled])
    stretched, mended = (
        positional.bone_length_change(truth.positions, each.positions, truth.skeleton.parents)
        for each in (broken, kept)
    )
    assert mended < 0.01 < 10 < stretched
    stretched, mended = (positional.mpjpe(truth.positions, each.positions, filled) for each in (broken, kept))
    assert mended < stretched


@pytest.fixture(scope="module")
def walk(cmu):
    return mm.load(cmu / "16" / "16_15.amc")


def sliding(take, start, stop):
    """A take whose root drifts inside a gap, so that its feet slide; and the mask of what was filled."""
    filled = np.zeros(take.rig.trusted.shape, bool)
    filled[start:stop] = True
    shifts = take.rig.translations.copy()
    drift = np.sin(np.linspace(0, np.pi, stop - start)) ** 2
    shifts[start:stop, 0] += drift[:, None] * [0.04, 0.0, 0.04]
    return take.with_rig(replace(take.rig, translations=shifts)), filled


def test_feet_are_planted_inside_the_gap_and_nowhere_else(walk):
    start, stop = 100, 220
    slid, filled = sliding(walk, start, stop)
    joints = map_rig(walk.skeleton, walk.motion.positions).joints
    planted, feet = plant_feet(slid, filled, legs(joints))
    assert feet.skate_after < 0.5 * feet.skate_before and feet.unreached < 20
    assert np.array_equal(planted.rig.rotations[~filled], slid.rig.rotations[~filled])
    assert np.array_equal(planted.rig.translations, slid.rig.translations)
    report = checks(walk, planted, filled, [leg[3] for leg in legs(joints)])
    assert report.seam_jump.ok and report.changed.ok and report.bone_length.ok

    points = Take(slid.motion, None, None, slid.units, "npz", "made.npz")
    moved, feet = plant_feet(points, filled, legs(joints))
    assert feet.skate_after < 0.5 * feet.skate_before
    assert np.array_equal(moved.motion.positions[~filled], slid.motion.positions[~filled])


def test_a_clean_repair_passes_and_each_planted_fault_is_seen(walk):
    filled = np.zeros(walk.rig.trusted.shape, bool)
    filled[100:160] = True
    good = checks(walk, walk, filled)
    assert good.ok and good.changed.value == 0
    json.dumps(good.as_dict())

    def with_points(positions):
        return replace(walk.motion, positions=positions.astype(np.float32))

    before = Take(walk.motion, None, None, walk.units, "npz", "made.npz")
    popped, stretched, outside, kinked = (walk.motion.positions.copy() for _ in range(4))
    popped[100:160, 5] += [0.0, 0.05, 0.0]
    stretched[130, 4] += [0.0, 0.08, 0.0]
    outside[40, 7, 1] += 1e-6
    kinked[100:160] += (np.arange(60) * 0.03)[:, None, None] * np.array([1, 0, 0])
    broken = (popped, stretched, outside, kinked)
    found = [checks(before, replace(before, motion=with_points(each)), filled) for each in broken]
    assert not found[0].seam_jump.ok and found[0].seam_jump.value == pytest.approx(50, abs=5)
    assert not found[1].bone_length.ok and found[1].seam_jump.ok
    assert found[2].changed.value == 1 and not found[2].changed.ok
    assert not found[3].seam_kink.ok
    assert all(each.changed.ok for each in (found[0], found[1], found[3]))


def test_a_changed_channel_outside_is_counted_and_gaps_left_are_told(walk):
    filled = np.zeros(walk.rig.trusted.shape, bool)
    filled[100:160, 3] = True
    rotations = walk.rig.rotations.copy()
    rotations[120, 3] = [0, 0, 0, 1]  # inside
    rotations[[10, 11], 8] = [0, 0, 1, 0]  # outside
    after = walk.with_rig(replace(walk.rig, rotations=rotations)).distrust(np.eye(*filled.shape, dtype=bool))
    report = checks(walk, after, filled)
    assert report.changed.value == 2
    assert report.unfilled.value == min(filled.shape) and not report.unfilled.ok and not report.ok


def test_marker_clouds_and_short_takes_are_checked_too():
    take = point_take(curve(3, 2))
    report = checks(take, take, np.ones((3, 2), bool))
    assert report.ok and report.seam_jump.value is None and report.bone_length.text == "no bones"
    json.dumps(report.as_dict())
