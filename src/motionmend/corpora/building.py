"""Make a corpus out of a data set: map the joints, set the floor, resample, check, and name what is dropped."""

from __future__ import annotations

import csv
import importlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, groupby
from pathlib import Path
from statistics import median

import numpy as np

from ..body.joints import BODY
from ..body.mapping import map_rig, to_body
from ..body.measures import stature
from ..constraints.ground import ground, leg_length
from ..errors import InputError
from ..motion import Motion
from ..networks.rows import body_local
from ..networks.windows import resample
from ..progress import Stage, silent
from .corpus import SPLITS, ClipInfo, Corpus, Dropped
from .datasets import DATASETS, folder
from .datasets.raw import Raw
from .writing import refuse_target, write_corpus

SHORTEST = 0.2  # seconds; less is no motion
SLOWEST = 10  # frames per second in the file; between fewer there is no motion to learn, only what a curve makes up
STATURES = 0.8, 2.5  # metres, within which people are
SAME_LEGS = 0.03  # share by which the legs of one figure may differ between its takes
NEAR = 0.15  # metres off y = 0 at which the feet may stand before the file's floor is no longer believed


@dataclass(frozen=True)
class Row:
    """A line of a table of splits: what a user says of a file."""

    split: str
    fps: float | None = None
    subject: str | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A clip that is ready but for the check of its legs against those of its figure's other takes."""

    info: ClipInfo
    motion: Motion
    figure: str
    leg: float


def build(
    dataset: str,
    source: str | Path,
    target: str | Path,
    *,
    fps: float = 60.0,
    dtype: str = "float32",
    splits: str | Path | None = None,
    native: bool = False,
    local: bool = False,
    force: bool = False,
    stage: Stage = silent,
) -> Corpus:
    """Build a corpus from the files of a data set; the same files give the same bytes.

    Parameters
    ----------
    dataset : a name in `datasets.DATASETS`. source : the folder with its files.
    target : the corpus's folder. fps : its rate. dtype : "float32", or "float16" for half the size.
    splits : a CSV with the columns file and split, and optionally subject and (for "folder") fps, that wins
        over what the data set says.
    native : keep the data set's own joints rather than map them to BODY.
    local : without global translation and rotation: poses as seen from where the body stands and faces in each frame
        (`rows.body_local`), which is the data of table 3 of Björkstrand et al. 2023. The corpus's name says so.
    force : replace a corpus that is there.

    Raises
    ------
    InputError : for whatever the caller can mend, before anything is written.
    """
    source, target = Path(source), Path(target)
    if dataset not in DATASETS:
        raise InputError(f"no data set is named {dataset!r}", expected=f"one of {', '.join(DATASETS)}")
    if not 0 < fps <= 1000:
        raise InputError(f"a rate of {fps:g} fps", expected="frames per second above 0, such as 60")
    if local and native:
        raise InputError("poses as seen from the body need BODY's joints", hint="leave out --native or --local")
    if not source.is_dir():
        found = "no such folder" if not source.exists() else "this is a file"
        raise InputError(found, where=source, expected="a folder with the data set's files")
    refuse_target(target, force)
    module_name, function = DATASETS[dataset].split(":")
    module = importlib.import_module(module_name, f"{__package__}.datasets")
    table = read_splits(Path(splits)) if splits else {}
    rates = {file: row.fps for file, row in table.items() if row.fps}
    if dataset == "folder":
        raws = folder.read(source, stage=stage, rates=rates)
    elif rates:
        raise InputError("a column fps", where=splits, expected="none: the data set knows the rates of its files")
    else:
        raws = getattr(module, function)(source, stage=stage)
    if splits:  # it may lie among the takes, and CSV files are takes
        raws = (raw for raw in raws if (source / raw.file).resolve() != Path(splits).resolve())

    dropped: list[Dropped] = []
    ready = _prepared(raws, table, dropped, float(fps), native)
    name = module.NAME or source.resolve().name
    if local:
        ready = _seen_from_the_body(ready, dropped)
        name += "-local"
    first = next(ready, None)
    return write_corpus(
        target, name=name, fps=float(fps), dtype=dtype, licence=module.LICENCE,
        credit=module.CREDIT, skeleton=first.motion.skeleton if first else BODY, dropped=dropped,
        contacts=not local, force=force,
        clips=_checked(chain([first], ready), dropped) if first else (),
    )  # fmt: skip


