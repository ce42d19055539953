"""Where the ground is under a body, as its feet tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .body import BODY, JOINT, floor_height
from .motion import Motion

# Heights of a standing person's joints over the ground, in lengths of a leg (thigh and shin). Ankle: 0.039 / 0.491 of
# the stature, Drillis & Contini 1966, in Winter 2009, figure 4.1; in CMU's takes of train subjects the median is 0.077
# (BVH) and 0.088 (AMC). Ball of the foot: the median there, 0.031 and 0.035.
ANKLE, BALL = 0.08, 0.034


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
