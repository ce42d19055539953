"""The `eased` curve and the room beside it, in many windows of BODY at 30 frames a second at once.

What `curves.CURVES["eased"]` does for one gap after the other is done here for all missing samples of a batch
together, and for those alone, so that making a training batch takes a few hundredths of a second. Joints are curved
as seen from the joint they hang on, which is the same where both miss the same frames.

B = windows, T = frames, J = BODY's joints, M = missing samples.
"""

from __future__ import annotations

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.standing import STANDING
from ..fills.curves import CARRY_SECONDS, SETTLE_SECONDS, velocity_frames

Array = np.ndarray

FPS = 30.0
CARRY, SETTLE = CARRY_SECONDS * FPS, SETTLE_SECONDS * FPS  # frames
PARABOLA = (1.5, -2.0, 0.5)  # velocity at the first of three samples in a row, a frame, away from the other two
assert velocity_frames(FPS) == len(PARABOLA)
# How far a body is off the curve in the middle of a gap, metres: STRAY · (seconds of the gap) ** GROWTH, at most MOST.
STRAY, GROWTH, MOST = 0.5, 1.6, 0.6


def _levels() -> list[Array]:
    """BODY's joints, those that hang on the hips after the hips and so on."""
    depth = np.zeros(len(BODY), int)
    for joint, parent in enumerate(BODY.parents):
        depth[joint] = depth[parent] + 1 if parent >= 0 else 0
    return [np.flatnonzero(depth == level) for level in range(depth.max() + 1)]


LEVELS = _levels()
PARENT = np.array(BODY.parents)


LEFT_THIGH, RIGHT_THIGH = JOINT["left_thigh"], JOINT["right_thigh"]


def nearest(observed: Array) -> tuple[Array, Array]:
    """The last observed frame of a joint up to each frame, or -1, and its next from there on, or T: `(B, T, J)` int16.

    observed : `(B, T, J)` bool.
    """
    frames = observed.shape[1]
    clock = np.arange(frames, dtype=np.int16)[None, :, None]
    before = np.maximum.accumulate(np.where(observed, clock, np.int16(-1)), axis=1)
    after = np.minimum.accumulate(np.where(observed, clock, np.int16(frames))[:, ::-1], axis=1)[:, ::-1]
    return before, after


def eased(positions: Array, observed: Array) -> tuple[Array, Array]:
    """Positions with every missing sample on the curve along the bones, and the envelope of what may be beside it.

    Parameters
    ----------
    positions : `(B, T, J, 3)` float32 metres, not read where not `observed (B, T, J)`.

    Returns
    -------
    curve : `(B, T, J, 3)` float32. Past a joint's only seam its velocity dies away as in `curves.settle`. A joint
        that is never seen hangs on its parent as in the mean body, the hips are at the mean of all that is seen.
    envelope : `(B, T, J)` float32 metres, 0 where observed: how far off the curve a sample may well be, by the length
        of its gap and by where in it it is; twice the way to the only seam counts as a gap's length.
    """
    frames = observed.shape[1]
    before, after = nearest(observed)
    curve = np.where(observed[..., None], positions, np.float32(0))
    envelope = np.zeros(observed.shape, np.float32)
    middle = _middles(curve, observed)
    for level, joints in enumerate(LEVELS):
        rows, times, which = np.nonzero(~observed[:, :, joints])
        if not len(rows):
            continue
        these = joints[which]
        first = before[rows, times, these].astype(np.int64)
        last = after[rows, times, these].astype(np.int64)
        place = _Places(curve, observed, rows, these, level)
        filled, room = _across(place, times, first, last, frames)
        blind = (first < 0) & (last >= frames)
        if blind.any() and not level:
            filled[blind] = middle[rows[blind]]
        elif blind.any():
            filled[blind] = _usual(curve, rows[blind], times[blind], these[blind], level)
        if level:
            filled += curve[rows, times, PARENT[these]]
        curve[rows, times, these] = filled
        envelope[rows, times, these] = room
    return curve, envelope


