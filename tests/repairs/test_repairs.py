"""Whole repairs of real takes, held against truth that was planted and a filler that is not ours."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import motionmend as mm
import walks
from motionmend.motion import Skeleton, Take, Units
from walks import WALK


@pytest.fixture(scope="module")
def walk() -> mm.Take:
    return mm.load(WALK)


@pytest.fixture(scope="module")
def cloud(walk) -> mm.Take:
    """The walk's joints as a cloud of markers."""
    skeleton = Skeleton.cloud(walk.skeleton.names)
    motion = mm.Motion(walk.motion.positions, walk.motion.observed, walk.fps, skeleton)
    return mm.Take(motion, None, None, Units(1.0, "y", "made"), "npz", "walk.npz")


def scipy_hermite(positions: np.ndarray, start: int, stop: int, context: int = 4) -> np.ndarray:
    """Positions in a gap by SciPy's Hermite spline, end velocities from the mean of a few steps."""
    before = np.diff(positions[start - context : start].astype(float), axis=0).mean(axis=0)
    after = np.diff(positions[stop : stop + context].astype(float), axis=0).mean(axis=0)
    ends = positions[[start - 1, stop]].astype(float)
    return CubicHermiteSpline([start - 1, stop], ends, [before, after])(np.arange(start, stop))


def spoiled(take: mm.Take, mask: np.ndarray) -> mm.Take:
    """The take with nonsense where the mask is True, so that a fill that peeks is found out."""
    if take.rig is None:
        positions = np.where(mask[..., None], np.float32(77), take.motion.positions)
        return take.with_motion(replace(take.motion, positions=positions))
    rotations = np.where(mask[..., None], [0.6, 0.0, 0.0, 0.8], take.rig.rotations)
    return take.with_rig(replace(take.rig, rotations=rotations))


@pytest.mark.parametrize("start", [0, 150])
@pytest.mark.parametrize("method", ["auto", "hermite"])
def test_a_leg_that_is_lost_for_good_is_not_called_repaired(walk, method, start):
    """Neither turns nor paths can be filled: from 150 on, too, more than a second is missing up to the end."""
    fixed = mm.repair(walk, lost=[(["LeftUpLeg", "LeftLeg", "LeftFoot"], start, len(walk))], method=method)
    assert fixed.report.repaired == 0 and not fixed.report.fills
    assert [(row.start, row.stop) for row in fixed.report.left] == [(start, len(walk))]


def test_a_gap_is_filled_as_well_as_by_scipy(cmu):
    """Full gaps of 0.1 to 0.9 s in takes of six kinds: our mean error is at most SciPy's."""
    ours, theirs = [], []
    for trial in ("16/16_01.amc", "16/16_15.amc", "16/16_35.amc", "16/16_21.amc", "16/16_10.amc", "16/16_57.amc"):
        take = mm.load(cmu / trial)
        for seconds in (0.1, 0.3, 0.5, 0.7, 0.9):
            length = round(seconds * take.fps)
            start = (len(take) - length) // 2
            truth = take.motion.positions[start : start + length]
            broken = spoiled(take, np.isin(np.arange(len(take)), np.arange(start, start + length))[:, None])
            fixed = mm.repair(broken, gaps=[(start, start + length)], method="hermite")
            ours.append(np.linalg.norm(fixed.motion.positions[start : start + length] - truth, axis=-1).mean())
            guess = scipy_hermite(take.motion.positions, start, start + length)
            theirs.append(np.linalg.norm(guess - truth, axis=-1).mean())
    assert np.mean(ours) <= np.mean(theirs)


def test_only_the_named_frames_of_the_file_change(walk, tmp_path):
    fixed = mm.repair(walk, gaps=[(120, 150)], lost=["LeftArm,LeftForeArm:200:230"], method="hermite")
    path = mm.save(fixed, tmp_path / "fixed.bvh")
    before, after = WALK.read_bytes().splitlines(keepends=True), path.read_bytes().splitlines(keepends=True)
    assert len(before) == len(after)
    first = len(before) - 359
    changed = [line - first for line in range(len(before)) if before[line] != after[line]]
    assert changed
    assert set(changed) <= {*range(120, 150), *range(200, 230)}
    # In the lines of the lost arm, the other joints' numbers keep their spelling.
    for line in range(first + 200, first + 230):
        old, new = before[line].split(), after[line].split()
        assert 1 <= sum(a != b for a, b in zip(old, new, strict=True)) <= 6


def test_the_file_holds_what_memory_holds(walk, tmp_path):
    fixed = mm.repair(walk, gaps=[(120, 180)])
    again = mm.load(mm.save(fixed, tmp_path / "fixed.bvh"))
    np.testing.assert_allclose(again.motion.positions, fixed.motion.positions, atol=1e-5)


def test_bones_keep_their_lengths(walk):
    fixed = mm.repair(walk, gaps=[(120, 180)], lost=["LeftUpLeg,LeftLeg,LeftFoot,LeftToeBase:220:260"])
    parents = np.array(walk.skeleton.parents)
    lengths = [
        np.linalg.norm(take.motion.positions[:, 1:] - take.motion.positions[:, parents[1:]], axis=-1)
        for take in (walk, fixed)
    ]
    np.testing.assert_allclose(lengths[1], lengths[0], atol=1e-5)


