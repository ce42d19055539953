"""Bones of one length: what a fill stretched is put back, from the root outward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..metrics import positional
from ..motion import Motion
from ..rotations import normalised

Array = np.ndarray

def reference_lengths(motion: Motion) -> Array:
    """`(joints,)` metres: each bone's median length where both its ends are observed; NaN where they never are."""
    points = np.where(motion.observed[..., None], motion.positions, np.nan)
    bones = (column[np.isfinite(column)] for column in positional.bone_lengths(points, motion.skeleton.parents).T)
    return np.array([np.median(bone) if len(bone) else np.nan for bone in bones])


def keep_lengths(motion: Motion, lengths: Array, filled: Array) -> Motion:
    """Give bones their length back by moving filled points only, from the root outward.

    A point stays in the direction it has from its parent's new place, so errors do not add up along a chain; one
    between two others that it must suit, of which the outer is not filled, goes to the nearest place that suits
    both, or as near as can be.

    lengths : `(joints,)` metres, NaN for bones to leave alone. filled : `(frames, joints)` bool.
    """
    skeleton = motion.skeleton
    points = motion.positions.astype(float)
    for joint, parent in enumerate(skeleton.parents):
        rows = np.flatnonzero(filled[:, joint])
        if parent < 0 or not np.isfinite(lengths[joint]) or not len(rows):
            continue
        along = points[rows, joint] - points[rows, parent]
        points[rows, joint] = points[rows, parent] + normalised(along) * lengths[joint]
        for child in skeleton.children[joint]:
            held = rows[~filled[rows, child] & motion.observed[rows, child]]
            if np.isfinite(lengths[child]) and len(held):
                ends = points[held, parent], motion.positions[held, joint], points[held, child]
                points[held, joint] = between_two(*ends, lengths[joint], lengths[child])
    positions = np.where(filled[..., None] & np.isfinite(points), points.astype(np.float32), motion.positions)
    return replace(motion, positions=positions)


def between_two(start: Array, middle: Array, end: Array, first: float, second: float) -> Array:
    """The place `(rows, 3)` nearest to `middle` at distance `first` from `start` and `second` from `end`."""
    axis = end - start
    distance = np.linalg.norm(axis, axis=-1, keepdims=True)
    apart = np.clip(distance, max(abs(first - second), 1e-9), first + second)
    axis = normalised(axis)
    along = (first**2 - second**2 + apart**2) / (2 * apart)
    aside = middle - start
    aside = normalised(aside - axis * np.sum(aside * axis, axis=-1, keepdims=True))
    return start + axis * along + aside * np.sqrt(np.maximum(first**2 - along**2, 0))
