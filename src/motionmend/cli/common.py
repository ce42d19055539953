"""What verbs share: options that several have, how a file is read, one error a line, nothing overwritten."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Optional

from tyro.conf import arg
from tyro.constructors import PrimitiveConstructorSpec

from ..errors import InputError


def paths(what: str) -> PrimitiveConstructorSpec:
    """Any number of paths, shown in the help as `what`; `tuple[Path, ...]` has tyro import typeguard, which is slow."""
    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=f"{what} [{what} ...]",
        instance_from_str=lambda names: tuple(map(Path, names)),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda paths: [str(path) for path in paths],
    )


Files = Annotated[tuple, paths("FILE")]
Folders = Annotated[tuple, paths("FOLDER")]
Output = Annotated[Path, arg(aliases=["-o"], metavar="PATH")]


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


def report_of(output: Path) -> Path:
    return output.with_name(output.name + ".report.json")


def checked(output: Path, sources: Sequence[Path], force: bool) -> None:
    """Refuse what cannot be written before the work starts."""
    from ..io import format_of

    if not format_of(output).writes:
        raise InputError("this format can be read but not written", where=output, hint="write .bvh instead")
    for source in sources:
        if source.exists():
            refuse_to_overwrite([output, report_of(output)], source, force)


def written(result: Any, asked: Any) -> int:
    """Write the take and its report where a Blend or a Chain `asked` for them, and print it."""
    from ..io import save, write_whole

    save(result, asked.output, force=asked.force)
    told, report = replace(result.report, output=str(asked.output)), report_of(asked.output)
    write_whole(report, lambda temporary: temporary.write_text(told.to_json(), encoding="utf-8"))
    print(told.to_json() if asked.json else f"{told}\nwritten: {asked.output}\nreport:  {report}")
    return 0
