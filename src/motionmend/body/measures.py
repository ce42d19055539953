"""A person measured: stature, which way is up, where the floor is, where the body faces. In any units and axes."""

from __future__ import annotations

import warnings
from typing import TypedDict

import numpy as np

from ..motion import Motion, Skeleton
from ..rotations import normalised
from . import names
from .joints import LEFT_RIGHT, PARTS
from .mapping import map_rig, sampled

Array = np.ndarray

# Shares of the stature between two points: Drillis & Contini 1966, in Winter, Biomechanics and Motor Control of
# Human Movement, 2009, figure 4.1; those of trunk, neck and pelvis are for the joints and markers that rigs have.
_LEGS_AND_TRUNK = (
    ("thigh", "shin", 0.24),
    ("shin", "foot", 0.24),
    ("middle thigh", "neck", 0.28),
    ("neck", "head", 0.075),
    ("knee marker", "ankle marker", 0.246),
    ("pelvis markers", "knee marker", 0.28),
    ("pelvis markers", "neck marker", 0.30),
    ("neck marker", "head markers", 0.09),
)
_ARMS = (("upper_arm", "forearm", 0.186), ("forearm", "hand", 0.146))


class Measures(TypedDict):
    """What `units.resolve` wants to know of a body."""

    stature: float | None
    upward: Array | None


def measure(skeleton: Skeleton, positions: Array, rest: Array | None = None) -> Measures:
    """`stature` and `upward` at once."""
    points = _landmarks(skeleton, positions)
    return {"stature": _stature(points), "upward": _upward(points, skeleton, positions, rest)}


def stature(skeleton: Skeleton, positions: Array) -> float | None:
    """The standing height of the person in the units of `positions (frames, points, 3)`, whatever the pose.

    The medians over frames of the lengths of shins, thighs, trunk and neck (of the arms, where none of
    these is there) divided by their usual share of the height. Joints, joint centres, keypoints or markers
    of the Plug-in Gait and similar sets; None if no person is found among them.
    """
    return _stature(_landmarks(skeleton, positions))


def _stature(points: dict[str, Array]) -> float | None:
    for segments in (_LEGS_AND_TRUNK, _ARMS):
        lengths, shares = 0.0, 0.0
        for start, end, share in segments:
            sides = [_distance(points, start, end, side) for side in names.SIDES]
            if np.isfinite(sides).any():
                lengths, shares = lengths + float(np.nanmean(sides)), shares + share
        if lengths > 0:
            return lengths / shares
    return None


def upward(skeleton: Skeleton, positions: Array, rest: Array | None = None) -> Array | None:
    """The mean direction `(3,)` from feet and hips to the head in the axes of `positions`; None if not known.

    Frames in which the person stands tall count most, so a take with a fall or a handstand does not mislead.

    Parameters
    ----------
    rest : `(joints, 3)` the rig's rest pose, where it has one. If that stands along another axis, as it does in
        takes of crawling and lying, the floor decides between the two.
    """
    return _upward(_landmarks(skeleton, positions), skeleton, positions, rest)


def _upward(points: dict[str, Array], skeleton: Skeleton, positions: Array, rest: Array | None) -> Array | None:
    rise = _rise(points)
    stands = None if rest is None or rise is None else _rise(_landmarks(skeleton, rest[None]))
    if rise is None or stands is None or np.array_equal(_axis(rise), _axis(stands)):
        return None if rise is None else normalised(rise)
    # What the body rests on stays at one height, and the head is above it.
    axes = np.array([_axis(rise), _axis(stands)])
    lowest = np.nanmin(sampled(positions) @ axes.T, axis=1)
    wander = np.ptp(np.nanpercentile(lowest, [10, 90], axis=0), axis=0)
    scores = axes @ rise - wander
    return axes[1] if scores[1] > scores[0] else normalised(rise)


