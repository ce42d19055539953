"""The nouns: Skeleton, Motion, Rig, Take.

Metres, seconds, radians, Y up, right-handed, quaternions xyzw, frame axis first. Nothing here knows a file
format. All are immutable by convention: every step returns a new one and never writes into an array it
was given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from .errors import InputError, nearest_names
from .rotations import forward_kinematics

Array = np.ndarray


@dataclass(frozen=True)
class Skeleton:
    """Joint (or marker) names, and the index of each one's parent: before it in order, -1 for a root.

    A cloud of markers is a skeleton whose every point is a root.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]

    def __post_init__(self):
        if len(self.names) != len(self.parents):
            raise ValueError(f"{len(self.names)} names but {len(self.parents)} parents")
        if any(not -1 <= parent < joint for joint, parent in enumerate(self.parents)):
            raise ValueError("every parent must come before its child, or be -1")

    @classmethod
    def cloud(cls, names: Sequence[str]) -> Skeleton:
        """A skeleton without bones: markers."""
        return cls(tuple(names), (-1,) * len(names))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def has_bones(self) -> bool:
        return any(parent >= 0 for parent in self.parents)

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """For each joint, the indices of its children."""
        found: list[list[int]] = [[] for _ in self.names]
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                found[parent].append(joint)
        return tuple(map(tuple, found))

    def index(self, name: str) -> int:
        """The index of the joint with exactly this name; InputError names the nearest ones if none has it."""
        try:
            return self.names.index(name)
        except ValueError:
            hint = nearest_names(name, self.names)
            raise InputError(f"no joint or marker is named {name!r}", hint=hint) from None


@dataclass(frozen=True, eq=False)
class Motion:
    """Where every joint is, and which of that to trust.

    positions : `(frames, joints, 3)` float32, metres, Y up. Where `observed` is False the numbers mean
        nothing (NaN where the file had none), and no method may read them.
    observed : `(frames, joints)` bool, True = trust.
    fps : frames per second.
    """

    positions: Array
    observed: Array
    fps: float
    skeleton: Skeleton

    def __post_init__(self):
        frames, joints = self.positions.shape[:2]
        if self.positions.shape != (frames, len(self.skeleton), 3) or self.observed.shape != (frames, joints):
            raise ValueError(
                f"positions {self.positions.shape}, observed {self.observed.shape} and "
                f"{len(self.skeleton)} joints do not agree"
            )
        if self.positions.dtype != np.float32 or self.observed.dtype != np.bool_:
            raise TypeError("positions must be float32 and observed bool")
        if not self.fps > 0:
            raise ValueError(f"fps must be positive, not {self.fps}")

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def seconds(self) -> float:
        return len(self) / self.fps


class Completer(Protocol):
    """Anything that makes the untrusted entries of a motion right: a classical fill, a network, a chooser."""

    def complete(self, motion: Motion) -> Motion:
        """The motion with its unobserved entries filled.

        Observed samples come back bit for bit. `observed` of the result is True wherever the numbers may
        be used now; what could not be filled stays False.
        """
        ...


def runs(mask: Array) -> list[tuple[int, int]]:
    """The maximal stretches `[start, stop)` in which a `(frames,)` bool mask is True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


@dataclass(frozen=True, eq=False)
class Rig:
    """What moves a skeleton in files that store channels: each joint's turn and shift in its parent's frame.

    rotations : `(frames, joints, 4)` float64, local, xyzw.
    translations : `(frames, joints, 3)` float64, metres, in the parent's frame; constant and equal to
        `offsets` for joints that cannot move.
    trusted : `(frames, joints)` bool: whether this joint's own channels are trusted in this frame.
    offsets : `(joints, 3)` metres, the rest pose's bone to each joint.
    moves : `(joints,)` bool, whether the joint has position channels.
    orders : per joint the axes it can turn about, outermost first, in upper case as the file has them
        ("ZXY"; "" for a joint without rotation channels).
    ends : end sites, each `(joint index, offset (3,) metres)`.
    """

    skeleton: Skeleton
    rotations: Array
    translations: Array
    trusted: Array
    offsets: Array
    moves: Array
    orders: tuple[str, ...]
    ends: tuple[tuple[int, Array], ...] = ()

    @cached_property
    def kinematics(self) -> tuple[Array, Array]:
        """World positions `(frames, joints, 3)` and rotations `(frames, joints, 4)`, float64."""
        return forward_kinematics(self.rotations, self.translations, self.skeleton.parents)

    def observed(self) -> Array:
        """`(frames, joints)` bool: positions that hang on trusted channels only.

        A joint's position depends on the channels of all its ancestors, and on its own if it has
        position channels or is a root; its own turn moves only what is below it.
        """
        observed = np.empty_like(self.trusted)
        for joint, parent in enumerate(self.skeleton.parents):
            above = True if parent < 0 else observed[:, parent] & self.trusted[:, parent]
            own = self.trusted[:, joint] if parent < 0 or self.moves[joint] else True
            observed[:, joint] = above & own
        return observed

    def motion(self, fps: float) -> Motion:
        positions = self.kinematics[0].astype(np.float32)
        return Motion(positions, self.observed(), fps, self.skeleton)


@dataclass(frozen=True)
class Units:
    """How a file's numbers become metres with Y up.

    metres : metres per unit of the file.
    up : the file's upward axis: "x", "y", "z", "-x", "-y" or "-z".
    why : where both come from, in words for the report.
    """

    metres: float
    up: str
    why: str


@dataclass(frozen=True, eq=False)
class Take:
    """A Motion with what its file needs to be written back exactly.

    motion : positions and trust. For a file of channels, the forward kinematics of `rig`.
    rig : local turns and shifts, for files that store channels (BVH, AMC); None for files of points.
    document : the file as read; only the format that made it looks inside.
    format : "bvh", "c3d", …; source : the path, for messages.
    notes : what reading had to decide or found odd, one sentence each, for `inspect` and the report.
    report : what a repair did, on the take it returns.
    """

    motion: Motion
    rig: Rig | None
    document: Any
    units: Units
    format: str
    source: str
    notes: tuple[str, ...] = ()
    report: Any = None

    @property
    def skeleton(self) -> Skeleton:
        return self.motion.skeleton

    @property
    def fps(self) -> float:
        return self.motion.fps

    def __len__(self) -> int:
        return len(self.motion)

    @property
    def trusted(self) -> Array:
        """`(frames, joints)` bool: which of the file's own numbers are trusted (channels, or points)."""
        return self.motion.observed if self.rig is None else self.rig.trusted

    def distrust(self, mask: Array) -> Take:
        """This take with the `(frames, joints)` entries where `mask` is True no longer trusted."""
        if self.rig is None:
            motion = replace(self.motion, observed=self.motion.observed & ~mask)
            return replace(self, motion=motion)
        rig = replace(self.rig, trusted=self.rig.trusted & ~mask)
        # The trust changed, the pose did not: no second forward kinematics.
        motion = replace(self.motion, observed=rig.observed())
        return replace(self, rig=rig, motion=motion)

    def with_motion(self, motion: Motion) -> Take:
        """A take of points with other positions or trust; for a take with a rig use `fit`."""
        if self.rig is not None:
            raise TypeError("this take stores channels: give it a rig, or use motionmend.fit")
        return replace(self, motion=motion)

    def with_rig(self, rig: Rig) -> Take:
        """A take of channels with other turns, shifts or trust, and the positions that follow from them."""
        return replace(self, rig=rig, motion=rig.motion(self.fps))
