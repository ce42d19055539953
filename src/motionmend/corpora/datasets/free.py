"""Free motion: 319 minutes of many laboratories' takes, BVH and AMC/ASF, each free for any use by its own licence.

A table `free-motion.csv` says of every file who moved, its true rate, its licence and the repository that carried it.
What was measured in the 673 takes:

- y is up in all of them. Some lie, crawl, climb or walk on their hands, where the body's own axis says otherwise, so
  the axis is given rather than guessed.
- Units are centimetres, inches, or inches over 0.45, with no rule by folder: the body's height tells (1.6 to 1.9 m).
- The laboratory's skeleton calls its left collar bone LeftShoulder1 and its right one RightShoulder, and its first
  vertebra is followed by one at the height of the shoulders: no neck. One set carries the bones' meshes as joints.
- Basketball has jumps of a single frame, which the diagnosis distrusts.
- y = 0 is the ground within 8 cm of where feet stand; two takes on force plates stand 0.2 m under it.

Whole people are kept back for validation: `free-validation.csv`, beside this file, lists them and why.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from ...errors import InputError
from ...motion import Skeleton
from ...progress import Stage, silent
from ..corpus import Dropped
from .raw import Raw, Source
from .reading import takes

NAME = "free"
LICENCE = "free for any use: Apache-2.0, BSD-3-Clause or CMU's terms, as each take says"
CREDIT = (
    "Motions of the SNU Movement Research Laboratory and others, as carried by snumrl/TillingPatch, snumrl/ys2010, "
    "snumrl/VSports, snumrl/TimeCriticalResponse, snumrl/InteractiveAnimation, hpgit/HumanFoot, lsw9021/MASS and "
    "encadyma/motion-out; among them data of mocap.cs.cmu.edu, created with funding from NSF EIA-0196217."
)
HELD_OUT = Path(__file__).with_name("free-validation.csv")
# What people do there, by the first words that a file's path has in it.
KINDS = (
    ("vsports/", "basketball"), ("timecritical/", "martial arts"), ("interactive/", "walking, turns"),
    ("samsung_boxing", "boxing"), ("_tt_", "table tennis"), ("/Physics2/wd2_Walk", "walk styles"),
    ("/Physics2/", "pushes, jumps"), ("/Balancing/", "hops, kicks, falls"), ("/VideoMotion/", "walking, turns"),
    ("/Walking/", "walking, turns"), ("/Samsung/", "idling, poses"), ("/Picking/", "everyday acts"),
    ("_dance", "dance"), ("_box", "boxing"), ("_fighter", "boxing"), ("crawl", "crawling"), ("_walk", "walking, turns"),
    ("jump", "pushes, jumps"), ("tiling/", "everyday acts"), ("mass/", "dance, acrobatics"), ("golf", "golf"),
    ("mjackson", "dance"),
)  # fmt: skip
RENAMED = {"LeftShoulder1": "LeftShoulder", "LeftShoulder1Dummy": "LeftShoulderDummy"}
MESH = "_RIGMESH"


@dataclass(frozen=True)
class Listed:
    """A row of free-motion.csv."""

    file: str
    subject: str
    fps: float
    licence: str
    carrier: str


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The takes of free-motion.csv in its order; those of the people held out are the validation split.

    Parameters
    ----------
    source : the folder that holds free-motion/, or that folder itself, with free-motion.csv in it or beside it.

    Raises
    ------
    InputError : if there is no table, or it has other columns.
    """
    folder = source / "free-motion" if (source / "free-motion").is_dir() else source
    places = (folder / "free-motion.csv", folder.parent / "free-motion.csv", source / "free-motion.csv")
    table = next((each for each in places if each.is_file()), None)
    if table is None:
        hint = "it comes with the pack, one row a take: put it beside the folder"
        raise InputError("no free-motion.csv", where=source, hint=hint)
    sources = []
    for row in _listed(table):
        path = folder / row.file
        if path.is_file():
            sources.append(_source(path, row))
        else:
            yield Dropped(row.file, "listed in free-motion.csv, but not in the folder")
    for raw in takes(sources, stage):
        yield _with_our_names(raw) if isinstance(raw, Raw) else raw


def kind_of(file: str) -> str:
    """What somebody does in a take, in a word or two, by its path; "various" where that does not say."""
    return next((kind for words, kind in KINDS if words in f"/{file}"), "various")


@cache
def held_out() -> frozenset[str]:
    """The people of the validation split, as free-motion.csv names them."""
    with HELD_OUT.open(newline="", encoding="utf-8") as file:
        return frozenset(row["subject"] for row in csv.DictReader(file))


def _source(path: Path, row: Listed) -> Source:
    return Source(
        path, row.file, row.file.removesuffix(path.suffix), subject=row.subject,
        split="validation" if row.subject in held_out() else "train", licence=row.licence, fps=row.fps, up="y",
        notes=(f"kind: {kind_of(row.file)}", f"carried by {row.carrier}"),
    )  # fmt: skip


def _with_our_names(raw: Raw) -> Raw:
    """A take whose joints have names that the mapping to BODY knows, and none that are meshes of bones."""
    motion, skeleton = raw.motion, raw.motion.skeleton
    kept = [joint for joint, name in enumerate(skeleton.names) if not name.endswith(MESH)]
    if len(kept) == len(skeleton) and not RENAMED.keys() & set(skeleton.names):
        return raw
    place = {joint: number for number, joint in enumerate(kept)} | {-1: -1}
    names = tuple(RENAMED.get(skeleton.names[joint], skeleton.names[joint]) for joint in kept)
    # A mesh is a leaf: no joint that stays hangs on one.
    smaller = Skeleton(names, tuple(place[skeleton.parents[joint]] for joint in kept))
    motion = replace(
        motion, positions=motion.positions[:, kept], observed=motion.observed[:, kept], skeleton=smaller
    )  # fmt: skip
    return replace(raw, motion=motion)


def _listed(table: Path) -> list[Listed]:
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        return [
            Listed(row["file"].removeprefix("free-motion/"), row["subject"], float(row["fps"]), row["licence"],
                   row["carrier"])
            for row in rows
        ]  # fmt: skip
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(
            f"not a table of takes: {error}", where=table, expected="columns file, subject, fps, licence, carrier"
        ) from None
