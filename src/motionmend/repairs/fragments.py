"""Tracks without a label that go on where a labelled marker was lost: found, offered, and joined where one says so.

When a camera system loses a marker and finds it again, what it finds is often a track of its own: "*3", "Unlabeled 12".
A wrong join is worse than none, so everything must agree: the distances to the markers that keep theirs, the place
where `regression` expects the marker, and position and velocity at both ends; and no other lost marker, and no
other track, may come near to fitting as well.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..fills.donors import near
from ..fills.lessons import lesson
from ..fills.regression import regressed
from ..gaps import Gaps
from ..motion import Motion, Take, runs

Array = np.ndarray

# What Vicon ("*3", "uname*4"), OptiTrack ("Unlabeled 12"), Qualisys ("New 0012") and others call them.
UNLABELLED = re.compile(r"\*\d+|(unlabell?ed|unidentified|uname\*?|unnamed)[ _-]?\d*|new \d{4}", re.IGNORECASE)
SHORTEST_SECONDS = 0.02
REACH_SECONDS = 0.1  # beside a gap and at a fragment's ends, for velocities
DONORS = 8
JUDGES = 4  # the steadiest of them, whose distances are judged
DEVIATIONS = 3.5  # of what a distance may be off by
SURE_METRES = 0.003  # of a distance, however steady it is
EXPECTED_METRES = 0.015  # regression's place may be missed by this, or by
EXPECTED_SHARE = 0.15  # of the mean distance to the judges
END_METRES, JERK = 0.005, 250.0  # at an end: metres, and m/s³ over the time that is not seen
CLEARER = 3.0  # times nearer than the next marker or track
SAME_METRES = 0.01  # as near to a marker that is seen, it is that one's ghost


@dataclass(frozen=True)
class Fragment:
    """Frames `[start, stop)` of a track without a label that continue a labelled marker.

    track, marker : their indices. metres : how far, on average, from where the other markers put it.
    """

    track: int
    marker: int
    start: int
    stop: int
    metres: float


def unlabelled(names: Sequence[str]) -> Array:
    """`(joints,)` bool: names that a capture system gives to tracks which nobody has labelled."""
    return np.array([bool(UNLABELLED.fullmatch(name.strip().rpartition(":")[2])) for name in names], bool)


def fragments(motion: Motion) -> list[Fragment]:
    """The stretches of tracks without a label that can only be a labelled marker that is lost there, by time."""
    loose = unlabelled(motion.skeleton.names)
    if not loose.any() or loose.all():
        return []
    shortest = max(3, round(SHORTEST_SECONDS * motion.fps))
    pieces = [
        (track, start, stop)
        for track in np.flatnonzero(loose).tolist()
        for start, stop in runs(motion.observed[:, track])
        if stop - start >= shortest and not _ghost(motion, track, start, stop, ~loose)
    ]
    gaps = Gaps.of(motion.observed)
    gaps = gaps.pick(~loose[gaps.joint] & ~gaps.is_blank)
    found = []
    for track, start, stop in pieces:
        rows = np.flatnonzero((gaps.start <= start) & (gaps.stop >= stop)).tolist()
        fits = {row: _missed(motion, gaps, row, track, start, stop, loose) for row in rows}
        ranked = sorted(rows, key=lambda row: fits[row][0])
        if not ranked or not fits[ranked[0]][1]:
            continue
        best, metres = ranked[0], fits[ranked[0]][0]
        marker = int(gaps.joint[best])
        rivals = [fits[row][0] for row in ranked[1:]]
        for other, first, last in pieces:
            inside = gaps.start[best] <= first and last <= gaps.stop[best]
            if other != track and inside and first < stop and start < last:
                rivals.append(_missed(motion, gaps, best, other, first, last, loose)[0])
        # One that cannot be judged (NaN) is a rival, too.
        if all(rival > CLEARER * (metres + SURE_METRES) for rival in rivals):
            found.append(Fragment(track, marker, start, stop, metres))
    return sorted(found, key=lambda one: (one.start, one.track))


def joined(take: Take, found: Sequence[Fragment]) -> Take:
    """A take of points whose lost markers have the fragments' samples; the tracks without labels stay as they are."""
    positions, observed = take.motion.positions.copy(), take.motion.observed.copy()
    for one in found:
        where = slice(one.start, one.stop)
        positions[where, one.marker] = take.motion.positions[where, one.track]
        observed[where, one.marker] = True
    return take.with_motion(replace(take.motion, positions=positions, observed=observed))


