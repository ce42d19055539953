"""A pelvis and two legs that walk, made up: as a rig, and as a cloud of markers."""

from __future__ import annotations

import numpy as np

from motionmend.motion import Motion, Rig, Skeleton, Take, Units

NAMES = ("Hips", "LeftUpLeg", "LeftLeg", "RightUpLeg", "RightLeg")
UNITS = Units(1.0, "y", "metres")


def rig_take(frames: int = 240, fps: float = 120.0, seed: int = 0) -> Take:
    """A pelvis that walks and two legs that swing; every channel moves smoothly."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / fps
    skeleton = Skeleton(NAMES, (-1, 0, 1, 0, 3))
    phase, rate = rng.uniform(0, 6, (5, 3)), rng.uniform(0.4, 1.5, (5, 3))
    rotvec = rng.uniform(0.2, 0.6, (5, 3)) * np.sin(2 * np.pi * rate * time + phase)
    angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
    rotations = np.concatenate([rotvec / angle * np.sin(angle / 2), np.cos(angle / 2)], axis=-1)
    offsets = np.array([[0, 0, 0], [0.1, 0, 0], [0, -0.4, 0], [-0.1, 0, 0], [0, -0.4, 0]], float)
    translations = np.tile(offsets, (frames, 1, 1))
    translations[:, 0] = [0, 0.9, 0] + time[:, 0] * [0.3, 0, 1.2]
    moves = np.array([True, False, False, False, False])
    ends = ((2, np.array([0.0, -0.4, 0.0])), (4, np.array([0.0, -0.4, 0.0])))
    rig = Rig(skeleton, rotations, translations, np.ones((frames, 5), bool), offsets, moves, ("ZXY",) * 5, ends)
    return Take(rig.motion(fps), rig, None, UNITS, "bvh", "made up")


def point_take(frames: int = 240, fps: float = 120.0, names: tuple[str, ...] | None = None, seed: int = 0) -> Take:
    """The same movement as a cloud of markers, under other names if wanted."""
    motion = rig_take(frames, fps, seed).motion
    cloud = Motion(motion.positions, motion.observed, fps, Skeleton.cloud(names or NAMES))
    return Take(cloud, None, None, UNITS, "npz", "made up")
