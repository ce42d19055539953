"""Planted damage is found for what it is; what is good is not accused."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionmend
from legs import NAMES, UNITS, point_take, rig_take
from motionmend.damage.planting import mirrored_pairs, plant, plant_and_tell
from motionmend.diagnosis.diagnosing import diagnose
from motionmend.diagnosis.findings import CERTAIN, Diagnosis, told, unswap
from motionmend.diagnosis.symptoms import noise_level
from motionmend.io import load, save
from motionmend.motion import Motion, Skeleton, Take, Units
from motionmend.rotations import apply, from_rotvec, inverse, multiply


def cloud_of(positions: np.ndarray, fps: float = 120.0, names: tuple[str, ...] | None = None) -> Take:
    names = names or tuple(f"M{number}" for number in range(positions.shape[1]))
    observed = np.isfinite(positions).all(axis=-1)
    motion = Motion(positions.astype(np.float32), observed, fps, Skeleton.cloud(names))
    return Take(motion, None, None, UNITS, "npz", "made up")


def marker_cloud(frames: int = 600, markers: int = 8, fps: float = 100.0, seed: int = 0) -> Take:
    """Unnamed markers on smooth random ways, as fast as a person's."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / fps
    ways = sum(
        rng.uniform(0.02, 0.3 / rate, (markers, 3)) * np.sin(2 * np.pi * rate * time + rng.uniform(0, 6, (markers, 3)))
        for rate in (0.3, 0.7, 1.3, 2.1)
    )
    return cloud_of(ways + rng.uniform(-1, 1, (markers, 3)), fps)


def causes(diagnosis: Diagnosis) -> set[str]:
    return {finding.cause for finding in diagnosis.findings}


def only(diagnosis: Diagnosis, cause: str):
    found = [finding for finding in diagnosis.findings if finding.cause == cause]
    assert len(found) == 1, diagnosis.findings
    return found[0]


KINDS = pytest.mark.parametrize("make", [rig_take, point_take], ids=["channels", "points"])


# What is good -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0, 120.0, 250.0])
@KINDS
def test_smooth_movement_is_not_accused(make, fps):
    for seed in range(4):
        diagnosis = diagnose(make(int(6 * fps), fps, seed=seed))
        assert not diagnosis.findings and not diagnosis.untrusted.any()


@pytest.mark.parametrize("decimals", [1, 2, 3, 4])
def test_slow_movement_written_with_few_decimals_is_not_held(decimals):
    """Millimetres with so many decimals, of a person who stands and sways by 4 mm."""
    time = np.arange(3000)[:, None, None] / 120.0
    phase = np.random.default_rng(1).uniform(0, 6, (10, 3))
    sway = 4 * np.sin(2 * np.pi * 0.2 * time + phase) + 1000
    diagnosis = diagnose(cloud_of(np.round(sway, decimals) / 1000))
    assert not diagnosis.untrusted.any(), diagnosis.findings


def test_slow_channels_written_with_few_decimals_are_not_held():
    """Degrees with two decimals, a joint that turns by 3 degrees in five seconds."""
    take = rig_take(1200)
    assert take.rig is not None
    degrees = np.round(1.5 * np.sin(2 * np.pi * 0.1 * np.arange(1200) / 120.0 + np.arange(5)[:, None]), 2).T
    half = np.radians(degrees) / 2
    rotations = np.zeros((1200, 5, 4))
    rotations[..., 0], rotations[..., 3] = np.sin(half), np.cos(half)
    diagnosis = diagnose(take.with_rig(replace(take.rig, rotations=rotations)))
    assert not diagnosis.untrusted.any(), diagnosis.findings


def test_channels_that_never_move_are_not_held():
    take = rig_take(400)
    assert take.rig is not None
    rotations = take.rig.rotations.copy()
    rotations[:, 2] = [0, 0, 0, 1]
    assert not diagnose(take.with_rig(replace(take.rig, rotations=rotations))).findings


