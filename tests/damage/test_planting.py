"""Planted damage is where it says, of the size it says, repeatable, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legs import point_take, rig_take
from motionmend.damage.corruption import dropouts
from motionmend.damage.planting import mirrored_pairs, plant, plant_and_tell
from motionmend.errors import InputError


def same_bits(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Entries whose every bit agrees, NaN too."""
    kind = np.uint32 if a.dtype == np.float32 else np.uint64
    return np.all(a.view(kind) == b.view(kind), axis=-1)


DAMAGE = {
    "gaps": [(20, 30)],
    "lost": [([1, 2], 50, 70)],
    "held": [([3], 80, 95)],
    "jump": [([4], 110, 112)],
    "swap": [([2], 130, 150)],
    "displaced": [([0], 170, 190)],
}
WHERE = [
    (slice(20, 30), slice(None)),
    (slice(50, 70), [1, 2]),
    (slice(80, 95), [3]),
    (slice(110, 112), [4]),
    (slice(130, 150), [2, 4]),
    (slice(170, 190), [0]),
]


def expected_mask(frames: int) -> np.ndarray:
    mask = np.zeros((frames, 5), bool)
    for where in WHERE:
        mask[where] = True
    return mask


def test_points_are_damaged_exactly_where_asked():
    take = point_take()
    damaged, truth = plant_and_tell(take, **DAMAGE)
    mask = expected_mask(240)
    assert np.array_equal(truth.mask, mask)
    assert np.array_equal(same_bits(take.motion.positions, damaged.motion.positions), ~mask)
    gone = np.zeros_like(mask)
    gone[20:30], gone[50:70, [1, 2]] = True, True
    assert np.array_equal(np.isnan(damaged.motion.positions).all(axis=-1), gone)
    assert np.array_equal(damaged.motion.observed, ~gone)
    assert [p.cause for p in truth.planted] == ["gap", "lost", "held", "jump", "swap", "displaced"]


def test_channels_are_damaged_exactly_where_asked_and_stay_trusted():
    take = rig_take()
    damaged, truth = plant_and_tell(take, **DAMAGE)
    assert take.rig is not None and damaged.rig is not None
    mask = expected_mask(240)
    assert np.array_equal(truth.mask, mask)
    turned = ~same_bits(take.rig.rotations, damaged.rig.rotations)
    shifted = ~same_bits(take.rig.translations, damaged.rig.translations)
    assert np.array_equal(turned | shifted, mask)
    assert damaged.rig.trusted.all() and damaged.motion.observed.all()


def test_each_kind_does_what_its_name_says():
    take = point_take()
    before = take.motion.positions
    after = plant(take, **DAMAGE, size=0.1).motion.positions
    assert np.array_equal(after[80:95, 3], np.repeat(before[79:80, 3], 15, axis=0))
    for joint, start, stop in ((4, 110, 112), (0, 170, 190)):
        offset = after[start:stop, joint] - before[start:stop, joint]
        assert np.allclose(np.linalg.norm(offset, axis=-1), 0.1, atol=1e-5)
        assert np.ptp(offset, axis=0).max() < 1e-5
    assert np.array_equal(after[130:150, 2], before[130:150, 4])
    assert np.array_equal(after[130:150, 4], before[130:150, 2])


def test_a_stretch_at_the_start_holds_the_value_after_it():
    damaged = plant(rig_take(), lost=[([2], 0, 8)]).rig
    assert damaged is not None
    assert np.array_equal(damaged.rotations[0:8, 2], np.repeat(damaged.rotations[8:9, 2], 8, axis=0))


def test_a_turned_joint_is_off_by_the_angle_asked_for():
    take = rig_take()
    damaged = plant(take, displaced=[([3], 40, 60)], size=0.5)
    assert take.rig is not None and damaged.rig is not None
    dots = np.abs(np.sum(take.rig.rotations[40:60, 3] * damaged.rig.rotations[40:60, 3], axis=-1))
    assert np.allclose(2 * np.arccos(np.minimum(dots, 1)), 0.5, atol=1e-6)


