"""CMU Graphics Lab motion capture database, mocap.cs.cmu.edu: AMC with ASF, and two conversions to BVH.

What was measured in the 372 trials (docs/corpora.md has more):

- AMC lengths are in units of 0.0254 / 0.45 = 0.056444 m, and so are those of the BVH files with 31 joints: subject
  131 is there in both, with legs of 0.801 m in both. The BVH files with 43 joints are in centimetres, and all have
  one figure's bones (legs of 0.822 m) whoever was captured.
- Every BVH of both conversions but those of 131 begins with a T-pose. In those with 43 joints it rings on: second
  differences are 2 to 20 times the take's 95th percentile as far as frame 7, and usual from frame 8.
- The ground of AMC files and of BVH files with 31 joints is y = 0: in the median take the ball of the lowest foot is
  at 0.03 m (quartiles 0.02 and 0.03), the height of that joint over a sole. It is trusted, because a guess by the
  feet would be wrong where people climb, balance and walk on blocks (subjects 01 and 03), and no better elsewhere.
  The figure with 43 joints has other legs than the people had, and its feet stand up to 0.1 m off (in 01_14 0.8 m):
  there they tell.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...errors import InputError
from ...progress import Stage, silent
from ..corpus import Dropped
from .raw import Raw, Source
from .reading import reason, takes

NAME = "cmu"
LICENCE = "free for all uses; the data may not be resold, even in converted form"
CREDIT = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)
SPLITS = {**dict.fromkeys(("05", "13", "49"), "test"), **dict.fromkeys(("06", "16"), "validation")}
RINGS = 8  # frames of a T-pose and of what it leaves, in the BVH files with 43 joints
BAD = {
    "07_12": "the conversion failed: steps of 1.4 m on legs of 0.82 m, and feet 0.7 m under the ground",
}


@dataclass(frozen=True)
class Trial:
    """A row of cmu.csv, or what a file's name tells where there is none."""

    file: str
    subject: str
    split: str
    fps: float | None = None


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The trials of cmu.csv in its order, or without one all AMC and BVH files by name.

    Parameters
    ----------
    source : the folder that holds cmu.csv and cmu/, or the folder of subjects (01/, 02/, …) itself with cmu.csv in it
        or beside it.

    Raises
    ------
    InputError : if no trial is there, or cmu.csv has other columns.
    """
    folder = source / "cmu" if (source / "cmu").is_dir() else source
    table = next((each for each in (folder / "cmu.csv", folder.parent / "cmu.csv") if each.is_file()), None)
    present = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in (".amc", ".bvh") and path.is_file()
    }
    if not present:
        expected = "the folders of subjects, such as 05/05_01.amc with 05/05.asf, or a folder cmu/ that holds them"
        raise InputError("no AMC or BVH file", where=source, expected=expected)
    trials = _listed(table) if table else [_named(file) for file in present]
    sources = []
    for trial in trials:
        if trial.file not in present:
            yield Dropped(trial.file, "listed in cmu.csv, but not in the folder")
        elif why := BAD.get(Path(trial.file).stem):
            yield Dropped(trial.file, why)
        else:
            try:
                sources.append(_source(present[trial.file], trial))
            except OSError as error:
                yield Dropped(trial.file, reason(error, present[trial.file]))
    for file in sorted(set(present) - {trial.file for trial in trials}):
        yield Dropped(file, "not listed in cmu.csv")
    yield from takes(sources, stage)


def _source(path: Path, trial: Trial) -> Source:
    with path.open("rb") as file:
        joints = 1 + file.read(65536).count(b"JOINT ")
    notes = () if trial.fps else ("rate as the file says, for want of cmu.csv",)
    known = {
        "path": path, "file": trial.file, "name": path.stem, "subject": trial.subject, "split": trial.split,
        "licence": LICENCE, "fps": trial.fps, "figure": trial.subject, "ground": "file",
    }  # fmt: skip
    if joints == 43:
        why = f"T-pose of the conversion, and its ringing, cut off: {RINGS} frames at the start"
        notes += ("bones of the conversion's one figure, not of the subject",)
        known |= {"unit": "cm", "skip": RINGS, "skip_why": why, "figure": "43 joints", "ground": "feet"}
    elif joints == 31:
        known |= {"unit": "asf"}
    return Source(**known, notes=notes)


def _listed(table: Path) -> list[Trial]:
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        return [Trial(row["file"], row["subject"], row["split"], float(row["fps"])) for row in rows]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(
            f"not a table of trials: {error}", where=table, expected="columns file, subject, split, fps"
        ) from None


def _named(file: str) -> Trial:
    subject = Path(file).stem.split("_")[0]
    return Trial(file, subject, SPLITS.get(subject, "train"))
