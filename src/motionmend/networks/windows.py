"""Any length, rate and gap to a network's windows, and back without a seam."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from ..motion import Motion, runs

Array = np.ndarray

# Velocity per frame at sample 0 from samples at these distances, the better the later. The last is Catmull-Rom's; at
# the border of what is observed the parabola through three samples takes its place.
STENCILS: tuple[dict[int, float], ...] = (
    {0: -1, 1: 1},
    {-1: -1, 0: 1},
    {0: -3 / 2, 1: 2, 2: -1 / 2},
    {-2: 1 / 2, -1: -2, 0: 3 / 2},
    {-1: -1 / 2, 1: 1 / 2},
)

LONGEST = 0.6  # of a window: a full-body gap that is longer is crossed coarsely first
ROOM = 8  # a window shows at least its length divided by this beside what is taken from it
SHORTEST = 16  # frames: smaller windows cannot show a coarse gap with context on both sides

Predict = Callable[[Array, Array], Array]


def resample(motion: Motion, fps: float) -> Motion:
    """The motion at another rate; frame 0 stays where it is, and nothing is extrapolated.

    Frames whose times coincide are copied bit for bit: whole ratios are decimation, without a filter. Between two
    frames runs the cubic through both with velocities from the observed samples around them, a straight line where the
    two stand alone; a sample is observed where both are. `floor((frames - 1) * fps / motion.fps) + 1` frames, where the
    ratio is the nearest fraction with a denominator up to 1001, so that a frame time of 0.008333 s is 120 fps and 59.94
    is not 60.

    Raises
    ------
    ValueError : if `fps` is not positive, or a thousand times the rate of the motion.
    """
    ratio = Fraction(motion.fps / fps).limit_denominator(1001) if 0 < fps < np.inf else Fraction(0)
    if not ratio:
        raise ValueError(f"cannot go from {motion.fps} to {fps} frames per second")
    if ratio.denominator == 1:
        step = ratio.numerator
        return replace(motion, positions=motion.positions[::step], observed=motion.observed[::step], fps=float(fps))
    frames = max(0, (len(motion) - 1) * ratio.denominator // ratio.numerator + 1)
    at, beyond = np.divmod(np.arange(frames) * ratio.numerator, ratio.denominator)
    positions, observed = between(motion.positions, motion.observed, at, beyond / ratio.denominator)
    return Motion(positions, observed, float(fps), motion.skeleton)


def between(positions: Array, observed: Array, frame: Array, beyond: Array) -> tuple[Array, Array]:
    """Samples `beyond` [0, 1) frames after each `frame`: positions `(times, joints, 3)` and whether they are observed.

    Cubic Hermite with finite differences for velocities, so exact for parabolas where three samples are observed
    together. Unobserved samples are not read, and come out as NaN.
    """
    after = np.minimum(frame + (beyond > 0), len(positions) - 1)
    seen = observed[frame] & observed[after]
    velocity = _velocities(positions, observed)
    u = beyond[:, None, None]
    start, stop = positions[frame].astype(float), positions[after].astype(float)
    with np.errstate(invalid="ignore", over="ignore"):  # of unobserved samples, which are thrown away below
        curve = start + u**2 * (3 - 2 * u) * (stop - start)
        curve += u * (1 - u) ** 2 * velocity[frame] + u**2 * (u - 1) * velocity[after]
        out = np.where((beyond == 0)[:, None, None], positions[frame], curve.astype(np.float32))
    out[~seen] = np.nan
    return out, seen


def _velocities(positions: Array, observed: Array) -> Array:
    """`(frames, joints, 3)` float64 metres per frame from the observed samples around each; 0 where there are none."""
    frames = len(positions)
    around = np.pad(np.where(observed[..., None], positions, 0).astype(float), ((2, 2), (0, 0), (0, 0)))
    seen = np.pad(observed, ((2, 2), (0, 0)))
    velocity = np.zeros(positions.shape)
    for stencil in STENCILS:
        known = observed.copy()
        slope = np.zeros(positions.shape)
        for away, weight in stencil.items():
            known &= seen[2 + away : 2 + away + frames]
            slope += weight * around[2 + away : 2 + away + frames]
        np.copyto(velocity, slope, where=known[..., None])
    return velocity


def starts(frames: int, length: int, overlap: int) -> Array:
    """First frames `(W,)` of windows that cover a take, each sharing at least `overlap` frames with the next.

    Evenly spaced; the last one ends with the take, and a take that is not longer than a window has one.
    """
    if not 0 <= overlap < length:
        raise ValueError(f"windows of {length} frames cannot overlap by {overlap}")
    last = max(0, frames - length)
    count = -(-last // (length - overlap))
    return np.arange(count + 1) * last // max(1, count)


def cut(values: Array, starts: Array, length: int) -> Array:
    """Windows `(W, length, ...)` of `values (frames, ...)`; beyond the end they repeat the last frame."""
    return values[np.minimum(starts[:, None] + np.arange(length), len(values) - 1)]


def stitch(windows: Array, starts: Array, frames: int, overlap: int) -> Array:
    """One take `(frames, ...)` of windows `(W, T, ...)` that begin at `starts (W,)`, ascending.

    Each changes into the next along a straight ramp of `overlap` frames in the middle of what they share. So where they
    differ no step is above difference / overlap, if overlap is at most a third of T.    """
    shared = starts[:-1] + windows.shape[1] - starts[1:]
    if shared.min(initial=overlap) < overlap:
        raise ValueError(f"windows that share {shared.min()} frames cannot fade over {overlap}")
    return _blend(windows, starts, starts[1:] + (shared - overlap) // 2, [_ramp(overlap)] * len(shared), frames)


def _ramp(frames: int) -> Array:
    return np.arange(1, frames + 1, dtype=np.float32) / (frames + 1)


def _blend(windows: Array, starts: Array, begins: Array, shares: Sequence[Array], frames: int) -> Array:
    """`stitch`, where window i + 1 takes over from frame `begins[i]` on, and has `shares[i] (fade, ...)` there."""
    out = np.full((frames, *windows.shape[2:]), np.nan, windows.dtype)
    for window, start, begin, share in zip(windows, starts, [*starts[:1], *begins], [_ramp(0), *shares]):
        share = share.reshape(*share.shape, *[1] * (out.ndim - share.ndim))
        new, fade = window[begin - start : frames - start], len(share)
        old = out[begin : begin + fade]
        out[begin : begin + fade] = np.where(share < 1, old + share * (new[:fade] - old), new[:fade])
        out[begin + fade : begin + len(new)] = new[fade:]
    return out


def complete(
    predict: Predict,
    positions: Array,
    observed: Array,
    length: int,
    *,
    overlap: int,
    batch: int,
    most: int = 0,
    longest: float = LONGEST,
) -> Array:
    """A take of any length, its unobserved samples predicted by a network that knows windows of `length` frames.

    Windows lie where something is missing. They are cut where nothing is, or else where as little as possible is, so
    that a gap that fits has context on both sides in the window that it is taken from; where a gap must be shared, one
    window changes into the next over `overlap` frames. A gap of the whole body that is too long for a window is first
    predicted at a lower rate, which is repeated until it fits, and every few frames of that are shown to the windows
    at the full rate as known. Time and memory grow linearly with the take.

    Parameters
    ----------
    predict : `(positions (B, T, J, 3) float32, observed (B, T, J)) -> (B, T, J, 3)`, T = `length`. Unobserved
        samples are NaN. Frames beyond the end of a take shorter than a window are unobserved. It may say more of a
        sample than where it is, `(B, T, J, 3 + C)`: how far off it may be, say.
    positions, observed : `(frames, J, 3)` float32 and `(frames, J)` bool, at the network's rate.
    overlap : at most a quarter of `length`.
    batch : windows that are predicted at once.
    most : frames that `predict` also takes in one piece, where it takes any number; `length` if 0. Gaps that are too
        long for `length` are crossed at a lower rate all the same: that is what the network knows.
    longest : share of `length` that a gap of the whole body may take at the full rate.

    Returns
    -------
    `(frames, J, 3 + C)` float32: observed samples bit for bit, all others predicted, also of joints never observed.
    What more is said is 0 where observed; of samples between coarse ones it is the root of the sum of squares of both.
    """
    if not 0 <= overlap <= length // 4:
        raise ValueError(f"windows of {length} frames can fade over 0 to {length // 4} frames, not {overlap}")
    if observed.all():
        return positions.copy()
    guide, known, coarse = _guided(predict, positions, observed, length, overlap, batch, longest)
    length = max(1, min(most, len(observed))) if most else length
    first, begins, shares = _plan(~observed, length, overlap)
    windows = []
    for some in range(0, len(first), batch):
        begin = first[some : some + batch]
        seen = cut(known, begin, length) & (begin[:, None] + np.arange(length) < len(observed))[..., None]
        windows.append(predict(np.where(seen[..., None], cut(guide, begin, length), np.nan), seen))
    out = _blend(np.concatenate(windows, dtype=np.float32), first, begins, shares, len(observed))
    more = out.shape[2] - positions.shape[2]
    out = np.where(observed[..., None], np.pad(positions, ((0, 0), (0, 0), (0, more))), out).astype(np.float32)
    _bridge(out, observed, known & ~observed)
    if coarse is not None:
        out[..., 3:] = np.where(observed[..., None], 0, np.hypot(out[..., 3:], coarse))
    return out


def too_long(observed: Array, length: int, longest: float = LONGEST) -> list[tuple[int, int]]:
    """The gaps of the whole body, first frame and past the last, that `complete` crosses at a lower rate first."""
    return [hole for hole in runs(_blind(observed)) if hole[1] - hole[0] > int(longest * length) and length >= SHORTEST]


def _blind(observed: Array) -> Array:
    """`(frames,)` bool: less than half is there of what is ever there."""
    ever = observed.any(axis=0)
    return np.asarray(2 * observed[:, ever].sum(axis=1) < ever.sum())


def _plan(missing: Array, length: int, overlap: int) -> tuple[Array, Array, list[Array]]:
    """Where to lay windows so that all of `missing (frames, joints)` is well inside the window that it is taken from.

    First frames of the windows `(W,)`, and for `_blend` the frames from which on they take over and their shares there:
    none where no gap crosses the cut. Else a joint that is observed in the frames that fade changes windows there at
    once, and only those that are not are mixed.
    """
    frames, joints = missing.shape
    half, margin = overlap // 2, length // ROOM
    todo = np.flatnonzero(missing.any(axis=1))
    end = int(todo[-1]) + 1
    across = np.pad(missing[1:] & missing[:-1], ((1, 1), (0, 0)))  # (frames + 1, joints): a cut before the frame splits
    total, cuts = np.pad(np.cumsum(missing, axis=0, dtype=np.int32), ((1, 0), (0, 0))), np.arange(frames + 1)
    hidden = total[np.minimum(cuts + overlap - half, frames)] - total[np.maximum(cuts - half, 0)] == overlap
    crossing, mixed = across.sum(axis=1), (across & hidden).sum(axis=1)
    cost = crossing + (joints + 1) * mixed
    # How much a window shows on each side of a cut. What fades is context for what does not; in the midst of a gap of
    # most joints it needs context of its own.
    free, midst = crossing == 0, 2 * mixed > joints
    before, after = (
        np.where(free, margin, np.where(midst, fade + margin, max(fade, margin))) for fade in (half, overlap - half)
    )

    first, begins = [], [int(todo[0])]
    while True:
        begin = begins[-1]
        limit = max(0, begin - before[begin]) + length  # where a window ends that shows what follows as far as it can
        stop = end
        if min(end + after[end], frames) > limit:
            cuts = np.arange(begin + 1, min(limit, frames) + 1)
            soonest = begin + np.where(free[cuts], 1, max(1, overlap, margin))
            cuts = cuts[(cuts >= soonest) & (cuts + after[cuts] <= limit)]
            cuts = cuts[cost[cuts] == cost[cuts].min()]
            stop = int(cuts[np.argmin(np.abs(cuts - begin - length // 2))])
        upto = int(todo[np.searchsorted(todo, stop) - 1]) + 1
        spare = length - (upto - begin)
        left = max(before[begin], min(spare // 2, spare - after[stop]))
        first.append(max(0, min(begin - left, frames - length)))
        if stop == end:
            break
        begins.append(int(todo[np.searchsorted(todo, stop)]))
    shares = []
    for index, cut in enumerate(begins[1:]):
        shares.append(_ramp(0))
        if not free[cut]:
            begins[index + 1] = cut - half
            offset = np.arange(-half, overlap - half)[:, None]
            near = np.where(missing[cut - half : cut - half + overlap], frames, np.abs(offset))
            change = offset[near.argmin(axis=0), 0] if overlap else 0
            shares[-1] = np.where(near.min(axis=0, initial=frames) < frames, offset >= change, _ramp(overlap)[:, None])
    return np.array(first), np.array(begins[1:], int), shares


def _guided(
    predict: Predict, positions: Array, observed: Array, length: int, overlap: int, batch: int, share: float
) -> tuple[Array, Array, Array | None]:
    """`positions` and `observed` with a frame known every now and then in gaps of the whole body longer than a window.

    They come from the gap and its surroundings at a lower rate, chosen so that both its ends are among the samples.
    Third, what more `predict` said of them, `(frames, J, C)`; None where no gap is so long.
    """
    frames, ever = len(observed), observed.any(axis=0)
    blind, longest, holes = _blind(observed), int(share * length), too_long(observed, length, share)
    if not holes:
        return positions, observed, None
    guide, known, more = positions.copy(), observed.copy(), np.zeros((*observed.shape, 0), np.float32)
    for start, stop in holes:
        begin, end = max(start - 1, 0), min(stop, frames - 1)
        span, every, reach = end - begin, max(2, length // ROOM), length // 2
        count = max(-(-span // every), longest - 1)  # the highest rate at which it fits
        before, after = (min(reach, room * count // span) for room in (begin, frames - 1 - end))
        times = np.arange(-before, count + after + 1)
        frame, rest = np.divmod(begin * count + times * span, count)
        near = slice(max(0, frame[0] - 2), frame[-1] + 4)
        coarse, seen = between(positions[near], observed[near], frame - near.start, rest / count)
        whole = complete(predict, coarse, seen, length, overlap=overlap, batch=batch, longest=share)
        coarse, said = np.split(whole[(times >= 0) & (times <= count)], [3], axis=-1)
        more = np.zeros((*observed.shape, said.shape[-1]), np.float32) if not more.size else more
        nearest = ((np.arange(start, stop) - begin) * count + span // 2) // span
        more[start:stop] = said[nearest]
        knots = np.linspace(begin, end, -(-span // every) + 1).round().astype(int)
        knots = knots[blind[knots]]
        step, rest = np.divmod((knots - begin) * count, span)
        values, _ = between(coarse, np.ones(coarse.shape[:2], bool), step, rest / span)
        added = ever & ~observed[knots]
        guide[knots] = np.where(added[..., None], values, positions[knots])
        known[knots] |= added
    return guide, known, more


def _bridge(out: Array, observed: Array, knots: Array) -> None:
    """Put the samples of `out (frames, joints, 3)` where `knots` is True where their predicted neighbours lead.

    A network is not asked for what it was shown, and what it makes between need not pass through it exactly. On the
    cubic through two samples on each side, midway between one on each side where an observed one is among the four.
    """
    frame, joint = np.nonzero(knots)
    last = len(out) - 1
    steps = [np.clip(frame + away, 0, last) for away in (-2, -1, 1, 2)]
    far_left, left, right, far_right = (out[step, joint] for step in steps)
    free = ~np.any([observed[step, joint] for step in steps], axis=0)[:, None]
    through = np.where(free, (4 * (left + right) - far_left - far_right) / 6, (left + right) / 2)
    at_start, at_end = (np.where(free, 2 * near - far, near) for near, far in ((right, far_right), (left, far_left)))
    frame = frame[:, None]
    out[frame[:, 0], joint] = np.where(frame == 0, at_start, np.where(frame == last, at_end, through))