def test_a_knee_that_rests_against_its_limit_is_not_held():
    take = rig_take(600)
    assert take.rig is not None
    angle = np.maximum(np.sin(2 * np.pi * 1.1 * np.arange(600) / 120.0), 0.1)
    rotations = take.rig.rotations.copy()
    rotations[:, 2] = np.stack([np.sin(angle / 2), 0 * angle, 0 * angle, np.cos(angle / 2)], axis=-1)
    assert not diagnose(take.with_rig(replace(take.rig, rotations=rotations))).untrusted.any()


def test_euler_wrap_and_quaternion_signs_are_no_jumps():
    take = rig_take(480)
    assert take.rig is not None
    # A pirouette: three whole turns, whose angle wraps at 180 degrees and whose quaternion changes its sign.
    angle = 3 * 2 * np.pi * np.arange(480) / 480
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    rotations = take.rig.rotations.copy()
    rotations[:, 0] = np.stack([0 * angle, np.sin(wrapped / 2), 0 * angle, np.cos(wrapped / 2)], axis=-1)
    assert not diagnose(take.with_rig(replace(take.rig, rotations=rotations))).findings


def test_a_take_made_from_a_lower_rate_is_told_and_not_replaced():
    take = point_take(150, 30.0)
    repeated = cloud_of(np.repeat(take.motion.positions, 4, axis=0), 120.0)
    diagnosis = diagnose(repeated)
    assert only(diagnosis, "held").certainty < CERTAIN
    assert not diagnosis.untrusted.any()


def test_a_take_that_ends_with_a_still_is_not_replaced():
    take = point_take(300)
    still = np.concatenate([take.motion.positions, np.repeat(take.motion.positions[-1:], 60, axis=0)])
    assert not diagnose(cloud_of(still)).untrusted.any()
    # Nor are the other joints when one of them is damaged in the still.
    damaged, truth = plant_and_tell(cloud_of(still), jump=[([2], 330, 332)])
    assert np.array_equal(diagnose(damaged).untrusted, truth.mask)


def bent(take: Take, joint: int, degrees: np.ndarray) -> Take:
    """The take with one joint bent about its x axis, and nothing else, by so many degrees a frame."""
    assert take.rig is not None
    half = np.radians(degrees) / 2
    rotations = take.rig.rotations.copy()
    rotations[:, joint] = np.stack([np.sin(half), 0 * half, 0 * half, np.cos(half)], axis=-1)
    return take.with_rig(replace(take.rig, rotations=rotations))


def swing(frames: int = 600, fps: float = 120.0, size: float = 30.0) -> np.ndarray:
    return size * np.sin(2 * np.pi * 0.9 * np.arange(frames) / fps + 0.4)


def test_a_value_to_which_a_joint_comes_back_again_and_again_is_where_it_rests():
    """Toes that a solver puts to the same angle, in the midst of all they do, for a moment of every step."""
    frames = np.arange(600)
    once = swing()
    once[200:215] = once[200]
    assert diagnose(bent(rig_take(600), 2, once)).untrusted[201:215, 2].all()
    period = 30 * np.sin(2 * np.pi * np.arange(120) / 120 + 0.4)
    period[108:118] = period[108]
    assert not diagnose(bent(rig_take(600), 2, period[frames % 120])).untrusted.any()


def test_flat_keys_that_are_left_slowly_are_not_held():
    steps = [4.3, 7.9, 8.6, 7.1, 2.1, 0, 0, 0, 0, 0, 0.04, 6.0, 8.0, 6.9, 8.3, 8.5]
    way = swing(300, 30.0)
    degrees = np.concatenate([way[:150], way[149] - np.cumsum(steps), way[150:] - np.sum(steps)])
    assert not diagnose(bent(rig_take(len(degrees), 30.0), 2, degrees)).untrusted.any()


@KINDS
def test_what_is_held_all_the_time_is_how_the_take_was_made(make):
    stretches = [([2], start, start + 10) for start in range(40, 1150, 47)]
    diagnosis = diagnose(plant(make(1200), held=stretches))
    held = [finding for finding in diagnosis.findings if finding.cause == "held"]
    assert len(held) > 15 and all(finding.certainty < CERTAIN for finding in held)
    assert not diagnosis.untrusted.any()


