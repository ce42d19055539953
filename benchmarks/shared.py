"""What the scripts of this folder share: command lines, the takes they ask for, clocks that take turns, tables."""

from __future__ import annotations

import argparse
import csv
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

HELP = {
    "data": "the folder with the packs of takes: cmu/ and cmu.csv and, if at hand, the others",
    "every": "only every n-th take, for a quick look",
    "split": "of CMU's subjects: train, validation or test",
}
PACKS = {"ReActIdle (24 fps)": "reactidle", "Bandai-Namco 2 (30 fps)": "bandai-namco-2"}


def parser(doc: str | None, **flags: Any) -> argparse.ArgumentParser:
    """A command line with an option for each flag: its default, or its type where there is none.

    A list takes one value or more, False is a switch.
    """
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in flags.items():
        option, told = f"--{name.replace('_', '-')}", HELP.get(name)
        if default is False:
            made.add_argument(option, action="store_true", help=told)
        elif isinstance(default, list):
            made.add_argument(option, nargs="+", default=default, help=told)
        elif isinstance(default, type):
            made.add_argument(option, type=default, required=True, help=told)
        else:
            made.add_argument(option, type=type(default), default=default, help=told)
    return made


def options(doc: str | None, **flags: Any) -> argparse.Namespace:
    """What was said on a command line of these flags, and nothing else. See `parser`."""
    return parser(doc, **flags).parse_args()


def cmu_trials(data: Path, *splits: str, table: Path | None = None) -> Iterator[tuple[Path, float]]:
    """The trials of these splits of CMU's subjects, and their true rates, by the table that lies beside them."""
    with (table or data / "cmu.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if row["split"] in splits:
                yield data / "cmu" / row["file"], float(row["fps"])


def other_packs(data: Path) -> Iterator[tuple[str, list[tuple[Path, float | None]]]]:
    """Takes of other studios, those packs that are at hand: what to call them, and their files."""
    for name, folder in PACKS.items():
        if found := sorted((data / folder).rglob("*.bvh")):
            yield name, [(path, None) for path in found]


def in_turn(ways: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """Seconds of each way in so many rounds; they take turns, so that whatever else the machine does meets all."""
    spent: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            began = time.perf_counter()
            way()
            spent[name].append(time.perf_counter() - began)
    return spent


def best(ways: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """The least seconds of each way. See `in_turn`."""
    return {name: min(seconds) for name, seconds in in_turn(ways, rounds).items()}


def medians(ways: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """The median of each way's seconds, but for one round more that warms up. See `in_turn`."""
    return {name: float(np.median(seconds[1:])) for name, seconds in in_turn(ways, rounds + 1).items()}


def head(*names: str, left: int = 1) -> str:
    """The head of a Markdown table: the first `left` columns are words, the others numbers."""
    return row(*names) + "\n|" + "---|" * left + "---:|" * (len(names) - left)


def row(*cells: object) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(map(str, cells)) + " |"


def seconds_head(first: Sequence[str], seconds: Iterable[float]) -> str:
    """The head of a table with a column for each length of a gap, in seconds."""
    return head(*first, *(f"{each:g} s" for each in seconds), left=len(first))


def python() -> str:
    """The versions that numbers depend on, in words."""
    return f"Python {platform.python_version()}, NumPy {np.__version__}"


def here() -> str:
    """This machine in words."""
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
