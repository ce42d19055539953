"""The command line: one dataclass a command, whose fields are its options."""

from __future__ import annotations

import importlib
import io
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path
from typing import Any, Literal, Optional

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

from . import __version__
from .cli_options import Files, Output
from .errors import InputError


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
        from .io import load

        return load(path, unit=self.unit, up=self.up, fps=self.fps, asf=self.asf)


@dataclass(frozen=True, kw_only=True)
class Inspect(Reading):
    """Say what is in a take, which rig it is, and what is untrusted and why. Changes nothing."""

    files: Positional[Files]
    """Takes: BVH, AMC (with its ASF), C3D, TRC, CSV, NPZ."""
    map: Optional[Path] = None
    """A TOML file that says which joint is which: `left_forearm = "LeftElbow"`."""
    json: bool = False
    """Print JSON for machines."""

    def run(self) -> int:
        from .inspection import inspect

        def one(path: Path) -> None:
            print(inspect(self.load(path), self.map, as_json=self.json))

        return each(self.files, one)


@dataclass(frozen=True, kw_only=True)
class Repair(Reading):
    """Find what is damaged in takes and repair it, or repair what you name; touch nothing else.

    With --gap or --lost only what they name is repaired, unless --find is given too.
    """

    files: Positional[Files]
    """Damaged takes."""
    output: Output
    """The repaired file; for several takes, a folder."""
    gap: UseAppendAction[tuple[str, ...]] = ()
    """Frames in which all joints are untrusted: 120:180, 0.5s:0.8s, :60. Repeatable."""
    lost: UseAppendAction[tuple[str, ...]] = ()
    """Joints or markers, named as in the file, and frames: LeftForeArm,LeftHand:300:360. Repeatable."""
    find: bool = False
    """Repair what diagnosis finds, besides what --gap and --lost name."""
    method: Literal[
        "auto", "linear", "hermite", "eased", "cubic", "pattern", "bones", "rigid", "xmae", "convae", "trajevae"
    ] = "auto"
    """How to fill; auto takes for each gap what won on validation takes for its kind and length."""
    samples: int = 1
    """With --method trajevae: in how many ways, each in a file of its own."""
    seed: int = 0
    """Of these ways; the same gives the same."""
    donors: tuple[str, ...] = ()
    """Markers or joints that `pattern` and `rigid` follow; otherwise they are chosen."""
    max_gap: Optional[str] = None
    """Fill gaps up to this long (60 or 0.5s); leave longer ones, marked as missing where the format can."""
    keep_longer: bool = False
    """With --max-gap: leave longer gaps exactly as the file has them, unmarked."""
    denoise: Optional[str] = None
    """Also smooth the whole take: savgol, butterworth, or a network (xmae). This changes every sample."""
    cutoff: float = 6.0
    """Low-pass frequency of --denoise butterworth, Hz."""
    plant_feet: bool = False
    """Hold feet still where they stand inside repaired frames."""
    map: Optional[Path] = None
    """A TOML file that says which joint is which."""
    report: Optional[Path] = None
    """Where the JSON report goes; otherwise beside the output, as OUTPUT.report.json."""
    picture: Optional[Path] = None
    """Also draw the repair, as PNG."""
    json: bool = False
    """Print the report as JSON."""
    force: bool = False
    """Overwrite files that exist."""

    def run(self) -> int:
        from .io import save, write_whole
        from .progress import following
        from .report import Variants
        from .varied_fill import must_vary

        must_vary(self.method, self.samples, self.seed)
        many, ways = len(self.files) > 1, self.samples > 1
        folder = many or ways or self.output.is_dir() or not self.output.suffix
        if many and (self.report or self.picture):
            raise InputError("--report and --picture name one file", hint="for several takes leave them out")
        if ways and self.picture:
            raise InputError("--picture draws one repair", hint="for several variants leave it out")
        if (many or ways) and not self.output.is_dir() and (self.output.suffix or self.output.exists()):
            what, hint = ("several takes", "say -o repaired/") if many else ("several variants", "say -o variants/")
            raise InputError(f"{what} need a folder", where=self.output, hint=hint)
        if folder:
            self.output.mkdir(parents=True, exist_ok=True)

        def one(path: Path) -> None:
            targets, report = self._targets(path, folder)
            wanted = [*targets, report, *([self.picture] if self.picture else [])]
            refuse_to_overwrite(wanted, path, self.force)
            with following(path.name) as stage:
                stage("reading")
                take, reports = self.load(path), []
                for number, target in enumerate(targets, 1):
                    fixed = self._repaired(take, number, stage)
                    stage("writing")
                    save(fixed, target, force=self.force)
                    reports.append(replace(fixed.report, output=str(target)))
                    if self.picture and fixed.report.repaired:
                        from .picture import draw_repair

                        write_whole(self.picture, lambda temporary, fixed=fixed: draw_repair(take, fixed, temporary))
                told = Variants(tuple(reports)) if ways else reports[0]
                write_whole(report, lambda temporary: temporary.write_text(told.to_json(), encoding="utf-8"))
            written = f"{self.output} ({len(targets)} takes)" if ways else targets[0]
            print(told.to_json() if self.json else f"{told}\nwritten: {written}\nreport:  {report}")

        return each(self.files, one)

    def _repaired(self, take, number: int, stage):
        """The take repaired, in the way of this number."""
        from .repairs import repair

        return repair(
            take, gaps=self.gap, lost=self.lost, find=self.find or None, method=self.method, donors=self.donors,
            max_gap=self.max_gap, keep_longer=self.keep_longer, denoise=self.denoise, cutoff=self.cutoff,
            plant_feet=self.plant_feet, seed=self.seed, variant=number, map=self.map,
            stage=stage if self.samples == 1 else lambda what: stage(f"variant {number}, {what}"),
        )  # fmt: skip

    def _targets(self, path: Path, folder: bool) -> tuple[list[Path], Path]:
        """The files to write for one take, and that of the report."""
        from .io import format_of

        target = self.output / path.name if folder else self.output
        if folder and not format_of(target).writes:
            target = target.with_suffix(".bvh")
        if not format_of(target).writes:
            raise InputError("this format can be read but not written", where=target, hint="write .bvh instead")
        if self.samples == 1:
            return [target], self.report or target.with_name(target.name + ".report.json")
        targets = [target.with_stem(f"{target.stem}_{number}") for number in range(1, self.samples + 1)]
        return targets, self.report or target.with_name(f"{path.stem}.report.json")


