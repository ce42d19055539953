"""Where the ground is under a body, as its feet tell, and a body put back on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.measures import floor_height
from ..fills.curves import least_jerk
from ..motion import Motion

Array = np.ndarray

# Heights of a standing person's joints over the ground, in lengths of a leg (thigh and shin). Ankle: 0.039 / 0.491 of
# the stature, Drillis & Contini 1966, in Winter 2009, figure 4.1; in CMU's takes of train subjects the median is 0.077
# (BVH) and 0.088 (AMC). Ball of the foot: the median there, 0.031 and 0.035.
ANKLE, BALL = 0.08, 0.034
FLIGHT = 0.6  # seconds: who has no foot on the ground for longer floats
SUNK = 0.2  # seconds in which a foot comes out of the ground


def leg_length(body: Motion) -> float:
    """Thigh and shin in metres, the median over frames and the mean of the sides observed; NaN where none is."""
    lengths = []
    for side in ("left", "right"):
        hip, knee, ankle = (JOINT[f"{side}_{part}"] for part in ("thigh", "shin", "foot"))
        seen = body.observed[:, [hip, knee, ankle]].all(axis=1)
        if seen.any():
            points = body.positions[seen].astype(float)
            thigh, shin = points[:, knee] - points[:, hip], points[:, ankle] - points[:, knee]
            lengths.append(np.median(np.linalg.norm(thigh, axis=-1) + np.linalg.norm(shin, axis=-1)))
    return float(np.mean(lengths)) if lengths else float("nan")


def ground(body: Motion) -> float:
    """The height in metres of the ground under a motion of BODY, from how high its feet are when they stand.

    The 5th percentile over frames of the lowest ball of a foot, or of the lowest ankle where there are no toes, less
    that joint's height in a standing person. Without feet, the lowest joint is on the ground.
    """
    leg = leg_length(body)
    for part, share in (("toe", BALL), ("foot", ANKLE)):
        joints = [JOINT[f"left_{part}"], JOINT[f"right_{part}"]]
        if body.observed[:, joints].any() and np.isfinite(leg):
            only = np.zeros(len(BODY), bool)
            only[joints] = True
            return floor_height(replace(body, observed=body.observed & only)) - share * leg
    return floor_height(body)


def above_ground(positions: Array, ground: float) -> Array:
    """How high the lowest foot is over where it would stand, `(frames,)` metres, negative if it has sunk in.

    positions : `(frames, J, 3)` metres of BODY's joints, NaN for those that are not there; all NaN without feet.
    """
    observed = np.asarray(np.isfinite(positions).all(axis=-1))
    leg = leg_length(Motion(positions.astype(np.float32), observed, 1.0, BODY))
    heights = [positions[:, JOINT[f"{side}_{part}"], 1] - ground - share * leg
               for part, share in (("toe", BALL), ("foot", ANKLE)) for side in ("left", "right")]  # fmt: skip
    return np.fmin.reduce(heights)


def grounded(positions: Array, over: Array, fps: float, fade: float) -> Array:
    """`positions (frames, J, 3)` lowered until a foot is on the ground in any FLIGHT, and raised out of it.

    Jumps stay. Frame 0 stays where it is; what floats is down after `fade` seconds, what has sunk in is up after SUNK.

    over : `above_ground` of them. Without feet they stay as they are.
    """
    from scipy.ndimage import grey_opening, minimum_filter1d, uniform_filter1d

    if not np.isfinite(over).all():
        return positions
    flight, sunk = (2 * round(seconds * fps / 2) + 1 for seconds in (FLIGHT, SUNK))
    usual = uniform_filter1d(grey_opening(over, flight, mode="nearest"), sunk, mode="nearest")
    down = usual * _ease(len(over), fade * fps)
    # The mean of as many least values, each over so many frames, is nowhere above what it is made of.
    least = minimum_filter1d(np.minimum(over - down, 0), sunk, mode="nearest")
    up = -uniform_filter1d(least, sunk, mode="nearest") * _ease(len(over), SUNK * fps)
    out = positions.copy()
    out[..., 1] += (up - down)[:, None]
    return out


def _ease(count: int, frames: float) -> Array:
    """From 0 to 1 in so many frames."""
    return least_jerk(np.minimum(np.arange(count) / max(1.0, frames), 1))