def _ghost(motion: Motion, track: int, start: int, stop: int, labelled: Array) -> bool:
    """Whether a track runs along a labelled marker that is seen."""
    seen = motion.observed[start:stop] & labelled
    own = motion.positions[start:stop, track, None]
    apart = np.linalg.norm(np.where(seen[..., None], motion.positions[start:stop] - own, np.inf), axis=-1)
    return bool(np.any(apart < SAME_METRES))


def _missed(
    motion: Motion, gaps: Gaps, row: int, track: int, start: int, stop: int, loose: Array
) -> tuple[float, bool]:
    """How far a piece of a track is from where a gap's marker should be, metres, and whether all agrees that it is it.

    NaN and False where there is too little to tell from.
    """
    marker, first, last = int(gaps.joint[row]), int(gaps.start[row]), int(gaps.stop[row])
    reach = max(3, round(REACH_SECONDS * motion.fps))
    candidates = motion.observed[start:stop].all(axis=0) & ~loose
    one = lesson(motion, marker, start, stop, near(motion.observed[:, marker], first, last, reach), candidates, DONORS)
    chart = None if one is None else regressed(one)
    if one is None or chart is None:
        return np.nan, False
    own = motion.positions[start:stop, track].astype(np.float64)
    metres = float(np.linalg.norm(own - chart.outward(np.zeros((stop - start, 3))), axis=-1).mean())
    known = np.linalg.norm(one.known - one.own[:, None], axis=-1)[:, :JUDGES]
    apart = np.linalg.norm(one.asked[len(one.near) :] - own[:, None], axis=-1)[:, :JUDGES]
    off = np.abs(apart.mean(axis=0) - known.mean(axis=0)) / np.hypot(known.std(axis=0), SURE_METRES)
    agrees = metres < min(EXPECTED_METRES, EXPECTED_SHARE * known.mean()) and np.all(off < DEVIATIONS)
    ends = _ends_meet(motion, marker, track, first, start, reach) and _ends_meet(
        replace(motion, positions=motion.positions[::-1], observed=motion.observed[::-1]),
        marker, track, len(motion) - last, len(motion) - stop, reach,
    )  # fmt: skip
    return metres, bool(agrees and ends)


def _ends_meet(motion: Motion, marker: int, track: int, lost: int, found: int, reach: int) -> bool:
    """Whether a marker that is lost at frame `lost` can be where a track begins at `found`, with both velocities.

    Of a steady acceleration the way is the mean of the velocities times the time; the rest is jerk.
    """
    if lost == 0:
        return True
    before, after = np.arange(max(lost - reach, 0), lost), np.arange(found, min(found + reach, len(motion)))
    before, after = before[motion.observed[before, marker]], after[motion.observed[after, track]]
    if len(before) < 2 or len(after) < 2:
        return False
    seconds = (found - lost + 1) / motion.fps
    ends = []
    for frames, joint, seam in ((before, marker, lost - 1), (after, track, found)):
        degree = min(2, len(frames) - 1)
        ends.append(np.polynomial.polynomial.polyfit(
            (frames - seam) / motion.fps, motion.positions[frames, joint].astype(np.float64), degree
        )[:2])  # fmt: skip
    (from_, leaving), (to, arriving) = ends
    off = np.linalg.norm(to - from_ - (leaving + arriving) / 2 * seconds)
    return bool(off < END_METRES + JERK * seconds**3)
