"""What a memory holds: takes at one rate, those of one skeleton end to end, with what of them is to be trusted.

A take of channels is remembered as positions of its joints and the ends of its bones, to be compared, and as its local
turns and shifts, to teach them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..damage.planting import mirrored_pairs
from ..motion import Motion, Rig, Skeleton, Take, runs
from ..networks.windows import between
from ..rotations import apply, from_rotvec, inverse, multiply, normalised, to_rotvec

Array = np.ndarray

RATE = 30.0  # frames a second
RATE_SHARE = 0.01  # a rate that is a whole multiple but for this share is thinned out, not interpolated
BRIDGED_SECONDS = 0.2  # holes up to this long are bridged to be compared, and never teach
UNKNOWN, BRIDGED, SEEN = range(3)
UNEVEN, UNEVEN_METRES = 0.1, 0.01  # of a bone's length, and metres, by which a rig's sides may differ
SAME_METRES, SAME_SHARE = 1e-3, 0.5  # of samples that are at the same places in two versions of one take
END = " (end)"  # of the name of a bone's end site


@dataclass(frozen=True)
class Remembered:
    """A take in a session: its frames `[start, stop)` there, and the hash of its content."""

    name: str
    sha256: str
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class Session:
    """Takes of one skeleton, end to end, at RATE.

    skeleton : joints or markers; a rig's joints first, then the ends of its bones.
    positions `(frames, points, 3)` float32, metres, Y up, each take about its middle on the floor; 0 where unknown.
    trust `(frames, points)` uint8 : UNKNOWN; BRIDGED, to be compared only; or SEEN.
    offsets `(joints, 3)`, rotations `(frames, joints, 4)`, shifts `(frames, joints, 3)` : of a rig, else None. float32.
    """

    skeleton: Skeleton
    takes: tuple[Remembered, ...]
    positions: Array
    trust: Array
    offsets: Array | None = None
    rotations: Array | None = None
    shifts: Array | None = None
    # What `neighbours` keeps for the next gap.
    sizes: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def index(self) -> dict[str, int]:
        return {name: joint for joint, name in enumerate(self.skeleton.names)}

    @cached_property
    def owner(self) -> Array:
        """`(frames,)` the index in `takes` of each frame's take."""
        return np.repeat(np.arange(len(self.takes)), [take.stop - take.start for take in self.takes])

    @cached_property
    def twins(self) -> Array | None:
        """`(points,)` the index of each point's left or right twin, or its own.

        None where nothing has sides, or where a rig's are not each other's mirror image.
        """
        pairs = mirrored_pairs(self.skeleton.names)
        if not pairs:
            return None
        twins = np.arange(len(self.skeleton))
        left, right = np.array(pairs).T
        twins[left], twins[right] = right, left
        return twins if self.offsets is None or mirror_axis(self.offsets, twins) is not None else None

    def check(self) -> None:
        """ValueError if its arrays and its takes do not agree."""
        frames, points = len(self.positions), len(self.skeleton)
        shapes = {"positions": (frames, points, 3), "trust": (frames, points)}
        if self.offsets is not None:
            joints = len(self.offsets)
            shapes |= {"offsets": (joints, 3), "rotations": (frames, joints, 4), "shifts": (frames, joints, 3)}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} are {np.shape(getattr(self, name))}, not {shape}")
        bounds = [0, *(take.stop for take in self.takes)]
        if bounds[-1] != frames or any(take.start != at or take.stop < at for take, at in zip(self.takes, bounds)):
            raise ValueError("its takes do not follow each other")

    @property
    def key(self) -> tuple:
        """What two sessions have in common if they can be one."""
        offsets = () if self.offsets is None else tuple(np.round(self.offsets, 4).ravel().tolist())
        return self.skeleton.names, self.skeleton.parents, offsets