def _rise(points: dict[str, Array]) -> Array | None:
    """The mean vector `(3,)` from the feet to the head, and from the hips on once more; None if not known."""
    top = _first(points, "head", "head markers", "neck", "neck marker", "chest", "middle upper_arm")
    middle = _first(points, "hips", "pelvis markers", "middle thigh")
    bottom = _first(points, "middle foot", "middle ankle marker", "middle shin", "middle knee marker")
    ends = [each for each in (top, middle, bottom) if each is not None]
    if len(ends) < 2:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # frames or takes in which a point is always missing
        total = np.nanmean(ends[0] - ends[-1], axis=0)
        if len(ends) == 3:
            total = np.nansum([total, np.nanmean(ends[0] - ends[1], axis=0)], axis=0)
    return total if np.isfinite(total).all() and np.any(total) else None


def _axis(direction: Array) -> Array:
    """The unit vector along the axis that a direction is nearest to."""
    largest = int(np.argmax(np.abs(direction)))
    return np.sign(direction[largest]) * np.eye(3)[largest]


def floor_height(motion: Motion) -> float:
    """The height in metres on which the lowest observed joint usually stands; 0 if nothing was observed.

    The 5th percentile over frames, so that neither a single bad sample nor a jump moves it.
    """
    heights = np.where(motion.observed, motion.positions[..., 1], np.inf).min(axis=1, initial=np.inf)
    heights = heights[np.isfinite(heights)]
    return float(np.percentile(heights, 5)) if len(heights) else 0.0


def facing(body: Motion) -> Array:
    """Where a motion of BODY faces: `(frames, 3)` unit vectors in the floor plane, NaN where it cannot be told.

    The mean direction from right to left across hips and shoulders, turned by a quarter about the vertical
    (Holden et al. 2016, section 3). Not smoothed.
    """
    left, right = np.array([LEFT_RIGHT[PARTS.index(part)] for part in ("thigh", "upper_arm")]).T
    across = body.positions[:, left] - body.positions[:, right]
    seen = (body.observed[:, left] & body.observed[:, right])[..., None]
    leftward = np.where(seen, across, 0).sum(axis=1)
    forward = np.stack([-leftward[:, 2], np.zeros(len(body), np.float32), leftward[:, 0]], axis=1)
    unit = normalised(forward)
    unit[~np.any(forward, axis=1)] = np.nan
    return unit


def _landmarks(skeleton: Skeleton, positions: Array) -> dict[str, Array]:
    """Named points of a person, each `(frames, 3)`, of a sample of the frames: BODY's joints, markers, middles."""
    sample = sampled(positions)
    mapping = map_rig(skeleton, positions)
    points = {}
    if mapping.is_person:
        points = {name: sample[:, joint] for name, joint in mapping.found.items()}
    else:
        for name, markers in names.markers(skeleton.names).items():
            points[name] = _mean(sample[:, markers])
    for part in (*PARTS, *names.SIDED_MARKERS):
        pair = [points[f"{side}_{part}"] for side in names.SIDES if f"{side}_{part}" in points]
        if len(pair) == 2:
            points[f"middle {part}"] = (pair[0] + pair[1]) / 2
    return points


def _mean(points: Array) -> Array:
    """The mean over axis 1 of those that are there; NaN where none is."""
    there = np.isfinite(points).all(axis=-1, keepdims=True)
    count = there.sum(axis=1)
    return np.where(there, points, 0).sum(axis=1) / np.where(count, count, np.nan)


def _distance(points: dict[str, Array], start: str, end: str, side: str) -> float:
    """The median distance between two landmarks, those of one side where they have sides; NaN if unknown."""
    first, second = (points.get(name, points.get(f"{side}_{name}")) for name in (start, end))
    if first is None or second is None:
        return np.nan
    distances = np.linalg.norm(first - second, axis=-1)
    distances = distances[np.isfinite(distances)]
    return float(np.median(distances)) if len(distances) else np.nan


def _first(points: dict[str, Array], *names: str) -> Array | None:
    return next((points[name] for name in names if name in points), None)
