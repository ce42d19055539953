"""Links: pairs of joints that keep their distance, such as the two ends of a bone, and what their misfits say.

Where a joint is wrong its bones stretch. If one constant offset of some joints makes all their links fit again, in
frame after frame, then that is how far they are off, and they can be moved back.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..motion import Array, Motion, runs

LEAST = 0.005  # metres: a link that misfits by less is no evidence
LOOSEST = 0.02  # metres, the spread from which on a pair of joints has no length
SHORT = 0.02  # metres: a link of joints that all but coincide tells all three coordinates, not a distance alone
BREAK = 0.15  # seconds for which a link may seem to fit within one stretch
SHORTEST = 0.03  # seconds that must misfit strongly
NOISY = 0.001  # metres, the spread from which on a distance is averaged
AVERAGED = 0.1  # seconds
KEPT = 0.4  # share of the frames that are thought to be good at the least
MOST_STRETCHES = 6.0  # a minute in which a bone misfits, from which on (and from four on) it is one that stretches


@dataclass(frozen=True, eq=False)
class Links:
    """Pairs of joints that keep their distance.

    ends `(links, 2)` : joint indices. lengths, noise `(links,)` : metres; the usual distance and its spread.
    window `(links,)` : frames over which a noisy one is averaged before it is judged; 1 for others.
    """

    ends: Array
    lengths: Array
    noise: Array
    window: Array

    def __len__(self) -> int:
        return len(self.ends)

    def pick(self, rows: Array) -> Links:
        return Links(self.ends[rows], self.lengths[rows], self.noise[rows], self.window[rows])

    def misfits(self, points: Array) -> Array:
        """`(frames, links)` metres by which each link is too long (or, negative, too short); NaN where not known."""
        misfits = _distances(points, self.ends) - self.lengths
        for row in np.flatnonzero(self.window > 1):
            misfits[:, row] = _averaged(misfits[:, row], int(self.window[row]))
        return misfits

    @property
    def strong(self) -> Array:
        """`(links,)` metres from which on a misfit is evidence of damage."""
        return np.maximum(LEAST, 8 * self.noise)

    @property
    def weak(self) -> Array:
        """`(links,)` metres up to which a link fits; a stretch of misfits reaches to where it fits again."""
        return np.maximum(0.25 * LEAST, 3 * self.noise)

    def touching(self, joints: tuple[int, ...]) -> Array:
        """`(links,)` bool: at least one end is among `joints`."""
        return np.asarray(np.isin(self.ends, joints).any(axis=1))


def find_links(motion: Motion, points: Array, bending: Collection[int] = ()) -> Links:
    """The bones of a motion that have a length, and the pairs of children of one parent that keep their distance.

    points : `(frames, joints, 3)`, NaN where not known. bending : joints with others between them and their parents.
    """
    ends = _bones(motion.skeleton)
    bones = _measured(points, ends[~np.isin(ends[:, 1], list(bending))], motion.fps)
    bones = bones.pick(bones.noise < LOOSEST)
    misfits = bones.misfits(points)
    often = max(3.0, MOST_STRETCHES * motion.seconds / 60)
    steady = [_stretches(np.abs(column) > limit, motion.fps) <= often for column, limit in zip(misfits.T, bones.strong)]
    bones = bones.pick(np.array(steady, bool))
    pairs = _measured(points, _siblings(motion.skeleton, bones), motion.fps)
    pairs = pairs.pick(pairs.noise < 0.001 + 2 * np.median(bones.noise) if len(bones) else np.zeros(len(pairs), bool))
    # Twins that a resting body held apart just so are no link: they must keep it wherever their bones are right.
    wrong = np.abs(bones.misfits(points)) > bones.weak
    kept = np.ones(len(pairs), bool)
    for row, misfit in enumerate(pairs.misfits(points).T):
        right = ~wrong[:, bones.touching(tuple(pairs.ends[row]))].any(axis=1) & np.isfinite(misfit)
        kept[row] = right.any() and np.quantile(np.abs(misfit[right]), 0.99) < pairs.strong[row]
    pairs = pairs.pick(kept)
    both = ((one.ends, one.lengths, one.noise, one.window) for one in (bones, pairs))
    return Links(*(np.concatenate(each) for each in zip(*both)))


def _bones(skeleton) -> Array:
    """Each joint's link to its parent; not that of a root on the floor, on which all the rest hangs by one joint."""
    parents, children = skeleton.parents, skeleton.children
    floor = [parent >= 0 and parents[parent] < 0 and len(children[parent]) == 1 for parent in parents]
    ends = [(parent, joint) for joint, parent in enumerate(parents) if parent >= 0 and not floor[joint]]
    return np.array(ends, int).reshape(-1, 2)