def read_splits(path: Path) -> dict[str, Row]:
    """A table of splits: the columns file and split, and optionally subject and fps; others are ignored.

    Raises
    ------
    InputError : with its line, for a table that is none, another split, a rate that is none, or a file named twice.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            columns = set(reader.fieldnames or ())
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", where=path) from None
    if missing := {"file", "split"} - columns:
        expected = "columns file, split and, if you like, subject and fps"
        raise InputError(f"no column {min(missing)}", where=path, expected=expected)
    table: dict[str, Row] = {}
    for line, row in rows:
        where, split, fps = f"{path}:{line}", (row["split"] or "").strip(), (row.get("fps") or "").strip()
        file = Path((row["file"] or "").strip()).as_posix()
        if split not in (*SPLITS, ""):
            raise InputError(f"a split named {split!r}", where=where, expected=f"{', '.join(SPLITS)}, or nothing")
        if file in table:
            raise InputError(f"{file} is listed twice", where=where)
        try:
            rate = float(fps) if fps else None
        except ValueError:
            rate = 0.0
        if rate is not None and not 0 < rate < np.inf:
            raise InputError(f"a rate of {fps!r}", where=where, expected="frames per second above 0, or nothing")
        table[file] = Row(split, rate, (row.get("subject") or "").strip() or None)
    return table


def _prepared(
    raws: Iterable[Raw | Dropped], table: dict[str, Row], dropped: list[Dropped], fps: float, native: bool
) -> Iterator[Prepared]:
    """The takes that can be clips; the others are added to `dropped`, and so are rows of the table that no take has."""
    listed = set(table)
    names: dict[str, str] = {}
    skeleton = None
    for raw in raws:
        listed.discard(raw.file)
        if isinstance(raw, Raw):
            if row := table.get(raw.file):
                raw = replace(raw, split=row.split, subject=raw.subject if row.subject is None else row.subject)
            try:
                if raw.name in names:
                    raise InputError(f"{names[raw.name]} is a clip of the same name, {raw.name}")
                clip = _prepare(raw, fps, native)
                skeleton = skeleton or clip.motion.skeleton
                if clip.motion.skeleton != skeleton:
                    raise InputError(f"its {len(clip.motion.skeleton)} joints are not those of the first take")
                names[raw.name] = raw.file
                yield clip
            except InputError as error:
                dropped.append(Dropped(raw.file, str(error)))
        else:
            dropped.append(raw)
    dropped += [Dropped(file, "listed in the table of splits, but no take of the data set") for file in sorted(listed)]


def _prepare(raw: Raw, fps: float, native: bool) -> Prepared:
    """A take at the corpus's rate with its ground at y = 0; InputError if it cannot be a clip."""
    motion = raw.motion
    if raw.untrusted is not None:
        motion = replace(motion, observed=motion.observed & ~raw.untrusted)
    mapping = map_rig(motion.skeleton, motion.positions)
    if not mapping.is_person:
        raise InputError("no person is recognised among its joints")
    body = to_body(motion, mapping)
    if motion.seconds < SHORTEST:
        raise InputError(f"{motion.seconds:.2f} s are too short; expected at least {SHORTEST} s")
    if motion.fps < SLOWEST:
        hint = "if that is not its true rate, name that in the column fps of a table for --splits"
        raise InputError(f"{motion.fps:.3g} fps are too few; expected at least {SLOWEST}", hint=hint)
    tall = stature(motion.skeleton, np.where(motion.observed[..., None], motion.positions, np.nan))
    if tall is not None and not STATURES[0] <= tall <= STATURES[1]:
        raise InputError(f"the person would be {tall:.3g} m tall; the unit is wrong")
    floor = raw.floor
    if floor is None:
        guess = ground(body)
        floor = guess if abs(guess) > NEAR else 0.0
    floor = round(floor, 4)
    notes = list(raw.notes)
    if absent := [name for name, joint in zip(BODY.names, mapping.joints) if joint < 0]:
        notes.append(f"no {', '.join(absent)}")
    try:
        motion = resample(motion if native else body, fps)
    except ValueError:
        raise InputError(f"a rate of {motion.fps:g} fps cannot be brought to {fps:g}") from None
    if not motion.observed.any():
        raise InputError("no sample can be trusted")
    lowered = motion.positions - np.array([0, floor, 0], np.float32)
    info = ClipInfo(
        raw.name, raw.file, raw.sha256, raw.subject, raw.split, float(raw.motion.fps), raw.rig, raw.licence, floor,
        tuple(notes),
    )  # fmt: skip
    return Prepared(info, replace(motion, positions=lowered), raw.figure, leg_length(body))


def _seen_from_the_body(clips: Iterable[Prepared], dropped: list[Dropped]) -> Iterator[Prepared]:
    """The clips without global translation and rotation; those in which no heading is to be seen are dropped."""
    for clip in clips:
        motion = clip.motion
        poses = body_local(np.where(motion.observed[..., None], motion.positions, np.nan)[None])[0]
        seen = np.asarray(np.isfinite(poses).all(axis=-1))
        if not seen.any():
            dropped.append(Dropped(clip.info.file, "it is nowhere to be seen which way the body faces"))
            continue
        yield replace(clip, motion=replace(motion, positions=poses.astype(np.float32), observed=seen))


def _checked(clips: Iterable[Prepared], dropped: list[Dropped]) -> Iterator[tuple[ClipInfo, Motion]]:
    """Drop the clips whose legs are not those of their figure. A subject's clips are held together, no more."""
    for _, group in groupby(clips, key=lambda clip: clip.info.subject if clip.figure else clip.info.name):
        held = list(group)
        for clip in held:
            legs = [other.leg for other in held if other.figure == clip.figure and np.isfinite(other.leg)]
            usual = median(legs) if legs else clip.leg
            if abs(clip.leg / usual - 1) > SAME_LEGS:
                reason = f"legs of {clip.leg:.3f} m; those of the same figure are {usual:.3f} m long"
                dropped.append(Dropped(clip.info.file, reason))
            else:
                yield clip.info, clip.motion