def test_dropped_channels_repeat_the_sample_before():
    take = rig_take(2000)
    damaged, truth = plant_and_tell(take, dropout=0.1, seed=4)
    assert damaged.rig is not None and take.rig is not None
    mask = truth.masks["dropout"]
    assert not mask[0].any() and 0.09 < mask.mean() < 0.11
    frames, joints = np.nonzero(mask)
    assert np.array_equal(damaged.rig.rotations[frames, joints], damaged.rig.rotations[frames - 1, joints])
    assert same_bits(take.rig.rotations, damaged.rig.rotations)[~mask].all()


def test_noise_moves_joints_by_about_as_much_as_asked():
    for take in (point_take(2000), rig_take(2000)):
        damaged, truth = plant_and_tell(take, noise=0.005)
        spread = (damaged.motion.positions - take.motion.positions).std(axis=(0, 2))
        # Joints further out carry the noise of those above them.
        assert np.all((spread > 0.004) & (spread < 0.012)), spread
        assert not truth.mask.any() and truth.masks["noise"].all()


def test_a_joint_with_one_axis_is_turned_about_that_axis():
    take = rig_take()
    assert take.rig is not None
    rig = replace(take.rig, orders=("ZXY", "ZXY", "X", "ZXY", "X"))
    still = rig.rotations.copy()
    still[:, 2] = [0, 0, 0, 1]
    take = take.with_rig(replace(rig, rotations=still))
    damaged = plant(take, jump=[([2], 30, 32)], size=0.4).rig
    assert damaged is not None
    assert np.allclose(np.abs(damaged.rotations[30:32, 2]), [np.sin(0.2), 0, 0, np.cos(0.2)], atol=1e-7)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), dropout=st.floats(0, 0.5), noise=st.floats(0, 0.02))
def test_the_same_seed_plants_the_same(seed, dropout, noise):
    for take in (point_take(60), rig_take(60)):
        one, two = (plant(take, dropout=dropout, noise=noise, jump=[([1], 5, 7)], seed=seed) for _ in range(2))
        assert one.motion.positions.tobytes() == two.motion.positions.tobytes()
        other = plant(take, jump=[([1], 5, 7)], seed=seed + 1)
        assert other.motion.positions.tobytes() != one.motion.positions.tobytes()


def test_nothing_asked_nothing_changed_and_the_input_is_never_written_to():
    for take in (point_take(), rig_take()):
        bits = take.motion.positions.tobytes()
        assert plant(take).motion.positions.tobytes() == bits
        plant(take, **DAMAGE, dropout=0.2, noise=0.01)
        assert take.motion.positions.tobytes() == bits


def test_twins_are_known_in_the_spellings_of_the_field():
    for left, right in (
        ("LeftArm", "RightArm"),
        ("lhumerus", "rhumerus"),
        ("mixamorig:LeftHand", "mixamorig:RightHand"),
        ("UpperArm_L", "UpperArm_R"),
        ("thigh.l", "thigh.r"),
        ("LASI", "RASI"),
        ("hand_l", "hand_r"),
        ("bip01 L Foot", "bip01 R Foot"),
        ("HandL", "HandR"),
        ("left_knee", "right_knee"),
        ("LThumb", "RThumb"),
    ):
        assert mirrored_pairs(["Head", right, "Spine", left]) == [(3, 1)], left
    assert mirrored_pairs(["Hips", "Lead", "Lumbar", "Tail", "upper", "lower", "LeftArm", ""]) == []


def test_what_cannot_be_planted_is_said():
    with pytest.raises(InputError, match="Hips"):
        plant(point_take(), swap=[([0], 5, 9)])
    with pytest.raises(InputError, match="dropout"):
        plant(point_take(), dropout=1.5)
    with pytest.raises(InputError, match="noise"):
        plant(point_take(), noise=float("nan"))


def test_masks_alone():
    mask = dropouts((1000, 20), 0.25, np.random.default_rng(0))
    assert mask.shape == (1000, 20) and 0.24 < mask.mean() < 0.26