@KINDS
def test_a_pose_that_stops_all_the_time_is_how_the_take_was_made(make):
    stills = [([0, 1, 2, 3, 4], start, start + 7) for start in (100, 180, 290, 400, 520)]
    diagnosis = diagnose(plant(make(600), held=stills))
    gaps = [finding for finding in diagnosis.findings if finding.cause == "gap"]
    assert len(gaps) == 5 and all(gap.certainty < CERTAIN for gap in gaps)
    assert not diagnosis.untrusted.any()
    few = diagnose(plant(make(600), held=stills[:2]))
    assert few.untrusted.all(axis=1).sum() == 14 == few.untrusted.sum() // 5


def test_a_start_made_from_a_lower_rate_does_not_hide_a_gap():
    take = rig_take(600)
    assert take.rig is not None
    rotations, translations = take.rig.rotations.copy(), take.rig.translations.copy()
    for array in (rotations, translations):
        array[1:60:2] = array[0:60:2]
    slow = take.with_rig(replace(take.rig, rotations=rotations, translations=translations))
    damaged, truth = plant_and_tell(slow, gaps=[(300, 330)])
    diagnosis = diagnose(damaged)
    assert np.array_equal(diagnosis.untrusted, truth.mask)
    slower = only(diagnosis, "held")
    assert (slower.start, slower.stop) == (0, 60) and slower.certainty < CERTAIN


def test_two_tips_alone_are_not_exchanged():
    """Both knees change places in the same frames, and nothing else does: told, and left."""
    one, other = swing(size=10), 25 + swing(size=12)
    one[250:310], other[250:310] = other[250:310].copy(), one[250:310].copy()
    diagnosis = diagnose(bent(bent(rig_take(600), 2, one), 4, other))
    swap = only(diagnosis, "swap")
    assert (swap.start, swap.stop, swap.indices) == (250, 310, (2, 4)) and swap.certainty < CERTAIN


def test_twins_that_jump_in_different_frames_have_not_changed_places():
    one, other = 1 + 0 * swing(), 18 + 0 * swing()
    one[250:310], other[254:306] = 18, 1
    assert "swap" not in causes(diagnose(bent(bent(rig_take(600), 2, one), 4, other)))


def test_a_finger_keyed_fast_at_a_low_rate_is_no_jump():
    degrees = swing(150, 30.0, size=4.0)
    degrees[[60, 90]] += 12
    assert not diagnose(bent(rig_take(150, 30.0), 2, degrees)).untrusted.any()
    degrees[[60, 90]] += 30
    assert np.argwhere(diagnose(bent(rig_take(150, 30.0), 2, degrees)).untrusted).tolist() == [[60, 2], [90, 2]]


def test_points_that_move_together_by_a_little_are_told_and_left():
    take = marker_cloud()
    positions = take.motion.positions.copy()
    positions[300:302, :5] += [0.0, 0.02, 0.0]
    diagnosis = diagnose(cloud_of(positions, 100.0))
    jump = only(diagnosis, "jump")
    assert (jump.start, jump.stop, len(jump.indices)) == (300, 302, 5) and jump.certainty < CERTAIN
    positions[300:302, :5] += [0.0, 0.06, 0.0]
    assert np.flatnonzero(diagnose(cloud_of(positions, 100.0)).untrusted.any(axis=1)).tolist() == [300, 301]


# What is not ------------------------------------------------------------------------------------------------


def test_missing_points_are_told_apart():
    take = point_take(600)
    mask = np.zeros((600, 5), bool)
    mask[100:140] = True
    mask[200:260, [1, 2]] = True
    mask[[300, 320, 340], [0, 3, 4]] = True
    positions = np.where(mask[..., None], np.nan, take.motion.positions)
    diagnosis = diagnose(cloud_of(positions, 120.0, NAMES))
    assert np.array_equal(diagnosis.untrusted, mask)
    gap, lost, dropout = (only(diagnosis, cause) for cause in ("gap", "lost", "dropout"))
    assert (gap.start, gap.stop, gap.joints) == (100, 140, NAMES)
    assert (lost.start, lost.stop, lost.joints) == (200, 260, ("LeftUpLeg", "LeftLeg"))
    assert (dropout.start, dropout.stop, dropout.joints) == (300, 341, ("Hips", "RightUpLeg", "RightLeg"))
    assert causes(diagnosis) == {"gap", "lost", "dropout"}


