"""Curves across a gap.

A curve is a matrix. Given when the good samples around a gap are, every fill here is linear in their values,
so a gap is filled by `weights @ samples`, and all gaps with the same length and the same context (the joints
of a full-body gap, thousands of one-frame dropouts) share one matrix and one product. The samples may be
positions, differences to a donor, coordinates in a rigid body's frame, or rotation vectors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

Array = np.ndarray

VELOCITY_SECONDS = 0.075  # how far from the seam the end velocity is measured
VELOCITY_DEGREE = 2  # of the polynomial through the seam that measures it
CARRY_SECONDS = 0.75  # for so long a velocity says something about where a joint goes
RAMP_SECONDS = 0.2  # and what a model misses at a seam goes on for so long
SPLINE_SAMPLES = 6  # on each side
SETTLE_SECONDS = 0.1  # time constant with which a motion without a far end comes to rest


def least_jerk(u: Array) -> Array:
    """From 0 to 1, at rest at both ends, for `u` from 0 to 1 (Flash & Hogan 1985)."""
    return u**3 * (10 - 15 * u + 6 * u**2)


@dataclass(frozen=True)
class Curve:
    """A way across a gap.

    weights : `(length, times (samples,), fps) -> (length, samples)`.
    reach : how many frames on each side it looks at, given the rate.
    """

    name: str
    weights: Callable[[int, Array, float], Array]
    reach: Callable[[float], int]

    def across(self, length: int, times: Array, fps: float) -> Array:
        """The weights of the samples at `times` in each of the gap's frames; with one seam only, `settle`."""
        both = times[0] <= 0 and times[-1] > length
        return (self.weights if both else settle)(length, times, fps)


def velocity_frames(fps: float) -> int:
    """How many frames the end velocity is measured from, the seam included."""
    return 1 + max(2, round(VELOCITY_SECONDS * fps))


def velocity(times: Array, seam: float, degree: int = VELOCITY_DEGREE) -> Array:
    """The weights `(samples,)` of the velocity at the sample at time `seam`, per frame; zeros if it is alone.

    Least-squares polynomial of this degree (or less, where there are fewer samples) that passes through the seam's
    sample.
    """
    return _velocity(tuple((times - seam).tolist()), degree)


@lru_cache(maxsize=4096)  # many gaps have the same context on one side
def _velocity(away: tuple[float, ...], degree: int) -> Array:
    distance = np.array(away, float)
    others = distance != 0
    weights = np.zeros(len(away))
    if np.any(others):
        powers = np.arange(1, min(degree, int(others.sum())) + 1)
        weights[others] = np.linalg.pinv(distance[others, None] ** powers)[0]
        weights[~others] = -weights.sum()
    return weights


def _linear(length: int, times: Array, fps: float) -> Array:
    del fps
    u = np.arange(1, length + 1) / (length + 1)
    return np.outer(1 - u, times == 0) + np.outer(u, times == length + 1)


def _hermite(length: int, times: Array, fps: float, carry: float = np.inf) -> Array:
    """Cubic Hermite: the seams' values, and velocities from a few frames on each side.

    p = h00 p0 + h10 T v0 + h01 p1 + h11 T v1, the textbook basis on u = t/T. A seam that stands alone has the
    velocity of the straight line. `carry`, seconds, trusts velocities less: see `_eased`.
    """
    reach, span = velocity_frames(fps), length + 1
    u = np.arange(1, length + 1) / span
    start, stop = (times == 0).astype(float), (times == span).astype(float)
    eased, trust, ends = np.isfinite(carry), min(1.0, carry * fps / span), []
    for seam, near in ((0, (times <= 0) & (times > -reach)), (span, (times >= span) & (times < span + reach))):
        weights = np.zeros(len(times))
        weights[near] = velocity(times[near], seam, 1 if eased and near.sum() < reach else VELOCITY_DEGREE)
        chord = stop - start
        ends.append(chord + trust * (span * weights - chord) if near.sum() > 1 else chord)
    value = np.outer((1 + 2 * u) * (1 - u) ** 2, start) + np.outer(u**2 * (3 - 2 * u), stop)
    return value + np.outer(u * (1 - u) ** 2, ends[0]) + np.outer(u**2 * (u - 1), ends[1])


def _eased(length: int, times: Array, fps: float) -> Array:
    """Cubic Hermite that does not trust a velocity for longer than it is worth.

    In gaps of more than CARRY_SECONDS, T, the end velocities are (CARRY_SECONDS / T) of the measured ones and the rest
    of the straight line's. Where fewer samples are left at a seam than `velocity_frames`, a straight line measures its
    velocity: a parabola through so few is mostly noise. Both were found on CMU's training takes.
    """
    return _hermite(length, times, fps, CARRY_SECONDS)


def _ramp(length: int, times: Array, fps: float) -> Array:
    """`eased`, with RAMP_SECONDS: through a long gap nearly a straight line, for what a model of the marker misses."""
    return _hermite(length, times, fps, RAMP_SECONDS)


def _cubic(length: int, times: Array, fps: float) -> Array:
    """Not-a-knot cubic spline through the samples (SciPy's CubicSpline)."""
    from scipy.interpolate import CubicSpline

    del fps
    return CubicSpline(times, np.eye(len(times)))(np.arange(1, length + 1))


def settle(length: int, times: Array, fps: float) -> Array:
    """Past the only seam: go on with its velocity, which dies away: p + v tau (1 - exp(-t / tau))."""
    forward = times[0] <= 0
    seam = 0 if forward else length + 1
    reach = velocity_frames(fps)
    tau = SETTLE_SECONDS * fps
    away = np.abs(np.arange(1, length + 1) - seam)
    near = np.abs(times - seam) < reach
    speed = np.zeros(len(times))
    speed[near] = velocity(times[near], seam)
    coast = tau * -np.expm1(-away / tau) * (1 if forward else -1)
    return (times == seam).astype(float) + np.outer(coast, speed)


