"""What blending and chaining share: clips at one rate, which joint is which, where a body goes, and a report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..body.joints import LIMBS
from ..body.mapping import Mapping, map_rig, to_body
from ..errors import InputError
from ..motion import Array, Motion, Rig, Skeleton, Take
from ..networks.rows import path_of
from ..networks.windows import between, resample
from ..ranges import Range, parse_frames, parse_range
from ..repairs.report import Filled, table, to_json
from ..rotations import normalised

PATH_RATE = 60.0  # frames per second for which `rows.path_of` smooths
REST_DEGREES = 10.0  # rest poses that differ by less mean the same by a rotation

Path2D = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Clip:
    """Some frames of a take, at a rate that may be another.

    take : as it was read. start, stop : its frames `[start, stop)`.
    rig, motion : those frames at `motion.fps`; `rig` is None for points.
    frames : `(len(motion),)` the frame of `take` that each is, or lies after. exact : whether each is one.
    """

    take: Take
    start: int
    stop: int
    rig: Rig | None
    motion: Motion
    frames: Array
    exact: bool

    @classmethod
    def of(cls, take: Take, frames: Range | None, fps: float) -> Clip:
        """Frames of a take at `fps`; the first stays where it is. Between frames run cubics.

        Raises
        ------
        InputError : for a range that holds no frame of the take, or a rate that cannot be reached.
        """
        start, stop = frames_of(":" if frames is None else frames, take)
        ratio = Fraction(take.fps / fps).limit_denominator(1001) if 0 < fps < np.inf else Fraction(0)
        if not ratio:
            raise InputError(f"cannot go from {take.fps:g} to {fps:g} frames per second", where=take.source)
        count = (stop - start - 1) * ratio.denominator // ratio.numerator + 1
        frame, rest = np.divmod(np.arange(count) * ratio.numerator, ratio.denominator)
        frame, beyond = frame + start, rest / ratio.denominator
        if not rest.any():
            motion, rig = replace(take.motion, fps=fps), take.rig
            motion = replace(motion, positions=motion.positions[frame], observed=motion.observed[frame])
            rig = rig and _with(rig, rig.rotations[frame], rig.translations[frame], rig.trusted[frame])
        elif take.rig is None:
            rig = None
            positions, observed = between(take.motion.positions, take.motion.observed, frame, beyond)
            motion = Motion(positions, observed, fps, take.skeleton)
        else:
            rig = _rig_between(take.rig, frame, beyond)
            motion = rig.motion(fps)
        return cls(take, start, stop, rig, motion, frame, not rest.any())

    @property
    def seconds(self) -> Array:
        """`(len(motion),)` the time of each frame in the take."""
        return self.start / self.take.fps + np.arange(len(self.motion)) / self.motion.fps

    @property
    def name(self) -> str:
        return Path(self.take.source).name

    def __len__(self) -> int:
        return len(self.motion)


def _with(rig: Rig, rotations: Array, translations: Array, trusted: Array) -> Rig:
    return replace(rig, rotations=rotations, translations=translations, trusted=trusted)


def _rig_between(rig: Rig, frame: Array, beyond: Array) -> Rig:
    """The rig `beyond` frames after each `frame`: cubics through quaternions on one side of their sphere."""
    flips = np.sum(rig.rotations[1:] * rig.rotations[:-1], axis=-1, keepdims=True) < 0
    sign = np.cumprod(np.where(np.pad(flips, ((1, 0), (0, 0), (0, 0))), -1.0, 1.0), axis=0)
    turns, seen = between(rig.rotations * sign, rig.trusted, frame, beyond)
    shifts, _ = between(rig.translations, rig.trusted, frame, beyond)
    there = seen[..., None]
    rotations = np.where(there, normalised(turns.astype(float)), rig.rotations[frame])
    return _with(rig, rotations, np.where(there, shifts, rig.translations[frame]), seen)


def frames_of(frames: Range, take: Take) -> tuple[int, int]:
    """`ranges.parse_range`, with the take's name in the error."""
    try:
        return parse_range(frames, len(take), take.fps)
    except InputError as error:
        raise InputError(str(error), where=take.source) from None


def frame_of(at: int | str, take: Take) -> int:
    """A frame of the take, from 120, "120" or "2s"; InputError if the take has none of that number."""
    start, _ = frames_of(f"{str(at).strip()}:", take)
    return start


def length_of(length: int | str, fps: float, what: str) -> int:
    """A length in frames, from 75, "75" or "1.25s"; InputError if it is less than one frame."""
    try:
        count = parse_frames(str(length).strip(), fps)
    except InputError as error:
        raise InputError(f"{what}: {error}") from None
    if count < 1:
        raise InputError(f"{what} of {count} frames", expected="one frame or more", hint=f"say {what} such as 0.5s")
    return count


def person_in(take: Take, overrides: dict[str, str] | None = None) -> Mapping:
    """Which of the take's joints is which of BODY's; InputError if there is no person in it."""
    seen = np.where(take.motion.observed[..., None], take.motion.positions, np.nan)
    mapping = map_rig(take.skeleton, seen, overrides)
    if not mapping.is_person:
        hint = "say in a map file which joint is which" if mapping.found else "is it a take of a person?"
        raise InputError("no human body was found among the joints", where=take.source, hint=hint)
    return mapping


