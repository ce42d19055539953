"""The windows of a memory that are most like a gap's: exact distances to all of them, by correlation.

A window's distance to the gap's is |q|² + |w|² - 2 |<q, w>| - 2 <heights>, and both the norms and the inner products
are sums of something of single frames, some frames apart. So nothing is kept for each length of gap: one matrix product
with the sessions' frames, and a few shifted sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .descriptors import Layout, Term, columns, descriptors, packed, terms
from .sessions import SEEN, UNKNOWN, Session

Array = np.ndarray

NEAREST = 256
BLOCK = 1 << 15  # frames at a time, which stay in the processor's cache
SIZES_KEPT = 8
ALIKE = 0.75  # of what is seen in the gap, the share that a session must have


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The nearest windows, nearest first.

    sessions : those asked, and each one's Layout. session, start, mirrored `(near,)` : where each window is.
    turn `(near,)` : the phase that turns its horizontal vectors to the gap's.
    across `(near, features)` complex, heights `(near, features)` : descriptors, turned.
    own : the gap's descriptor, the same two `(features,)`. distance `(near,)` : metres, weighted.
    """

    sessions: tuple[tuple[Session, Layout], ...]
    session: Array
    start: Array
    mirrored: Array
    turn: Array
    across: Array
    heights: Array
    own: tuple[Array, Array]
    distance: Array

    def __len__(self) -> int:
        return len(self.start)

    def groups(self):
        """The rows of each session, mirrored or not: `(rows, session, layout of these windows, mirrored)`."""
        for number, (session, layout) in enumerate(self.sessions):
            for mirrored in (False, True):
                rows = np.flatnonzero((self.session == number) & (self.mirrored == mirrored))
                if len(rows):
                    yield rows, session, seen_as(layout, session, mirrored), mirrored


def seen_as(layout: Layout, session: Session, mirrored: bool) -> Layout:
    """The layout, or that of its points' twins."""
    return layout.moved(session.twins) if mirrored and session.twins is not None else layout


def nearest(
    window: Array, layout: Layout, names: Sequence[str], sessions: Sequence[Session], without: frozenset[str]
) -> Neighbours | None:
    """The windows most like this one; None if no session has the points that it needs, or no window is whole.

    window : `(layout.length, points, 3)`, NaN where missing. names : of its points.
    without : hashes of takes that are not asked.
    """
    layout, asked = _understood(layout, names, sessions)
    if not asked:
        return None
    parts = terms(layout)
    across, heights = descriptors(columns(window, layout)[None], parts)
    found = []
    for number, (session, its) in enumerate(asked):
        for mirrored in (False, True) if session.twins is not None else (False,):
            own = across.conj() if mirrored else across
            start, distance = _candidates(session, seen_as(its, session, mirrored), parts, own[0], heights[0], without)
            found.append((np.full(len(start), number), start, np.full(len(start), mirrored), distance))
    session, start, mirrored, rough = (np.concatenate(each) for each in zip(*found))
    if not len(start):
        return None
    first = np.lexsort((mirrored, start, session, rough))[: 2 * NEAREST]
    near = Neighbours(
        asked, session[first], start[first], mirrored[first], np.ones(len(first), complex),
        np.empty((len(first), across.shape[1]), complex), np.empty((len(first), across.shape[1])),
        (across[0], heights[0]), rough[first],
    )  # fmt: skip
    return _exact(near, parts)


def gathered(session: Session, name: str, start: Array, length: int) -> Array:
    """Windows `(windows, length, …)` of one of a session's arrays."""
    return getattr(session, name)[start[:, None] + np.arange(length)]


def _understood(
    layout: Layout, names: Sequence[str], sessions: Sequence[Session]
) -> tuple[Layout, tuple[tuple[Session, Layout], ...]]:
    """The layout with those seen points that all sessions have that can be asked, and these with their own indices."""
    needed = {names[point] for point in (*layout.lost, *layout.anchors, layout.anchor) if point >= 0}
    seen = {names[point] for point in layout.seen}
    able = [
        session
        for session in sessions
        if needed <= session.index.keys() and len(seen & session.index.keys()) >= ALIKE * len(seen)
    ]
    shared = seen.intersection(*(session.index.keys() for session in able))
    layout = replace(layout, seen=np.array([point for point in layout.seen if names[point] in shared], int))
    known = [np.array([session.index.get(name, -1) for name in names]) for session in able]
    return layout, tuple((session, layout.moved(index)) for session, index in zip(able, known))