@pytest.mark.parametrize("method", ["linear", "hermite", "eased", "cubic", "pattern", "bones", "rigid", "xmae", "auto"])
@pytest.mark.parametrize("kind", ["walk", "cloud"])
def test_every_method_repairs_both_kinds_of_take(request, kind, method):
    take = request.getfixturevalue(kind)
    mask = np.zeros(take.trusted.shape, bool)
    mask[150:162] = True
    mask[200:220, take.skeleton.index("LeftForeArm")] = True
    broken = spoiled(take, mask)
    fixed = mm.repair(broken, gaps=[(150, 162)], lost=["LeftForeArm:200:220"], method=method)
    assert fixed.trusted.all()
    assert fixed.report.repaired == mask.sum()
    assert fixed.report.checks["changed"]["value"] == 0
    error = np.linalg.norm(fixed.motion.positions - take.motion.positions, axis=-1)
    assert error.max() < 0.08
    if take.rig is None:
        assert np.array_equal(fixed.motion.positions[~mask], take.motion.positions[~mask])
    else:
        assert np.array_equal(fixed.rig.rotations[~mask], take.rig.rotations[~mask])


def test_what_is_named_is_all_that_is_repaired(walk):
    """The walk has a glitch or two of its own; they are nobody's business until asked for."""
    broken = mm.plant(walk, gaps=[(200, 230)], seed=1)
    fixed = mm.repair(broken, gaps=[(120, 150)])
    assert np.array_equal(fixed.rig.rotations[200:230], broken.rig.rotations[200:230])
    both = mm.repair(broken, gaps=[(120, 150)], find=True)
    assert not np.array_equal(both.rig.rotations[200:230], broken.rig.rotations[200:230])


def test_missing_samples_that_were_not_named_stay_missing(cloud):
    broken = mm.plant(cloud, lost=[([5], 40, 60)])
    fixed = mm.repair(broken, gaps=[(100, 110)])
    assert not fixed.motion.observed[40:60, 5].any()
    assert fixed.motion.observed[100:110].all()
    assert [(fill.start, fill.stop, fill.why) for fill in fixed.report.left] == [(40, 60, "missing, but not named")]
    assert mm.repair(broken, gaps=[(100, 110)], find=True).motion.observed.all()
    assert mm.repair(cloud.distrust(~broken.motion.observed), find=False).motion.observed.all()


def test_damage_is_found_without_being_told(walk, cloud):
    joints = [walk.skeleton.index(name) for name in ("LeftArm", "LeftForeArm", "LeftHand")]
    for take in (walk, cloud):
        broken = mm.plant(take, gaps=[(128, 160)], held=[(joints, 230, 270)], jump=[(joints[1:2], 300, 302)], seed=3)
        fixed = mm.repair(broken)
        off = [np.linalg.norm(each.motion.positions - take.motion.positions, axis=-1) for each in (broken, fixed)]
        assert np.nanmean(off[1]) < 0.004
        assert off[1][300:302, joints[1:]].max() < 0.02
        causes = {finding["cause"] for finding in fixed.report.findings}
        assert {"gap", "held", "jump"} <= causes


def test_a_swap_is_undone_to_the_bit(cloud):
    pair = [cloud.skeleton.index("LeftFoot"), cloud.skeleton.index("LeftToeBase"), cloud.skeleton.index("LeftLeg")]
    broken = mm.plant(cloud, swap=[(pair, 150, 190)])
    assert not np.array_equal(broken.motion.positions, cloud.motion.positions)
    fixed = mm.repair(broken)
    assert np.array_equal(fixed.motion.positions[150:190], cloud.motion.positions[150:190])


def test_long_gaps_are_left_and_marked_or_kept(cloud):
    spec = {"gaps": [(50, 60), (100, 200)], "max_gap": "0.5s"}
    marked = mm.repair(cloud, **spec)
    assert marked.motion.observed[50:60].all()
    assert not marked.motion.observed[100:200].any()
    assert [(fill.start, fill.stop) for fill in marked.report.left] == [(100, 200)]
    kept = mm.repair(cloud, **spec, keep_longer=True)
    assert kept.motion.observed.all()
    assert np.array_equal(kept.motion.positions[100:200], cloud.motion.positions[100:200])


def test_nothing_is_held_silently_at_the_ends(cloud):
    fixed = mm.repair(cloud, gaps=[(340, 359)])
    assert all("extrapolated" in fill.why for fill in fixed.report.fills)
    far = mm.repair(cloud, gaps=[(100, 359)])
    assert not far.motion.observed[100:].any()
    assert far.report.left[0].why == "nothing is known after it"


def test_a_clean_take_comes_back_the_same(cmu, tmp_path):
    path = cmu / "07" / "07_01.bvh"
    take = mm.load(path)
    fixed = mm.repair(take)
    assert fixed.report.repaired <= 0.002 * fixed.report.samples
    if not fixed.report.repaired:
        assert mm.save(fixed, tmp_path / "same.bvh").read_bytes() == path.read_bytes()