def overrides_for(take: Take, first: Take, overrides: dict[str, str] | None) -> dict[str, str] | None:
    """What the user says of the first take's joints, for another one that has joints of those names."""
    wanted = {name for name in (overrides or {}).values() if name}
    return overrides if take is first or wanted <= set(take.skeleton.names) else None


def counterparts(skeleton: Skeleton, other: Skeleton, ours: Mapping, theirs: Mapping) -> tuple[Array, Array]:
    """For each joint of a skeleton the joint of another that is the same, and the one above from which both are seen.

    Skeletons of the same names and parents agree joint by joint, others in the bones of BODY's limbs: where a spine
    bends and where a collar bone begins is each rig's own. `(joints,)` each, -1 for none.
    """
    if skeleton == other and skeleton.has_bones:
        return np.arange(len(skeleton)), np.array(skeleton.parents)
    same, above = np.full((2, len(skeleton)), -1)
    for limb in LIMBS.values():
        there = [joint for joint in limb if min(ours.joints[joint], theirs.joints[joint]) >= 0]
        for start, end in pairwise(there):
            same[[ours.joints[start], ours.joints[end]]] = theirs.joints[start], theirs.joints[end]
            above[ours.joints[end]] = ours.joints[start]
    return same, above


def ancestors(skeleton: Skeleton, joint: int) -> list[int]:
    """The joints above one, the nearest first."""
    found = []
    while (joint := skeleton.parents[joint]) >= 0:
        found.append(joint)
    return found


def same_rest(rig: Rig, other: Rig) -> bool:
    """Whether two rigs of the same joints rest alike, in all but size: so that a rotation means the same in both."""
    if rig.skeleton != other.skeleton:
        return False
    lengths = [np.linalg.norm(each.offsets, axis=-1) for each in (rig, other)]
    cosine = np.sum(rig.offsets * other.offsets, axis=-1)
    bones = (lengths[0] > 0.01) & (lengths[1] > 0.01)
    least = np.cos(np.radians(REST_DEGREES)) * lengths[0] * lengths[1]
    return bool(np.all(cosine[bones] >= least[bones]))


def path_in(take: Take, mapping: Mapping) -> Path2D:
    """Where the body stands and faces, by `rows.path_of`: a function of times `(n,)` in seconds.

    It gives the root on the floor `(n, 2)`, metres, and the heading `(n,)`, radians about +Y from +Z towards +X.
    """
    from scipy.interpolate import CubicSpline

    try:
        body = resample(to_body(take.motion, mapping), PATH_RATE)
    except ValueError as error:
        raise InputError(str(error), where=take.source) from None
    root, heading = path_of(body.positions[None], body.observed[None])
    rows = np.concatenate([root[0], np.unwrap(heading[0])[:, None]], axis=1)
    if len(rows) < 2:
        rows = np.repeat(rows, 2, axis=0)
    curve = CubicSpline(np.arange(len(rows)) / PATH_RATE, rows)

    def path(seconds: Array) -> tuple[Array, Array]:
        at = curve(seconds)
        return at[:, :2], at[:, 2]

    return path


@dataclass(frozen=True)
class Piece:
    """One stretch `[start, stop)` of the result that comes from a file: whose joints, from which frames, and how."""

    start: int
    stop: int
    joints: tuple[str, ...]
    source: str
    frames: tuple[int, int]
    how: str


@dataclass(frozen=True)
class Composition:
    """What was put together from what, what was filled between, and checks of it. `to_json` is for machines.

    samples, changed : joints (or markers) times frames of the result; how many of them were filled or came from
        elsewhere than the first take. checks : as those of a repair.
    """

    source: str
    format: str
    frames: int
    fps: float
    units: str
    samples: int
    changed: int
    pieces: list[Piece]
    fills: list[Filled] = field(default_factory=list)
    checks: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    output: str = ""

    def to_json(self) -> str:
        return to_json(asdict(self))

    def __str__(self) -> str:
        lines = [
            f"{self.source}: {self.format.upper()}, {self.frames} frames at {self.fps:g} fps",
            f"  units: {self.units}",
            *(f"  note: {note}" for note in self.notes),
            "",
            "put together",
        ]
        rows = [
            (f"{it.start}:{it.stop}", few(it.joints), f"{it.source} {it.frames[0]}:{it.frames[1]}", it.how)
            for it in self.pieces
        ]
        lines.append(table(("frames", "joints", "from", ""), rows))
        fills = [
            (f"{each.start}:{each.stop}", f"{each.seconds:.2f} s", few(each.joints), each.method, each.why)
            for each in self.fills
        ]
        lines += ["", "filled", table(("frames", "length", "joints", "method", "why"), fills)] if fills else []
        rows = [(name, check["text"], "ok" if check["ok"] else "LOOK") for name, check in self.checks.items()]
        return "\n".join([*lines, "", "checks", table(("check", "value", ""), rows)])


def few(names: Sequence[str], most: int = 3) -> str:
    """The first few names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