@KINDS
def test_a_held_joint_is_found_to_the_frame(make):
    damaged, truth = plant_and_tell(make(600), held=[([3], 200, 230)])
    diagnosis = diagnose(damaged)
    held = only(diagnosis, "held")
    assert (held.start, held.stop, held.joints) == (200, 230, ("RightUpLeg",))
    assert np.array_equal(diagnosis.untrusted, truth.mask)


def test_a_gap_in_channels_is_a_pose_that_freezes():
    damaged, truth = plant_and_tell(rig_take(600), gaps=[(200, 260)])
    diagnosis = diagnose(damaged)
    gap = only(diagnosis, "gap")
    assert (gap.start, gap.stop) == (200, 260)
    assert np.array_equal(diagnosis.untrusted, truth.mask)


def test_single_repeated_samples_are_dropouts():
    damaged, truth = plant_and_tell(rig_take(600), dropout=0.03, seed=2)
    diagnosis = diagnose(damaged)
    assert "dropout" in causes(diagnosis)
    assert (diagnosis.untrusted & truth.mask).sum() > 0.9 * truth.mask.sum()
    assert not (diagnosis.untrusted & ~truth.mask).any()


@pytest.mark.parametrize("frames", [1, 2, 3])
@pytest.mark.parametrize("fps", [30.0, 120.0])
@KINDS
def test_a_jump_is_found_to_the_frame_and_accuses_no_other_joint(make, frames, fps):
    damaged, truth = plant_and_tell(make(int(5 * fps), fps), jump=[([1], 60, 60 + frames)], size=0.4)
    diagnosis = diagnose(damaged)
    jump = only(diagnosis, "jump")
    assert (jump.start, jump.stop, jump.joints) == (60, 60 + frames, ("LeftUpLeg",))
    assert np.array_equal(diagnosis.untrusted, truth.mask)


@KINDS
def test_a_displaced_joint_is_found_to_the_frame(make):
    damaged, truth = plant_and_tell(make(600), displaced=[([3], 300, 340)], size=0.3)
    diagnosis = diagnose(damaged)
    displaced = only(diagnosis, "displaced")
    assert (displaced.start, displaced.stop) == (300, 340)
    assert np.array_equal(diagnosis.untrusted, truth.mask)


@KINDS
def test_a_step_that_is_not_undone_is_told_and_not_replaced(make):
    diagnosis = diagnose(plant(make(600), jump=[([3], 300, 600)], size=0.3))
    step = only(diagnosis, "jump")
    assert (step.start, step.joints) == (300, ("RightUpLeg",)) and step.certainty < CERTAIN
    assert not diagnosis.untrusted.any()


@KINDS
def test_a_swap_is_found_and_exchanged_back_to_the_last_bit(make):
    take = make(600)
    damaged = plant(take, swap=[([1, 2], 250, 310)])
    assert damaged.motion.positions.tobytes() != take.motion.positions.tobytes()
    diagnosis = diagnose(damaged)
    swap = only(diagnosis, "swap")
    assert (swap.start, swap.stop, swap.indices) == (250, 310, (1, 3, 2, 4)) and swap.certainty >= CERTAIN
    assert not diagnosis.untrusted.any()
    back = unswap(damaged, swap)
    assert back.motion.positions.tobytes() == take.motion.positions.tobytes()
    if take.rig is not None and back.rig is not None:
        assert back.rig.rotations.tobytes() == take.rig.rotations.tobytes()


def test_a_swap_after_an_occlusion_is_found():
    take = point_take(600)
    damaged = plant(plant(take, swap=[([2], 250, 310)]), lost=[([2, 4], 246, 254)])
    swap = only(diagnose(damaged), "swap")
    assert swap.indices == (2, 4) and swap.stop == 310 and 246 <= swap.start <= 254


@pytest.mark.parametrize("level", [0.003, 0.01])
def test_noise_is_told_with_its_level_and_not_replaced(level):
    diagnosis = diagnose(plant(point_take(1200), noise=level))
    told_level = float(only(diagnosis, "noise").detail.split()[1])
    assert told_level == pytest.approx(1000 * level, rel=0.1)
    assert not diagnosis.untrusted.any()