def test_the_report_is_json_and_adds_up(walk):
    fixed = mm.repair(walk, gaps=[(120, 150)])
    facts = json.loads(fixed.report.to_json())
    assert facts["repaired"] == 30 * 31
    assert sorted(name for row in facts["fills"] for name in row["joints"]) == sorted(walk.skeleton.names)
    assert "120:150" in str(fixed.report)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"gaps": [(0, 359)]}, "no sample"),
        ({"gaps": ["400:420"]}, "no frame"),
        ({"lost": ["LeftHnd:3:9"]}, "LeftHand"),
        ({"gaps": [(3, 9)], "method": "hermit"}, "hermite"),
        ({"gaps": [(3, 9)], "donors": ["Nobody"]}, "Nobody"),
        ({"gaps": [(3, 9)], "donors": ["LeftHand"]}, "follow their parents"),
    ],
)
def test_what_cannot_be_done_is_said(walk, options, words):
    with pytest.raises(mm.InputError, match=words):
        mm.repair(walk, **options)


def test_planted_feet_slide_less(cmu):
    take = mm.load(cmu / "16" / "16_15.amc")
    start = 180
    plain, planted = (mm.repair(take, gaps=[(start, start + 60)], plant_feet=flag) for flag in (False, True))
    assert planted.report.checks["changed"]["value"] == 0
    assert plain.report.checks["foot_skate"]["value"] > 50  # mm/s
    assert planted.report.checks["foot_skate"]["value"] < 1


def test_points_with_bones_keep_their_lengths(walk):
    """A skeleton of positions, as an NPZ holds it: a filled limb neither shrinks nor stretches."""
    motion = mm.Motion(walk.motion.positions[1:], walk.motion.observed[1:], walk.fps, walk.skeleton)
    take = mm.Take(motion, None, None, Units(1.0, "y", "made"), "npz", "walk.npz")
    fixed = mm.repair(take, gaps=[(120, 180)], lost=["LeftLeg,LeftFoot,LeftToeBase:250:300"])
    assert fixed.report.checks["bone_length"]["value"] < 0.01
    mask = np.ones(len(take), bool)
    mask[120:180] = mask[250:300] = False
    assert np.array_equal(fixed.motion.positions[mask], motion.positions[mask])


def test_the_report_names_the_donors(cloud):
    fixed = mm.repair(cloud, lost=["LeftForeArm:150:180"], method="pattern", donors=["LeftArm", "LeftHand"])
    (fill,) = fixed.report.fills
    assert fill.method == "pattern"
    assert set(fill.donors) < {"LeftArm", "LeftHand"}
    assert len(fill.donors) == 1


def test_the_report_tells_how_much_denoising_changed():
    """Noise on the joints of a body: bones and joints shake less after the filter, and both are told."""
    motion = walks.walk(60.0)
    noise = np.random.default_rng(0).normal(0, 0.005, motion.positions.shape).astype(np.float32)
    shaken = replace(motion, positions=motion.positions + noise)
    noisy = Take(shaken, None, None, Units(1.0, "y", "made up"), "npz", "made")
    told = mm.repair(noisy, denoise="butterworth").report
    assert told.denoised is not None and told.denoised.method == "butterworth"
    before, after = told.denoised.limb_sigma
    assert 4 < before < 10 and after < 0.6 * before
    before, after = told.denoised.jitter
    assert after < 0.1 * before
    apart = 1000 * np.linalg.norm(noise, axis=-1)
    assert 0.5 * apart.mean() < told.denoised.moved < 1.5 * apart.mean() < told.denoised.farthest
    assert "limb σ" in str(told) and "then the whole take denoised by butterworth" in str(told)
    assert '"limb_sigma"' in told.to_json()
    assert mm.repair(noisy).report.denoised is None


@pytest.mark.parametrize("method", ["local", "regression", "pca", "average"])
def test_fills_for_markers_mend_a_rig_by_its_joints_places(walk, method):
    """A hand whose forearm is lost follows the path that the fill finds; bones keep their lengths."""
    fixed = mm.repair(walk, lost=["LeftForeArm:120:180", "LeftHand:120:180"], method=method)
    told = {(fill.joints, fill.method) for fill in fixed.report.fills}
    assert told == {(("LeftForeArm", "LeftHand"), method)}
    assert fixed.report.checks["changed"]["value"] == 0
    off = np.linalg.norm(fixed.motion.positions - walk.motion.positions, axis=-1)
    assert off[:120].max() < 1e-6 and off[180:].max() < 1e-6 and 0 < off[120:180].max() < 0.15
    lengths = [np.linalg.norm(np.diff(each.motion.positions[:, list(pair)], axis=1), axis=-1) for each in (walk, fixed)
               for pair in [[walk.skeleton.index(name) for name in ("LeftForeArm", "LeftHand")]]]
    np.testing.assert_allclose(lengths[1], lengths[0], atol=1e-5)
