"""The verb `data`: build corpora, list them, show one."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Optional

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, arg

from ..errors import InputError
from .common import Folders, Output


@dataclass(frozen=True, kw_only=True)
class Build:
    """Turn a data set's raw files into a corpus. The same files give the same bytes; every dropped file is named."""

    dataset: Annotated[Positional[str], arg(metavar="DATASET")]
    """cmu, reactidle, bandai, h36m, holden, amass, lafan1, or `folder` for any folder of takes."""
    source: Path
    """The folder with its files."""
    output: Output
    """The corpus, a folder: cmu.corpus."""
    fps: float = 60.0
    """Frames per second of the corpus."""
    dtype: Literal["float32", "float16"] = "float32"
    """How positions are stored; float16 takes half the space and is good to about 0.5 mm."""
    splits: Annotated[Optional[Path], arg(metavar="CSV")] = None
    """A CSV with the columns file and split (train, validation, test), and if you like subject and fps."""
    native: bool = False
    """Keep the data set's own joints instead of the 21 that networks speak."""
    local: bool = False
    """Without global translation and rotation: poses as seen from where the body stands and faces in each frame."""
    force: bool = False
    """Replace a corpus that is there."""

    def run(self) -> int:
        from ..corpora.building import build
        from ..corpora.listing import length, told_dropped
        from ..progress import following

        with following(self.output.name) as stage:
            corpus = build(
                self.dataset, self.source, self.output, fps=self.fps, dtype=self.dtype, splits=self.splits,
                native=self.native, local=self.local, force=self.force, stage=stage,
            )  # fmt: skip
        print(f"written: {corpus.path}, {len(corpus.clips)} clips, {length(corpus, corpus.clips)}")
        print(told_dropped(corpus))
        print(f"data hash: {corpus.sha256}")
        return 0


@dataclass(frozen=True, kw_only=True)
class List:
    """List corpora: clips, length, rate, joints, splits, licence."""

    places: Positional[Folders] = (Path(),)
    """Corpora, or folders that hold some; by default the current one."""

    def run(self) -> int:
        from ..corpora.corpus import Corpus
        from ..corpora.listing import found, listed

        rows, bad = [], 0
        for path in found(self.places):
            try:
                rows.append(listed(Corpus.open(path)))
            except (InputError, OSError) as error:
                print(f"motionmend: {error}", file=sys.stderr)
                bad = 1
        if not rows and not bad:
            raise InputError("no corpus here", where=self.places[0], hint="make one with `motionmend data build`")
        widths = [max(map(len, column)) for column in zip(*rows)]
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
        return bad


@dataclass(frozen=True, kw_only=True)
class Show:
    """Tell all about a corpus, check that its arrays are whole, and draw a sheet of its poses."""

    corpus: Annotated[Positional[Path], arg(metavar="CORPUS")]
    """The corpus."""
    sheet: Annotated[Optional[Path], arg(metavar="PNG")] = None
    """Also draw some clips of each split, as PNG."""
    force: bool = False
    """Overwrite the sheet."""

    def run(self) -> int:
        from ..corpora.corpus import Corpus
        from ..corpora.listing import described
        from ..corpora.poses import draw_sheet
        from ..io import write_whole

        corpus, sheet = Corpus.open(self.corpus), self.sheet
        if sheet is not None:
            if sheet.suffix.lower() != ".png":
                raise InputError("the sheet is a PNG", where=sheet, expected="a name that ends in .png")
            if not sheet.parent.is_dir():
                raise InputError("no such folder", where=sheet.parent)
            if sheet.exists() and not self.force:
                hint = "choose another name, or overwrite it with --force"
                raise InputError("the file exists", where=sheet, hint=hint)
        damage = corpus.damaged()
        print(described(corpus, damage))
        if sheet is not None:
            write_whole(sheet, lambda temporary: draw_sheet(corpus, temporary))
            print(f"sheet:     {sheet}")
        if damage:
            hint = "build it again with `motionmend data build`"
            raise InputError("this is not what was written: the data hash is another", where=corpus.path, hint=hint)
        return 0


def parsed(argv: Sequence[str]) -> Build | List | Show:
    """The command that a command line means, which begins with the word `data`."""
    return tyro.extras.subcommand_cli_from_dict(
        {"build": Build, "list": List, "show": Show},
        prog="motionmend data",
        args=argv[1:],
        config=(FlagCreatePairsOff,),
        description="Build corpora from raw takes, and show what is in them.",
    )
