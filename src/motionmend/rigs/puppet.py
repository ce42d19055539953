"""A rig that holds one pose, and is posed anew for as many frames as are wanted: bones keep their lengths."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..body.joints import BODY, JOINT
from ..motion import Motion, Rig, Skeleton, Take
from ..rotations import IDENTITY, apply, inverse, normalised
from .fitting import fit, scatter

Array = np.ndarray

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
