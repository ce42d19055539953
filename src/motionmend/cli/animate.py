"""The verb `animate`: a pose, and paths of some joints, become animations of the same rig."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional, UseAppendAction, arg

from ..errors import InputError
from .common import Output, Reading, refuse_to_overwrite

File = Annotated[Optional[Path], arg(metavar="FILE")]


@dataclass(frozen=True, kw_only=True)
class Animate(Reading):
    """Let a network animate the person of one pose, along the paths of any joints, or of none.

    Given paths are met and bones keep their lengths: what the network misses is mended afterwards, and told.
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """A take with the pose. What comes out has its rig, its rate and its units."""
    output: Output
    """The animation; for several, a folder."""
    frame: int = 0
    """The frame of the take in which the pose is; 0 is the first."""
    trajectory: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="JOINT=CSV")] = ()
    """A joint and a CSV file with the columns t (seconds) or frame, x, y, z: where it is to be. Repeatable."""
    like: File = None
    """Another take, from which the paths of --joints are taken, moved to the pose and scaled to its body."""
    joints: str = ""
    """Joints of --like, with commas between: LeftHand,RightHand."""
    seconds: Optional[float] = None
    """How long; otherwise as long as the longest path, or 2 s."""
    frames: Optional[int] = None
    """How many frames."""
    samples: int = 1
    """How many variants."""
    mean: bool = False
    """Instead of a sample, the network's one best guess."""
    diversity: float = 1.0
    """From 0, all variants are the best guess, to 1, as different as the network knows."""
    seed: int = 0
    """Of the variants; the same gives the same."""
    network: str = "trajevae"
    """A generative network: its name, or the folder of a checkpoint or a run."""
    raw: bool = False
    """The network's own output: --raw-paths, --raw-bones and --raw-floor."""
    raw_paths: bool = False
    """Leave joints beside their paths where the network has them there."""
    raw_bones: bool = False
    """Leave bones as long as the network makes them; then 21 joints are written as positions."""
    raw_floor: bool = False
    """Let the body float over the ground or sink into it as it does there."""
    map: File = None
    """A TOML file that says which joint is which."""
    report: File = None
    """Where the JSON report goes; otherwise beside the output, as OUTPUT.report.json."""
    picture: Annotated[Optional[Path], arg(metavar="PNG")] = None
    """Also draw the variants over each other."""
    json: bool = False
    """Print the report as JSON."""
    force: bool = False
    """Overwrite files that exist."""

    def run(self) -> int:
        from ..animation.animating import animate, generative
        from ..animation.report import AnimationReport
        from ..io import load, save, write_whole
        from ..progress import following

        targets, folder = self._targets()
        base = folder / self.file.stem if folder else targets[0]
        report = self.report or base.with_name(base.name + ".report.json")
        if self.picture and self.picture.suffix.lower() != ".png":
            raise InputError("the picture is a PNG", where=self.picture, expected="a name that ends in .png")
        wanted = [*targets, report, *([self.picture] if self.picture else [])]
        there = [each for each in wanted if folder is None or folder.exists() or each.parent != folder]
        refuse_to_overwrite(there, self.file, self.force)
        network = generative(self.network)
        with following(self.file.name) as stage:
            stage("reading")
            take = self.load(self.file)
            takes = animate(
                take, [_named(spec) for spec in self.trajectory], like=load(self.like) if self.like else None,
                joints=self.joints.split(",") if self.joints else (), frame=self.frame, seconds=self.seconds,
                frames=self.frames, samples=self.samples, mean=self.mean, diversity=self.diversity, seed=self.seed,
                network=network, raw_paths=self.raw or self.raw_paths, raw_bones=self.raw or self.raw_bones,
                raw_floor=self.raw or self.raw_floor, map=self.map, stage=stage,
            )  # fmt: skip
            stage("writing")
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
            for target, each in zip(targets, takes):
                save(each, target, force=self.force)
            told = AnimationReport.joined([each.report.written(str(to)) for to, each in zip(targets, takes)])
            write_whole(report, lambda temporary: temporary.write_text(told.to_json(), encoding="utf-8"))
            if self.picture:
                from ..animation.picture import draw_animation

                write_whole(self.picture, lambda temporary: draw_animation(takes, temporary))
        written = targets[0] if not folder else f"{folder} ({len(targets)} takes)"
        print(told.to_json() if self.json else f"{told}\n\nwritten: {written}\nreport:  {report}")
        return 0

    def _targets(self) -> tuple[list[Path], Path | None]:
        """The files to write, and the folder that they are in where it is one."""
        from ..io import format_of

        many, out = self.samples > 1, self.output
        if many and not out.is_dir() and (out.suffix or out.exists()):
            raise InputError("several variants need a folder", where=out, hint="say -o variants/")
        if not many and not out.is_dir() and out.suffix:
            targets, folder = [out], None
        else:
            suffix = self.file.suffix if format_of(self.file).writes else ".bvh"
            numbers = ["mean"] if self.mean else range(1, self.samples + 1)
            targets, folder = [out / f"{self.file.stem}_{number}{suffix}" for number in numbers], out
        for target in targets:
            if not format_of(target).writes:
                hint = "write .bvh instead"
                raise InputError("this format can be read but not written", where=target, hint=hint)
        return targets, folder


def _named(spec: str) -> tuple[str, Path]:
    name, mark, path = spec.partition("=")
    if not (name and mark and path):
        expected = "a joint and a CSV file, such as LeftHand=lhand.csv"
        raise InputError(f"cannot read the trajectory {spec!r}", expected=expected)
    return name, Path(path)