CURVES = {
    curve.name: curve
    for curve in (
        Curve("linear", _linear, velocity_frames),
        Curve("hermite", _hermite, velocity_frames),
        Curve("eased", _eased, velocity_frames),
        Curve("ramp", _ramp, velocity_frames),
        Curve("cubic", _cubic, lambda fps: max(SPLINE_SAMPLES, velocity_frames(fps))),
    )
}


def between_seen(positions: Array, observed: Array) -> tuple[Array, Array]:
    """`eased` curves, and straight lines, through whatever is observed, in all joints of many 60 fps windows at once.

    Parameters
    ----------
    positions : `(B, T, J, 3)` float32, finite where `observed (B, T, J)`, not read elsewhere.

    Returns
    -------
    Both `(B, T, J, 3)` float32: `positions` where observed. Before a joint's first and after its last sample it stands
    still; 0 for a joint that has none.

    The seams' velocities are measured as `velocity` does, over NEAR frames; over two frames or one where fewer are
    observed in a row, and along the chord where the seam stands alone.
    """
    frames = observed.shape[1]
    seen = observed[..., None]
    known = np.where(seen, positions, np.float32(0))
    clock = np.arange(frames)[None, :, None]
    before = np.maximum.accumulate(np.where(observed, clock, -1), axis=1)
    after = np.minimum.accumulate(np.where(observed, clock, frames)[:, ::-1], axis=1)[:, ::-1]
    first, last = np.maximum(before, 0), np.minimum(after, frames - 1)
    first, last = np.where(before < 0, last, first), np.where(after >= frames, first, last)
    span = np.maximum(last - first, 1).astype(np.float32)[..., None]
    u = (clock - first)[..., None] / span

    def at(values: Array, index: Array) -> Array:
        return np.take_along_axis(values, index[..., None], axis=1)

    start, stop = at(known, first), at(known, last)
    chord, sway = stop - start, np.minimum(np.float32(CARRY) / span, 1)
    slopes = []
    for side, index in ((-1, first), (1, last)):
        slope, sure = _slopes(known, observed, side)
        slopes.append(chord + np.where(at(sure[..., None], index), at(slope, index) * span - chord, 0) * sway)
    leaving, arriving = slopes
    ever = np.asarray(observed.any(axis=1))[:, None, :, None]
    curve = start + u**2 * (3 - 2 * u) * chord + u * (1 - u) ** 2 * leaving + u**2 * (u - 1) * arriving
    between = ((before >= 0) & (after < frames))[..., None]
    held = np.where(before[..., None] >= 0, start, stop)
    curve, line = (np.where(seen, known, np.where(between, each, held)) for each in (curve, start + u * chord))
    curve, line = (np.where(ever, each, 0).astype(np.float32) for each in (curve, line))
    return curve, line


def along_bones(positions: Array, observed: Array, parents: Sequence[int]) -> tuple[Array, Array]:
    """`between_seen` for each joint as seen from its parent, wherever the parent is known or its own curve is.

    Where a joint and all above it miss the same frames, these are the curves through its positions. Where a limb is
    missing, it is carried by the body. A joint that is never seen lies on its parent, a root at the mean of all.
    """
    curve, line = (np.zeros(positions.shape, np.float32) for _ in range(2))
    above, depth = np.array(parents), np.zeros(len(parents), int)
    for joint, parent in enumerate(parents):
        depth[joint] = depth[parent] + 1 if parent >= 0 else 0
    sums = np.where(observed[..., None], positions, 0).sum(axis=(1, 2), keepdims=True, dtype=float)
    middle = sums / np.maximum(np.count_nonzero(observed, axis=(1, 2)), 1)[:, None, None, None]
    for level in range(depth.max() + 1):
        joints = np.flatnonzero(depth == level)
        anchor = curve[:, :, above[joints]] if level else middle.astype(np.float32)
        seen = observed[:, :, joints]
        apart = np.where(seen[..., None], positions[:, :, joints], anchor) - anchor
        curve[:, :, joints], line[:, :, joints] = (each + anchor for each in between_seen(apart, seen))
    curve, line = (np.where(observed[..., None], positions, each) for each in (curve, line))
    return curve, line


CARRY = 45  # frames: CARRY_SECONDS at 60 fps
NEAR = 4  # frames beside the seam: VELOCITY_SECONDS at 60 fps


def _slopes(known: Array, observed: Array, side: int) -> tuple[Array, Array]:
    """Velocity a frame `(B, T, J, 3)` at each sample from those on one `side` of it, and where there is one."""
    frames = known.shape[1]
    pad = [(0, 0), (NEAR, NEAR), (0, 0)]
    around, there = np.pad(known, [*pad, (0, 0)]), np.pad(observed, pad)
    away = side * np.arange(NEAR + 1)
    weights = velocity(away.astype(float), 0.0).astype(np.float32)
    slope, all_there = np.zeros_like(known), np.ones_like(observed)
    for distance, weight in zip(away, weights):
        part = slice(NEAR + distance, NEAR + distance + frames)
        slope += weight * around[:, part]
        all_there &= there[:, part]
    one, two = (slice(NEAR + side * far, NEAR + side * far + frames) for far in (1, 2))
    step = np.where((there[:, one] & there[:, two])[..., None], (around[:, two] - known) / 2, around[:, one] - known)
    return np.where(all_there[..., None], slope, step * np.float32(side)), there[:, one] & observed
