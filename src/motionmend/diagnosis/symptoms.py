"""What damage looks like in the numbers of one joint: frozen samples, torn seams, noise.

Arrays in, frames out: nothing here knows takes, files or bodies. A `Track` is what one joint does by
itself; whether it turns or shifts, the same arithmetic on vectors judges it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..motion import Array, runs
from ..rotations import continuous, inverse, multiply, normalised

FEW = 3  # frames
TOLERANCE = 6.0  # how many times what is usual around it a jump must be
SPIKE_SECONDS = 0.045  # a jump out and back within this is a spike; longer ones are displaced stretches
LONGEST_DISPLACED = 1.0  # seconds; longer ones are told, not replaced


@dataclass(frozen=True, eq=False)
class Track:
    """What one joint does by itself: `values (frames, 3)` metres, or `(frames, 4)` quaternions times two.

    Missing samples are NaN. Twice a continuous quaternion moves by as much as the rotation's angle, in
    radians, for small turns.
    """

    joint: int
    turns: bool
    values: Array
    least: float  # the smallest jump that matters

    @property
    def is_lively(self) -> bool:
        """Whether it moves at all: less than 0.1 mm or 0.01 degrees in the whole take is rounding."""
        known = self.values[known_rows(self.values)]
        return len(known) > FEW and bool(np.ptp(known, axis=0).max() > 1e-4)

    def describe(self, size: float) -> str:
        return f"{np.degrees(size):.0f}°" if self.turns else f"{1000 * size:.0f} mm"


def known_rows(values: Array) -> Array:
    """`(frames,)` bool: no component is missing."""
    return np.isfinite(np.einsum("ij->i", values))


def _dot(a: Array, b: Array) -> Array:
    # Several times faster than a sum over so short an axis.
    return np.einsum("...i,...i->...", a, b)


def length(vectors: Array) -> Array:
    return np.sqrt(_dot(vectors, vectors))


def steps_of(values: Array) -> Array:
    """`(frames,)` how far each sample is from the one before it; 0 for the first, NaN next to missing ones."""
    return length(np.diff(values, axis=0, prepend=values[:1]))


def usual(values: Array, start: int, stop: int, window: int) -> float:
    """The upper quartile of `values` around frames `[start, stop]`, without these and their neighbours."""
    first = max(0, start - 1)
    around = np.concatenate([values[max(0, first - window) : first], values[stop + 2 : stop + 2 + window]])
    return float(np.sort(around)[len(around) * 3 // 4]) if len(around) else np.inf


def continuous_track(values: Array) -> Array:
    """Quaternions with the signs of their neighbours, missing ones (NaN) stepped over."""
    known = known_rows(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))
    filled = continuous(np.nan_to_num(values[last]))
    filled[~known] = np.nan
    return filled


def calibration_frames(tracks: list[Track], fps: float) -> int:
    """The number of first frames that hold a pose from which at least a quarter of the tracks jump; or 0."""
    frames = len(tracks[0].values) if tracks else 0
    window = max(FEW, round(0.25 * fps))
    most = min(max(2, round(0.1 * fps)), frames - 2)
    if len(tracks) < FEW or most < 1:
        return 0
    steps = np.nan_to_num(np.stack([steps_of(track.values[: most + window + 1]) for track in tracks], axis=1))
    least = np.array([2 * track.least for track in tracks])
    for first in range(1, most + 1):
        after = np.median(steps[first + 1 : first + 1 + window], axis=0)
        before = steps[1:first].max(axis=0, initial=0)
        jumped = (steps[first] > 5 * np.maximum(after, before)) & (steps[first] > least)
        if jumped.mean() >= 0.25 and jumped.sum() >= FEW:
            return first
    return 0


def doubled_stretches(still: Array) -> list[tuple[int, int]]:
    """Stretches `[start, stop)` made from a lower rate: more than one in 20 frames repeats the one before it.

    still : `(frames,)` bool, whether everything repeats the frame before.
    """
    found = np.array(runs(still)).reshape(-1, 2)
    groups = np.split(found, np.flatnonzero(found[1:, 0] - found[:-1, 1] > 40) + 1)
    stretches = [(max(0, int(group[0, 0]) - 1), int(group[-1, 1]), len(group)) for group in groups if len(group)]
    return [(start, stop) for start, stop, count in stretches if count > max(5, 0.05 * (stop - start))]


# Held values ----------------------------------------------------------------------------------------------


def copies(values: Array) -> Array:
    """`(frames,)` bool: the sample repeats the one before it.

    The first or last of several may differ from the others by its rounding: a recorder that froze wrote the value
    again, by another way of units and float32 than the value itself had come.
    """
    steps = steps_of(values)
    steps[:1] = np.inf
    # Equal numbers in a file may differ in the last bit once they have been turned into quaternions.
    copied = steps < 1e-12
    beside = np.zeros_like(copied)
    beside[1:] |= copied[:-1]
    beside[:-1] |= copied[1:]
    return copied | (beside & (steps < _rounding(values)))


def _rounding(values: Array) -> float:
    """By how much the same number may differ after a few roundings to float32."""
    return float(4 * np.finfo(np.float32).eps * np.nanmax(np.abs(values), initial=0))


def held_runs(values: Array, fps: float) -> list[tuple[int, int, float]]:
    """Runs `[start, stop)` of repeated samples in one track that are not natural, with their certainty.

    A joint may rest, reach its limit, turn back, or move by less than the file's last decimal. A frozen one
    stops at once while it moves, and then jumps to where it would have been.
    """
    steps, copied = steps_of(values), copies(values)
    moving = steps[steps > _rounding(values)]  # NaN compares false
    if not copied.any() or len(moving) < FEW:
        return []
    found = np.array(runs(copied))
    starts, stops = found[:, 0], found[:, 1]
    lengths = stops - starts
    window = np.arange(max(FEW, round(0.05 * fps)))
    before = _median_of(steps, starts[:, None] - 1 - window)
    after = _median_of(steps, stops[:, None] + 1 + window)
    speed = np.fmin(before, after)
    smallest = np.partition(moving, FEW - 1)[FEW - 1]
    # A file of few decimals makes its smallest step again and again; one that does not is far finer than it.
    if np.sum(moving < 1.001 * smallest) < max(2 * FEW, 0.02 * len(moving)):
        smallest /= 20
    evidence = lengths * speed / smallest  # how far it would have gone, in the file's smallest steps

    padded = np.concatenate([values, np.full((2, values.shape[1]), np.nan)])
    came = values[starts - 1] - values[np.maximum(starts - 2, 0)]
    release, onward = padded[stops] - padded[stops - 1], padded[stops + 1] - padded[stops]
    catches_up = length(release - onward) > 0.5 * np.fmax(before, after)
    # What rests by itself slows down before and sets out slowly; a frozen one leaves at a leap.
    leap = length(release) / np.maximum(length(onward), 1e-30)
    catches_up &= (leap > 1.5) | ((leap > 0.4) & (length(came) > 0.1 * before))
    # A few equal samples may be a turning point, after which the way leads straight back.
    goes_on = _dot(came, release) > -0.8 * length(came) * length(release)
    goes_on &= length(release) > 0.3 * length(onward)
    resumes = np.where(lengths < FEW, goes_on, catches_up)
    at_end = (stops == len(steps)) | (starts == 1)
    open_ended = at_end & (lengths >= max(FEW, round(0.1 * fps)))
    accepted = (evidence > 6) & (speed > 2.5 * smallest) & (resumes | open_ended)
    accepted &= ~_at_limit(values, starts) & ~_returns(values[starts])
    # One that stands still most of the time does so by itself.
    sure = resumes & ~at_end & (copied.mean() < 0.5)
    certainty = np.where(sure, np.clip(1 - 2 / np.maximum(evidence, 6), 0.66, 0.98), 0.5)
    rows = zip(starts[accepted], stops[accepted], np.round(certainty[accepted], 2))
    return [(int(start), int(stop), float(sure)) for start, stop, sure in rows]


def _at_limit(values: Array, at: Array) -> Array:
    """Whether a track is at an end of all that it ever does: knees and wrists rest against their limits."""
    known = values[known_rows(values)]
    centre = known.mean(axis=0)
    main = np.linalg.eigh((known - centre).T @ (known - centre))[1][:, -1]
    along, here = (known - centre) @ main, (values[at] - centre) @ main
    nearly = 1e-6 * np.ptp(along)
    return (here > along.max() - nearly) | (here < along.min() + nearly)


def _returns(held: Array) -> Array:
    """Whether the value of each run is held in another one too: toes that rest at zero again and again."""
    places = np.round(np.abs(held) / max(_rounding(held), 1e-9))  # q and -q are the same turn
    _, kinds, counts = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    return counts[kinds.reshape(-1)] > 1


def _median_of(steps: Array, at: Array) -> Array:
    """The median of `steps` at each row of indices, leaving out those outside; NaN where none is inside."""
    inside = (at >= 1) & (at < len(steps))
    picked = np.sort(np.where(inside, steps[np.clip(at, 0, len(steps) - 1)], np.nan), axis=1)  # NaN last
    count = np.isfinite(picked).sum(axis=1)
    middle = picked[np.arange(len(picked)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, middle, np.nan)


# Torn seams: jumps and displaced stretches ------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Seam:
    """Between frames `at - 1` and `at` a track jumps by `size` more than its speeds before and after allow.

    score : the size over what is tolerated there. speed : the step that those speeds would have made.
    """

    at: int
    size: float
    score: float
    speed: Array


@dataclass(frozen=True)
class Tear:
    """cause : "jump", "displaced", or "step" for one that is not undone; size : metres or radians."""

    cause: str
    start: int
    stop: int
    certainty: float
    size: float


def tears(track: Track, fps: float) -> Iterator[Tear]:
    """Jumps, displaced stretches and steps of one track."""
    values = _bridged(track.values)
    seams = _seams(track, values, fps)
    longest = max(FEW, round(SPIKE_SECONDS * fps))
    used: set[int] = set()
    for number, seam in enumerate(seams):
        if seam.at in used:
            continue
        for other in seams[number + 1 :]:
            if other.at - seam.at > longest:
                break
            size, mismatch = _excursion(values, seam, other)
            if mismatch < 0.35 * size and size > track.least:
                yield Tear("jump", seam.at, other.at, _certainty(min(seam.score, other.score)), size)
                used |= {inner.at for inner in seams if seam.at <= inner.at <= other.at}
                break
    rest = [seam for seam in seams if seam.at not in used and seam.score > 2]
    pairs = []
    for number, seam in enumerate(rest):
        # The next one of its kind must bring it back, or nothing does.
        other = next((other for other in rest[number + 1 :] if other.size > 0.5 * seam.size), None)
        if other is not None and other.at - seam.at <= len(values) / 2:
            size, mismatch = _offset(track, values, seam, other)
            if mismatch < 0.25 * size:
                pairs.append((other.at - seam.at, seam, other, size))
    # A joint that flips to and fro is wrong in the short stretches; one seam missed must not turn that round.
    for length, seam, other, size in sorted(pairs, key=lambda pair: pair[0]):
        if used & {seam.at, other.at}:
            continue
        used |= {seam.at, other.at}
        certainty = _certainty(0.5 * min(seam.score, other.score))
        # The longer it lasts, the less it can be said which side of a step is the wrong one.
        if length > LONGEST_DISPLACED * fps:
            certainty = min(certainty, 0.5)
        yield Tear("displaced", seam.at, other.at, certainty, size)
    for seam in rest:
        if seam.at not in used and seam.score > 4:
            yield Tear("step", seam.at, seam.at + 1, 0.5, seam.size)


def _certainty(score: float) -> float:
    return int(100 - 50 / max(score, 0.5)) / 100  # rounded down: what is told as certain is


def _bridged(values: Array) -> Array:
    """Missing samples on the straight line between their neighbours; where more than a few, still NaN."""
    known = known_rows(values)
    if known.all() or not known.any():
        return values
    at = np.flatnonzero(known)
    filled = np.stack([np.interp(np.arange(len(values)), at, column[at]) for column in values.T], axis=1)
    for start, stop in runs(~known):
        if stop - start > FEW or start == 0 or stop == len(values):
            filled[start:stop] = np.nan
    return filled


def _seams(track: Track, values: Array, fps: float) -> list[_Seam]:
    """Where one step lies far off the steps before and after it, and all between these two."""
    if len(values) < 5:
        return []
    steps = np.diff(values, axis=0)
    allowed = _between(steps[:-2], steps[1:-1], steps[2:])
    sizes = np.zeros(len(values))
    sizes[2:-1] = np.nan_to_num(length(steps[1:-1] - allowed))
    # What this joint does again and again, as toes do at every step, is its habit, however abrupt.
    habit = np.sort(sizes)[max(0, min(int(0.98 * len(sizes)), len(sizes) - 8))]
    floor = max(0.5 * track.least, 12 * float(np.median(sizes)), 2.5 * float(habit))
    window = max(6, round(0.1 * fps))
    seams = []
    for at in np.flatnonzero(sizes > floor).tolist():
        tolerated = max(floor, TOLERANCE * usual(sizes, at, at + FEW, window))
        if sizes[at] > tolerated:
            seams.append(_Seam(at, float(sizes[at]), float(sizes[at] / tolerated), allowed[at - 2]))
    return seams


def _between(before: Array, here: Array, after: Array) -> Array:
    """The point nearest to `here` on the line from `before` to `after`; `(..., d)` each."""
    change = after - before
    share = _dot(here - before, change) / np.maximum(_dot(change, change), 1e-30)
    return before + np.clip(share, 0, 1)[..., None] * change


def _excursion(values: Array, out: _Seam, back: _Seam) -> tuple[float, float]:
    """How far a short stretch is off the way between its neighbours, and how badly these neighbours meet."""
    start, stop = out.at, back.at
    way = (values[stop] - values[start - 1]) / (stop - start + 1)
    before, after = values[start - 1] - values[start - 2], values[stop + 1] - values[stop]
    mismatch = length(way - _between(before, way, after)) * (stop - start + 1)
    inside = values[start - 1] + way * np.arange(1, stop - start + 1)[:, None]
    return float(length(values[start:stop] - inside).min()), float(mismatch)


def _offset(track: Track, values: Array, enter: _Seam, leave: _Seam) -> tuple[float, float]:
    """The offset of a stretch from what surrounds it, and how much it differs between its two ends."""
    outside, inside = values[enter.at - 1] + enter.speed, values[enter.at]
    inside_too, outside_too = values[leave.at - 1] + leave.speed, values[leave.at]
    if not track.turns:
        one, two = inside - outside, inside_too - outside_too
        return float(length(one)), float(length(one - two))
    a, b, c, d = (normalised(q) for q in (outside, inside, inside_too, outside_too))
    # The offset may be constant in the parent's frame or in the joint's own.
    pairs = (multiply(b, inverse(a)), multiply(c, inverse(d))), (multiply(inverse(a), b), multiply(inverse(d), c))
    differ = min(2 * min(length(p - q), length(p + q)) for p, q in pairs)
    return float(2 * length(a - b)), float(differ)


# Noise ----------------------------------------------------------------------------------------------------


def noise_level(values: Array) -> float:
    """Standard deviation per axis of white noise on a track; 0 where what is quick in it is movement.

    The third difference of white noise has 20 times its variance, and neighbouring ones are opposed
    (correlation -0.75); those of movement are not.
    """
    third = np.diff(values, n=3, axis=0)
    third = third[known_rows(third)]
    if len(third) < 16:
        return 0.0
    size = np.median(np.abs(third))
    clipped = np.clip(third, -6 * size, 6 * size)
    power = np.sum(clipped * clipped)
    if power <= 0 or np.sum(clipped[1:] * clipped[:-1]) > -0.55 * power:
        return 0.0
    return float(1.4826 * size / np.sqrt(20))
