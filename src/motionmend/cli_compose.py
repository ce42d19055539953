"""The verbs `blend` and `chain`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Optional

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, arg

from .cli import Reading, refuse_to_overwrite
from .cli_options import Output, paths
from .errors import InputError

Clips = Annotated[tuple, paths("CLIP")]
_RANGE = re.compile(r"(.+):([^:/\\]*:[^:/\\]*)")


@dataclass(frozen=True, kw_only=True)
class Blend(Reading):
    """Put the motion that some joints have in another take into this one; touch nothing else.

    The joints are turned as a body sees them from where it faces, and take some time to go there and back.
    """

    file: Positional[Path]
    """The take."""
    output: Output
    """The new file."""
    source: Annotated[Path, arg(name="from", metavar="FILE")]
    """The take whose motion is put in; of any rate, and of any rig in which a person is found."""
    joints: Annotated[str, arg(metavar="NAMES")]
    """Joints, named as in the take: RightArm,RightForeArm,RightHand."""
    frames: Annotated[str, arg(metavar="START:STOP")]
    """Which frames of the other take: 40:55 or 0.5s:0.8s."""
    at: Annotated[str, arg(metavar="FRAME")]
    """Where they begin in this one: 120 or 2s."""
    fade: str = "0.4s"
    """How long the joints take to go there, and to go back."""
    whole: bool = False
    """Hide the rest of the body for that time, too, so that a network may let it answer."""
    method: str = "auto"
    """How to fill; a method of `repair`."""
    map: Optional[Path] = None
    """A TOML file that says which joint is which."""
    json: bool = False
    """Print the report as JSON."""
    force: bool = False
    """Overwrite files that exist."""

    def run(self) -> int:
        from .blending import blend
        from .progress import following

        _checked(self.output, (self.file, self.source), self.force)
        with following(self.file.name) as stage:
            stage("reading")
            take, source = self.load(self.file), self.load(self.source)
            result = blend(
                take, source, joints=self.joints, frames=self.frames, at=self.at, fade=self.fade, whole=self.whole,
                method=self.method, map=self.map, stage=stage,
            )  # fmt: skip
        return _written(result, self)


@dataclass(frozen=True, kw_only=True)
class Chain(Reading):
    """Make one motion of several clips: each goes on from where the last one ended, and the gaps are filled.

    Clips are turned about the vertical and moved on the floor, and stay as they are in all else.
    """

    clips: Positional[Clips]
    """Takes in their order. walk.bvh:40:80 means these frames of it."""
    output: Output
    """The new file, with the first clip's rig and rate."""
    gap: str = "1s"
    """Between two clips: 75 or 1.25s; 50,100,75 for one length each."""
    method: str = "auto"
    """How to fill; a method of `repair`."""
    map: Optional[Path] = None
    """A TOML file that says which joint is which."""
    json: bool = False
    """Print the report as JSON."""
    force: bool = False
    """Overwrite files that exist."""

    def run(self) -> int:
        from .chaining import chain
        from .progress import following

        named = [_clip(str(name)) for name in self.clips]
        _checked(self.output, [path for path, _ in named], self.force)
        with following(self.output.name) as stage:
            stage("reading")
            takes = {path: self.load(path) for path in dict.fromkeys(path for path, _ in named)}
            result = chain(
                [(takes[path], frames) for path, frames in named], gap=self.gap, method=self.method, map=self.map,
                stage=stage,
            )  # fmt: skip
        return _written(result, self)


def _clip(name: str) -> tuple[Path, str]:
    """A file and its frames: all of them, unless two numbers follow its name."""
    found = _RANGE.fullmatch(name)
    if found and not Path(name).exists():
        return Path(found[1]), found[2]
    return Path(name), ":"


def _report(output: Path) -> Path:
    return output.with_name(output.name + ".report.json")


def _checked(output: Path, sources: Sequence[Path], force: bool) -> None:
    """Refuse what cannot be written before the work starts."""
    from .io import format_of

    if not format_of(output).writes:
        raise InputError("this format can be read but not written", where=output, hint="write .bvh instead")
    for source in sources:
        if source.exists():
            refuse_to_overwrite([output, _report(output)], source, force)


def _written(result: Any, asked: Blend | Chain) -> int:
    """Write the take and its report, and print it."""
    from .io import save, write_whole

    save(result, asked.output, force=asked.force)
    told, report = replace(result.report, output=str(asked.output)), _report(asked.output)
    write_whole(report, lambda temporary: temporary.write_text(told.to_json(), encoding="utf-8"))
    print(told.to_json() if asked.json else f"{told}\nwritten: {asked.output}\nreport:  {report}")
    return 0


def parsed(argv: Sequence[str]) -> Any:
    """The command that a command line means, with its options; `argv` begins with the verb."""
    return tyro.extras.subcommand_cli_from_dict(
        {"blend": Blend, "chain": Chain}, prog="motionmend", args=argv, config=(FlagCreatePairsOff,)
    )
