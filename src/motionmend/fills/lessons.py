"""What a take teaches about where a lost marker is among those that are still seen, and frames to see it from.

The fills `local`, `regression`, `pca` and `average` begin here. None of their numbers is a length: a cloud that is
scaled, turned or moved is filled by the scaled, turned or moved answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..motion import Motion
from .donors import Chart, pose

Array = np.ndarray

LEAST = 3  # donors that give a place and an orientation
MOST_FRAMES = 400  # that teach, of the take, and as many of others
LOOSE_SHARE = 0.05  # of its mean distance is as bad, in a donor, as a standard deviation of that much
KEPT_SHARE = 0.8  # of the frames that teach must remain when another donor is taken
SEEN_SHARE = 0.5  # of the frames in which the marker is seen must show a donor
FLAT_SHARE = 0.05  # donors whose breadth is less than this share of their length have no orientation


@dataclass(frozen=True, eq=False)
class Lesson:
    """One marker, its gap, and its donors, which are seen throughout the gap.

    start, stop, fps : of the gap `[start, stop)`, and of its take.
    donors `(donors,)` : those that keep their distance to the marker best come first.
    known `(frames, donors, 3)`, own `(frames, 3)` : donors and marker in the frames that teach, float64.
    near `(samples,)` : frames beside the gap in which marker and donors are seen; beside `(samples, 3)` : it, there.
    asked `(samples + gap frames, donors, 3)` : the donors in the near frames, and then in the gap.
    apart, loose `(donors,)` : the mean distance to the marker, and how badly it is kept.
    """

    start: int
    stop: int
    fps: float
    donors: tuple[int, ...]
    known: Array
    own: Array
    near: Array
    beside: Array
    asked: Array
    apart: Array
    loose: Array

    def only(self, chosen: Iterable[int]) -> Lesson:
        """The lesson of some of its donors, by their places among them; those that there are."""
        rows = [row for row in chosen if row < len(self.donors)]
        donors = tuple(self.donors[row] for row in rows)
        cut = {name: getattr(self, name)[rows] for name in ("apart", "loose")}
        return replace(self, donors=donors, known=self.known[:, rows], asked=self.asked[:, rows], **cut)

    def chart(self, answer: Array, turn: Array | None = None) -> Chart:
        """Coordinates about an answer `(samples + gap frames, 3)`: what it misses beside the gap is ramped through it.

        turn `(samples + gap frames, 3, 3)` : the orientation of what the marker rides on, with which the miss turns.
        """
        turn = np.broadcast_to(np.eye(3), (len(answer), 3, 3)) if turn is None else turn
        beside = len(self.near)
        missed = np.einsum("fji,fj->fi", turn[:beside], self.beside - answer[:beside])
        inside, turned = answer[beside:], turn[beside:]
        return Chart(self.donors, self.near, missed, lambda miss: inside + np.einsum("fij,fj->fi", turned, miss))


def lesson(
    motion: Motion,
    joint: int,
    start: int,
    stop: int,
    frames: Array,
    candidates: Array,
    most: int,
    teaching: Array | None = None,
) -> Lesson | None:
    """The lesson for a gap `[start, stop)` of a joint, from at most `most` donors. None if there are fewer than LEAST.

    frames : `(samples,)` where the joint is observed, near the gap. candidates : `(joints,)` bool, who may lend.
    teaching : `(frames, joints, 3)`, other takes' frames of the same joints in the same order, NaN where unseen.

    Frames near the gap teach, and others of the take, the thinner the longer it is.
    """
    lenders = np.flatnonzero(candidates & (np.arange(len(candidates)) != joint))
    if len(lenders) < LEAST:
        return None
    seen = np.flatnonzero(motion.observed[:, joint])
    seen = seen[_thinned(np.where(seen < start, start - seen, seen - stop + 1))]
    there = motion.observed[seen][:, lenders]
    known, own = motion.positions[seen][:, lenders].astype(np.float64), motion.positions[seen, joint].astype(np.float64)
    if teaching is not None:
        told = np.flatnonzero(np.isfinite(teaching[:, joint]).all(axis=-1))
        told = told[:: max(1, -(-len(told) // MOST_FRAMES))]
        others = teaching[told][:, lenders].astype(np.float64)
        known, own = np.concatenate([known, others]), np.concatenate([own, teaching[told, joint]])
        there = np.concatenate([there, np.isfinite(others).all(axis=-1)])
    often = np.flatnonzero(there.sum(axis=0) >= max(1, SEEN_SHARE * len(there)))
    distances = np.linalg.norm(np.where(there[..., None], known, 0) - own[:, None], axis=-1)
    apart, spread = _moments(distances, there)
    # A donor at the marker's very place is steady without end, and still not all that there is to know.
    loose = np.maximum(np.hypot(spread, LOOSE_SHARE * apart), LOOSE_SHARE**2 * apart[often].mean() if len(often) else 0)
    chosen, rows = [], np.ones(len(own), bool)
    for lender in often[np.argsort(loose[often], kind="stable")][: 2 * most]:
        left = rows & there[:, lender]
        enough = KEPT_SHARE * rows.sum() if len(chosen) >= LEAST else 1
        if left.sum() >= enough and len(chosen) < most:
            chosen.append(lender)
            rows = left
    donors = lenders[chosen]
    near = frames[motion.observed[frames][:, donors].all(axis=1)]
    if len(chosen) < LEAST or not len(near) or not rows.any():
        return None
    asked = np.concatenate([near, np.arange(start, stop)])
    # A donor may be unseen in frames of the gap that are not asked for in the end: those must not be read.
    asked = np.where(motion.observed[asked][:, donors, None], motion.positions[asked][:, donors], 0).astype(np.float64)
    beside = motion.positions[near, joint].astype(np.float64)
    return Lesson(
        start, stop, motion.fps, tuple(donors.tolist()), known[rows][:, chosen], own[rows], near, beside, asked,
        apart[chosen], loose[chosen],
    )  # fmt: skip


def _thinned(away: Array) -> Array:
    """`(frames,)` bool: about MOST_FRAMES of the frames, by how far `away` from a gap they are, before it or after."""
    if len(away) <= MOST_FRAMES:
        return np.ones(len(away), bool)
    near = np.sort(away)[MOST_FRAMES // 2]
    return (away <= near) | ((away - near) % -(-2 * len(away) // MOST_FRAMES) == 0)


def _moments(values: Array, there: Array) -> tuple[Array, Array]:
    """Mean and standard deviation over frames of `(frames, joints)` where `there`; 0 where there is none."""
    count = np.maximum(there.sum(axis=0), 1)
    mean = np.where(there, values, 0).sum(axis=0) / count
    return mean, np.sqrt(np.sum(np.where(there, values - mean, 0) ** 2, axis=0) / count)


@dataclass(frozen=True, eq=False)
class View:
    """A lesson as seen from its donors' body: about their weighted middle, turned as they are turned.

    known `(frames, donors, 3)`, own `(frames, 3)`, asked `(samples + gap frames, donors, 3)` : from there.
    weights `(donors,)` : sum to 1; the steadier, the more. outward : `(samples + gap frames, 3)` seen from there ->
    positions. turn `(samples + gap frames, 3, 3)` : how the body stands.
    """

    known: Array
    own: Array
    asked: Array
    weights: Array
    outward: Callable[[Array], Array]
    turn: Array


def view(one: Lesson) -> View | None:
    """Each frame's donors laid on their mean shape by weighted least squares (Kabsch 1976).

    The shape is that of the mean squared distances (classical scaling, Torgerson 1952), so that it depends on
    no order of frames. None if the donors lie so near to one line that their orientation would be noise.
    """
    weights = one.loose.min() ** 2 / np.maximum(one.loose, 1e-300) ** 2
    weights = weights / weights.sum()
    root = np.sqrt(weights)
    squares = np.sum(one.known**2, axis=-1)
    products = np.einsum("fpi,fqi->pq", one.known, one.known) / len(one.known)
    squared = squares.mean(axis=0)[:, None] + squares.mean(axis=0) - 2 * products
    centring = np.eye(len(weights)) - weights
    values, vectors = np.linalg.eigh(-0.5 * root[:, None] * (centring @ squared @ centring.T) * root)
    breadths = np.sqrt(np.maximum(values[:-4:-1], 0))
    if not breadths[1] > FLAT_SHARE * breadths[0]:
        return None
    shape = vectors[:, :-4:-1] * breadths / root[:, None]
    # Distances do not tell a shape from its mirror image: the frames do.
    about = one.known - (weights @ one.known)[:, None]
    if np.linalg.det(np.swapaxes(about, 1, 2) @ (weights[:, None] * shape)).sum() < 0:
        shape = shape * [1, 1, -1]
    known, turn, centre = _laid(shape, one.known, weights)
    own = np.einsum("fji,fj->fi", turn, one.own - centre)
    asked, turn, centre = _laid(shape, one.asked, weights)
    outward = lambda inside: np.einsum("fij,fj->fi", turn, inside) + centre  # noqa: E731
    return View(known, own, asked, weights, outward, turn)


def _laid(shape: Array, points: Array, weights: Array) -> tuple[Array, Array, Array]:
    """`points (frames, donors, 3)` turned and moved onto `shape`, and the turns and centres that were taken off."""
    turn, centre = pose(shape, points, weights)
    return np.einsum("fji,fpj->fpi", turn, points - centre[:, None]), turn, centre
