"""Positions → channels: planted truth on random rigs, SciPy's Wahba as oracle, and real captures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

import motionmend as mm
from motionmend.body.mapping import map_rig
from motionmend.rigs.aiming import aimed, allowed
from motionmend.rigs.fitting import fit, reach, scatter
from rigs import ARM, as_take, random_rig


def perturbed(rig, seed, angle=0.3):
    """A first guess: every joint that turns turned by a smooth, random, wrong amount, about its own axes."""
    rng = np.random.default_rng(seed)
    rotations = rig.rotations.copy()
    wave = np.sin(np.linspace(0, 3, len(rotations)))[:, None]
    for joint, axes in enumerate(rig.orders):
        if len(axes) == 3:
            wrong = Rotation.from_rotvec(rng.normal(size=3) * angle * wave)
        elif len(axes) == 1:
            wrong = Rotation.from_euler(axes, rng.normal() * angle * wave)
        else:
            continue
        rotations[:, joint] = (Rotation.from_quat(rotations[:, joint]) * wrong).as_quat()
    return replace(rig, rotations=rotations)


def everywhere(rig):
    return np.ones(rig.trusted.shape, bool)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), shape=st.lists(st.integers(0, 10**6), min_size=1, max_size=14))
def test_positions_come_back_on_any_rig(seed, shape):
    parents = (-1, *(draw % (joint + 1) for joint, draw in enumerate(shape)))
    rig = random_rig(seed, parents, frames=6)
    truth = rig.kinematics[0]
    fitted = fit(as_take(perturbed(rig, seed)), truth, everywhere(rig)).rig
    # Exact but where children happen to lie in one line: there the guess has its word.
    np.testing.assert_allclose(fitted.kinematics[0], truth, atol=2e-4)
    lengths, wanted = (np.linalg.norm(each.translations, axis=-1) for each in (fitted, rig))
    np.testing.assert_allclose(lengths[:, 1:], wanted[:, 1:], rtol=1e-12)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_a_pose_that_fits_is_left_alone(seed):
    rig = random_rig(seed)
    fitted = fit(as_take(rig), rig.kinematics[0], everywhere(rig)).rig
    assert np.abs(fitted.kinematics[0] - rig.kinematics[0]).max() < 1e-6
    assert np.abs(fitted.rotations - rig.rotations).max() < 1e-6


def test_what_may_not_change_is_the_same_bit_for_bit():
    rig = random_rig(3)
    guess = perturbed(rig, 4)
    where = np.random.default_rng(5).random(rig.trusted.shape) < 0.5
    where[:10] = False
    fitted = fit(as_take(guess), rig.kinematics[0], where).rig
    assert np.array_equal(fitted.rotations[~where], guess.rotations[~where])
    assert np.array_equal(fitted.translations[~where], guess.translations[~where])
    assert np.abs(fitted.rotations - guess.rotations).max() > 0.05
    assert fitted.trusted.all()


def test_targets_of_other_proportions_keep_the_rigs_bones_and_do_not_add_up_errors():
    rig = random_rig(7)
    truth = rig.kinematics[0]
    targets = truth[:, :1] + 1.04 * (truth - truth[:, :1])
    fitted = fit(as_take(rig), targets, everywhere(rig)).rig
    np.testing.assert_allclose(
        np.linalg.norm(fitted.translations[:, 1:], axis=-1), np.linalg.norm(rig.translations[:, 1:], axis=-1)
    )
    # A free end is aimed at exactly: it lies on the line from its parent's real place to the target.
    end, parent = 4, 3
    placed = fitted.kinematics[0]
    toward, along = targets[:, end] - placed[:, parent], placed[:, end] - placed[:, parent]
    assert np.linalg.norm(np.cross(toward, along), axis=-1).max() < 1e-9


@pytest.mark.parametrize("hinges", [{3: "X"}, {2: "Y", 3: "Z"}, {3: ""}])
def test_joints_of_one_axis_or_none_meet_their_targets(hinges):
    orders = [hinges.get(joint, "ZXY") for joint in range(len(ARM))]
    rig = random_rig(11, orders=orders)
    fitted = fit(as_take(perturbed(rig, 12)), rig.kinematics[0], everywhere(rig)).rig
    np.testing.assert_allclose(fitted.kinematics[0], rig.kinematics[0], atol=1e-6)
    for joint, axes in hinges.items():
        vectors = Rotation.from_quat(fitted.rotations[:, joint]).as_rotvec()
        off_axis = [axis for axis in range(3) if "XYZ"[axis] not in axes]
        assert np.abs(vectors[:, off_axis]).max() < 1e-9


@pytest.mark.parametrize("axes", ["XY", "ZX", "YX", "ZY"])
def test_two_axes_are_projected_and_then_aimed(axes):
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1, 1, size=(50, 2))
    truth = Rotation.from_euler(axes, angles)
    guess = (truth * Rotation.from_rotvec(rng.normal(size=(50, 3)) * 0.15)).as_quat()
    # The projection beats every neighbour on a grid of the two angles.
    best = np.abs(np.sum(allowed(guess, axes) * guess, axis=-1))
    grid = np.stack(np.meshgrid(*[np.linspace(-np.pi, np.pi, 73)] * 2), -1).reshape(-1, 2)
    others = np.abs(Rotation.from_euler(axes, grid).as_quat() @ guess.T).max(axis=0)
    assert np.all(best >= others - 1e-12) and np.all(best - others < 2e-3)
    arm = rng.normal(size=(50, 1, 3))
    goals = Rotation.from_quat(guess).inv().apply(truth.apply(arm[:, 0]))[:, None]
    turned = Rotation.from_quat(aimed(guess, axes, arm, goals, np.ones((50, 1))))
    assert np.median(np.linalg.norm(turned.apply(arm[:, 0]) - truth.apply(arm[:, 0]), axis=-1)) < 1e-6
    np.testing.assert_allclose(np.abs(np.sum(allowed(turned.as_quat(), axes) * turned.as_quat(), axis=-1)), 1)


def test_several_targets_agree_with_scipys_wahba():
    rng = np.random.default_rng(2)
    arms = rng.normal(size=(30, 4, 3))
    truth = Rotation.from_rotvec(rng.normal(size=(30, 3)) * 0.4)
    goals = np.stack([turn.apply(arm) for turn, arm in zip(truth, arms)]) + rng.normal(size=arms.shape) * 0.1
    found = Rotation.from_quat(aimed(np.tile([0, 0, 0, 1.0], (30, 1)), "ZXY", arms, goals, np.ones((30, 4))))
    wanted = [Rotation.align_vectors(goal, arm)[0].as_quat() for goal, arm in zip(goals, arms)]
    assert (found * Rotation.from_quat(wanted).inv()).magnitude().max() < 1e-6


def test_children_in_one_line_leave_the_twist_to_the_guess():
    arms = np.array([[[1.0, 0, 0], [-1.0, 0, 0]]]).repeat(50, axis=0)
    tremble = np.random.default_rng(3).normal(size=arms.shape) * 1e-6
    goals = Rotation.from_euler("z", 40, degrees=True).apply(arms.reshape(-1, 3)).reshape(arms.shape) + tremble
    found = Rotation.from_quat(aimed(np.tile([0, 0, 0, 1.0], (50, 1)), "ZXY", arms, goals, np.ones((50, 2))))
    np.testing.assert_allclose(found.as_rotvec(degrees=True), [[0, 0, 40]] * 50, atol=0.1)


def test_a_lost_elbow_bends_so_that_the_wrist_arrives():
    rig = random_rig(5)
    targets = rig.kinematics[0].copy()
    targets[:, 3] = np.nan
    fitted = fit(as_take(perturbed(rig, 6, 0.2)), targets, everywhere(rig)).rig
    np.testing.assert_allclose(fitted.kinematics[0][:, 4], rig.kinematics[0][:, 4], atol=1e-6)


def test_joints_without_length_are_looked_through():
    # As CMU's hip joints: offsets of nothing, then a real bone.
    rig = random_rig(8, (-1, 0, 1, 0, 3, 0, 5), no_length=(1, 3, 5))
    fitted = fit(as_take(perturbed(rig, 9, 0.2)), rig.kinematics[0], everywhere(rig)).rig
    np.testing.assert_allclose(fitted.kinematics[0], rig.kinematics[0], atol=1e-6)


def test_constant_channels_stay_constant():
    rig = random_rig(10, (-1, 0, 1, 0, 3, 0, 5), no_length=(1, 3))
    rotations = rig.rotations.copy()
    rotations[:, [1, 3]] = [0, 0, 0, 1.0]
    rig = replace(rig, rotations=rotations)
    where = everywhere(rig)
    where[:15] = False
    where[30:] = False
    guess = perturbed(rig, 11)
    turned = np.where(where[..., None], guess.rotations, rig.rotations)
    turned[:, [1, 3]] = [0, 0, 0, 1.0]
    fitted = fit(as_take(replace(rig, rotations=turned)), rig.kinematics[0], where).rig
    assert np.all(fitted.rotations[:, [1, 3]] == [0, 0, 0, 1.0])
    np.testing.assert_allclose(fitted.kinematics[0], rig.kinematics[0], atol=1e-6)


def test_position_channels_in_use_are_met_exactly():
    rig = random_rig(13, moving=(1, 8))
    guess = perturbed(rig, 14)
    fitted = fit(as_take(guess), rig.kinematics[0] + 0.01, everywhere(rig)).rig
    np.testing.assert_allclose(fitted.kinematics[0][:, [0, 1, 8]], rig.kinematics[0][:, [0, 1, 8]] + 0.01, atol=1e-12)


def test_axes_follow_the_files_up():
    # A hinge about the file's Z is a hinge about our Y if Z is up.
    rig = random_rig(15, orders=["ZXY", "ZXY", "ZXY", "Y", *["ZXY"] * 7])
    guess = perturbed(rig, 16)
    named = replace(guess, orders=("ZXY", "ZXY", "ZXY", "Z", *["ZXY"] * 7))
    fitted = fit(as_take(named, up="z"), rig.kinematics[0], everywhere(rig)).rig
    assert np.abs(fitted.kinematics[0] - rig.kinematics[0]).max() < 1e-3
    assert np.abs(fitted.rotations[:, 3, [0, 2]]).max() < 1e-9
    misled = fit(as_take(named, up="y"), rig.kinematics[0], everywhere(rig)).rig
    assert np.abs(misled.rotations[:, 3, [0, 2]]).max() > 0.01


def test_the_end_of_a_limb_is_reached_and_keeps_its_attitude():
    rig = random_rig(17)
    take = as_take(rig)
    hip, end = rig.kinematics[0][:, 8], rig.kinematics[0][:, 10]
    where = np.zeros(len(take), bool)
    where[10:30] = True
    targets = hip + 0.9 * (end - hip) + [0.01, 0.02, 0.0]
    reached, miss = reach(take, 10, targets, where)
    np.testing.assert_allclose(reached.rig.kinematics[0][where, 10], targets[where], atol=1e-9)
    assert miss.max() < 1e-9
    turned = np.abs(np.sum(reached.rig.kinematics[1][:, 10] * rig.kinematics[1][:, 10], axis=-1))
    np.testing.assert_allclose(turned, 1)
    changed = np.any(reached.rig.rotations != rig.rotations, axis=-1)
    assert not changed[~where].any() and set(np.flatnonzero(changed.any(axis=0))) == {8, 9, 10}


def test_beyond_reach_the_limb_is_straight_and_the_miss_is_told():
    rig = random_rig(18)
    hip, knee, end = (rig.kinematics[0][:, joint] for joint in (8, 9, 10))
    whole = np.linalg.norm(knee - hip, axis=-1) + np.linalg.norm(end - knee, axis=-1)
    direction = np.array([0.0, -1.0, 0.0])
    targets = hip + direction * (whole[:, None] + 0.25)
    reached, miss = reach(as_take(rig), 10, targets, np.ones(len(hip), bool))
    np.testing.assert_allclose(miss, 0.25, atol=1e-6)
    np.testing.assert_allclose(reached.rig.kinematics[0][:, 10], hip + direction * whole[:, None], atol=1e-6)


def test_a_mapping_is_scattered():
    positions = np.arange(2 * 3 * 3.0).reshape(2, 3, 3)
    targets = scatter(positions, (4, -1, 0), 5)
    assert np.array_equal(targets[:, 4], positions[:, 0]) and np.array_equal(targets[:, 0], positions[:, 2])
    assert np.isnan(targets[:, [1, 2, 3]]).all()


def test_points_have_no_channels():
    take = replace(as_take(random_rig(1)), rig=None)
    with pytest.raises(TypeError):
        fit(take, take.motion.positions, take.motion.observed)
    with pytest.raises(ValueError, match="do not fit"):
        fit(as_take(random_rig(1)), np.zeros((1, 2, 3)), np.zeros((1, 2), bool))


@pytest.mark.parametrize("name", ["06/06_02.bvh", "16/16_01.amc"])
@pytest.mark.parametrize("only_body", [False, True])
def test_real_takes_come_back_from_a_slerped_guess(cmu, name, only_body):
    take = mm.load(cmu / name)
    rig, length = take.rig, round(take.fps / 2)
    truth, rotations = rig.kinematics[0], rig.rotations.copy()
    where = np.zeros(rig.trusted.shape, bool)
    for start in range(length, len(take) - length - 1, 3 * length):
        where[start : start + length] = True
        ends, inside = [start - 1, start + length], np.arange(start, start + length)
        for joint in range(rotations.shape[1]):
            rotations[inside, joint] = Slerp(ends, Rotation.from_quat(rig.rotations[ends, joint]))(inside).as_quat()
    joints = map_rig(take.skeleton, take.motion.positions).joints if only_body else range(truth.shape[1])
    joints = np.array([joint for joint in joints if joint >= 0])
    targets = scatter(truth[:, joints], joints, truth.shape[1])
    fitted = fit(take.with_rig(replace(rig, rotations=rotations)), targets, where).rig
    gap = where.any(axis=1)
    error = np.linalg.norm(fitted.kinematics[0] - truth, axis=-1)[gap][:, joints] * 1000
    assert np.median(error) < 1e-3 and error.max() < 1.0
    # No flips: the fit's steps are as large as the take's own.
    steps = [
        (Rotation.from_quat(each[1:, 1:].reshape(-1, 4)).inv() * Rotation.from_quat(each[:-1, 1:].reshape(-1, 4)))
        for each in (rig.rotations, fitted.rotations)
    ]
    assert steps[1].magnitude().max() < 1.5 * steps[0].magnitude().max() + 0.05