def test_noise_level_is_that_of_the_noise_and_not_of_the_movement():
    rng = np.random.default_rng(0)
    movement = np.sin(2 * np.pi * 2 * np.arange(2000) / 120.0)[:, None] * [0.3, 0.2, 0.1]
    assert noise_level(movement) == 0
    assert noise_level(movement + rng.normal(0, 0.004, movement.shape)) == pytest.approx(0.004, rel=0.15)


@pytest.mark.parametrize("frames", [1, 3])
def test_a_calibration_pose_in_front_is_told_and_not_replaced(frames):
    take = rig_take(300)
    assert take.rig is not None
    rotations = take.rig.rotations.copy()
    rotations[:frames] = [0.5, 0.5, 0.5, 0.5]
    diagnosis = diagnose(take.with_rig(replace(take.rig, rotations=rotations)))
    pose = only(diagnosis, "t-pose")
    assert (pose.start, pose.stop) == (0, frames)
    assert causes(diagnosis) == {"t-pose"} and not diagnosis.untrusted.any()


def test_markers_without_names_or_bones_are_judged_too():
    take = marker_cloud()
    assert not diagnose(take).findings
    damaged, truth = plant_and_tell(
        take, lost=[([2], 100, 150)], held=[([5], 300, 330)], jump=[([1], 400, 402)], size=0.2
    )
    diagnosis = diagnose(damaged)
    assert causes(diagnosis) == {"lost", "held", "jump"}
    assert np.array_equal(diagnosis.untrusted, truth.mask)


def test_what_is_told_has_names_and_plain_numbers():
    finding = only(diagnose(plant(rig_take(600), held=[([3], 200, 230)])), "held")
    facts = told(finding)
    assert facts["joints"] == ("RightUpLeg",) and set(facts) == {
        "cause", "joints", "start", "stop", "certainty", "detail",
    }  # fmt: skip
    assert all(type(facts[name]) in (int, float) for name in ("start", "stop", "certainty"))


# What the world says ----------------------------------------------------------------------------------------


def jumping_root(start: int, stop: int, made_up: bool) -> Take:
    """A rig whose root turns by 12 degrees and shifts by 6 cm, and whose children, if asked, undo it at once."""
    take = rig_take(600)
    assert take.rig is not None
    places, turns = (array[start:stop] for array in take.rig.kinematics)
    rotations, translations = take.rig.rotations.copy(), take.rig.translations.copy()
    rotations[start:stop, 0] = multiply(from_rotvec(np.array([0.0, 0.15, 0.15])), rotations[start:stop, 0])
    translations[start:stop, 0] += [0.06, 0.0, 0.0]
    if made_up:
        back = inverse(rotations[start:stop, 0])
        for child in (1, 3):
            rotations[start:stop, child] = multiply(back, turns[:, child])
            translations[start:stop, child] = apply(back, places[:, child] - translations[start:stop, 0])
    moves = np.array([True, True, False, True, False])
    return take.with_rig(replace(take.rig, rotations=rotations, translations=translations, moves=moves))


@pytest.mark.parametrize("stop", [281, 320])
def test_a_jump_that_the_joints_below_make_up_for_is_told_and_left_alone(stop):
    diagnosis = diagnose(jumping_root(280, stop, made_up=True))
    told_of = [f for f in diagnosis.findings if 0 in f.indices and (f.start, f.stop) == (280, stop)]
    assert told_of and all(f.certainty < CERTAIN and "no smoother" in f.detail for f in told_of)
    assert not diagnosis.untrusted.any()


@pytest.mark.parametrize("stop", [281, 320])
def test_a_jump_that_moves_what_is_below_is_found(stop):
    expected = np.zeros((600, 5), bool)
    expected[280:stop, 0] = True
    assert np.array_equal(diagnose(jumping_root(280, stop, made_up=False)).untrusted, expected)


def test_a_jump_below_a_root_that_is_made_up_for_is_found():
    take = jumping_root(280, 281, made_up=True)
    damaged, truth = plant_and_tell(take, jump=[([2], 400, 402)], held=[([4], 100, 130)], size=0.4)
    assert np.array_equal(diagnose(damaged).untrusted, truth.mask)


