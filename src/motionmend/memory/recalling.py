"""A gap answered from memory: its base, plus the weighted sum of what its neighbours' truth was beyond theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..motion import Motion, Skeleton
from . import bases, neighbours, regression
from .descriptors import CONTEXT, Layout, plane, space
from .neighbours import Neighbours, gathered
from .sessions import RATE, Session, parts, thinned

Array = np.ndarray

APART = 5  # frames at RATE between the beginnings of windows, from which on they are told apart
DOUBTFUL = 0.05  # an answer believed less is none
LEAST = 16  # windows, of which fewer say nothing
LONGEST, LONGEST_END = 8.0, 2.0  # seconds of a gap, and of one at a take's end
SHORTEST = 3  # frames at RATE from seam to seam
TOO_SHORT = "too short, or too little seen beside it, to be recalled"
TOO_LONG = "too long to be recalled"
TOO_FEW = "memory has too few stretches like it"
UNLIKE = "the stretches like it do not agree on how it goes"


@dataclass(frozen=True, eq=False)
class Answer:
    """What memory says of one gap.

    layout : of the gap at RATE. near : the windows asked, weights `(near,)` : theirs.
    taught `(near, missing, lost, 3)` : the neighbours' truth less their base, turned to the gap.
    step : frames of the take in one at RATE.
    """

    layout: Layout
    near: Neighbours
    weights: Array
    taught: Array
    step: float

    def sources(self) -> list[tuple[str, float]]:
        """The takes that taught, and the share of each, the greatest first."""
        shares: dict[str, float] = {}
        for session, start, weight in zip(self.near.session, self.near.start, np.abs(self.weights)):
            of = self.near.sessions[session][0]
            name = of.takes[of.owner[start]].name
            shares[name] = shares.get(name, 0.0) + float(weight)
        whole = sum(shares.values())
        return sorted(((name, share / whole) for name, share in shares.items()), key=lambda each: (-each[1], each[0]))

    @property
    def beyond(self) -> Array:
        """`(missing, lost, 3)` at RATE, what is to be added to the gap's base."""
        return np.tensordot(self.weights, self.taught, 1)

    def at_frames(self, values: Array, frames: int) -> Array:
        """`(missing, …)` at RATE -> `(frames, …)` of the take: a spline that is nothing, and at rest, at each seam."""
        from scipy.interpolate import CubicSpline

        layout, nothing = self.layout, np.zeros((1, *values.shape[1:]))
        rest, free = (1, nothing[0]), (2, nothing[0])
        if layout.before < 0:
            knots, ends, times = np.concatenate([values, nothing]), (free, rest), np.arange(-frames, 0) / self.step
            clock = np.arange(-len(values), 1)
        elif layout.after < 0:
            knots, ends, times = np.concatenate([nothing, values]), (rest, free), np.arange(1, frames + 1) / self.step
            clock = np.arange(len(values) + 1)
        else:
            knots, ends = np.concatenate([nothing, values, nothing]), (rest, rest)
            clock, times = np.arange(len(values) + 2), np.arange(1, frames + 1) / self.step
        return CubicSpline(clock, knots, bc_type=ends)(times)  # pyright: ignore[reportArgumentType]


def turned(vectors: Array, turn: Array, mirrored: bool) -> Array:
    """Vectors `(near, …, 3)`, each neighbour's turned about the vertical."""
    across = plane(vectors)
    across = across.conj() if mirrored else across
    return space(across * turn.reshape(-1, *[1] * (across.ndim - 1)), vectors[..., 1])


def ask(
    motion: Motion, lost: Array, start: int, stop: int, sessions: Sequence[Session], without: frozenset[str],
    base: bases.Base = bases.eased,
) -> Answer | str:  # fmt: skip
    """What these sessions say of points lost in frames `[start, stop)`, or why they say nothing.

    without : hashes of takes that are not to teach. base : what is taught is the difference to it.
    """
    longest = LONGEST if start and stop < len(motion) else LONGEST_END
    if stop - start > longest * motion.fps:
        return TOO_LONG
    posed = _posed(motion, lost, start, stop)
    if posed is None:
        return TOO_SHORT
    layout, window, step = posed
    near = neighbours.nearest(window, layout, motion.skeleton.names, sessions, without)
    if near is None or len(near) < LEAST:
        return TOO_FEW
    taught = _taught(near, base)
    weights, fitted = regression.weights(near.across, near.heights, near.own, near.distance)
    belief = regression.believed(fitted, taught.reshape(len(near), -1), _stretches(near))
    if belief < DOUBTFUL:
        return UNLIKE
    weights *= belief
    return Answer(layout, near, weights, taught, step)


