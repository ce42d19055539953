"""Joints that lend their motion to one that is missing: the charts in which a gap is nearly straight.

A chart moves with joints that are observed throughout the gap. In it the missing joint hardly moves, so a
short curve across the gap says little wrong, and the donors bring the rest. These are the "pattern fill" and
"rigid body fill" of Vicon Nexus and other marker tools.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..motion import Motion
from .curves import CURVES

Array = np.ndarray

JUDGE_SECONDS = 0.25  # how far from the gap the candidates are judged, on each side
STEADIER = 0.5  # a pattern donor's difference must vary at most this much as the joint itself
RIGID_METRES = 0.01  # standard deviation of the distances within one rigid body
RIGID_DONORS = 6  # at most
FLAT_METRES = 0.005  # donors nearer than this to one line have no orientation
FLAT_SHARE = 0.08  # and neither have those nearer to it than this share of their distance from the joint


@dataclass(frozen=True, eq=False)
class Chart:
    """Moving coordinates for one gap.

    donors : the joints it moves with.
    frames `(samples,)` : where the missing joint and the donors are observed.
    samples `(samples, 3)` : the missing joint there, in these coordinates.
    outward : `(gap frames, 3)` in these coordinates -> positions.
    """

    donors: tuple[int, ...]
    frames: Array
    samples: Array
    outward: Callable[[Array], Array]

    def path(self, start: int, stop: int, fps: float, curve: str) -> Array:
        """Positions `(gap frames, 3)` in `[start, stop)`: the curve of this name through the samples, taken outward."""
        weights = CURVES[curve].across(stop - start, self.frames - (start - 1), fps)
        return self.outward(weights @ self.samples)


def near(observed: Array, start: int, stop: int, reach: int) -> Array:
    """The frames at most `reach` from a gap `[start, stop)` in which `observed (frames,)` is True."""
    around = np.r_[max(start - reach, 0) : start, stop : min(stop + reach, len(observed))]
    return around[observed[around]]


def pattern_chart(
    motion: Motion, joint: int, start: int, stop: int, frames: Array, candidates: Array
) -> Chart | None:
    """The difference to the one candidate to which it is the steadiest around the gap.

    frames : `(samples,)` where the joint is observed, near the gap. candidates : `(joints,)` bool,
    observed from seam to seam. None if no candidate halves the joint's own variation.
    """
    judged = near(motion.observed[:, joint], start, stop, max(2, round(JUDGE_SECONDS * motion.fps)))
    own = motion.positions[judged, joint].astype(np.float64)
    chosen, best = -1, STEADIER * _spread(own)
    for candidate in np.flatnonzero(candidates):
        both = motion.observed[judged, candidate]
        spread = _spread(own[both] - motion.positions[judged[both], candidate])
        if both.sum() > len(judged) / 2 and spread < best:
            chosen, best = int(candidate), spread
    if chosen < 0:
        return None
    donor, frames = motion.positions[:, chosen], frames[motion.observed[frames, chosen]]
    samples = motion.positions[frames, joint].astype(np.float64) - donor[frames]
    return Chart((chosen,), frames, samples, lambda inside: inside + donor[start:stop])


def bone_chart(motion: Motion, joint: int, start: int, stop: int, frames: Array, candidates: Array) -> Chart | None:
    """The difference to the nearest joint above it in the skeleton that is observed from seam to seam.

    As `pattern_chart`, which asks whose difference is the steadiest. None if there is no such joint.
    """
    parents = motion.skeleton.parents
    above = parents[joint]
    while above >= 0 and not candidates[above]:
        above = parents[above]
    frames = frames[motion.observed[frames, above]]
    if above < 0 or not len(frames):
        return None
    donor = motion.positions[:, above]
    samples = motion.positions[frames, joint].astype(np.float64) - donor[frames]
    return Chart((above,), frames, samples, lambda inside: inside + donor[start:stop])


def _spread(vectors: Array) -> float:
    """Root mean square distance of `(samples, 3)` from their mean."""
    return float(np.sqrt(np.sum(np.var(vectors, axis=0)))) if len(vectors) else np.inf


def rigid_chart(
    motion: Motion, joint: int, start: int, stop: int, frames: Array, candidates: Array
) -> Chart | None:
    """Coordinates in the body frame of three or more candidates that keep their distances.

    Candidates whose distance to the joint is steady around the gap are taken, the steadiest first, as long as
    they also keep their distances to each other, through the gap as well. Each frame's orientation is the
    least-squares one (Kabsch 1976) against the shape at the seams. None if fewer than three qualify or
    they lie so near to one line that the turn about it, and with it the joint, would be noise.
    """
    positions, reach = motion.positions, max(2, round(JUDGE_SECONDS * motion.fps))
    judged = near(motion.observed[:, joint], start, stop, reach)

    ranked = []
    for candidate in np.flatnonzero(candidates):
        both = judged[motion.observed[judged, candidate]]
        apart = np.linalg.norm(positions[both, joint].astype(np.float64) - positions[both, candidate], axis=-1)
        if len(both) > len(judged) / 2 and (spread := np.std(apart)) < RIGID_METRES:
            ranked.append((spread, int(candidate)))
    through = np.arange(max(start - 1, 0), min(stop + 1, len(motion)))
    chosen: list[int] = []
    for _, candidate in sorted(ranked):
        apart = positions[through, candidate, None].astype(np.float64) - positions[through][:, chosen]
        if np.all(np.std(np.linalg.norm(apart, axis=-1), axis=0) < RIGID_METRES):
            chosen.append(candidate)
        if len(chosen) == RIGID_DONORS:
            break
    if len(chosen) < 3:
        return None

    seams = frames[(frames == start - 1) | (frames == stop)]
    shape = _shape(positions[seams][:, chosen].astype(np.float64))
    breadth = np.linalg.svd(shape, compute_uv=False)[1] / np.sqrt(len(chosen))
    centres = positions[seams][:, chosen].astype(np.float64).mean(axis=1)
    lever = np.linalg.norm(positions[seams, joint] - centres, axis=-1).max()
    if breadth < max(FLAT_METRES, FLAT_SHARE * lever):
        return None
    frames = frames[np.all(motion.observed[frames][:, chosen], axis=1)]
    turn, centre = pose(shape, positions[frames][:, chosen].astype(np.float64))
    samples = np.einsum("fji,fj->fi", turn, positions[frames, joint] - centre)
    gap_turn, gap_centre = pose(shape, positions[start:stop, chosen].astype(np.float64))

    def outward(inside: Array) -> Array:
        return np.einsum("fij,fj->fi", gap_turn, inside) + gap_centre

    return Chart(tuple(chosen), frames, samples, outward)


def _shape(points: Array) -> Array:
    """The mean shape `(donors, 3)`, about its centre, of `(frames, donors, 3)`; oriented as in the first."""
    centred = points - points.mean(axis=1, keepdims=True)
    turn, _ = pose(centred[0], centred)
    return np.einsum("fji,fdj->fdi", turn, centred).mean(axis=0)


def pose(shape: Array, points: Array, weights: Array | None = None) -> tuple[Array, Array]:
    """Rotations `(frames, 3, 3)` and centres `(frames, 3)` that carry a centred `shape` onto `points`.

    weights : `(donors,)` of the points, which sum to 1; all alike if None.
    """
    if weights is None:
        weights = np.full(len(shape), 1 / len(shape))
    centre = weights @ points
    u, _, vt = np.linalg.svd(np.swapaxes(points - centre[:, None], 1, 2) @ (weights[:, None] * shape))
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt, centre