class _Places:
    """Samples of some joints as seen from the joints they hang on, which must be filled already."""

    def __init__(self, curve: Array, observed: Array, rows: Array, joints: Array, level: int):
        rows_of, frames, count = observed.shape
        del rows_of
        self.flat, self.seen = curve.reshape(-1, 3), observed.reshape(-1)
        self.frames, self.step = frames, count
        self.own = rows * frames * count + joints
        self.above = rows * frames * count + PARENT[joints] if level else None

    def at(self, times: Array) -> Array:
        """`(M, 3)`; whatever is there where a time is outside the window or its sample is not seen."""
        away = np.clip(times, 0, self.frames - 1) * self.step
        found = self.flat[self.own + away]
        return found if self.above is None else found - self.flat[self.above + away]

    def is_seen(self, times: Array) -> Array:
        inside = (times >= 0) & (times < self.frames)
        return inside & self.seen[self.own + np.clip(times, 0, self.frames - 1) * self.step]

    def leaving(self, seam: Array, start: Array, way: int) -> tuple[Array, Array]:
        """Velocity a frame along the time axis at `seam` from the samples on the far side of the gap, and if known."""
        one, two = seam - way, seam - 2 * way
        known, both = self.is_seen(one), self.is_seen(two)
        near, far = self.at(one), self.at(two)
        parabola = PARABOLA[0] * start + PARABOLA[1] * near + PARABOLA[2] * far
        speed = np.where((known & both)[:, None], parabola, start - near) * np.float32(way)
        return np.where(known[:, None], speed, np.float32(0)), known


def _across(place: _Places, times: Array, first: Array, last: Array, frames: int) -> tuple[Array, Array]:
    """`(M, 3)` where the curve is at `times (M,)` between the seams, and the envelope there `(M,)`."""
    left, right = first >= 0, last < frames
    both = (left & right)[:, None]
    start, stop = place.at(first), place.at(last)
    leaving, left_known = place.leaving(first, start, 1)
    arriving, right_known = place.leaving(last, stop, -1)
    span = (last - first).astype(np.float32)
    u = ((times - first) / span).astype(np.float32)
    chord = stop - start
    trust = np.minimum(np.float32(CARRY) / span, 1)[:, None]
    length = span[:, None]
    ends = [chord + np.where(known[:, None], trust * (length * speed - chord), 0)
            for speed, known in ((leaving, left_known), (arriving, right_known))]  # fmt: skip
    h = u[:, None]
    between = start + h**2 * (3 - 2 * h) * chord + h * (1 - h) ** 2 * ends[0] + h**2 * (h - 1) * ends[1]
    # Past the only seam.
    away = np.where(left, times - first, last - times).astype(np.float32)
    coast = np.float32(SETTLE) * -np.expm1(-away / np.float32(SETTLE))
    seam = np.where(left[:, None], start, stop)
    speed = np.where(left[:, None], leaving, -arriving)
    filled = np.where(both, between, seam + coast[:, None] * speed).astype(np.float32)
    missing = np.where(both[:, 0], span - 1, np.where(left | right, 2 * away, frames))
    peak = np.minimum(STRAY * (missing / FPS) ** GROWTH, MOST)
    shape = np.sqrt(np.where(both[:, 0], 4 * u * (1 - u), 1))
    return filled, (peak * shape).astype(np.float32)


def _usual(curve: Array, rows: Array, times: Array, joints: Array, level: int) -> Array:
    """Where joints are from their parents in the mean body, `(M, 3)`, turned as the hips face in each frame."""
    bones = STANDING[joints] - STANDING[PARENT[joints]]
    if level < 2:
        return bones  # the thighs, which tell, may be among them
    across = curve[rows, times, LEFT_THIGH] - curve[rows, times, RIGHT_THIGH]
    length = np.hypot(across[:, 0], across[:, 2])
    cosine = np.where(length > 0, across[:, 0] / np.maximum(length, 1e-9), 1)
    sine = np.where(length > 0, across[:, 2] / np.maximum(length, 1e-9), 0)
    x, y, z = bones.T
    return np.stack([x * cosine - z * sine, y, z * cosine + x * sine], axis=1).astype(np.float32)


def _middles(known: Array, observed: Array) -> Array:
    """The mean `(B, 3)` of all that is observed in a window; 0 where nothing is."""
    count = np.maximum(np.count_nonzero(observed, axis=(1, 2)), 1)
    return (known.sum(axis=(1, 2), dtype=float) / count[:, None]).astype(np.float32)
