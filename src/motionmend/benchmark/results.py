"""What a protocol measures: its cells, and where they come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray

TRUTH = "truth"  # the method name of rows that measure the undamaged motion itself


@dataclass(frozen=True)
class Protocol:
    """What a protocol module says of itself, as PROTOCOL.

    name : as on the command line. fps, frames : what a window is. unit : of its main errors ("mm", "cm").
    describe : a paragraph for the head of the table: task, sections of the paper, what is ours.
    highest : metrics of which more is better. unjudged : metrics of which no value is best.
    spread : whether tables show the spread beside each value.
    source : True if `measure` takes a folder or an archive of takes (Path) instead of a Corpus.
    """

    name: str
    fps: float
    frames: int
    unit: str
    describe: str
    highest: tuple[str, ...] = ()
    unjudged: tuple[str, ...] = ()
    spread: bool = False
    source: bool = False


@dataclass(frozen=True)
class Cell:
    """One number of a table.

    task : "full skeleton". setting : "0.5 s", a column. method : a row. metric : "MPJPE, root-relative".
    value : NaN where the method left samples empty. spread : standard deviation over windows, or None.
    """

    task: str
    setting: str
    method: str
    metric: str
    value: float
    spread: float | None
    unit: str


def evenly(starts: Array, limit: int | None) -> Array:
    """`limit` of the windows' `starts (W,)`, spread evenly from the first to the last; all if there are no more."""
    if limit is None or limit >= len(starts):
        return starts
    return starts[np.linspace(0, len(starts) - 1, limit).round().astype(int)]


@dataclass(frozen=True)
class Results:
    """What one call measured.

    header : where the numbers come from (`provenance.header`). cells : the numbers.
    runtime : for each method and what it did ("fill", "restore", "sample"), seconds per frame and `ratio` to the
        linear fill; not repeatable, and kept apart. extra : figures of the protocol's own, by file stem.
    """

    protocol: Protocol
    header: dict[str, Any]
    cells: list[Cell]
    runtime: dict[str, dict[str, dict[str, float | None]]]
    extra: dict[str, Any]
