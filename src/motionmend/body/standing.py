"""The mean standing body, and a pose made whole by it: where a joint is that nothing else tells of."""

from __future__ import annotations

import re

import numpy as np

from .joints import BODY

Array = np.ndarray

UPRIGHT = np.array([0, 0.95, 0], np.float32)  # the hips of who stands, metres
# The mean over CMU's training takes of BODY's joints from the hips, facing +Z, metres; of both sides, on the left.
_MEAN = {
    "hips": (0, 0, 0), "spine": (0, 0.12, 0.02), "chest": (0, 0.22, 0.05), "neck": (0, 0.33, 0.09),
    "head": (0, 0.5, 0.13), "shoulder": (0, 0.33, 0.08), "upper_arm": (0.18, 0.39, 0.09), "forearm": (0.25, 0.19, 0.11),
    "hand": (0.23, 0.15, 0.2), "thigh": (0.09, -0.09, 0.03), "shin": (0.11, -0.44, 0.16), "foot": (0.11, -0.82, 0),
    "toe": (0.13, -0.88, 0.11),
}  # fmt: skip
_SIDES = {"left": (1, 1, 1), "right": (-1, 1, 1)}
STANDING = np.array(
    [np.multiply(_MEAN[re.sub("^(left|right)_", "", name)], _SIDES.get(name.split("_")[0], 1)) for name in BODY.names],
    np.float32,
)

NEAR = 0.25  # metres along the bones over which joints tell where one is that a rig lacks


def whole(pose: Array, there: Array) -> Array:
    """A pose `(J, 3)` in which joints that are not `there (J,)` stand to their neighbours as in a standing body."""
    rest, out = STANDING.astype(float) + UPRIGHT, pose.copy()
    known = np.flatnonzero(there)
    if there.all() or len(known) < 3:
        return out
    spread = [np.linalg.norm(each[known] - each[known].mean(axis=0)) for each in (pose, rest)]
    # Posture changes how far joints are from their middle, so bones tell the size where there are any.
    bones = [(joint, above) for joint, above in enumerate(BODY.parents) if above >= 0 and there[[joint, above]].all()]
    if bones:
        ends = np.array(bones).T
        spread = [np.linalg.norm(each[ends[0]] - each[ends[1]], axis=-1).sum() for each in (pose, rest)]
    scale = spread[0] / spread[1]
    for joint in np.flatnonzero(~there).tolist():
        weight = np.exp(-np.array([_apart(rest, joint, other) for other in known.tolist()]) / NEAR)
        weight /= weight.sum()
        middles = weight @ rest[known], weight @ pose[known]
        moment = ((rest[known] - middles[0]) * weight[:, None]).T @ (pose[known] - middles[1])
        left, _, right = np.linalg.svd(moment)  # Kabsch 1976
        flip = np.diag([1, 1, np.sign(np.linalg.det(left @ right))])
        out[joint] = middles[1] + scale * (rest[joint] - middles[0]) @ (left @ flip @ right)
    return out


def _apart(rest: Array, one: int, other: int) -> float:
    """How far two joints of BODY are along its bones."""
    paths = []
    for joint in (one, other):
        path = [joint]
        while BODY.parents[path[-1]] >= 0:
            path.append(BODY.parents[path[-1]])
        paths.append(path)
    loose = set(paths[0]) ^ set(paths[1])
    return float(sum(np.linalg.norm(rest[joint] - rest[BODY.parents[joint]]) for joint in loose))
