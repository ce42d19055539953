"""Feet that stand still: when they do, and how to hold them where a fill let them slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..body.joints import LIMBS
from ..fills.curves import least_jerk
from ..metrics import positional
from ..motion import Motion, Take, runs
from ..rigs.fitting import reach
from .bones import between_two
from .checks import affected_by
from .seams import FADE

Array = np.ndarray

STANCE_SHIFT = 0.1  # metres: what would have to be moved further was not standing

Leg = tuple[int, int, int, int]


@dataclass(frozen=True)
class Feet:
    """What planting did: the mean speed of standing feet inside the gaps, mm/s, before and after it (NaN if none
    stands), how far a foot was moved at most, mm, and by how much a leg was too short for that, mm."""

    skate_before: float
    skate_after: float
    moved: float
    unreached: float


def legs(joints: Sequence[int]) -> list[Leg]:
    """The rig's thigh, shin, foot and toe (-1 if it has none) of each whole leg in a mapping's `joints`."""
    found = [[joints[each] for each in limb] for name, limb in LIMBS.items() if name.endswith("leg")]
    return [(thigh, shin, foot, toe) for thigh, shin, foot, toe in found if min(thigh, shin, foot) >= 0]


def soles(legs: Sequence[Leg]) -> list[int]:
    """The joint of each leg that touches the floor: the toe, or the foot of a rig without toes."""
    return [toe if toe >= 0 else foot for *_, foot, toe in legs]


def plant_feet(take: Take, filled: Array, legs: Sequence[Leg], fade: float = FADE) -> tuple[Take, Feet]:
    """Hold feet still where they stand inside gaps; knees follow, ankles keep their attitude.

    A stance that goes on across a seam stands where the known foot stands; one within the gap, at its mean. Between
    stances the shift eases out. Only frames in which the whole leg was filled are touched.

    filled : `(frames, joints)` bool, the file's own samples that were filled. legs : from `legs`.
    """
    affected = affected_by(take, filled)
    unreached, moved = 0.0, 0.0
    ends = soles(legs)
    stands = positional.stances(take.motion.positions[:, ends], take.fps)
    before = take
    for (thigh, shin, foot, toe), end, contact in zip(legs, ends, stands.T):
        free = filled[:, shin] & filled[:, foot] & (filled[:, thigh] if take.rig is not None else affected[:, end])
        shift = _holding(take.motion.positions[:, end].astype(float), contact, free, max(2, round(fade * take.fps)))
        rows = np.any(shift != 0, axis=-1)
        if not rows.any():
            continue
        moved = max(moved, float(np.linalg.norm(shift, axis=-1).max() * 1000))
        if take.rig is not None:
            target = take.rig.kinematics[0][:, foot] + shift
            take, miss = reach(take, foot, target, rows, (thigh, shin))
            unreached = max(unreached, float(miss.max() * 1000))
        else:
            take = take.with_motion(_leg_moved(take.motion, (thigh, shin, foot, toe), shift, filled))

    inside = affected[:, ends]
    places = [each.motion.positions[:, ends] for each in (before, take)]
    old, new = (positional.foot_skate(points, stands & inside, take.fps) for points in places)
    return take, Feet(old, new, moved, unreached)


def _holding(points: Array, stands: Array, free: Array, most: int) -> Array:
    """The shifts `(frames, 3)` that hold a point still where it stands and may be moved."""
    shift = np.zeros_like(points)
    stands = stands.copy()
    for start, stop in runs(~stands):
        # Too short for a swing, and for easing from one place to another.
        stands[start:stop] |= start > 0 and stop < len(stands) and stop - start < most
    for start, stop in runs(free):
        held = []
        for a, b in runs(stands & (np.arange(len(stands)) < stop + 1)):
            # Away from a seam that the stance does not cross, there must be room to ease.
            from_before, to_after = a < start, b > stop
            first, last = start if from_before else max(a, start + most), stop if to_after else min(b, stop - most)
            if first < last:
                held.append((first, last, from_before, to_after))
        done = start  # up to here the frames belong to an earlier stance
        for index, (first, last, from_before, to_after) in enumerate(held):
            anchor = points[first:last].mean(axis=0)
            if from_before and to_after:
                u = (np.arange(first, last) - start + 1)[:, None] / (stop - start + 1)
                anchor = (1 - u) * points[start - 1] + u * points[stop]
            elif from_before:
                anchor = points[start - 1]
            elif to_after:
                anchor = points[stop]
            by = anchor - points[first:last]
            if np.linalg.norm(by, axis=-1).max() > STANCE_SHIFT:
                continue
            shift[first:last] += by
            upcoming = held[index + 1][0] if index + 1 < len(held) else stop
            for edge, room, way in ((first, first - done + 1, -1), (last - 1, upcoming - last + 1, 1)):
                span = min(most, room)
                steps = np.arange(1, span)
                shift[edge + way * steps] += least_jerk(1 - steps / span)[:, None] * shift[edge]
            done = last
    return shift


def _leg_moved(motion: Motion, leg: Leg, shift: Array, filled: Array) -> Motion:
    thigh, shin, foot, toe = leg
    points = motion.positions.astype(float)
    bones = ((thigh, shin), (shin, foot))
    lengths = [float(np.nanmedian(np.linalg.norm(points[:, a] - points[:, b], axis=-1))) for a, b in bones]
    ends = [joint for joint in (foot, toe) if joint >= 0]
    points[:, ends] += shift[:, None]
    points[:, shin] = between_two(points[:, thigh], points[:, shin], points[:, foot], *lengths)
    may = np.zeros_like(filled)
    may[:, [shin, *ends]] = np.any(shift != 0, axis=-1)[:, None]
    positions = np.where((may & filled)[..., None], points.astype(np.float32), motion.positions)
    return replace(motion, positions=positions)