def _siblings(skeleton, bones: Links) -> Array:
    """Pairs of joints with one parent; joints that all but coincide count as one parent."""
    place = list(range(len(skeleton)))
    for (parent, joint), length in zip(bones.ends.tolist(), bones.lengths):
        if length < SHORT:
            place[joint] = place[parent]
    families: dict[int, list[int]] = {}
    for (parent, joint), length in zip(bones.ends.tolist(), bones.lengths):
        if length >= SHORT:
            families.setdefault(place[parent], []).append(joint)
    ends = [pair for family in families.values() if len(family) <= 6 for pair in combinations(family, 2)]
    return np.array(ends, int).reshape(-1, 2)


def _measured(points: Array, ends: Array, fps: float) -> Links:
    distances = _distances(points, ends)
    lengths, noise = np.full((2, len(ends)), np.nan)
    window = np.ones(len(ends), int)
    for row, column in enumerate(distances.T):
        lengths[row], noise[row] = _usual(column)
        if np.isfinite(noise[row]) and noise[row] > NOISY:
            window[row] = 2 * round(0.5 * AVERAGED * fps) + 1
            lengths[row], noise[row] = _usual(_averaged(column, int(window[row])))
    return Links(ends, lengths, noise, window)


def _usual(values: Array) -> tuple[float, float]:
    """Middle and spread of the narrowest interval that holds KEPT of the values, which damage cannot widen much."""
    known = np.sort(values[np.isfinite(values)])
    if len(known) < 10:
        return np.nan, np.inf
    count = int(KEPT * len(known))
    widths = known[count:] - known[:-count]
    first = int(np.argmin(widths))
    # The middle 40 % of a normal distribution are 1.05 standard deviations wide.
    return float(known[first] + known[first + count]) / 2, float(widths[first]) / 1.05


def _distances(points: Array, ends: Array) -> Array:
    return np.linalg.norm(points[:, ends[:, 0]] - points[:, ends[:, 1]], axis=-1)


def _averaged(values: Array, window: int) -> Array:
    """Each known value averaged with the known ones beside it, `window` frames (odd) in all."""
    known = np.isfinite(values)
    sums, counts = (
        np.cumsum(np.pad(each, (window // 2 + 1, window // 2))) for each in (np.where(known, values, 0.0), known * 1.0)
    )
    sums, counts = sums[window:] - sums[:-window], counts[window:] - counts[:-window]
    return np.where(known, sums / np.maximum(counts, 1), np.nan)


@dataclass(frozen=True, eq=False)
class Stretch:
    """Frames `[start, stop)` in which neighbouring links (rows of the table) misfit."""

    start: int
    stop: int
    rows: tuple[int, ...]

    def meets(self, start: int, stop: int) -> bool:
        return self.start < stop and start < self.stop

    def joints(self, links: Links) -> set[int]:
        """The joints at its links."""
        return set(links.ends[list(self.rows)].ravel().tolist())


def find_stretches(misfits: Array, links: Links, fps: float) -> list[Stretch]:
    """Where links misfit, those of links that share a joint at the same time together."""
    needed, gap = max(3, round(SHORTEST * fps)), max(2, round(BREAK * fps))
    sizes = np.nan_to_num(np.abs(misfits))
    pieces: list[Stretch] = []
    for row, size in enumerate(sizes.T):
        if (size > links.strong[row]).sum() >= needed:
            for start, stop in runs(closed(size > links.weak[row], gap)):
                if (size[start:stop] > links.strong[row]).sum() >= needed:
                    pieces.append(Stretch(start, stop, (row,)))
    together: list[Stretch] = []
    for piece in sorted(pieces, key=lambda piece: piece.start):
        joints = piece.joints(links)
        near = [other for other in together if other.meets(piece.start, piece.stop) and joints & other.joints(links)]
        together = [other for other in together if other not in near]
        every = [piece, *near]
        rows = tuple(sorted({row for one in every for row in one.rows}))
        together.append(Stretch(min(one.start for one in every), max(one.stop for one in every), rows))
    return sorted(together, key=lambda stretch: stretch.start)


def closed(mask: Array, frames: int) -> Array:
    """A `(frames,)` bool mask with its breaks of up to so many frames closed."""
    out = mask.copy()
    for start, stop in runs(~mask):
        if start > 0 and stop < len(mask) and stop - start <= frames:
            out[start:stop] = True
    return out


def _stretches(mask: Array, fps: float) -> int:
    return len(runs(closed(mask, round(0.25 * fps))))
