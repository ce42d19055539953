"""The verb `repair`: damaged takes in, repaired takes and reports out."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Optional

from tyro.conf import Positional, UseAppendAction

from ..errors import InputError
from .common import Files, Output, Reading, complain, each, refuse_to_overwrite


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
        "auto", "linear", "hermite", "eased", "cubic", "pattern", "bones", "rigid", "local", "regression", "pca",
        "average", "recall", "mend", "xmae", "convae", "trajevae",
    ] = "auto"
    """How to fill; auto takes for each gap what won on validation takes for its kind and length."""
    learn: tuple[str, ...] = ()
    """Takes that `recall` learns from besides this one: files, folders, patterns, memories. With --method recall
    several FILEs teach each other; `none` forbids it."""
    samples: int = 1
    """With --method trajevae: in how many ways, each in a file of its own."""
    seed: int = 0
    """Of these ways; the same gives the same."""
    donors: tuple[str, ...] = ()
    """Markers or joints that `pattern`, `rigid` and the fills that learn follow; otherwise they are chosen."""
    max_gap: Optional[str] = None
    """Fill gaps up to this long (60 or 0.5s); leave longer ones, marked as missing where the format can."""
    keep_longer: bool = False
    """With --max-gap: leave longer gaps exactly as the file has them, unmarked."""
    denoise: Optional[str] = None
    """Also smooth the whole take: savgol, butterworth, or a network (xmae). This changes every sample."""
    cutoff: float = 6.0
    """Low-pass frequency of --denoise butterworth, Hz."""
    join: bool = False
    """First give lost markers the samples of tracks without a label that go on there; inspect lists them."""
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
        from ..io import save, write_whole
        from ..progress import following
        from ..repairs.report import Variants
        from ..repairs.varied_fill import must_vary

        must_vary(self.method, self.samples, self.seed)
        self.must_learn()
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

        memory = self._memory()

        def one(path: Path) -> None:
            targets, report = self._targets(path, folder)
            wanted = [*targets, report, *([self.picture] if self.picture else [])]
            refuse_to_overwrite(wanted, path, self.force)
            with following(path.name) as stage:
                stage("reading")
                take, reports = self.load(path), []
                for number, target in enumerate(targets, 1):
                    fixed = self._repaired(take, number, stage, memory)
                    stage("writing")
                    save(fixed, target, force=self.force)
                    reports.append(replace(fixed.report, output=str(target)))
                    if self.picture and fixed.report.repaired:
                        from ..repairs.picture import draw_repair

                        write_whole(self.picture, lambda temporary, fixed=fixed: draw_repair(take, fixed, temporary))
                told = Variants(tuple(reports)) if ways else reports[0]
                write_whole(report, lambda temporary: temporary.write_text(told.to_json(), encoding="utf-8"))
            written = f"{self.output} ({len(targets)} takes)" if ways else targets[0]
            print(told.to_json() if self.json else f"{told}\nwritten: {written}\nreport:  {report}")

        return each(self.files, one)

    def must_learn(self) -> None:
        """Refuse --learn for methods that do not."""
        if self.learn and self.method not in ("auto", "recall"):
            raise InputError(f"--method {self.method} does not learn", hint="say --method recall, or leave --learn out")

    def _memory(self):
        """What --learn names, and for `recall` the takes that are to be repaired; None for nothing."""
        from ..progress import following
        from ..repairs.learning import learn

        named = () if self.learn == ("none",) else self.learn
        each_other = self.files if self.method == "recall" and len(self.files) > 1 and self.learn != ("none",) else ()
        if not named and not each_other:
            return None
        memories = []
        with following("learning") as stage:
            if named:
                memories.append(learn(named, skip=complain, stage=stage))
            if each_other:
                # What is wrong with one of these is told when it is its turn to be repaired.
                with suppress(InputError):
                    memories.append(learn(each_other, skip=lambda *_: None, read=self.load, stage=stage))
        if not memories:
            return None
        return learn(memories)

    def _repaired(self, take, number: int, stage, memory):
        """The take repaired, in the way of this number."""
        from ..repairs.repairing import repair

        return repair(
            take, gaps=self.gap, lost=self.lost, find=self.find or None, method=self.method, donors=self.donors,
            max_gap=self.max_gap, keep_longer=self.keep_longer, denoise=self.denoise, cutoff=self.cutoff,
            plant_feet=self.plant_feet, join=self.join, seed=self.seed, variant=number, learn=memory or (),
            map=self.map, stage=stage if self.samples == 1 else lambda what: stage(f"variant {number}, {what}"),
        )  # fmt: skip

    def _targets(self, path: Path, folder: bool) -> tuple[list[Path], Path]:
        """The files to write for one take, and that of the report."""
        from ..io import format_of

        target = self.output / path.name if folder else self.output
        if folder and not format_of(target).writes:
            target = target.with_suffix(".bvh")
        if not format_of(target).writes:
            raise InputError("this format can be read but not written", where=target, hint="write .bvh instead")
        if self.samples == 1:
            return [target], self.report or target.with_name(target.name + ".report.json")
        targets = [target.with_stem(f"{target.stem}_{number}") for number in range(1, self.samples + 1)]
        return targets, self.report or target.with_name(f"{path.stem}.report.json")
