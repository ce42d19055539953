"""Gaps of every kind for the house network's training: whole batches, NumPy only.

B = windows, T = frames, J = BODY's joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..body.joints import BODY, JOINT

Array = np.ndarray

CONTEXT = 4  # frames seen at least on each side of a gap
NEAR = 3, 8  # frames seen beside a gap where the rest is hidden
AGAIN = 8, 24  # frames seen between gaps that come several times
FEW = 7  # joints lost at random, at most


@dataclass(frozen=True)
class Shares:
    """How often windows lose what. Bodies are all that limbs and joints are not."""

    limbs: float = 0.3
    joints: float = 0.1
    throughout: float = 0.1  # of limbs and joints, lost in the whole window
    lonely: float = 0.25  # all is hidden that is farther than a few frames from the gap
    ends: float = 0.1  # nothing is seen on one side
    again: float = 0.7  # of the others, gaps that come several times in a window
    shortest: int = 3  # frames
    longest: int = 72


def _limbs() -> Array:
    """`(limbs, J)` bool: what may be lost together."""
    parts = [("upper_arm", "forearm", "hand"), ("forearm", "hand"), ("hand",),
             ("thigh", "shin", "foot", "toe"), ("shin", "foot", "toe"), ("foot", "toe")]  # fmt: skip
    sets = [[f"{side}_{part}" for part in each] for side in ("left", "right") for each in parts]
    sets += [[f"{side}_{part}" for side in ("left", "right") for part in parts[which]] for which in (1, 4)]
    sets += [["head", "neck"]]
    mask = np.zeros((len(sets), len(BODY)), bool)
    for row, names in zip(mask, sets):
        row[[JOINT[name] for name in names]] = True
    return mask


LIMBS = _limbs()


def draw(observed: Array, rng: np.random.Generator, shares: Shares) -> tuple[Array, Array]:
    """What of windows `observed (B, T, J)` to hide: what is asked for, and all that is hidden, `(B, T, J)` bool.

    Lengths are log-uniform. Frames without any sample, before and after a take, are no context.
    """
    rows, frames, joints = observed.shape
    there = np.asarray(observed.any(axis=2))
    first = np.where(there.any(axis=1), there.argmax(axis=1), 0)
    stop = np.where(there.any(axis=1), frames - there[:, ::-1].argmax(axis=1), frames)
    chance = rng.random((8, rows))
    low, high = np.log(shares.shortest), np.log(shares.longest + 1)
    length = np.exp(low + chance[0] * (high - low)).astype(int)
    length = np.clip(np.minimum(length, stop - first - 2 * CONTEXT), 1, frames)
    room = np.maximum(stop - first - 2 * CONTEXT - length, 0)
    begin = first + CONTEXT + (chance[1] * (room + 1)).astype(int)
    end = begin + length
    lost = np.ones((rows, joints), bool)
    limb, single = chance[2] < shares.limbs, chance[2] > 1 - shares.joints
    lost[limb] = LIMBS[(chance[3] * len(LIMBS)).astype(int)][limb]
    count = 1 + (chance[3] * FEW).astype(int)
    order = np.argsort(rng.random((rows, joints)), axis=1).argsort(axis=1)
    lost[single] = (order < count[:, None])[single]
    throughout = (limb | single) & (chance[4] < shares.throughout)
    begin, end = np.where(throughout, 0, begin), np.where(throughout, frames, end)
    clock = np.arange(frames)
    inside = (clock >= begin[:, None]) & (clock < end[:, None])
    lonely = (chance[7] < shares.lonely) & ~throughout
    one_sided = (chance[7] > 1 - shares.ends) & ~throughout
    # The same gap again and again as far as it has context on both sides: more to learn from in one window.
    spaced = (end - begin) + AGAIN[0] + (rng.random(rows) * (AGAIN[1] - AGAIN[0] + 1)).astype(int)
    start = begin[:, None] + (clock - begin[:, None]) // spaced[:, None] * spaced[:, None]
    stops = start + (end - begin)[:, None]
    fits = (start >= first[:, None] + CONTEXT) & (stops <= stop[:, None] - CONTEXT)
    again = (rng.random(rows) < shares.again) & ~throughout & ~lonely & ~one_sided
    inside |= again[:, None] & fits & (clock < stops)
    asked = inside[:, :, None] & lost[:, None]
    # The context that is left.
    before, after = NEAR[0] + (chance[5:7] * (NEAR[1] - NEAR[0] + 1)).astype(int)
    left = one_sided & (chance[5] < 0.5)
    before = np.where(lonely, before, np.where(left, 0, frames))
    after = np.where(lonely, after, np.where(one_sided & ~left, 0, frames))
    beyond = (clock < (begin - before)[:, None]) | (clock >= (end + after)[:, None])
    beyond &= (lonely | one_sided)[:, None]
    return asked & observed, asked | beyond[:, :, None]