def mirror_axis(offsets: Array, twins: Array) -> int | None:
    """Along which axis of its rest pose a rig is the mirror image of itself, or None."""
    twins = twins[: len(offsets)]
    allowed = np.maximum(UNEVEN * np.linalg.norm(offsets, axis=-1, keepdims=True), UNEVEN_METRES)
    for axis in range(3):
        image = offsets[twins] * np.where(np.arange(3) == axis, -1, 1)
        if np.all(np.abs(image - offsets)[1:] <= allowed[1:]):
            return axis
    return None


def content(take: Take) -> str:
    """A hash of what a take says: two takes of one hash are one take."""
    said = hashlib.sha256(repr((take.skeleton.names, take.fps)).encode())
    said.update(np.ascontiguousarray(take.motion.positions).data)
    return said.hexdigest()


def versions(take: Session, sessions: Iterable[Session]) -> frozenset[str]:
    """Hashes of the takes that are this one but for what a repair or an edit has changed in it.

    What fills once guessed would teach them to guess so again. The same take has most of its samples in the same frames
    at the same places, but for the shift to its middle.
    """
    found = set()
    for session in sessions:
        if session.skeleton.names != take.skeleton.names:
            continue
        for other in session.takes:
            there = slice(other.start, other.stop)
            if other.stop - other.start != len(take):
                continue
            both = (take.trust == SEEN) & (session.trust[there] == SEEN)
            apart = session.positions[there][both] - take.positions[both]
            if len(apart) and np.mean(np.abs(apart - np.median(apart, axis=0)).max(axis=1) < SAME_METRES) > SAME_SHARE:
                found.add(other.sha256)
    return frozenset(found)


def remember(motion: Motion, rig: Rig | None, name: str, sha256: str = "") -> Session:
    """A session of one take: what is observed teaches, short holes are bridged, the rest is unknown.

    motion : of the take, or of `rig`.
    """
    if rig is not None:
        motion = with_ends(rig, motion)
    at, beyond = grid(len(motion), motion.fps)
    positions, seen = thinned(motion.positions, motion.observed, at, beyond)
    positions, trust = _bridged(positions, seen)
    session = Session(motion.skeleton, (Remembered(name, sha256, 0, len(at)),), positions, trust)
    if rig is None:
        return session
    turns, shifts = _channels(rig, at, beyond)
    return replace(session, offsets=rig.offsets.astype(np.float32), rotations=turns, shifts=shifts)


def with_ends(rig: Rig, motion: Motion) -> Motion:
    """A rig's motion, with the ends of its bones as more joints.

    A joint without a child or an end gets one as far beyond it as it is beyond its parent, so that its turn shows.
    """
    places, turns = rig.kinematics
    bare = {joint for joint, below in enumerate(rig.skeleton.children) if not below} - {joint for joint, _ in rig.ends}
    ends = [*rig.ends, *((joint, rig.offsets[joint]) for joint in sorted(bare))]
    owners = np.array([joint for joint, _ in ends])
    tips = places[:, owners] + apply(turns[:, owners], np.array([offset for _, offset in ends]))
    names = [f"{rig.skeleton.names[joint]}{END}" for joint in owners]
    names = [name if names.index(name) == number else f"{name}{number}" for number, name in enumerate(names)]
    skeleton = Skeleton((*rig.skeleton.names, *names), (*rig.skeleton.parents, *owners.tolist()))
    seen = motion.observed[:, owners] & rig.trusted[:, owners]
    return Motion(
        np.concatenate([motion.positions, tips.astype(np.float32)], axis=1),
        np.concatenate([motion.observed, seen], axis=1), motion.fps, skeleton,
    )  # fmt: skip


