"""Made-up walkers for the tests of what learns from other takes: the same steps again, never quite the same."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from motionmend.motion import Motion, Rig, Skeleton, Take, Units

NAMES = ("hips", "chest", "head", "left_knee", "left_foot", "right_knee", "right_foot", "left_hand", "right_hand")
PARENTS = (-1, 0, 1, 0, 3, 0, 5, 1, 1)
BONES = np.array(
    [[0, 0, 0], [0, 0.5, 0], [0, 0.3, 0], [0.1, -0.4, 0], [0, -0.4, 0], [-0.1, -0.4, 0], [0, -0.4, 0], [0.2, -0.5, 0],
     [-0.2, -0.5, 0]]
)  # fmt: skip
SWING = np.array([0.1, 0.15, 0.1, 0.5, 0.4, 0.5, 0.4, 0.6, 0.6])  # radians
PHASE = np.array([0.0, 1.0, 2.0, 0.0, 0.7, np.pi, np.pi + 0.7, np.pi, 0.0])


def stroll(seed: int, seconds: float = 12.0, fps: float = 60.0, heading: float = 0.0, beat: float = 1.0) -> Rig:
    """A rig that walks along `heading` (radians), a step every second or so, swinging in its own way in each."""
    random = np.random.default_rng(seed)
    clock = np.arange(round(seconds * fps)) / fps
    turns = 2 * np.pi * beat * clock + 0.3 * np.sin(0.9 * clock + random.uniform(0, 6)) + random.uniform(0, 6)
    sway = 1 + 0.15 * np.sin(np.outer(clock, random.uniform(0.5, 0.8, len(NAMES))) + random.uniform(0, 6, len(NAMES)))
    angle = SWING * sway * (np.sin(turns[:, None] + PHASE) + 0.35 * np.sin(2 * turns[:, None] + 2 * PHASE))
    twist = 0.2 * np.sin(turns[:, None] + PHASE + 1)
    sides = np.array([1 if name.startswith("left") else -1 if name.startswith("right") else 0 for name in NAMES])
    vectors = np.stack([angle, twist * sides, 0.1 * angle * sides], axis=-1)
    local = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_quat().reshape(*vectors.shape[:2], 4)
    about = Rotation.from_rotvec([0, heading, 0])
    local[:, 0] = (about * Rotation.from_quat(local[:, 0])).as_quat()
    shifts = np.broadcast_to(BONES, (len(clock), *BONES.shape)).copy()
    way = np.stack([0.02 * np.sin(turns), 0.9 + 0.03 * np.cos(2 * turns), 1.1 * clock], axis=-1)
    shifts[:, 0] = about.apply(way)
    moves = np.arange(len(NAMES)) == 0
    trusted = np.ones((len(clock), len(NAMES)), bool)
    ends = tuple((NAMES.index(name), np.array([0, -0.1, 0.1])) for name in ("left_foot", "right_foot"))
    return Rig(Skeleton(NAMES, PARENTS), local, shifts, trusted, BONES, moves, ("ZXY",) * len(NAMES), ends)


def as_rig_take(rig: Rig, fps: float = 60.0, name: str = "stroll.bvh") -> Take:
    return Take(rig.motion(fps), rig, None, Units(0.01, "y", "made up"), "bvh", name)


def as_points(rig: Rig, fps: float = 60.0) -> Motion:
    return rig.motion(fps)


def as_point_take(motion: Motion, name: str = "stroll.npz") -> Take:
    return Take(motion, None, None, Units(1.0, "y", "made up"), "npz", name)
