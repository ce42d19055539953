"""What is animated: a take's rig with one pose held, or a rig made for it where a file holds points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.mapping import Mapping, to_body
from ..body.standing import whole
from ..constraints.ground import ground
from ..io import held
from ..motion import Rig, Skeleton, Take, Units
from ..rigs.aiming import free_axes
from ..rigs.puppet import Puppet, standing_rig
from ..units import rotation_to_y_up

Array = np.ndarray

ENOUGH = 10  # frames of a take that tell which of its joints never turn
AROUND = 1.0  # seconds of a take on each side of a pose that tell where the ground is: stairs go on, jumps do not


def puppet(take: Take, frame: int, frames: int, mapping: Mapping) -> Puppet:
    """The puppet of a take's pose in `frame`, for `frames` frames. The mapping must be a person's."""
    joints = np.array(mapping.joints)
    body = to_body(take.motion, mapping)
    pose = whole(body.positions[frame].astype(float), body.observed[frame])
    lacking = tuple(name for name, there in zip(BODY.names, body.observed[frame]) if not there)
    still = held(take, frame, frames)
    near = slice(max(0, round(frame - AROUND * take.fps)), round(frame + AROUND * take.fps) + 1)
    floor = ground(replace(body, positions=body.positions[near], observed=body.observed[near]))
    if take.rig is None:
        return replace(_of_points(still, joints, pose, lacking), ground=floor)
    up = np.abs(rotation_to_y_up(take.units.up)).argmax(axis=0)
    letters = str.maketrans("XYZ", "".join("XYZ"[axis] for axis in up))
    axes = tuple(free_axes(order.upper()).translate(letters) for order in take.rig.orders)
    joints = np.where(body.observed[frame], joints, -1)
    mover = _mover(take.rig, int(joints[0]))
    return Puppet(still, joints, pose, _turning(take, joints, axes), axes, mover, lacking, ground=floor)


def _turning(take: Take, joints: Array, axes: Sequence[str]) -> Array:
    """Which joints of a rig may turn: the body's, and those of the spine between them; none that never does."""
    assert take.rig is not None
    free = np.zeros(len(axes), bool)
    free[joints[joints >= 0]] = True
    ends = [joints[JOINT[name]] for name in ("head", "neck", "chest", "left_upper_arm", "right_upper_arm")]
    for joint in (end for end in ends if end >= 0):
        path = [int(joint)]
        while path[-1] >= 0:
            path.append(take.skeleton.parents[path[-1]])
        if joints[0] in path:
            free[path[: path.index(joints[0])]] = True
    free &= np.array([bool(each) for each in axes])
    turned = np.ptp(take.rig.rotations, axis=0).max(axis=-1) > 1e-7
    # Channels that are there and never used, as those of CMU's hip joints. A still take tells nothing.
    if len(take) >= ENOUGH and turned[free].mean() > 0.5:
        free &= turned
    return free


def _mover(rig: Rig, hips: int) -> int:
    """The joint nearest to the hips, itself or above, that has position channels; the root where none has."""
    while not rig.moves[hips] and rig.skeleton.parents[hips] >= 0:
        hips = rig.skeleton.parents[hips]
    return hips


def _of_points(still: Take, joints: Array, pose: Array, lacking: tuple[str, ...]) -> Puppet:
    """A rig of BODY's joints; every other point hangs on the bone that is nearest to it in the pose."""
    points, seen = still.motion.positions[0].astype(float), still.motion.observed[0]
    others = np.setdiff1d(np.flatnonzero(seen), joints)
    bones = np.array([(joint, parent) for joint, parent in enumerate(BODY.parents) if parent >= 0])
    parents, places = list(BODY.parents), pose.copy()
    for point in others:
        start, end = pose[bones[:, 1]], pose[bones[:, 0]]
        square = np.maximum(np.sum((end - start) ** 2, axis=-1), 1e-12)
        along = np.sum((points[point] - start) * (end - start), axis=-1) / square
        nearest = start + np.clip(along, 0, 1)[:, None] * (end - start)
        parents.append(int(bones[np.argmin(np.linalg.norm(points[point] - nearest, axis=-1)), 1]))
        places = np.vstack([places, points[point]])
    at = np.full(len(points), -1)
    known = (joints >= 0) & seen[joints]
    at[joints[known]], at[others] = np.flatnonzero(known), np.arange(len(BODY), len(parents))
    names = (*BODY.names, *(f"point {index}" for index in range(len(others))))
    rig = standing_rig(places[None].repeat(len(still), axis=0), Skeleton(names, tuple(parents)), len(BODY))
    take = Take(rig.motion(still.fps), rig, None, Units(1.0, "y", ""), "npz", still.source)
    free = np.arange(len(parents)) < len(BODY)
    return Puppet(take, np.arange(len(BODY)), pose, free, rig.orders, 0, lacking, still, at)