@dataclass(frozen=True, kw_only=True)
class Damage(Reading):
    """Plant damage in a good take, to try a repair on it. The same seed plants the same damage."""

    file: Positional[Path]
    """A good take."""
    output: Output
    """The damaged file."""
    gap: UseAppendAction[tuple[str, ...]] = ()
    """Frames in which all joints are lost: 120:180. In a BVH, which cannot say "missing", they hold still."""
    lost: UseAppendAction[tuple[str, ...]] = ()
    """Joints and frames: LeftForeArm,LeftHand:300:360."""
    held: UseAppendAction[tuple[str, ...]] = ()
    """Joints that freeze while the rest moves, and frames."""
    jump: UseAppendAction[tuple[str, ...]] = ()
    """Joints that jump away and back, and frames."""
    swap: UseAppendAction[tuple[str, ...]] = ()
    """Joints that are exchanged, each with its left or right twin, and frames: LeftHand:40:80."""
    displaced: UseAppendAction[tuple[str, ...]] = ()
    """Joints off by a constant offset, and frames."""
    dropout: float = 0.0
    """Share of single samples lost, 0 to 1."""
    noise: str = "0"
    """Standard deviation of Gaussian noise on positions: 5mm, 0.5cm, 0.005 (metres)."""
    seed: int = 0
    """Seed of the random numbers."""
    force: bool = False
    """Overwrite the output."""

    def run(self) -> int:
        from .io import save
        from .planting import plant
        from .ranges import parse_length, parse_lost, parse_range

        take = self.load(self.file)
        spots = {
            name: [parse_lost(spec, take) for spec in getattr(self, name)]
            for name in ("lost", "held", "jump", "swap", "displaced")
        }
        gaps = [parse_range(gap, len(take), take.fps) for gap in self.gap]
        noise = parse_length(self.noise)
        if not (gaps or any(spots.values()) or self.dropout or noise):
            raise InputError("no damage was named", hint="say --gap, --lost, --held, --jump, --dropout or --noise")
        if not 0 <= self.dropout <= 1:
            raise InputError(f"a dropout of {self.dropout:g}", expected="a share from 0 to 1")
        broken = plant(take, gaps=gaps, dropout=self.dropout, noise=noise, seed=self.seed, **spots)
        print(f"written: {save(broken, self.output, force=self.force)}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Compare(Reading):
    """Measure how far a take is from another: MPJPE, bone lengths, seams, samples that differ."""

    file: Positional[Path]
    """The reference."""
    other: Positional[Path]
    """The take to measure."""
    frames: Optional[str] = None
    """Only these frames: 120:180 or 1s:1.5s."""
    json: bool = False
    """Print JSON for machines."""

    def run(self) -> int:
        from .comparison import compare

        result = compare(self.load(self.file), self.load(self.other), self.frames)
        print(result.to_json() if self.json else result)
        return 0


@dataclass(frozen=True, kw_only=True)
class Convert(Reading):
    """Write a take in another format: BVH, C3D, TRC, CSV, NPZ, or GLB for Blender and game engines."""

    file: Positional[Path]
    """The take."""
    output: Output
    """The new file; its suffix names the format."""
    force: bool = False
    """Overwrite the output."""

    def run(self) -> int:
        from .io import save

        take = self.load(self.file)
        print(f"written: {save(take, self.output, force=self.force)}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Repair a bundled damaged take, and write it, its report and a picture into a folder."""

    output: Output = Path("demo")
    """The folder."""

    def run(self) -> int:
        from .demo import demo

        demo(self.output)
        return 0


COMMANDS = {
    "inspect": Inspect,
    "repair": Repair,
    "damage": Damage,
    "compare": Compare,
    "convert": Convert,
    "demo": Demo,
}

# Verbs with a file of their own, imported when they are asked for: module, and what the list of commands says.
ELSEWHERE = {
    "animate": ("cli_animate", "Animate a pose along the paths of some joints."),
    "blend": ("cli_compose", "Put the motion of some joints from another take into this one."),
    "chain": ("cli_compose", "Make one motion of several clips, the gaps between them filled."),
    "data": ("cli_data", "Build corpora from raw takes, and show what is in them."),
    "benchmark": ("cli_benchmark", "Measure methods by the papers' protocols."),
    "train": ("cli_train", "Train a network on corpora."),
    "models": ("cli_train", "List the trained networks that are installed."),
}


def parsed(argv: list[str]) -> Any:
    """The command that a command line means, with its options."""
    verb = argv[0] if argv else ""
    if verb in ELSEWHERE:
        module = importlib.import_module(f".{ELSEWHERE[verb][0]}", __package__)
        return module.parsed(argv)
    listed = {name: make_dataclass(name, (), namespace={"__doc__": told}) for name, (_, told) in ELSEWHERE.items()}
    return tyro.extras.subcommand_cli_from_dict(
        COMMANDS | listed, prog="motionmend", args=argv, config=(FlagCreatePairsOff,),
        description="Repair human motion capture, and touch nothing else.",
    )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0, 1 when any file failed, 2 for a wrong command line."""
    argv = list(sys.argv[1:] if argv is None else argv)
    if argv == ["--version"]:
        print(f"motionmend {__version__}")
        return 0
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot show "←" shows "?"
    try:
        status = parsed(argv).run()
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader (`head`, `less`) has seen enough. Python would complain again when it closes stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (InputError, OSError, MemoryError) as error:
        return complain(error)
    except KeyboardInterrupt:
        print("motionmend: stopped; nothing half-written is left", file=sys.stderr)
        return 130


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
