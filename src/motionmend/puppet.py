"""What is posed: a take's rig with one pose held, or a rig made for it where a file holds points; and posing it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .aiming import free_axes
from .body import BODY, JOINT, Mapping, to_body
from .fitting import fit, scatter
from .footing import ground
from .io import held
from .io.units import rotation_to_y_up
from .motion import Motion, Rig, Skeleton, Take, Units
from .rotations import IDENTITY, apply, inverse, normalised
from .spaces import STANDING, UPRIGHT

Array = np.ndarray

ENOUGH = 10  # frames of a take that tell which of its joints never turn
AROUND = 1.0  # seconds of a take on each side of a pose that tell where the ground is: stairs go on, jumps do not
NEAR = 0.25  # metres along the bones over which joints tell where one is that a rig lacks


@dataclass(frozen=True, eq=False)
class Puppet:
    """A rig that holds one pose for as long as the animation is to last.

    take : with a rig. joints : `(J,)` for each of BODY's the rig's, or -1. pose : `(J, 3)` metres, float64, whole:
    joints that the rig lacks stand where those of a standing body would. free : `(rig's joints,)` bool, which may turn.
    axes : per joint of the rig the axes it can turn about, in our frame. mover : the joint whose shift moves the body.
    lacking : BODY's joints that the file has none for.
    points : the frame as it was read, where a file holds points; their places in the rig are `at`, -1 for none.
    ground : the height in metres on which the person stands around that frame.
    """

    take: Take
    joints: Array
    pose: Array
    free: Array
    axes: tuple[str, ...]
    mover: int
    lacking: tuple[str, ...] = ()
    points: Take | None = None
    at: Array | None = None
    ground: float = 0.0

    def posed(self, positions: Array) -> Take:
        """Its rig posed after `positions (frames, J, 3)` metres; frame 0 stays the pose, bones keep their lengths.

        Bones keep their directions, too: limbs that were to end where they cannot reach would be stretched out.
        """
        rig, parents = self._rig, self.take.skeleton.parents
        positions = self.in_proportion(positions)
        hips, above = int(self.joints[JOINT["hips"]]), parents[self.mover]
        shift = positions[:, JOINT["hips"]] - rig.kinematics[0][:, hips]
        shift[0] = 0
        turn = rig.kinematics[1][:, above] if above >= 0 else np.broadcast_to(IDENTITY, (len(shift), 4))
        moved = rig.translations.copy()
        moved[:, self.mover] += apply(inverse(turn), shift)
        where = np.tile(self.free, (len(shift), 1))
        where[0] = False
        guess = self.take.with_rig(replace(rig, translations=moved))
        return fit(guess, scatter(positions, self.joints, len(parents)), where)

    def back(self, posed: Take) -> Take:
        """A posed rig as what the file holds: channels as they are, points where the rig carries them."""
        if self.points is None or self.at is None:
            return posed
        there = self.at >= 0
        positions = np.full((len(posed), len(self.at), 3), np.nan, np.float32)
        positions[:, there] = posed.motion.positions[:, self.at[there]]
        positions[0] = self.points.motion.positions[0]
        observed = np.tile(self.points.motion.observed[0] & there, (len(posed), 1))
        return replace(self.points, motion=Motion(positions, observed, posed.fps, self.points.skeleton))

    @cached_property
    def bones(self) -> list[int]:
        """BODY's joints that no turn of the rig parts from their parents in BODY: a spine is no bone."""
        parents, found = self.take.skeleton.parents, []
        for joint, above in enumerate(BODY.parents):
            here, end = (int(self.joints[each]) for each in (joint, above))
            here = -1 if min(here, end, above) < 0 else parents[here]
            while here >= 0 and here != end and not self.free[here]:
                here = parents[here]
            found += [joint] * (here >= 0 and here == end)
        return found

    def in_proportion(self, positions: Array) -> Array:
        """Positions `(frames, J, 3)` whose bones are as long as the pose's, from the hips outward."""
        out = positions.copy()
        for joint, above in enumerate(BODY.parents):
            if above >= 0:
                bone = positions[:, joint] - positions[:, above]
                if joint in self.bones:
                    bone = normalised(bone) * np.linalg.norm(self.pose[joint] - self.pose[above])
                out[:, joint] = out[:, above] + bone
        return out

    @property
    def _rig(self) -> Rig:
        assert self.take.rig is not None
        return self.take.rig


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


def standing_rig(positions: Array, skeleton: Skeleton, turning: int) -> Rig:
    """A rig without turns whose joints are at `positions (frames, joints, 3)`; the first `turning` can turn freely."""
    shifts = positions.astype(float)
    for joint, parent in reversed(list(enumerate(skeleton.parents))):
        if parent >= 0:
            shifts[:, joint] -= shifts[:, parent]
    orders = tuple("ZXY" if joint < turning else "" for joint in range(len(skeleton)))
    return Rig(
        skeleton=skeleton,
        rotations=np.tile(IDENTITY, (*shifts.shape[:2], 1)),
        translations=shifts,
        trusted=np.ones(shifts.shape[:2], bool),
        offsets=shifts[0],
        moves=np.array(skeleton.parents) < 0,
        orders=orders,
    )
