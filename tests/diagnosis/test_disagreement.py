"""Joints that are displaced are told by their bones and put right; what is good, or unsure, is left as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import motionmend as mm
from motionmend.body.links import find_links
from motionmend.body.mapping import map_rig
from motionmend.damage.planting import mirrored_pairs, plant
from motionmend.diagnosis.diagnosing import diagnose
from motionmend.diagnosis.disagreement import disagreements
from motionmend.diagnosis.findings import CERTAIN, undone
from motionmend.diagnosis.offsets import solve_offset
from motionmend.motion import Motion, Skeleton, Take, Units
from walks import WALK

UNITS = Units(1.0, "y", "metres")


def points(motion: Motion, names: tuple[str, ...] | None = None, *, bones: bool = True) -> Take:
    skeleton = motion.skeleton if bones else Skeleton.cloud(names or motion.skeleton.names)
    return Take(replace(motion, skeleton=skeleton), None, None, UNITS, "npz", "walk.npz")


@pytest.fixture(scope="module")
def walk() -> Take:
    """A real walk of three seconds at 120 fps, as joint centres with bones; without its first frame, a T-pose."""
    motion = mm.load(WALK).motion
    return points(replace(motion, positions=motion.positions[1:], observed=motion.observed[1:]))


@pytest.fixture(scope="module")
def cloud(walk) -> Take:
    return points(walk.motion, bones=False)


def below(take: Take, name: str) -> list[int]:
    """The joint of this name and all that hangs on it; parents come before their children."""
    joints = [take.skeleton.index(name)]
    for joint, parent in enumerate(take.skeleton.parents):
        if parent in joints:
            joints.append(joint)
    return joints


def displaced(take: Take, joints, start: int, stop: int, offset, ramp: int = 0) -> tuple[Take, np.ndarray]:
    """The take with these joints off by `offset` metres, which grows and fades over `ramp` frames; and where."""
    weights = np.zeros(len(take))
    count = stop - start
    there = np.minimum(np.arange(1, count + 1), np.arange(count, 0, -1)) / ramp if ramp else np.ones(count)
    weights[start:stop] = np.minimum(1, there)
    positions = take.motion.positions.copy()
    positions[:, joints] += (weights[:, None, None] * np.asarray(offset)).astype(np.float32)
    mask = np.zeros(take.trusted.shape, bool)
    mask[start:stop, joints] = True
    return take.with_motion(replace(take.motion, positions=positions)), mask


def errors(take: Take, truth: Take, mask: np.ndarray) -> float:
    """Metres, the mean over the mask."""
    return float(np.linalg.norm(take.motion.positions - truth.motion.positions, axis=-1)[mask].mean())


def certain(take: Take):
    return [finding for finding in diagnose(take).findings if finding.certainty >= CERTAIN and finding.cause != "noise"]


def with_positions(take: Take, positions: np.ndarray) -> Take:
    return take.with_motion(replace(take.motion, positions=positions.astype(np.float32)))


# What is good -----------------------------------------------------------------------------------------------


def test_a_clean_walk_is_not_accused(walk, cloud):
    assert not disagreements(walk.motion) and not disagreements(cloud.motion)
    assert not certain(walk) and not certain(cloud)


@pytest.mark.parametrize("level", [0.002, 0.005, 0.015])
def test_a_noisy_skeleton_is_not_accused(walk, level):
    noise = np.random.default_rng(0).normal(0, level, walk.motion.positions.shape)
    assert not certain(with_positions(walk, walk.motion.positions + noise))


@pytest.mark.parametrize("size", [0.005, 0.02, 0.05])
def test_bones_that_stretch_by_themselves_are_not_accused(walk, size):
    """Every joint drifts to and fro on its own, as markers on soft tissue and joints with position channels do."""
    rng = np.random.default_rng(1)
    time = np.arange(len(walk))[:, None, None] / walk.fps
    shape = (1, len(walk.skeleton), 3)
    drift = sum(np.sin(2 * np.pi * rate * time + rng.uniform(0, 6, shape)) for rate in (0.4, 1.1, 2.3))
    assert not certain(with_positions(walk, walk.motion.positions + size / 2 * drift))


def test_a_bone_that_stretches_with_every_step_is_not_accused(walk):
    knee = walk.skeleton.index("LeftLeg")
    stretch = 0.04 * np.maximum(0, np.sin(2 * np.pi * 2 * np.arange(len(walk)) / walk.fps)) ** 8
    positions = walk.motion.positions.copy()
    positions[:, knee, 1] += stretch
    assert not disagreements(with_positions(walk, positions).motion)


@pytest.mark.parametrize("frames", [1, 2, 3, 9, 10, 11, 20])
def test_short_takes_are_judged_without_complaint(walk, frames):
    motion = replace(walk.motion, positions=walk.motion.positions[:frames], observed=walk.motion.observed[:frames])
    broken, _ = displaced(points(motion), [20], frames // 2, frames, [0.3, 0, 0])
    diagnose(broken)
    assert not disagreements(motion)


def test_a_cloud_in_which_nobody_is_recognised_has_no_bones_to_judge_by(walk):
    motion = walk.motion
    skeleton = Skeleton.cloud(tuple(f"M{number}" for number in range(len(motion.skeleton))))
    broken, _ = displaced(points(motion), below(walk, "LeftArm"), 100, 240, [0.2, 0.1, 0])
    assert not disagreements(replace(broken.motion, skeleton=skeleton))


def test_channels_are_judged_by_channels():
    take = plant(mm.load(WALK), displaced=[([8], 100, 160)], size=0.4)
    assert not any("bones fit" in finding.detail for finding in diagnose(take).findings)


# What is off by one offset ----------------------------------------------------------------------------------

SOME = [
    ("LeftArm", 100, 136, 0.1),
    ("LeftArm", 60, 190, 0.05),
    ("RightArm", 0, 100, 0.2),
    ("RightHand", 200, 358, 0.1),
    ("LeftUpLeg", 150, 186, 0.5),
    ("RightUpLeg", 238, 358, 0.05),
]


@pytest.mark.parametrize("number", range(len(SOME)))
def test_a_limb_off_by_one_offset_is_moved_back_to_the_millimetre(walk, number):
    top, start, stop, size = SOME[number]
    offset = np.random.default_rng(number).normal(size=3)
    broken, mask = displaced(walk, below(walk, top), start, stop, size * offset / np.linalg.norm(offset))
    (found,) = certain(broken)
    assert (found.cause, found.start, found.stop) == ("displaced", start, stop)
    assert set(found.indices) == set(below(walk, top)) and found.is_undone
    fixed = mm.repair(broken)
    assert errors(fixed, walk, mask) < 0.006 < 0.1 * errors(broken, walk, mask) + 0.004
    assert fixed.motion.positions[~mask].tobytes() == walk.motion.positions[~mask].tobytes()
    (row,) = fixed.report.fills
    assert (row.method, row.start, row.stop) == ("shift", start, stop)


@pytest.mark.parametrize("name", ["LeftForeArm", "RightLeg", "RightFoot", "Neck1"])
def test_one_joint_between_good_ones_is_accused_alone(walk, name):
    joint = walk.skeleton.index(name)
    broken, mask = displaced(walk, [joint], 120, 180, [0.05, 0.03, -0.04])
    assert {joint for finding in certain(broken) for joint in finding.indices} == {joint}
    assert errors(mm.repair(broken), walk, mask) < 0.005


def test_an_offset_that_grows_and_fades_is_put_right(walk):
    broken, mask = displaced(walk, below(walk, "LeftArm"), 100, 208, [0.15, -0.2, 0.1], ramp=12)
    fixed = mm.repair(broken)
    assert errors(fixed, walk, mask) < 0.25 * errors(broken, walk, mask)
    changed = (fixed.motion.positions != broken.motion.positions).any(axis=-1)
    assert not changed[:96].any() and not changed[212:].any() and mask[:, changed.any(axis=0)].any(axis=0).all()


def test_a_short_bump_is_filled_where_a_prediction_is_sure_of_it(walk):
    """Never at rest for a frame: no offset to take out."""
    joints = below(walk, "RightUpLeg")
    bump = np.sin(np.pi * np.arange(30) / 30)[:, None, None] * np.array([0.2, 0.1, -0.1])
    positions = walk.motion.positions.copy()
    positions[150:180, joints] += bump.astype(np.float32)
    broken = with_positions(walk, positions)
    mask = np.zeros(walk.trusted.shape, bool)
    mask[150:180, joints] = True
    found = [finding for finding in certain(broken) if finding.cause == "displaced"]
    assert found and all(finding.shift is None and "predicted" in finding.detail for finding in found)
    assert errors(mm.repair(broken), walk, mask) < 0.25 * errors(broken, walk, mask)


def test_names_tell_the_bones_of_points_without_parents(walk, cloud):
    mapping = map_rig(walk.skeleton, walk.motion.positions)
    arm = [joint for joint in below(walk, "LeftArm") if joint in mapping.joints]
    broken, mask = displaced(cloud, arm, 100, 230, [0.1, 0.1, 0.02])
    (found,) = certain(broken)
    assert set(found.indices) == set(arm) and (found.start, found.stop) == (100, 230)
    assert errors(mm.repair(broken), cloud, mask) < 0.005


def test_samples_missing_in_a_displaced_stretch_are_filled_in_their_right_place(walk):
    joints = below(walk, "LeftArm")
    broken, mask = displaced(walk, joints, 100, 240, [0.1, 0.2, 0.0])
    positions, observed = broken.motion.positions.copy(), broken.motion.observed.copy()
    positions[160:170, joints] = np.nan
    observed[160:170, joints] = False
    fixed = mm.repair(broken.with_motion(replace(broken.motion, positions=positions, observed=observed)))
    assert errors(fixed, walk, mask) < 0.01


def test_what_moves_on_while_it_is_displaced_for_long_is_told_and_left(walk):
    joints = below(walk, "LeftUpLeg")
    time = np.arange(140)[:, None, None] / 140
    positions = walk.motion.positions.copy()
    positions[110:250, joints] += (np.sin(np.pi * time) * [0.3 * 1, 0.2, 0.1] * np.cos(7 * time)).astype(np.float32)
    broken = with_positions(walk, positions)
    assert not certain(broken)
    assert any("not plain" in finding.detail for finding in diagnose(broken).findings)
    assert mm.repair(broken).motion.positions.tobytes() == broken.motion.positions.tobytes()


# Twins --------------------------------------------------------------------------------------------------------


AT_ENDS = [("LeftArm", 0, 80), ("LeftForeArm", 260, 358), ("LeftUpLeg", 0, 120)]


@pytest.mark.parametrize(("top", "start", "stop"), AT_ENDS)
def test_a_swap_at_an_end_of_the_take_is_told_by_the_bones_and_exchanged_back(walk, top, start, stop):
    twins = {one: other for pair in mirrored_pairs(walk.skeleton.names) for one, other in (pair, pair[::-1])}
    joints = [joint for joint in below(walk, top) if joint in twins]
    broken = plant(walk, swap=[(joints, start, stop)])
    (found,) = [finding for finding in diagnose(broken).findings if finding.cause == "swap"]
    assert (found.start, found.stop) == (start, stop) and found.certainty >= CERTAIN
    assert mm.repair(broken).motion.positions.tobytes() == walk.motion.positions.tobytes()


def test_a_swap_is_undone_by_its_pairs_whatever_the_names(walk):
    broken = plant(walk, swap=[(below(walk, "LeftArm"), 200, 358)])
    swap = next(finding for finding in diagnose(broken).findings if finding.cause == "swap")
    nameless = Skeleton(tuple(f"J{joint}" for joint in range(len(walk.skeleton))), walk.skeleton.parents)
    renamed = broken.with_motion(replace(broken.motion, skeleton=nameless))
    assert undone(renamed, swap).motion.positions.tobytes() == undone(broken, swap).motion.positions.tobytes()


# The parts ----------------------------------------------------------------------------------------------------


def test_links_are_bones_and_what_hangs_on_one_parent(walk):
    links = find_links(walk.motion, walk.motion.positions.astype(float))
    pairs = {tuple(walk.skeleton.names[joint] for joint in pair) for pair in links.ends.tolist()}
    assert {("LeftArm", "LeftForeArm"), ("LeftUpLeg", "RightUpLeg")} <= pairs
    assert ("LeftHand", "RightHand") not in pairs
    exact = links.pick(links.noise < 1e-5)
    assert len(exact) >= 30 and np.abs(exact.misfits(walk.motion.positions.astype(float))).max() < 1e-4


@pytest.mark.parametrize("offset", [(0.1, 0, 0), (0, -0.3, 0.2), (0.02, 0.03, 0.01)])
def test_an_offset_is_solved_from_bones_alone_where_they_turn(walk, offset):
    joints = below(walk, "RightForeArm")
    broken, _ = displaced(walk, joints, 0, len(walk), offset)
    links = find_links(walk.motion, walk.motion.positions.astype(float))
    moved = np.isin(np.arange(len(walk.skeleton)), joints)
    solved, doubt = solve_offset(broken.motion.positions.astype(float), links, moved, 0.5 * np.array(offset))
    assert np.linalg.norm(solved - offset) < max(3 * doubt, 1e-3)