def grid(frames: int, fps: float) -> tuple[Array, Array]:
    """Where the frames at RATE lie in a take: the frame before each, and how far beyond it, [0, 1).

    In the middle of the take, so that it is the same backwards.
    """
    step = fps / RATE
    if round(step) and abs(step / round(step) - 1) < RATE_SHARE:
        at = np.arange((frames - 1) % round(step) // 2, frames, round(step))
        return at, np.zeros(len(at))
    count = int((frames - 1) / step + 1e-9) + 1
    return parts((frames - 1 - (count - 1) * step) / 2 + step * np.arange(count))


def parts(times: Array) -> tuple[Array, Array]:
    """Times in frames as the frame before and how far beyond it; nearly whole ones as whole."""
    nearest = np.round(times)
    times = np.where(np.abs(times - nearest) < 1e-4, nearest, times)
    frame = np.floor(times).astype(int)
    return frame, times - frame


def thinned(positions: Array, observed: Array, at: Array, beyond: Array) -> tuple[Array, Array]:
    """Positions at these times, and whether the samples around are observed. See `networks.windows.between`."""
    return between(positions, observed, at, beyond) if beyond.any() else (positions[at], observed[at])


def _bridged(positions: Array, seen: Array) -> tuple[Array, Array]:
    """Positions about their middle, short holes bridged by straight lines, and how far each is to be trusted."""
    centre = positions[seen].mean(axis=0, dtype=float) * [1, 0, 1] if seen.any() else np.zeros(3)
    positions = np.where(seen[..., None], (positions - centre).astype(np.float32), np.float32(0))
    trust = np.where(seen, np.uint8(SEEN), np.uint8(UNKNOWN))
    most = round(BRIDGED_SECONDS * RATE)
    for joint in np.flatnonzero(seen.any(axis=0) & ~seen.all(axis=0)):
        for start, stop in runs(~seen[:, joint]):
            if start and stop < len(seen) and stop - start <= most:
                u = (np.arange(1, stop - start + 1) / (stop - start + 1))[:, None]
                positions[start:stop, joint] = (1 - u) * positions[start - 1, joint] + u * positions[stop, joint]
                trust[start:stop, joint] = BRIDGED
    return positions, trust


def _channels(rig: Rig, at: Array, beyond: Array) -> tuple[Array, Array]:
    """Turns and shifts at these times, float32: along the shortest turn, and straight, between two frames."""
    if not beyond.any():
        return rig.rotations[at].astype(np.float32), rig.translations[at].astype(np.float32)
    after, u = np.minimum(at + 1, len(rig.trusted) - 1), beyond[:, None, None]
    one, other = rig.rotations[at], rig.rotations[after]
    turns = multiply(one, from_rotvec(u * to_rotvec(multiply(inverse(one), other))))
    shifts = (1 - u) * rig.translations[at] + u * rig.translations[after]
    return normalised(turns).astype(np.float32), shifts.astype(np.float32)


def joined(sessions: Iterable[Session]) -> tuple[Session, ...]:
    """The same takes, those of one skeleton in one session, each take once; the same whatever their order."""
    kinds: dict[tuple, list[Session]] = {}
    for session in sessions:
        kinds.setdefault(session.key, []).append(session)
    return tuple(_end_to_end(kinds[key]) for key in sorted(kinds, key=repr))


def _end_to_end(sessions: list[Session]) -> Session:
    pieces: dict[str, tuple[Remembered, Session]] = {}
    for take, session in sorted(((take, each) for each in sessions for take in each.takes), key=lambda p: _order(p[0])):
        pieces.setdefault(take.sha256, (take, session))
    ordered = list(pieces.values())
    if len(sessions) == 1 and [take for take, _ in ordered] == list(sessions[0].takes):
        return sessions[0]
    takes, start = [], 0
    for take, _ in ordered:
        frames = take.stop - take.start
        takes.append(replace(take, start=start, stop=start + frames))
        start += frames

    def together(name: str) -> Array | None:
        if getattr(ordered[0][1], name) is None:
            return None
        return np.concatenate([getattr(session, name)[take.start : take.stop] for take, session in ordered])

    arrays = {name: together(name) for name in ("positions", "trust", "rotations", "shifts")}
    return replace(ordered[0][1], takes=tuple(takes), **arrays)


def _order(take: Remembered) -> tuple[str, str]:
    return take.name, take.sha256