def test_a_jump_in_a_swapped_stretch_is_that_of_the_joint_it_belongs_to():
    damaged = plant(rig_take(600), swap=[([1, 2], 250, 310)], jump=[([3], 280, 281)], size=0.4)
    diagnosis = diagnose(damaged)
    assert only(diagnosis, "swap").indices == (1, 3, 2, 4)
    assert np.argwhere(diagnosis.untrusted).tolist() == [[280, 1]]


def test_the_bundled_walk_keeps_its_hips():
    """CMU's solver let the hips jump in frame 12, and the legs and the spine jump back."""
    take = load(Path(motionmend.__file__).parent / "examples" / "walk.bvh")
    diagnosis = diagnose(take)
    assert any(f.joints == ("Hips",) and (f.start, f.stop) == (12, 13) for f in diagnosis.findings)
    assert not diagnosis.untrusted[:, 0].any()


# Rounding ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [1.0, 1000.0, 0.0254])
def test_a_value_that_is_held_in_another_rounding_is_held_from_its_first_frame(unit):
    """What was recorded came as float32 in some unit; the value held was written anew, from metres."""
    take = point_take(600)
    recorded = (take.motion.positions / np.float32(unit)).astype(np.float32) * np.float32(unit)
    off_by_one = np.nextafter(recorded, np.float32(np.inf))
    for first, last in ((off_by_one, recorded), (recorded, off_by_one), (off_by_one, off_by_one)):
        positions = recorded.copy()
        positions[200:230, 3] = recorded[199, 3]
        positions[199, 3], positions[229, 3] = first[199, 3], last[199, 3]
        held = only(diagnose(cloud_of(positions)), "held")
        assert (held.start, held.stop, held.certainty >= CERTAIN) == (200, 230, True)


def test_a_value_that_is_held_in_a_converted_file_is_held_from_its_first_frame(tmp_path):
    save(point_take(600), tmp_path / "walk.c3d")
    walk = load(tmp_path / "walk.c3d")
    save(plant(walk, held=[([2], 200, 230)]), tmp_path / "held.c3d")
    held = only(diagnose(load(tmp_path / "held.c3d")), "held")
    assert (held.start, held.stop, held.indices) == (200, 230, (2,))


# Edges ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frames", range(9))
@KINDS
def test_short_takes(make, frames):
    take = make(20)
    cut = slice(0, frames)
    if take.rig is None:
        motion = replace(take.motion, positions=take.motion.positions[cut], observed=take.motion.observed[cut])
        take = take.with_motion(motion)
    else:
        rig = replace(
            take.rig,
            rotations=take.rig.rotations[cut],
            translations=take.rig.translations[cut],
            trusted=take.rig.trusted[cut],
        )
        take = take.with_rig(rig)
    diagnosis = diagnose(take)
    assert diagnosis.untrusted.shape == (frames, 5) and not diagnosis.untrusted.any()


def test_all_missing_is_one_gap():
    diagnosis = diagnose(cloud_of(np.full((50, 4, 3), np.nan)))
    gap = only(diagnosis, "gap")
    assert (gap.start, gap.stop) == (0, 50) and diagnosis.untrusted.all() and len(diagnosis.findings) == 1


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), share=st.floats(0, 1), frames=st.integers(1, 40))
def test_missing_samples_never_crash_warn_or_get_trusted(seed, share, frames):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(frames, 4, 3)).cumsum(axis=0) * 0.01
    positions[rng.random((frames, 4)) < share] = np.nan
    names = ("LHand", "RHand", "LFoot", "RFoot")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        diagnosis = diagnose(cloud_of(positions, 60.0, names))
        rig = rig_take(frames)
        diagnosis_of_rig = diagnose(rig.distrust(rng.random((frames, 5)) < share))
    assert diagnosis.untrusted[np.isnan(positions).all(axis=-1)].all()
    assert diagnosis_of_rig.untrusted.shape == (frames, 5)
    for finding in diagnosis.findings:
        assert 0 <= finding.start < finding.stop <= frames and 0 <= finding.certainty <= 1


