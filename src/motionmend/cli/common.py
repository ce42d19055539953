"""What verbs share: how a file is read, one error a line, nothing overwritten."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from ..errors import InputError


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What you know of a file better than it does itself; all of it is otherwise found or guessed."""

    unit: Optional[str] = None
    """Unit of length: m, cm, mm, in, ft, dm, or asf (CMU's)."""
    up: Optional[str] = None
    """Upward axis: y, z, x, -y, …"""
    fps: Optional[float] = None
    """Frames per second."""
    asf: Optional[Path] = None
    """Skeleton of an AMC take, where it is not the .asf beside it."""

    def load(self, path: Path):
        from ..io import load

        return load(path, unit=self.unit, up=self.up, fps=self.fps, asf=self.asf)


def each(files: Sequence[Path], one: Callable[[Path], None]) -> int:
    """Do `one` for every file; a bad one is named on stderr and does not stop the rest."""
    if not files:
        raise InputError("no file was named", hint="name one or more takes, such as walk.bvh")
    bad = 0
    for path in files:
        try:
            one(path)
        except BrokenPipeError:
            raise
        except (InputError, OSError, MemoryError) as error:
            bad += complain(error, path)
    if bad and len(files) > 1:
        print(f"motionmend: {bad} of {len(files)} files failed", file=sys.stderr)
    return min(bad, 1)


def complain(error: Exception, path: Path | None = None) -> int:
    """Print an error as one line that says which file it is about; returns exit status 1."""
    message = "not enough memory" if isinstance(error, MemoryError) else str(error)
    if path is not None and path.name not in message:
        message = f"{path}: {message}"
    print(f"motionmend: {message}", file=sys.stderr)
    return 1


def refuse_to_overwrite(targets: Sequence[Path], source: Path, force: bool) -> None:
    """Refuse before the work starts rather than after it; a take is never written over itself."""
    for target in targets:
        if not target.parent.is_dir():
            raise InputError("no such folder", where=target.parent)
        if target.exists() and target.samefile(source):
            raise InputError("this would overwrite the take itself", where=target, hint="choose another output")
        if target.exists() and not force:
            hint = "choose another name, or overwrite it with --force"
            raise InputError("the file exists", where=target, hint=hint)
