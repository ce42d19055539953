"""Random rigs in random motion, for the tests of what turns positions into channels."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from motionmend.motion import Rig, Skeleton, Take, Units

ARM = (-1, 0, 1, 2, 3, 1, 5, 6, 0, 8, 9)  # a root with a trunk of two arms, and a leg


def random_rig(seed, parents=ARM, frames=40, orders=None, no_length=(), moving=(), size=0.3):
    """A rig whose joints swing smoothly about random attitudes; its root wanders."""
    rng = np.random.default_rng(seed)
    joints = len(parents)
    offsets = rng.normal(size=(joints, 3)) * size
    offsets[list(no_length)] = 0
    clock = np.linspace(0, 2, frames)[:, None]
    rotations = np.zeros((frames, joints, 4))
    orders = tuple(orders or ["ZXY"] * joints)
    for joint in range(joints):
        axes = orders[joint]
        if len(axes) == 3:
            swing = Rotation.from_rotvec(np.sin(clock + rng.normal()) * rng.normal(size=3) * 0.6)
            turns = Rotation.from_rotvec(rng.normal(size=3)) * swing
        elif axes:
            angles = rng.normal(size=len(axes)) * 0.6 + np.sin(clock + rng.normal()) * 0.5
            turns = Rotation.from_euler(axes, angles)
        else:
            turns = Rotation.identity(frames)
        rotations[:, joint] = turns.as_quat()
    moves = np.zeros(joints, bool)
    moves[[0, *moving]] = True
    shifts = np.broadcast_to(offsets, (frames, joints, 3)).copy()
    for joint in np.flatnonzero(moves):
        shifts[:, joint] += np.cumsum(rng.normal(size=(frames, 3)), axis=0) * 0.01
    skeleton = Skeleton(tuple(f"joint{joint}" for joint in range(joints)), tuple(parents))
    trusted = np.ones((frames, joints), bool)
    return Rig(skeleton, rotations, shifts, trusted, offsets, moves, orders)


def as_take(rig, fps=100.0, up="y"):
    return Take(rig.motion(fps), rig, None, Units(1.0, up, "made up"), "bvh", "made.bvh")