def test_diagnosis_writes_into_nothing():
    for take in (rig_take(200), point_take(200)):
        damaged = plant(take, held=[([1], 50, 60)], jump=[([2], 90, 91)], swap=[([1], 120, 150)])
        bits = damaged.motion.positions.tobytes()
        rotations = b"" if damaged.rig is None else damaged.rig.rotations.tobytes()
        diagnose(damaged)
        assert damaged.motion.positions.tobytes() == bits
        assert damaged.rig is None or damaged.rig.rotations.tobytes() == rotations


# Real captures ----------------------------------------------------------------------------------------------

VALIDATION = ("06/06_02.bvh", "16/16_15.amc", "16/16_35.amc", "16/16_04.amc")


def as_points(take: Take) -> Take:
    return cloud_of(take.motion.positions, take.fps, take.skeleton.names)


@pytest.mark.parametrize("name", VALIDATION)
@pytest.mark.parametrize("kind", ["channels", "points"])
def test_damage_in_real_movement(cmu, name, kind):
    take = load(cmu / name, fps=120.0)
    if kind == "points":
        take = as_points(take)
    known = diagnose(take).untrusted  # these captures have a few glitches of their own
    assert known.mean() <= 0.01
    arm = next(pair for pair in mirrored_pairs(take.skeleton.names) if "umerus" in take.skeleton.names[pair[0]]
               or "Shldr" in take.skeleton.names[pair[0]])  # fmt: skip
    damaged, truth = plant_and_tell(
        take, gaps=[(30, 42)], held=[([arm[0]], 60, 72)], jump=[([arm[1]], 85, 87)],
        displaced=[([arm[0]], 95, 110)], size=0.3,
    )  # fmt: skip
    found = diagnose(damaged).untrusted
    assert (found & truth.mask).sum() >= 0.95 * truth.mask.sum()
    assert (found & ~truth.mask & ~known).sum() <= 0.02 * truth.mask.sum()


def test_the_converters_t_pose_is_a_t_pose_and_no_jump(cmu):
    diagnosis = diagnose(load(cmu / "06/06_02.bvh", fps=120.0))
    assert only(diagnosis, "t-pose").stop == 1 and not diagnosis.untrusted[:4].any()


def test_quiet_and_slow_rate_captures_are_hardly_accused(reactidle, bandai):
    takes = sorted(reactidle.rglob("*.bvh"))[::8] + sorted(bandai.rglob("*.bvh"))[::120]
    accused = [diagnose(load(path)).untrusted for path in takes]
    assert sum(mask.sum() for mask in accused) <= 0.0005 * sum(mask.size for mask in accused)


@pytest.mark.slow
def test_clean_captures_are_hardly_accused(cmu):
    files = [*sorted((cmu / "06").glob("*.bvh")), *sorted((cmu / "16").glob("*.amc"))]
    takes = [load(path, fps=120.0) for path in files]
    assert len(takes) > 70
    for kind in (takes, [as_points(take) for take in takes]):
        accused = [diagnose(take).untrusted for take in kind]
        assert sum(mask.sum() for mask in accused) <= 0.002 * sum(mask.size for mask in accused)


def test_a_joint_that_hardly_moved_when_its_limb_froze_is_found_with_it():
    """By itself a joint that slows down, rests and leaves could be at a turning point; frozen in just the frames of its
    neighbour it is not."""
    clock = np.arange(240) / 120
    swing = np.stack([np.sin(4 * clock), 0.3 * np.cos(3 * clock), clock], axis=-1)
    turning = np.stack([(clock - 0.99) ** 2, 0.2 * (clock - 0.99) ** 2, 0 * clock], axis=-1)
    positions = np.stack([swing, turning, 0.5 * swing[:, ::-1]], axis=1).astype(np.float32)
    positions[120:150, :2] = positions[119, :2]
    motion = Motion(positions, np.ones(positions.shape[:2], bool), 120.0, Skeleton.cloud(("a", "b", "c")))
    take = Take(motion, None, None, Units(1.0, "y", "made"), "npz", "made.npz")
    untrusted = diagnose(take).untrusted
    assert untrusted[120:150, :2].all()
    assert not untrusted[:, 2].any()
