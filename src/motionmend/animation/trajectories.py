"""Paths that joints are to follow: from CSV files, from arrays, from another take; and where they are at any time."""

from __future__ import annotations

import csv
from collections.abc import Mapping as MappingABC
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.mapping import Mapping, map_rig, to_body
from ..body.measures import facing, stature
from ..constraints.ground import ground
from ..errors import InputError, nearest_names
from ..io.csv_cells import NUMBER
from ..motion import Motion, Skeleton, Take, Units
from ..networks.spaces import turned
from ..units import to_metres

Array = np.ndarray

TIMES = {"t": True, "time": True, "frame": False}  # titles of the first column: whether it holds seconds


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where one joint is to be, at keys that may be sparse; nothing is said outside the first and the last.

    joint : an index of BODY. name : as the user called it. times : `(keys,)` seconds since the pose, increasing.
    points : `(keys, 3)` metres, Y up, world. source : the file or array, for messages.
    """

    joint: int
    name: str
    times: Array
    points: Array
    source: str = ""

    def at(self, times: Array, leeway: float) -> tuple[Array, Array]:
        """Points `(n, 3)` at `times (n,)`, and `(n,)` whether the path says anything then.

        Between keys runs the cubic with velocities from parabolas through three keys; `leeway` seconds beyond the ends,
        half a frame, are the ends themselves: a key means the nearest frame.
        """
        first, last = self.times[0], self.times[-1]
        given = (times >= first - leeway) & (times < last + leeway)
        if len(self.times) == 1:
            return np.tile(self.points, (len(times), 1)), given
        slope = np.gradient(self.points, self.times, axis=0, edge_order=2 if len(self.times) > 2 else 1)
        times = np.clip(times, first, last)
        key = np.clip(np.searchsorted(self.times, times, "right") - 1, 0, len(self.times) - 2)
        span = np.diff(self.times)[key, None]
        u = (times - self.times[key])[:, None] / span
        start, stop = self.points[key], self.points[key + 1]
        curve = start + u**2 * (3 - 2 * u) * (stop - start)
        curve += span * (u * (1 - u) ** 2 * slope[key] + u**2 * (u - 1) * slope[key + 1])
        return curve, given


def trajectory(joint: int, name: str, points: Any, times: Any = None, *, fps: float, source: str = "") -> Trajectory:
    """A checked Trajectory of an array `(keys, 3)` of metres; `times (keys,)` seconds, or one key a frame.

    Raises
    ------
    InputError : for an array of another shape, without keys or with NaN, and for times that do not increase.
    """
    where = source or f"the trajectory of {name}"
    try:
        points = np.asarray(points, float)
        times = np.arange(len(points)) / fps if times is None else np.asarray(times, float)
    except (TypeError, ValueError):
        raise InputError("not numbers", where=where, expected="(keys, 3) metres, or times and these") from None
    if points.ndim != 2 or points.shape[1:] != (3,) or times.shape != points.shape[:1]:
        found = f"points {points.shape} at times {times.shape}"
        raise InputError(found, where=where, expected="points (keys, 3) and as many times")
    if not len(points):
        raise InputError("it has no keys", where=where)
    for row in np.flatnonzero(~np.isfinite(points).all(axis=1) | ~np.isfinite(times)):
        hint = "leave out keys that are not known: those around them are joined"
        raise InputError(f"key {row} is not finite", where=where, hint=hint)
    if times[0] < 0:
        raise InputError(f"it begins {-times[0]:g} s before the pose", where=where, expected="times from 0 on")
    back = np.flatnonzero(np.diff(times) <= 0)
    if len(back):
        found = f"time goes from {times[back[0]]:g} to {times[back[0] + 1]:g} s at key {back[0] + 1}"
        raise InputError(found, where=where, expected="times that increase")
    return Trajectory(joint, name, times, points, source)


def read(path: Path, joint: int, name: str, units: Units, fps: float) -> Trajectory:
    """The trajectory in a CSV file with the columns `t` (seconds) or `frame`, and `x`, `y`, `z`; others are not read.

    Parameters
    ----------
    units : of x, y and z. fps : of the frames. Both those of the pose's file.

    Raises
    ------
    InputError : with the line, for whatever is wrong in the file.
    """
    rows = _rows(path)
    columns = _columns(rows[0][1], f"{path}:{rows[0][0]}")
    titles = [rows[0][1][column].strip() for column in columns]
    values = np.empty((len(rows) - 1, 4))
    for key, (line, cells) in enumerate(rows[1:]):
        if len(cells) < len(rows[0][1]):
            found = f"{len(cells)} columns"
            raise InputError(found, where=f"{path}:{line}", expected=f"{len(rows[0][1])}, as in the titles")
        for at, column in enumerate(columns):
            values[key, at] = _number(cells[column].strip(), titles[at], f"{path}:{line}")
        if values[key, 0] < 0 or (key and values[key, 0] <= values[key - 1, 0]):
            before = f" after {values[key - 1, 0]:g}" if key else ""
            expected = "numbers that increase" if key else "numbers from 0 on: 0 is the pose"
            raise InputError(f"{titles[0]} {values[key, 0]:g}{before}", where=f"{path}:{line}", expected=expected)
    if not len(values):
        raise InputError("there are titles but no keys", where=f"{path}:{rows[0][0]}")
    times = values[:, 0] if TIMES[titles[0].lower()] else values[:, 0] / fps
    return trajectory(joint, name, to_metres(values[:, 1:], units), times, fps=fps, source=str(path))


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """The lines of a table that are not blank: their numbers from 1, and their cells."""
    if not path.is_file():
        raise InputError("this is a folder" if path.exists() else "no such file", where=path)
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip(" ,;\t\0\"")]
    if not lines:
        raise InputError("the file is empty", where=path, expected="the titles t (or frame), x, y, z and a row a key")
    separator = max("\t;,", key=lines[0][1].count)
    comma = separator != "," and any("," in line for _, line in lines[1:])
    parsed = csv.reader((line for _, line in lines), delimiter=separator)
    rows = [(number, cells) for (number, _), cells in zip(lines, parsed)]
    return [(number, [cell.replace(",", ".") for cell in cells]) for number, cells in rows] if comma else rows


def _columns(titles: list[str], where: str) -> list[int]:
    """Where the times and x, y, z stand."""
    plain = [title.strip().lower() for title in titles]
    timed = [title for title in TIMES if title in plain]
    lacking = ["t or frame"] * (not timed) + [axis for axis in "xyz" if axis not in plain]
    if lacking:
        found = "no column is called " + ", ".join(lacking)
        raise InputError(found, where=where, expected="a first line with the titles t (seconds) or frame, x, y, z")
    return [plain.index(title) for title in (timed[0], *"xyz")]


def _number(cell: str, title: str, where: str) -> float:
    if NUMBER.fullmatch(cell):
        return float(cell)
    hint = "leave the row out if it is not known: keys may be sparse"
    raise InputError(f"{cell[:40]!r} in column {title!r} is not a finite number", where=where, hint=hint)


def from_take(other: Take, names: Sequence[str], body: Motion, frame: int) -> list[Trajectory]:
    """The paths of joints of another take, carried to a pose as if its person had begun there.

    Where the other person's hips stand over the ground in that take's first frame, and where they face, becomes where
    the pose's do; lengths are scaled by the ratio of the statures.

    Parameters
    ----------
    names : joints as the other take calls them, or BODY's. body : the pose's take as BODY (`mapping.to_body`); frame :
        of the pose.

    Raises
    ------
    InputError : for names that the other take does not have, and where either holds no person who can be placed.
    """
    mapping = map_rig(other.skeleton, np.where(other.motion.observed[..., None], other.motion.positions, np.nan))
    if not mapping.is_person:
        raise InputError("no human body was found among the joints", where=other.source)
    theirs = to_body(other.motion, mapping)
    here, size = _standing(body, frame, "the pose")
    begin = next((at for at in range(len(theirs)) if _can_stand(theirs, at)), 0)
    there, their_size = _standing(theirs, begin, other.source)
    scale = size / their_size
    found = []
    for name in names:
        joint = joint_named(name, other.skeleton, mapping, other.source)
        seen = theirs.observed[:, joint].copy()
        seen[:begin] = False
        if not seen.any():
            raise InputError(f"{name} is nowhere observed", where=other.source)
        local = theirs.positions[seen, joint].astype(float) - there[0]
        points = here[0] + turned(local[:, None], np.full(len(local), here[1] - there[1]))[:, 0] * scale
        times = (np.flatnonzero(seen) - begin) / other.fps
        found.append(trajectory(joint, name, points, times, fps=other.fps, source=f"{name} of {other.source}"))
    return found


def _can_stand(body: Motion, frame: int) -> bool:
    one = Motion(body.positions[frame : frame + 1], body.observed[frame : frame + 1], body.fps, BODY)
    return bool(body.observed[frame, JOINT["hips"]] and np.isfinite(facing(one)).all())


def _standing(body: Motion, frame: int, where: str) -> tuple[tuple[Array, float], float]:
    """Where a body stands in a frame, `(3,)` on the ground under the hips, and faces, radians as `turned` has them;
    and its stature in metres."""
    size = stature(BODY, np.where(body.observed[..., None], body.positions, np.nan))
    if not size or not _can_stand(body, frame):
        raise InputError("hips, thighs and shoulders must be seen to carry a path over", where=where)
    forward = facing(Motion(body.positions[frame : frame + 1], body.observed[frame : frame + 1], body.fps, BODY))[0]
    hips = body.positions[frame, JOINT["hips"]].astype(float)
    origin = np.array([hips[0], ground(body), hips[2]])
    return (origin, float(np.arctan2(forward[0], forward[2]))), size


def joint_named(name: str, skeleton: Skeleton, mapping: Mapping, where: object = None) -> int:
    """The index in BODY of a joint, called as its file does or as BODY does.

    Raises
    ------
    InputError : for a name that neither has, and for a joint of the file that stands for none of BODY's.
    """
    named = {skeleton.names[joint]: JOINT[ours] for ours, joint in mapping.found.items()}
    if name in named:
        return named[name]
    if name in mapping.found:
        return JOINT[name]
    found = f"no joint is named {name!r}"
    if name in skeleton.names:
        found = f"{name} stands for none of the {len(BODY)} joints that networks know"
    elif name in JOINT:
        found = f"the rig has no joint for {name}"
    raise InputError(found, where=where, hint=nearest_names(name, named))


def gathered(
    asked: MappingABC[str, Any] | Sequence[tuple[str, Any]],
    skeleton: Skeleton,
    mapping: Mapping,
    units: Units,
    fps: float,
) -> list[Trajectory]:
    """Trajectories of what a user gives: names, each with a CSV file, an array of points, or times and points.

    Raises
    ------
    InputError : for names that are not the pose's, and whatever is wrong with a file or an array.
    """
    found = []
    for name, what in asked.items() if isinstance(asked, MappingABC) else asked:
        joint = joint_named(name, skeleton, mapping)
        if isinstance(what, str | Path):
            found.append(read(Path(what), joint, name, units, fps))
        elif isinstance(what, tuple) and len(what) == 2:
            found.append(trajectory(joint, name, what[1], what[0], fps=fps))
        else:
            found.append(trajectory(joint, name, what, fps=fps))
    return found


def sampled(trajectories: Sequence[Trajectory], frames: int, fps: float) -> tuple[Array, Array]:
    """All paths at the times of frames: positions `(frames, J, 3)`, NaN where none is given, and `(frames, J)` bool.

    Raises
    ------
    InputError : where two of one joint speak of the same frame, and for a path that begins after the last frame.
    """
    points, given = np.full((frames, len(BODY), 3), np.nan), np.zeros((frames, len(BODY)), bool)
    for path in trajectories:
        values, said = path.at(np.arange(frames) / fps, 0.5 / fps)
        if not said.any():
            found = f"the path of {path.name} begins at {path.times[0]:g} s, after the last of {frames / fps:g} s"
            raise InputError(found, where=path.source or None, hint="make the animation longer with --seconds")
        if (said & given[:, path.joint]).any():
            found = f"two paths are given for {path.name} at {np.argmax(said & given[:, path.joint]) / fps:g} s"
            raise InputError(found, where=path.source or None)
        points[said, path.joint], given[said, path.joint] = values[said], True
    return points, given
