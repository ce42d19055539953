"""Fills against SciPy, against motions they must reproduce exactly, and the contract that all of them keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from motionmend import gaps
from motionmend.errors import InputError
from motionmend.fills.auto import WINNERS, Auto, choose, rig_methods
from motionmend.fills.channels import RIG_FILLS, fill_rig
from motionmend.fills.kinds import rig_kinds
from motionmend.fills.points import FILLS
from motionmend.gaps import Gaps
from motionmend.memory.filling import Recall
from motionmend.motion import Motion, Skeleton, runs
from rigs import random_rig

METHODS = {**FILLS, "auto": Auto(), "recall": Recall()}
RIG_METHODS = {**{name: name for name in RIG_FILLS}, "auto": rig_methods}
CURVES = ("linear", "hermite", "eased", "cubic")


def cloud(positions, observed=None, fps=100.0):
    positions = np.asarray(positions, np.float32)
    observed = np.ones(positions.shape[:2], bool) if observed is None else observed
    skeleton = Skeleton.cloud([f"m{marker}" for marker in range(positions.shape[1])])
    return Motion(positions, observed, fps, skeleton)


def smooth_cloud(seed, frames=60, markers=5, spread=1.0):
    """Markers on a body that turns and wanders, each swaying on it a little."""
    rng = np.random.default_rng(seed)
    clock = np.linspace(0, frames / 100, frames)[:, None]
    turn = Rotation.from_rotvec(np.sin(3 * clock + rng.normal()) * rng.normal(size=3))
    places = rng.normal(size=(markers, 3)) * 0.2 * spread
    way = np.sin(clock * rng.uniform(1, 4, 3) + rng.normal(size=3))
    sway = 0.002 * np.sin(9 * clock[:, None] + rng.normal(size=(markers, 3)))
    return np.stack([turn.apply(place) for place in places], 1) + sway + way[:, None]


def random_mask(seed, frames, joints):
    rng = np.random.default_rng(seed)
    observed = np.ones((frames, joints), bool)
    for _ in range(rng.integers(0, 6)):
        start, length = rng.integers(-5, frames), rng.integers(1, 20)
        observed[max(start, 0) : start + length, rng.random(joints) < rng.choice([0.3, 1.0])] = False
    return observed & (rng.random((frames, joints)) < rng.choice([1.0, 0.9]))


def hide(motion, filler):
    return replace(motion, positions=np.where(motion.observed[..., None], motion.positions, np.float32(filler)))


# --- gaps -------------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(1, 4))
@settings(max_examples=60, derandomize=True, deadline=None)
def test_gaps_are_the_runs_of_what_is_missing(seed, frames, joints):
    observed = np.random.default_rng(seed).random((frames, joints)) < 0.7
    found = Gaps.of(observed)
    expected = [(joint, *run) for joint in range(joints) for run in runs(~observed[:, joint])]
    assert list(zip(found.joint, found.start, found.stop)) == expected
    for joint, start, stop, before, after in zip(found.joint, found.start, found.stop, found.before, found.after):
        assert observed[start - before : start, joint].all() and observed[stop : stop + after, joint].all()
        assert start - before == 0 or not observed[start - before - 1, joint]
        assert stop + after == frames or not observed[stop + after, joint]


def test_longer_gaps_are_marked_whole():
    observed = np.ones((20, 2), bool)
    observed[3:6, 0] = observed[10:14, 0] = observed[:3, 1] = False
    expected = np.zeros((20, 2), bool)
    expected[10:14, 0] = True
    assert np.array_equal(gaps.longer(observed, 3), expected)


# --- independent oracles ----------------------------------------------------------------------------------


def test_hermite_is_scipys_with_velocities_of_a_parabola():
    positions = smooth_cloud(1)
    observed = np.ones(positions.shape[:2], bool)
    observed[25:40, 2] = False
    filled = FILLS["hermite"].complete(cloud(positions, observed)).positions
    track, fps = positions[:, 2].astype(np.float32).astype(float), 100.0
    slopes = []
    for seam, others in ((24, np.arange(16, 24)), (40, np.arange(41, 49))):
        away = (others - seam) / fps
        design = np.stack([away, away**2], axis=1)
        slopes.append(np.linalg.lstsq(design, track[others] - track[seam], rcond=None)[0][0])
    spline = CubicHermiteSpline([24 / fps, 40 / fps], track[[24, 40]], np.array(slopes))
    np.testing.assert_allclose(filled[25:40, 2], spline(np.arange(25, 40) / fps), atol=2e-6)


@pytest.mark.parametrize(("first", "last"), [(20, 120), (34, 39)])
def test_eased_is_scipys_hermite_with_velocities_that_carry_for_three_quarters_of_a_second(first, last):
    """By hand: parabolas over eight frames where there are so many, slopes of lines where only two are."""
    positions = smooth_cloud(3, frames=160)
    observed = np.zeros(positions.shape[:2], bool)
    beside = 8 if last - first > 50 else 2
    observed[first - beside - 1 : first], observed[last : last + beside + 1] = True, True
    filled = FILLS["eased"].complete(cloud(positions, observed)).positions
    track, fps, seconds = positions[:, 2].astype(np.float32).astype(float), 100.0, (last - first + 1) / 100.0
    slopes, chord = [], (track[last] - track[first - 1]) / seconds
    for seam, others in ((first - 1, first - 2 - np.arange(beside)), (last, last + 1 + np.arange(beside))):
        away = (others - seam) / fps
        design = np.stack([away**power for power in ((1, 2) if beside == 8 else (1,))], axis=1)
        slope = np.linalg.lstsq(design, track[others] - track[seam], rcond=None)[0][0]
        slopes.append(chord + min(1, 0.75 / seconds) * (slope - chord))
    ends = [(first - 1) / fps, last / fps]
    spline = CubicHermiteSpline(ends, track[[first - 1, last]], np.array(slopes))
    np.testing.assert_allclose(filled[first:last, 2], spline(np.arange(first, last) / fps), atol=2e-6)


def test_cubic_is_scipys_spline_through_the_samples_around():
    positions = smooth_cloud(2)
    observed = np.ones(positions.shape[:2], bool)
    observed[25:40, 2] = observed[43, 2] = False
    filled = FILLS["cubic"].complete(cloud(positions, observed)).positions
    knots = np.r_[17:25, 40:43, 44:48]
    spline = CubicSpline(knots, positions[knots, 2].astype(np.float32).astype(float))
    np.testing.assert_allclose(filled[25:40, 2], spline(np.arange(25, 40)), atol=2e-6)


def test_linear_turns_are_slerp_in_the_world():
    rig = broken(random_rig(3), [(10, 25)])
    filled = fill_rig(rig, 100.0, "linear")[0]
    _, world = filled.kinematics
    for joint in range(len(rig.skeleton)):
        slerp = Slerp([9, 25], Rotation.from_quat(world[[9, 25], joint]))
        off = slerp(np.arange(10, 25)).inv() * Rotation.from_quat(world[10:25, joint])
        assert np.max(off.magnitude()) < 1e-7


def test_rigid_turns_are_slerp_against_the_parent():
    rig = broken(random_rig(4), [(10, 25)])
    filled = fill_rig(rig, 100.0, "rigid")[0]
    slerp = Slerp([9, 25], Rotation.from_quat(rig.rotations[[9, 25], 6]))
    off = slerp(np.arange(10, 25)).inv() * Rotation.from_quat(filled.rotations[10:25, 6])
    assert np.max(off.magnitude()) < 1e-7


# --- motions that must come back exactly ----------------------------------------------------------------


@pytest.mark.parametrize(("method", "degree"), [("linear", 1), ("hermite", 2), ("cubic", 3)])
def test_polynomials_are_reproduced(method, degree):
    rng = np.random.default_rng(degree)
    clock = np.linspace(-1, 1, 60)[:, None, None]
    truth = sum(rng.normal(size=(4, 3)) * clock**power for power in range(degree + 1))
    observed = np.ones((60, 4), bool)
    observed[20:35] = observed[40:44, 1] = False
    filled = FILLS[method].complete(cloud(truth, observed))
    np.testing.assert_allclose(filled.positions, truth, atol=2e-6)
    assert filled.observed.all()


@pytest.mark.parametrize("method", RIG_FILLS)
@pytest.mark.parametrize("flip", [1, -1])
def test_a_steady_spin_is_reproduced(method, flip):
    rig = random_rig(5, parents=(-1, 0), frames=60)
    axis, clock = np.array([0.6, 0.0, 0.8]), np.linspace(0, 3, 60)[:, None]
    turns = Rotation.from_rotvec(axis * clock).as_quat()
    still = np.tile(rig.rotations[0, 1], (60, 1))
    signs = np.where(np.arange(60) % 7 == 0, flip, 1)[:, None]
    rotations = np.stack([turns * signs, still], axis=1)
    shifts = rig.translations.copy()
    shifts[:, 0] = [1, 2, 3] + clock * [0.5, 0, -1]
    whole = replace(rig, rotations=rotations, translations=shifts)
    filled = fill_rig(broken(whole, [(20, 45)]), 60.0, method)[0]
    np.testing.assert_allclose(filled.kinematics[0], whole.kinematics[0], atol=1e-9)


def test_a_body_that_spins_fast_goes_on_in_its_direction():
    rig = random_rig(5, parents=(-1, 0), frames=120)
    turns = Rotation.from_rotvec([0, 1, 0] * np.linspace(0, 24, 120)[:, None]).as_quat()
    whole = replace(rig, rotations=np.stack([turns, np.tile([0, 0, 0, 1.0], (120, 1))], axis=1))
    filled = fill_rig(broken(whole, [(40, 64)]), 120.0, "hermite")[0]  # 24 frames, 4.8 radians
    off = Rotation.from_quat(filled.rotations[:, 0]).inv() * Rotation.from_quat(turns)
    assert np.max(off.magnitude()) < 1e-6


def test_rigid_is_exact_on_a_rigid_body_and_at_its_edges():
    rng = np.random.default_rng(0)
    turn = Rotation.from_rotvec(np.cumsum(rng.normal(size=(50, 3)) * 0.2, axis=0))
    places = np.array([[0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2], [-0.2, 0.1, 0], [0.1, -0.2, 0.1]])
    way = np.cumsum(rng.normal(size=(50, 3)), axis=0) * 0.1
    truth = np.stack([turn.apply(place) for place in places], axis=1) + way[:, None]
    observed = np.ones((50, 5), bool)
    observed[10:40, 1] = observed[:6, 2] = observed[45:, 4] = False
    filled, found = FILLS["rigid"].fill(cloud(truth, observed))
    assert set(found.method) == {"rigid"} and all(len(donors) >= 3 for donors in found.donors.values())
    np.testing.assert_allclose(filled.positions, truth, atol=5e-6)


def test_pattern_is_exact_beside_a_donor_that_moves_alike():
    rng = np.random.default_rng(0)
    way = np.cumsum(rng.normal(size=(80, 3)), axis=0) * 0.02
    truth = np.stack([way, way + np.array([0.1, 0, 0]), np.cumsum(rng.normal(size=(80, 3)), axis=0) * 0.02], axis=1)
    observed = np.ones((80, 3), bool)
    observed[20:70, 0] = False
    filled, found = FILLS["pattern"].fill(cloud(truth, observed))
    assert found.donors == {0: (1,)}
    np.testing.assert_allclose(filled.positions, truth, atol=1e-5)


def test_bones_are_exact_below_a_joint_that_jerks_and_say_whom_they_followed():
    """A limb of two that keeps its shape, hung on a joint that shakes; the joint between them is missing too."""
    time = np.linspace(0, 1, 60)[:, None]
    root = np.random.default_rng(0).normal(0, 0.3, (60, 3))
    elbow = root + [0, 0.3, 0] + time * [0.1, 0, 0]
    truth = np.stack([root, elbow, elbow + [0.2, 0, 0] + time**2 * [0, 0, 0.1]], axis=1).astype(np.float32)
    observed = np.ones((60, 3), bool)
    observed[20:40, 1:] = observed[50:, 2] = False
    motion = Motion(truth, observed, 100.0, Skeleton(("root", "elbow", "hand"), (-1, 0, 1)))
    filled, found = FILLS["bones"].fill(motion)
    np.testing.assert_allclose(filled.positions[:50], truth[:50], atol=1e-5)
    assert list(found.method) == ["bones"] * 3 and found.donors == {0: (0,), 1: (0,), 2: (1,)}
    observed[25] = False
    _, found = FILLS["bones"].fill(motion)
    assert set(found.method[found.joint == 1]) == {"eased"}, "its donor must be there all the time"


def test_donors_may_be_named_and_without_them_it_says_eased():
    positions = smooth_cloud(7)
    observed = np.ones(positions.shape[:2], bool)
    observed[20:40, 0] = False
    motion = cloud(positions, observed)
    _, found = replace(FILLS["rigid"], donors=("m1", "m2")).fill(motion)
    assert list(found.method) == ["eased"] and not found.donors
    _, found = replace(FILLS["pattern"], donors=("m3",)).fill(motion)
    assert found.donors.get(0, (3,)) == (3,)
    with pytest.raises(InputError, match="Did you mean"):
        replace(FILLS["pattern"], donors=("m33",)).fill(motion)


def test_markers_on_one_line_are_no_rigid_body():
    truth = smooth_cloud(3, markers=1) + np.outer([0, 1, 2, 3], [0.1, 0, 0])
    observed = np.ones(truth.shape[:2], bool)
    observed[20:40, 0] = False
    _, found = FILLS["rigid"].fill(cloud(truth, observed))
    assert list(found.method) == ["eased"]


# --- what has no far end ----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", CURVES)
def test_edges_come_to_rest_and_long_ones_are_left(method):
    clock = np.arange(400)[:, None, None] * np.array([[1.0, 0, 0]]) / 100
    observed = np.ones((400, 1), bool)
    observed[380:] = False
    filled, found = FILLS[method].fill(cloud(clock, observed))
    steps = np.diff(filled.positions[379:, 0, 0])
    assert found.is_edge.all() and filled.observed.all()
    assert np.all(np.diff(steps) < 0) and steps[0] == pytest.approx(0.01, rel=0.1) and np.all(steps > 0)
    observed[200:] = False
    filled, found = FILLS[method].fill(cloud(clock, observed))
    assert list(found.method) == [""] and not filled.observed[200:].any()


def test_a_joint_never_seen_stays_unseen():
    for method in METHODS.values():
        observed = np.ones((30, 5), bool)
        observed[:, 2] = False
        filled, found = method.fill(hide(cloud(smooth_cloud(0, 30), observed), np.nan))
        assert not filled.observed[:, 2].any() and found.is_blank.all() and set(found.method) == {""}


# --- the contract -----------------------------------------------------------------------------------------

examples = settings(max_examples=12, derandomize=True, deadline=None)
cases = given(st.integers(0, 10_000), st.sampled_from([1, 2, 3, 17, 60]), st.integers(1, 6))


@pytest.mark.parametrize("method", METHODS)
@cases
@examples
def test_observed_samples_come_back_bit_for_bit_and_missing_ones_are_never_read(method, seed, frames, markers):
    motion = cloud(smooth_cloud(seed, frames, markers), random_mask(seed, frames, markers))
    filled = METHODS[method].complete(hide(motion, np.nan))
    assert np.array_equal(filled.positions[motion.observed], motion.positions[motion.observed])
    assert np.isfinite(filled.positions[filled.observed]).all() and not np.any(motion.observed & ~filled.observed)
    again = METHODS[method].complete(hide(motion, 1e9))
    assert np.array_equal(again.positions[filled.observed], filled.positions[filled.observed])
    assert np.array_equal(again.observed, filled.observed)


@pytest.mark.parametrize("method", METHODS)
def test_all_and_nothing_missing(method):
    for frames in (1, 7):
        motion = cloud(smooth_cloud(0, frames))
        assert METHODS[method].complete(motion).positions.tobytes() == motion.positions.tobytes()
        nothing = hide(replace(motion, observed=np.zeros_like(motion.observed)), np.nan)
        assert not METHODS[method].complete(nothing).observed.any()


@pytest.mark.parametrize("method", METHODS)
@cases
@examples
def test_backwards_in_time_is_the_same_backwards(method, seed, frames, markers):
    motion = cloud(smooth_cloud(seed, frames, markers), random_mask(seed, frames, markers))
    filled = METHODS[method].complete(hide(motion, np.nan))
    turned = replace(motion, positions=motion.positions[::-1].copy(), observed=motion.observed[::-1].copy())
    again = METHODS[method].complete(hide(turned, np.nan))
    np.testing.assert_allclose(again.positions[::-1], filled.positions, atol=2e-5)


@pytest.mark.parametrize("method", METHODS)
@cases
@examples
def test_moved_and_turned_in_space_is_the_same_there(method, seed, frames, markers):
    motion = cloud(smooth_cloud(seed, frames, markers), random_mask(seed, frames, markers))
    turn, shift = Rotation.random(rng=seed), np.array([1.0, -2.0, 0.5])
    moved = np.einsum("ij,fkj->fki", turn.as_matrix(), motion.positions) + shift
    one = METHODS[method].complete(hide(motion, np.nan))
    other = METHODS[method].complete(hide(replace(motion, positions=moved.astype(np.float32)), np.nan))
    expected = np.einsum("ij,fkj->fki", turn.as_matrix(), one.positions) + shift
    np.testing.assert_allclose(other.positions, expected, atol=5e-5)


@pytest.mark.parametrize("method", METHODS)
@cases
@examples
def test_the_order_of_joints_does_not_matter(method, seed, frames, markers):
    motion = cloud(smooth_cloud(seed, frames, markers), random_mask(seed, frames, markers))
    order = np.random.default_rng(seed).permutation(markers)
    shuffled = replace(motion, positions=motion.positions[:, order], observed=motion.observed[:, order])
    one, other = (METHODS[method].complete(hide(some, np.nan)) for some in (motion, shuffled))
    np.testing.assert_allclose(other.positions, one.positions[:, order], atol=1e-6)


@cases
@examples
def test_linear_never_overshoots(seed, frames, markers):
    motion = cloud(smooth_cloud(seed, frames, markers), random_mask(seed, frames, markers))
    filled, found = FILLS["linear"].fill(hide(motion, np.nan))
    found = found.pick(~found.is_edge & ~found.is_blank)
    for joint, start, stop in zip(found.joint, found.start, found.stop):
        ends, inside = motion.positions[[start - 1, stop], joint], filled.positions[start:stop, joint]
        assert np.all(inside >= ends.min(axis=0) - 1e-6) and np.all(inside <= ends.max(axis=0) + 1e-6)


# --- rigs -------------------------------------------------------------------------------------------------


def broken(rig, spans, joints=slice(None)):
    trusted = rig.trusted.copy()
    for start, stop in spans:
        trusted[start:stop, joints] = False
    return replace(rig, trusted=trusted, rotations=np.where(trusted[..., None], rig.rotations, np.nan))


@pytest.mark.parametrize("method", RIG_METHODS)
@given(st.integers(0, 10_000), st.sampled_from([1, 2, 9, 40]))
@examples
def test_rigs_keep_what_is_trusted_and_read_nothing_else(method, seed, frames):
    rig = random_rig(seed, frames=frames, moving=(3,))
    rig = replace(rig, trusted=random_mask(seed, frames, len(rig.skeleton)))

    def with_hidden(filler):
        hidden = ~rig.trusted[..., None]
        turns, shifts = np.where(hidden, filler, rig.rotations), np.where(hidden, filler, rig.translations)
        still = ~(rig.moves | (np.array(rig.skeleton.parents) < 0))
        shifts[:, still] = rig.translations[:, still]
        return fill_rig(replace(rig, rotations=turns, translations=shifts), 100.0, RIG_METHODS[method])

    filled, found = with_hidden(np.nan)
    assert np.array_equal(filled.rotations[rig.trusted], rig.rotations[rig.trusted])
    assert np.array_equal(filled.translations[rig.trusted], rig.translations[rig.trusted])
    assert np.isfinite(filled.rotations[filled.trusted]).all()
    assert np.isfinite(filled.translations[filled.trusted]).all()
    np.testing.assert_allclose(np.linalg.norm(filled.rotations[filled.trusted], axis=-1), 1, atol=1e-9)
    done = gaps.covered(found.pick(found.method != ""), rig.trusted.shape)
    assert np.array_equal(done, filled.trusted & ~rig.trusted)
    again, _ = with_hidden(1e9)
    assert np.array_equal(again.rotations[filled.trusted], filled.rotations[filled.trusted])


@pytest.mark.parametrize("method", RIG_METHODS)
def test_rigs_backwards_in_time(method):
    rig = broken(random_rig(8), [(5, 9), (20, 30), (38, 40)], [0, 1, 2, 3, 8])
    turned = {name: getattr(rig, name)[::-1].copy() for name in ("rotations", "translations", "trusted")}
    filled = fill_rig(rig, 100.0, RIG_METHODS[method])[0]
    again = fill_rig(replace(rig, **turned), 100.0, RIG_METHODS[method])[0]
    np.testing.assert_allclose(again.kinematics[0][::-1], filled.kinematics[0], atol=1e-9)


def test_a_lost_limb_follows_a_parent_that_is_never_known_by_its_own_turns():
    rig = broken(random_rig(9), [(0, 40)], 1)
    rig = broken(rig, [(10, 20)], 3)
    filled, found = fill_rig(rig, 100.0, "hermite")
    assert not filled.trusted[:, 1].any() and filled.trusted[:, 3].all()
    assert dict(zip(found.joint, found.method)) == {1: "", 3: "hermite"}
    assert np.isfinite(filled.rotations[:, 3]).all()


# --- the choice -------------------------------------------------------------------------------------------


def test_choices_are_methods_that_exist_with_reasons():
    for kind, ways in WINNERS.items():
        known = FILLS if kind in ("all points", "joints", "markers", "many markers") else RIG_FILLS
        for donors in (*ways, 99):
            for seconds in (0.0, 0.3, 1.0, 60.0):
                method, why = choose(kind, seconds, donors)
                assert method in known and method in why
    with pytest.raises(InputError, match="Did you mean"):
        choose("marker", 1)


def test_kinds_of_gaps_in_a_rig():
    rig = random_rig(0, parents=(-1, 0, 1, 2, 1, 4, 0, 6))
    offsets = np.zeros((8, 3))
    offsets[1:, 0] = [0.5, 0.3, 0.3, 0.3, 0.3, 0.1, 0.4]
    rig = replace(rig, offsets=offsets, ends=((3, np.array([0.3, 0, 0])), (7, np.array([0.4, 0, 0]))))
    for joints, kind in (([0], "body"), ([2, 3], "limb"), ([3], "lower limb"), (slice(None), "body")):
        lost = broken(rig, [(10, 20)], joints)
        assert set(rig_kinds(lost, Gaps.of(lost.trusted))) == {kind}


def test_auto_tries_the_methods_beside_the_gap():
    """A marker that rides on a tumbling body, and one that floats by itself: each gets what restores it."""
    time = np.arange(240) / 120
    turn = Rotation.from_euler("xyz", np.stack([np.sin(9 * time), 2 * time, np.cos(7 * time)], axis=-1))
    corners = np.array([[0.1, 0, 0], [0, 0.12, 0], [0, 0, 0.09], [-0.1, 0.05, 0.02]])
    centre = np.stack([np.sin(5 * time), np.cos(6 * time), time], axis=-1)
    riding = np.stack([turn.apply(corner) + centre for corner in corners], axis=1)
    floating = np.stack([time**2, 1 + 0.3 * time, -time], axis=-1)[:, None]
    positions = np.concatenate([riding, floating], axis=1).astype(np.float32)
    observed = np.ones(positions.shape[:2], bool)
    observed[100:136, 0] = observed[110:150, 4] = False
    motion = Motion(positions, observed, 120.0, Skeleton.cloud(tuple("abcde")))
    filled, done = Auto().fill(motion)
    assert done.method.tolist() == ["rigid", "eased"]
    assert all("beside" in done.reasons[row] for row in (0, 1))
    assert np.abs(filled.positions - positions)[~observed].max() < 1e-4


def test_donors_almost_on_a_line_carry_nothing_that_stands_far_off():
    """Noise on three points of a spine would swing an arm about it: such donors are declined."""
    rng = np.random.default_rng(0)
    places = np.array([[0.25, 0.1, 0], [0, 0, 0], [0.02, 0.1, 0], [-0.01, 0.2, 0.01]])
    truth = np.repeat(places[None], 60, axis=0)
    observed = np.ones((60, 4), bool)
    observed[30, 0] = False
    for _ in range(20):
        filled, _ = FILLS["rigid"].fill(cloud(truth + rng.normal(0, 0.004, truth.shape), observed))
        assert np.linalg.norm(filled.positions[30, 0] - truth[30, 0]) < 0.03
