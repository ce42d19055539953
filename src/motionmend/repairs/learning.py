"""Takes that teach repairs: gathered from files, folders, patterns and saved memories, judged, and remembered."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from ..diagnosis.diagnosing import diagnose
from ..diagnosis.findings import undone
from ..errors import InputError
from ..io import FORMATS, load
from ..memory.sessions import RATE, RATE_SHARE, Session, content, joined, remember
from ..memory.storing import SUFFIX, Memory
from ..motion import Take
from ..progress import Stage, silent

Teacher = str | os.PathLike | Take | Memory

LEAST_RATE = 45.0  # frames a second that are kept where the take's rate is no multiple of memory's
LEAST_SECONDS = 0.5  # shorter takes have no window


def learn(
    teachers: Iterable[Teacher],
    *,
    skip: Callable[[Exception, Path], object] | None = None,
    read: Callable[[Path], Take] = load,
    stage: Stage = silent,
) -> Memory:
    """A memory of takes, for `repair(…, learn=memory)`; the same whatever their order.

    Parameters
    ----------
    teachers : files, folders (all takes in and below them), patterns such as "session/*.c3d", saved memories, or Takes.
        What `diagnose` distrusts in them does not teach.
    skip : called with what is wrong with a file instead of raising it; the rest is learned.
    read : how a file is read.
    stage : called with what is done next, for progress.

    Raises
    ------
    InputError : for a file that cannot be read, a folder without takes, and if nothing is left to learn from.
    """
    sessions: list[Session] = []
    for teacher in teachers:
        if isinstance(teacher, Memory):
            sessions += teacher.sessions
        elif isinstance(teacher, Take):
            sessions.append(_judged(teacher, Path(teacher.source).name))
        else:
            sessions += _from_files(teacher, skip, read, stage)
    if not sessions:
        raise InputError("there is nothing to learn from", expected="files, folders or patterns with takes")
    return Memory(joined(sessions))


def _from_files(
    teacher: str | os.PathLike, skip: Callable[[Exception, Path], object] | None, read: Callable[[Path], Take],
    stage: Stage,
) -> Iterator[Session]:  # fmt: skip
    try:
        files = _files(teacher)
    except InputError as error:
        if skip is None:
            raise
        skip(error, Path(teacher))
        return
    for number, path in enumerate(files, 1):
        stage(f"learning from {path.name} ({number} of {len(files)})")
        try:
            if path.suffix == SUFFIX:
                yield from Memory.open(path).sessions
            else:
                yield _judged(read(path), path.name)
        except (InputError, OSError, MemoryError) as error:
            if skip is None:
                raise
            skip(error, path)


def _files(teacher: str | os.PathLike) -> list[Path]:
    path = Path(teacher)
    suffixes = {suffix for format in FORMATS.values() if format.reads for suffix in format.suffixes} | {SUFFIX}
    if path.is_dir():
        found = sorted(each for each in path.rglob("*") if each.suffix.lower() in suffixes and each.is_file())
        if not found:
            raise InputError("no take is in this folder", where=path, expected="files such as walk.bvh or walk.c3d")
        return found
    pattern = str(teacher)  # which may begin at the root, unlike those of Path.glob
    if not path.exists() and (found := sorted(map(Path, glob.glob(pattern, recursive=True)))):  # noqa: PTH207
        return [each for each in found if each.is_file()]
    return [path]  # what is wrong with it is told when it is read


def _judged(take: Take, name: str) -> Session:
    """A session of what of a take is good."""
    sha256, take = content(take), _thinned(take)
    if take.motion.seconds < LEAST_SECONDS:
        raise InputError(f"{take.motion.seconds:.2f} s are too short to learn from", where=take.source)
    found = diagnose(take)
    wrong = found.untrusted.copy()
    for finding in found.findings:
        if finding.is_undone:
            take = undone(take, finding)
        elif finding.cause == "t-pose":
            wrong[finding.start : finding.stop] = True
    take = take.distrust(wrong)
    return remember(take.motion, take.rig, name, sha256)


def _thinned(take: Take) -> Take:
    """Every second, third, … frame, where that is enough: the whole take need not be judged."""
    step = round(take.fps / RATE)
    if not step or abs(take.fps / RATE / step - 1) >= RATE_SHARE:
        step = int(take.fps / LEAST_RATE)
    if step < 2:
        return take
    kept = slice((len(take) - 1) % step // 2, None, step)
    motion = replace(
        take.motion, positions=take.motion.positions[kept], observed=take.motion.observed[kept], fps=take.fps / step
    )
    if take.rig is None:
        return take.with_motion(motion)
    names = ("rotations", "translations", "trusted")
    rig = replace(take.rig, **{name: getattr(take.rig, name)[kept] for name in names})
    return replace(take, rig=rig, motion=motion)
