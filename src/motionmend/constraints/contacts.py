"""When feet stand, in many takes or windows of BODY at once.

B = windows, T = frames, J = BODY's joints.
"""

from __future__ import annotations

import numpy as np

from ..body.joints import JOINT

Array = np.ndarray

STANDING_JOINTS = tuple(JOINT[f"{side}_{part}"] for side in ("left", "right") for part in ("foot", "toe"))
SLOW, LOW, SHORTEST = 0.3, 0.06, 0.1  # m/s, metres, seconds: what a foot that stands is and does
NEARBY = 3.2  # seconds around a frame whose lowest place is the ground there: stairs have many


def standing(positions: Array, observed: Array, fps: float) -> tuple[Array, Array]:
    """Whether ankles and balls of feet stand, and where that is known: `(B, T, 4)` bool, in the order STANDING_JOINTS.

    Slower than 0.3 m/s and within 6 cm of the lowest that this joint of either side is nearby, for 0.1 s.

    Parameters
    ----------
    positions : `(B, T, J, 3)` metres, not read where not `observed (B, T, J)`.
    """
    from scipy.ndimage import binary_opening, minimum_filter1d

    points, seen = positions[:, :, STANDING_JOINTS], observed[:, :, STANDING_JOINTS]
    rows, frames = seen.shape[:2]
    heights = np.where(seen, points[..., 1], np.inf)
    lowest = heights.reshape(rows, frames, 2, 2).min(axis=2)  # of both sides
    lowest = minimum_filter1d(lowest, 1 + 2 * round(NEARBY * fps / 2), axis=1, mode="nearest")
    known = np.zeros_like(seen)
    known[:, 1:-1] = seen[:, 1:-1] & seen[:, 2:] & seen[:, :-2]
    speed = np.full(seen.shape, np.inf, np.float32)
    speed[:, 1:-1] = np.linalg.norm(points[:, 2:] - points[:, :-2], axis=-1) * np.float32(fps / 2)
    stands = known & (speed < SLOW) & (heights < np.tile(lowest, (1, 1, 2)) + LOW)
    return binary_opening(stands, np.ones((1, max(1, round(SHORTEST * fps)), 1), bool)), known