def _taught(near: Neighbours, base: bases.Base) -> Array:
    """`(near, missing, lost, 3)` the neighbours' truth less their base, turned to the gap."""
    taught = []
    places = []
    for rows, session, layout, mirrored in near.groups():
        windows = gathered(session, "positions", near.start[rows], layout.length).astype(float)
        more = windows[:, layout.missing][:, :, layout.lost] - base(windows, layout, RATE)
        taught.append(turned(more, near.turn[rows], mirrored))
        places.append(rows)
    return np.concatenate(taught)[np.argsort(np.concatenate(places))]


def _stretches(near: Neighbours) -> Array:
    """`(near,)` which stretch each window belongs to: those of a take that begin within a few frames of each other."""
    order = np.lexsort((near.start, near.mirrored, near.session))
    first = np.ones(len(order), bool)
    same = (np.diff(near.session[order]) == 0) & (near.mirrored[order][1:] == near.mirrored[order][:-1])
    first[1:] = ~same | (np.diff(near.start[order]) > APART)
    stretches = np.empty(len(order), int)
    stretches[order] = np.cumsum(first)
    return stretches


def _posed(motion: Motion, lost: Array, start: int, stop: int) -> tuple[Layout, Array, float] | None:
    """The gap's layout and window `(frames, points, 3)` at RATE, and how many frames of the take one of them is.

    From seam to seam are whole steps, so that these are a little more or less than 1/RATE.
    """
    frames, count = len(motion), stop - start
    open_ended = start == 0 or stop == frames
    steps = round((count + 1) * RATE / motion.fps) if not open_ended else int(np.ceil(count * RATE / motion.fps))
    if steps < SHORTEST or (start == 0 and stop == frames):
        return None
    step = (count + 1) / steps if not open_ended else motion.fps / RATE
    seam = start - 1 if start else stop
    clock = np.arange(-CONTEXT, steps + CONTEXT + 1) if start else np.arange(-steps - CONTEXT, CONTEXT + 1)
    times = seam + step * clock
    inside = (times > -1e-3) & (times < frames - 1 + 1e-3)
    positions = np.full((len(clock), len(motion.skeleton), 3), np.nan)
    seen = np.zeros(positions.shape[:2], bool)
    first = max(int(times[inside][0]) - 3, 0)
    some = slice(first, int(times[inside][-1]) + 4)
    at, beyond = parts(np.clip(times[inside], 0, frames - 1) - first)
    positions[inside], seen[inside] = thinned(motion.positions[some], motion.observed[some], at, beyond)
    gap = (clock < 0) & (clock >= -steps) if not start else (clock > 0) & (clock < steps + (stop == frames))
    whole = np.asarray(seen[:, lost].all(axis=1))
    before, after = known(whole[: np.argmax(gap)][::-1]), known(whole[len(gap) - np.argmax(gap[::-1]) :])
    if max(before, after) < 0 or whole[gap].any():
        return None
    kept = slice(np.argmax(gap) - before - 1, len(gap) - np.argmax(gap[::-1]) + after + 1)
    positions, seen = positions[kept], seen[kept]
    layout = Layout(lost, lost, np.zeros(0, int), -1, before, after, steps)
    through = motion.observed[max(start - 1, 0) : stop + 1].all(axis=0)
    others = np.flatnonzero(seen[np.r_[layout.ends, layout.passing]].all(axis=0) & through)
    return _seen_from(layout, others, seen, positions, motion.skeleton), positions, step


def known(seen: Array) -> int:
    """How many frames beside a seam are seen, from the seam on and without it; -1 if not even the seam is."""
    return (len(seen) if seen.all() else int(np.argmin(seen))) - 1


def _seen_from(layout: Layout, others: Array, seen: Array, positions: Array, skeleton: Skeleton) -> Layout:
    """The layout with what is seen through the gap, and the point that each lost one is seen from.

    The nearest above it in the skeleton; where there is none, that from which it varies least beside the gap.
    """
    steady = others[seen[:, others].all(axis=0)]
    if not len(steady):
        return layout
    known = np.setdiff1d(np.arange(layout.length), layout.missing)
    anchors = []
    for point in layout.lost.tolist():
        above = skeleton.parents[point]
        while above >= 0 and above not in steady:
            above = skeleton.parents[above]
        if above < 0:
            apart = positions[known][:, steady] - positions[known][:, [point]]
            above = int(steady[np.argmin(np.var(apart, axis=0).sum(axis=-1))])
        anchors.append(above)
    each, often = np.unique(anchors, return_counts=True)
    anchor = int(each[np.argmax(often)])
    return Layout(layout.lost, np.array(anchors), others, anchor, layout.before, layout.after, layout.steps)
