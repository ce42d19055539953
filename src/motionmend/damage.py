"""Damage made on purpose, as masks and arrays: to train networks and to measure every method on the same ground.

Whole batches at a time, `(windows, frames, joints)`; whatever is drawn comes from the generator that is given.
`planting` puts such damage into a Take.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Array = np.ndarray

Stretch = tuple[Sequence[int], int, int]  # joint indices, start, stop


def dropout_mask(frames: int, joints: int, share: float, rng: np.random.Generator) -> Array:
    """`(frames, joints)` bool, each entry True with probability `share`, on its own."""
    return rng.random((frames, joints), np.float32) < share


def stretches_mask(frames: int, joints: int, stretches: Sequence[Stretch]) -> Array:
    """`(frames, joints)` bool, True in each stretch `(joint indices, start, stop)`."""
    mask = np.zeros((frames, joints), bool)
    for which, start, stop in stretches:
        mask[start:stop, list(which)] = True
    return mask