def _candidates(
    session: Session, layout: Layout, parts: list[Term], own: Array, heights: Array, without: frozenset[str]
) -> tuple[Array, Array]:
    """First frames and squared distances of twice as many windows as are wanted, those that come nearest."""
    whole = _whole(session, layout, without)
    starts, count = np.flatnonzero(whole), len(whole)
    if not len(starts):
        return starts, np.zeros(0)
    places = sorted({frame for term in parts for frame in term.frames})
    kernel = _kernel(parts, places, own, heights, layout) @ _selection(session, layout).T
    products = np.empty((len(kernel), len(session)), np.float32)
    flat = session.positions.reshape(len(session), -1)
    for first in range(0, len(session), BLOCK):
        np.matmul(kernel, flat[first : first + BLOCK].T, out=products[:, first : first + BLOCK])
    inner = np.zeros((3, count), np.float32)
    for place, frame in enumerate(places):
        inner += products[3 * place : 3 * place + 3, frame : frame + count]
    size = float(np.sum(np.abs(own) ** 2) + np.sum(heights**2))
    distance = _norms(parts, _sizes(session, layout, parts), count) + size - 2 * np.hypot(*inner[:2]) - 2 * inner[2]
    distance = distance[starts]
    most = min(2 * NEAREST, len(starts))
    picked = np.argpartition(distance, most - 1)[:most]
    return starts[picked], distance[picked]


def _selection(session: Session, layout: Layout) -> Array:
    """`(3 points, 3 columns)` float32: what makes `columns` of a frame's points, as a matrix."""
    points = len(session.skeleton)
    return columns(np.eye(3 * points, dtype=np.float32).reshape(-1, points, 3), layout).reshape(3 * points, -1)


def _whole(session: Session, layout: Layout, without: frozenset[str]) -> Array:
    """`(starts,)` bool: windows inside one take, that see all that is lost, and know what is compared besides."""
    count = max(len(session) - layout.length + 1, 0)
    owner = session.owner
    whole = owner[:count] == owner[layout.length - 1 :][:count]
    whole &= ~np.array([take.sha256 in without for take in session.takes], bool)[owner[:count]]
    holes = np.cumsum(np.pad((session.trust[:, layout.lost] < SEEN).any(axis=1), (1, 0)))
    whole &= holes[layout.length :] == holes[:count]
    if layout.anchor >= 0:
        through = np.union1d(layout.anchors, layout.anchor)
        holes = np.cumsum(np.pad((session.trust[:, through] == UNKNOWN).any(axis=1), (1, 0)))
        whole &= holes[layout.length :] == holes[:count]
        known = np.asarray((session.trust[:, layout.seen] > UNKNOWN).all(axis=1))
        for frame in (*layout.ends, *layout.passing):
            whole &= known[frame : frame + count]
    return whole


def _kernel(parts: list[Term], places: list[int], own: Array, heights: Array, layout: Layout) -> Array:
    """What the frames' columns are multiplied with for the inner product with the gap's descriptor.

    `(3 places, 3 columns)` float32: for each place the real part, the imaginary one, and that of heights.
    """
    width = len(layout.lost) + (len(layout.seen) if layout.anchor >= 0 else 0)
    kernel = np.zeros((len(places), 3, width, 3))
    done = 0
    for term in parts:
        size = term.columns.stop - term.columns.start
        a, b, c = (each[done : done + size] for each in (np.real(own), np.imag(own), heights))
        done += size
        for frame, factor in zip(term.frames, term.factors):
            here, by = kernel[places.index(frame), :, term.columns], term.weight * factor
            here[0, :, 0] += by * b  # x, y, z
            here[0, :, 2] += by * a
            here[1, :, 0] += by * a
            here[1, :, 2] -= by * b
            here[2, :, 1] += by * c
    return kernel.reshape(3 * len(places), -1).astype(np.float32)


