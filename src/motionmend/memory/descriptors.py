"""What of a window is compared: poses at a few frames, seam velocities, and what is seen through the gap.

A window is a gap at `sessions.RATE` with up to CONTEXT frames beside each of its seams. Its places are compared after
the turn about the vertical, and the shift along the floor, that bring two windows nearest to each other (Kabsch 1976):
with the horizontal plane as complex numbers z + ix that is the phase of one inner product. Heights are compared as they
are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray

CONTEXT = 7  # frames beside a seam
AHEAD = 12  # frames: a seam's velocity counts as the way it would go in so long
THROUGH = 7  # frames compared inside the gap, of what is seen there
# How much counts what is lost, where something else is seen; what is seen, at the ends and in the gap; and the path of
# the anchor.
LOST, RESTING, PASSING, PATH = 3.0, 0.6, 0.8, 0.6


@dataclass(frozen=True, eq=False)
class Layout:
    """One kind of gap: what is lost in it, what is seen, and how many frames are known beside it.

    lost, anchors : `(lost,)` indices of points, and of the one that each is seen from.
    seen : `(seen,)` those that are observed from end to end. anchor : of them, the one the others are seen from; -1
        where nothing else is seen, and the lost are seen from the world.
    before, after : frames known beside the seams, the seam's own not counted; -1 on the far side of a take's end.
    steps : from seam to seam, in frames at `sessions.RATE`; at a take's end, to its last frame.
    """

    lost: Array
    anchors: Array
    seen: Array
    anchor: int
    before: int
    after: int
    steps: int

    @property
    def first(self) -> int:
        """The first missing frame of a window."""
        return self.before + 1

    @property
    def missing(self) -> Array:
        """The missing frames of a window."""
        return self.first + np.arange(self.steps - 1 if self.after >= 0 and self.before >= 0 else self.steps)

    @property
    def length(self) -> int:
        return self.before + 1 + len(self.missing) + self.after + 1

    @property
    def ends(self) -> Array:
        """The frames whose poses are compared: the seams, and two more on each side."""
        left, right = (np.round(np.linspace(0, max(some, 0), 3)).astype(int) for some in (self.before, self.after))
        ends = [self.before - left] * (self.before >= 0) + [self.missing[-1] + 1 + right] * (self.after >= 0)
        return np.unique(np.concatenate(ends))

    @property
    def seams(self) -> list[tuple[int, int]]:
        """For each seam whose velocity is known, two neighbouring frames, in order of time."""
        left = [(self.before - 1, self.before)] * (self.before > 0)
        stop = int(self.missing[-1]) + 1
        return left + [(stop, stop + 1)] * (self.after > 0)

    @property
    def passing(self) -> Array:
        """The frames inside the gap at which what is seen is compared."""
        away = np.linspace(0, (len(self.missing) - 1) / 2, (THROUGH + 1) // 2).astype(int)  # from both seams alike
        return np.union1d(self.missing[0] + away, self.missing[-1] - away)

    def moved(self, index: Array) -> Layout:
        """The same gap of other points: `index (points,)` says which stands for each."""
        if self.anchor < 0:
            return replace(self, lost=index[self.lost])
        points = {name: index[getattr(self, name)] for name in ("lost", "anchors", "seen")}
        return replace(self, **points, anchor=int(index[self.anchor]))


@dataclass(frozen=True, eq=False)
class Term:
    """A part of the descriptor: `weight` times the sum of some frames of a window, each by a factor, in some columns.

    free : whether it moves along the floor with the window.
    """

    frames: tuple[int, ...]
    factors: tuple[float, ...]
    columns: slice
    weight: float
    free: bool

    def kind(self, what: str) -> tuple[int, int, str]:
        """A name for what is made of these columns."""
        return self.columns.start, self.columns.stop, what


def terms(layout: Layout) -> list[Term]:
    """The parts of a descriptor, over the columns that `columns` makes."""
    lost = slice(0, len(layout.lost))
    if layout.anchor < 0:
        found = [Term((frame,), (1.0,), lost, 1.0, True) for frame in layout.ends]
        return found + [Term(pair, (-1.0, 1.0), lost, float(AHEAD), False) for pair in layout.seams]
    rest = slice(lost.stop, lost.stop + len(layout.seen) - 1)
    path = slice(rest.stop, rest.stop + 1)
    found = [Term((frame,), (1.0,), lost, LOST, False) for frame in layout.ends]
    found += [Term(pair, (-1.0, 1.0), lost, AHEAD * LOST, False) for pair in layout.seams]
    found += [Term((frame,), (1.0,), rest, RESTING, False) for frame in layout.ends]
    found += [Term((frame,), (1.0,), rest, PASSING, False) for frame in layout.passing]
    return found + [Term((f,), (1.0,), path, PATH, True) for f in (*layout.ends, *layout.passing)]


def packed(parts: list[Term]) -> tuple[Array, list[Term]]:
    """The frames of a window that are compared at all, and the same terms over these."""
    frames = sorted({frame for term in parts for frame in term.frames})
    place = {frame: number for number, frame in enumerate(frames)}
    return np.array(frames), [replace(term, frames=tuple(place[frame] for frame in term.frames)) for term in parts]


def columns(positions: Array, layout: Layout) -> Array:
    """What is compared of each frame: `(…, points, 3)` -> `(…, columns, 3)`.

    The lost as seen from their anchors, the seen from theirs, and the anchor itself.
    """
    lost = positions[..., layout.lost, :]
    if layout.anchor < 0:
        return lost
    lost -= positions[..., layout.anchors, :]
    path = positions[..., [layout.anchor], :]
    rest = positions[..., layout.seen[layout.seen != layout.anchor], :] - path
    return np.concatenate([lost, rest, path], axis=-2)


def plane(vectors: Array) -> Array:
    """The horizontal part of `(…, 3)` as complex numbers: a turn by an angle about y is a product with its phase."""
    return vectors[..., 2] + 1j * vectors[..., 0]


def space(horizontal: Array, heights: Array) -> Array:
    """Vectors `(…, 3)` from their horizontal part and their heights."""
    return np.stack([np.imag(horizontal), heights, np.real(horizontal)], axis=-1)


def descriptors(compared: Array, parts: list[Term]) -> tuple[Array, Array]:
    """Of windows of `columns (windows, frames, columns, 3)`: horizontal `(windows, features)` complex, and heights."""
    compared = compared.astype(float)
    across, heights, weights, free = [], [], [], []
    for term in parts:
        picked = np.tensordot(term.factors, compared[:, list(term.frames), term.columns], (0, 1))
        across.append(term.weight * plane(picked))
        heights.append(term.weight * picked[..., 1])
        weights += [term.weight] * picked.shape[1]
        free += [term.free] * picked.shape[1]
    flat = np.concatenate(across, axis=1)
    weight = np.array(weights) * np.array(free)
    if weight.any():
        flat -= weight * (flat @ weight / (weight @ weight))[:, None]
    return flat, np.concatenate(heights, axis=1)