Kind = tuple[int, int, str]  # first column, the one after the last, and what is made of them


def _sizes(session: Session, layout: Layout, parts: list[Term]) -> dict[Kind, Array]:
    """What of single frames `(frames,)` the norms are made of: sums of squares, of squared steps, and of places.

    Kept with the session for the gaps to come, which often lost the same points.
    """
    key = tuple(sorted(layout.lost))
    if layout.anchor >= 0:
        key = tuple(layout.lost), tuple(layout.anchors), tuple(layout.seen), layout.anchor
    if key in session.sizes:
        return session.sizes[key]
    select, flat = _selection(session, layout), session.positions.reshape(len(session), -1)
    slices = sorted({(term.columns.start, term.columns.stop) for term in parts})
    moving = sorted({(term.columns.start, term.columns.stop) for term in parts if len(term.frames) > 1})
    free = sorted({(term.columns.start, term.columns.stop) for term in parts if term.free})

    def within(some: list[tuple[int, int]], axes: Sequence[int] = (0, 1, 2)) -> Array:
        found = np.zeros((len(some), select.shape[1] // 3, 3), np.float32)
        for row, (first, stop) in enumerate(some):
            found[row, first:stop, list(axes)] = 1
        return found.reshape(len(some), -1).T

    squares, steps, along, across = (
        np.zeros((len(session), len(some)), np.float32) for some in (slices, moving, free, free)
    )
    for first in range(0, len(session), BLOCK):
        block = flat[first : first + BLOCK + 1] @ select
        here = slice(first, min(first + BLOCK, len(session)))
        count = here.stop - first
        along[here], across[here] = (block[:count] @ within(free, [axis]) for axis in (2, 0))
        if moving:
            apart = np.diff(block, axis=0)
            steps[first : first + len(apart)] = np.square(apart, out=apart) @ within(moving)
        squares[here] = np.square(block[:count], out=block[:count]) @ within(slices)
    sizes = {(*each, "squares"): squares[:, row] for row, each in enumerate(slices)}
    sizes |= {(*each, "steps"): steps[:, row] for row, each in enumerate(moving)}
    sizes |= {(*each, "sum"): along[:, row] + 1j * across[:, row] for row, each in enumerate(free)}
    while len(session.sizes) >= SIZES_KEPT:
        del session.sizes[next(iter(session.sizes))]
    session.sizes[key] = sizes
    return sizes


def _norms(parts: list[Term], sizes: dict[Kind, Array], count: int) -> Array:
    """`(count,)` the windows' squared norms."""
    norms, moment, weights = np.zeros(count), np.zeros(count, complex), 0.0
    for term in parts:
        here, square = slice(term.frames[0], term.frames[0] + count), term.weight**2
        if len(term.frames) > 1:
            norms += square * sizes[term.kind("steps")][here]
            continue
        norms += square * sizes[term.kind("squares")][here]
        if term.free:
            moment += square * sizes[term.kind("sum")][here]
            weights += square * (term.columns.stop - term.columns.start)
    return norms - np.abs(moment) ** 2 / weights if weights else norms


def _exact(near: Neighbours, parts: list[Term]) -> Neighbours:
    """The same in double precision, turned, the nearest NEAREST of them in order."""
    own, heights = near.own
    frames, parts = packed(parts)
    across, level, turn = near.across, near.heights, near.turn
    for rows, session, layout, mirrored in near.groups():
        windows = session.positions[near.start[rows, None] + frames]
        flat, level[rows] = descriptors(columns(windows, layout), parts)
        flat = flat.conj() if mirrored else flat
        inner = flat @ own.conj()
        turn[rows] = np.exp(-1j * np.angle(inner))
        across[rows] = flat * turn[rows, None]
    distance = np.sqrt(np.sum(np.abs(across - own) ** 2, axis=1) + np.sum((level - heights) ** 2, axis=1))
    order = np.lexsort((near.mirrored, near.start, near.session, distance))[:NEAREST]
    columns_of = ("session", "start", "mirrored", "turn", "across", "heights")
    picked = {name: getattr(near, name)[order] for name in columns_of}
    return replace(near, **picked, distance=distance[order])
