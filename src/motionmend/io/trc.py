"""TRC files (OpenSim, Cortex, Pose2Sim): tab-separated marker tables, written back cell by cell.

    PathFileType  4  (X/Y/Z)  walk.trc
    DataRate  CameraRate  NumFrames  NumMarkers  Units  OrigDataRate  OrigDataStartFrame  OrigNumFrames
    100.00    100.00      238        41          mm     100.00        1                   238
    Frame#  Time  LASI          RASI          …
                  X1  Y1  Z1    X2  Y2  Z2    …
    (often a blank line)
    1       0.00  12.5  …

Read leniently where that is safe: other separators than tabs, empty cells or rows that end early for missing
markers, NaN in its spellings, decimal commas, names in other columns than usual, unnamed markers after the named
ones (Cortex). Writing changes the cells of repaired samples only.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from .. import units
from ..body.measures import measure
from ..errors import InputError
from ..motion import Motion, Skeleton, Take, Units
from ..units import Hints
from . import _points, _text

Array = np.ndarray

MISSING = {b"", b"nan", b"na", b"n/a", b"null", b"none", b"nan(ind)", b"1.#qnan", b"1.#ind", b"1.#qnb", b"inf"}
BOM = b"\xef\xbb\xbf"


@dataclass(frozen=True, eq=False)
class Document:
    """A TRC file as read. lines : all of them, without the line feed. rows : the line of each frame.

    separator : what stands between the cells of a row; None for any blanks.
    comma : whether decimals have commas.
    motion : what the reader made of it; a sample that differs from it was changed since.
    """

    lines: list[bytes] = field(repr=False)
    feed: bytes
    rows: Array
    separator: bytes | None
    comma: bool
    motion: Motion


def read(path: Path, hints: Hints) -> Take:
    """A take of the markers of a TRC file. Missing: empty cells, NaN, and what `_points.present` says."""
    raw = path.read_bytes()
    feed = b"\n" if b"\n" in raw else b"\r"
    lines = raw.split(feed)
    if not lines[0].removeprefix(BOM).strip().lower().startswith(b"pathfiletype"):
        raise InputError(
            f"the first line begins with {_text.decoded(lines[0][:20]).strip()!r}", where=f"{path}:1",
            expected="PathFileType, as in a TRC file",
        )
    if len(lines) < 5:
        raise InputError(
            f"the file ends in line {len(lines)}", where=path, expected="a header of five lines", hint="it is cut off"
        )
    notes: list[str] = []
    rows, separator, comma = _rows(lines, path)
    header = dict(zip(_words(lines[1].lower(), separator), _words(lines[2], separator)))
    declared = {key: _header_number(header, key, path) for key in ("datarate", "numframes", "nummarkers")}
    labels = _labels(lines[3].removesuffix(b"\r").split(separator))
    if not labels:
        raise InputError("no markers are named", where=f"{path}:4", expected="Frame#, Time and the markers' names")
    if len(labels) != declared["nummarkers"]:
        notes.append(f"NumMarkers is {declared['nummarkers']:g} but {len(labels)} markers are named")
    if len(rows) != declared["numframes"]:
        notes.append(f"NumFrames is {declared['numframes']:g} but there are {len(rows)} rows")
    if 3 * len(labels) * len(rows) > max(10_000_000, 8 * len(raw)):
        raise InputError(f"{len(labels)} markers are named but the rows are far shorter", where=f"{path}:4")
    whole = lines[-1].endswith(b"\r") or rows[-1] < len(lines) - 1 or len(rows) >= declared["numframes"]
    table = _Table(path, separator, comma, 3 * len(labels), may_end_early=separator is not None and whole)
    times, points = table.read(lines, rows)
    if table.surplus:
        notes.append(f"after the named markers there are up to {table.surplus // 3} unnamed ones: kept but not read")

    fps = hints.fps or declared["datarate"]
    if not 0 < fps <= 100_000:
        raise InputError(f"a DataRate of {fps:g}", where=f"{path}:3", hint="say the rate with --fps")
    said = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 10 and times[-1] > times[0] else fps
    if abs(said / fps - 1) > 0.02:
        notes.append(f"the Time column runs at {said:.4g} frames per second; taken were {fps:g}")

    skeleton = Skeleton.cloud(_points.unique(labels, notes))
    observed = _points.present(points, True, notes)
    points[~observed] = np.nan
    conversion = units.resolve(
        hints, said_unit=header.get("units"), usual_unit="mm", usual_up="y",
        **measure(skeleton, points),
    )
    motion = Motion(units.to_metres(points, conversion).astype(np.float32), observed, float(fps), skeleton)
    document = Document(lines, feed, rows, separator, comma, motion)
    return Take(motion, None, document, conversion, "trc", str(path), tuple(notes))


def _header_number(header: dict[str, str], key: str, path: Path) -> float:
    """A number of the header's third line; 0 where it says none."""
    text = header.get(key, "0").replace(",", ".")
    if not _text.NUMBER.fullmatch(text.encode("latin-1", "replace")):
        raise InputError(f"{key} is {text[:20]!r}", where=f"{path}:3", expected="a number")
    return min(float(text), 1e18)


def _words(line: bytes, separator: bytes | None) -> list[str]:
    return (line.replace(separator, b" ") if separator else line).decode("latin-1").split()


def _rows(lines: list[bytes], path: Path) -> tuple[Array, bytes | None, bool]:
    """The indices of the lines that hold a frame, what separates cells, and whether decimals have commas."""
    axes = re.match(rb"[\s,;]*[^\s\d,;]", lines[4]) or not lines[4].strip()
    rows = [index for index in range(5 if axes else 4, len(lines)) if lines[index].strip(b" \t\r,;\0\x1a")]
    if not rows:
        raise InputError("the file has a header but no frames", where=path, hint="it is cut off")
    separator = next((mark for mark in (b"\t", b";", b",") if lines[rows[0]].count(mark) >= 2), None)
    with_comma = next((index for index in rows if b"," in lines[index]), None)
    if with_comma is None or separator == b",":
        return np.array(rows), separator, False
    with_point = next((index for index in rows if b"." in lines[index]), None)
    if with_point is not None:
        raise InputError(
            "a comma among numbers with decimal points", where=f"{path}:{with_comma + 1}",
            expected=f"one kind of decimals, as in line {with_point + 1}",
        )
    return np.array(rows), separator, True


def _labels(cells: list[bytes]) -> list[str]:
    """The markers' names from the cells of line 4: in every third column after Frame# and Time.

    A marker without a name, between others, is called by its place. Some programs put two tabs between names
    or begin a column late; then they are taken in order.
    """
    names = [_text.decoded(cell).strip() for cell in cells[2:]]
    third = names[::3]
    if sum(map(bool, third)) < sum(map(bool, names)):
        return [name for name in names if name]
    while third and not third[-1]:
        third.pop()
    return [name or f"*{place}" for place, name in enumerate(third, start=1)]


@dataclass
class _Table:
    """Reads the rows. columns : coordinates of the named markers. surplus : cells found after these, at most."""

    path: Path
    separator: bytes | None
    comma: bool
    columns: int
    may_end_early: bool
    surplus: int = 0

    def read(self, lines: list[bytes], rows: Array) -> tuple[Array, Array]:
        """The Time column, and all coordinates `(frames, markers, 3)` in file units, NaN where a cell is empty."""
        times, table = np.full(len(rows), np.nan), np.full((len(rows), self.columns), np.nan)
        for frame, index in enumerate(rows.tolist()):
            times[frame], found = self._row(lines[index].removesuffix(b"\r"), partial(self._place, index))
            table[frame, : len(found)] = found
        return times, table.reshape(len(rows), -1, 3)

    def _place(self, index: int) -> str:
        return f"{self.path}:{index + 1}"

    def _row(self, line: bytes, where: Callable[[], str]) -> tuple[float, list[float]]:
        cells = (line.replace(b",", b".") if self.comma else line).split(self.separator)
        if not cells[0].strip():
            raise InputError("the row has no frame number", where=where(), expected="Frame#, Time, coordinates")
        _text.number(cells[0].strip(), where)
        time = _text.number(cells[1].strip(), where) if len(cells) > 1 and cells[1].strip() else math.nan
        while not cells[-1].strip() and len(cells) > 2 + self.columns:
            cells.pop()
        found = [cell.strip() for cell in cells[2 : 2 + self.columns]]
        surplus = max(0, len(cells) - 2 - self.columns)
        self.surplus = max(self.surplus, surplus)
        if len(found) < self.columns:
            while found and not found[-1]:
                found.pop()
        early = len(found) < self.columns and (len(found) % 3 or not self.may_end_early)
        if early or surplus % 3:
            raise InputError(
                f"{len(cells)} columns", where=where(), hint="the file is cut off or damaged",
                expected=f"{2 + self.columns}: Frame#, Time and {self.columns // 3} markers",
            )
        if _text.is_numeric(b" ".join(found)):
            try:
                return time, [float(cell) if cell else math.nan for cell in found]
            except ValueError:
                pass  # the slow way finds the cell
        return time, [_coordinate(cell, where) for cell in found]


def _coordinate(cell: bytes, where: Callable[[], str]) -> float:
    return math.nan if cell.lower().lstrip(b"+-") in MISSING else _text.number(cell, where)


def write(take: Take, path: Path) -> None:
    """Write the take: into the text it was read from, or as a new OpenSim TRC (mm, Y up).

    In the original text only the cells of samples that were filled change; those of samples that are no longer
    trusted and could not be filled become empty (NaN where only blanks separate the columns).
    """
    document, motion = take.document, take.motion
    if isinstance(document, Document) and motion.positions.shape == document.motion.positions.shape:
        path.write_bytes(_patched(document, motion, take.units))
    else:
        path.write_bytes(_new(motion, Path(take.source).stem).encode())


def _patched(document: Document, motion: Motion, conversion: Units) -> bytes:
    filled, lost = _points.changes(document.motion, motion)
    lines = list(document.lines)
    enough = max(0, math.ceil(-math.log10(1e-6 / conversion.metres)))  # decimals that tell a thousandth of a mm
    for frame in np.flatnonzero((filled | lost).any(1)):
        index = document.rows[frame]
        line = lines[index].removesuffix(b"\r")
        # Odd pieces are separators, kept as they are.
        pieces = re.split(rb"(\s+)" if document.separator is None else b"(%c)" % document.separator, line)
        first = 4 if pieces[0] or document.separator else 6
        decimals = max([enough, *(_decimals(cell) for cell in pieces[first::2])])
        coordinates = units.from_metres(motion.positions[frame], conversion)
        for joint in np.flatnonzero(filled[frame] | lost[frame]):
            for axis in range(3):
                cell = first + 2 * (3 * joint + axis)
                while len(pieces) <= cell:  # a row that ended early
                    pieces += [document.separator or b" ", b""]
                if filled[frame, joint]:
                    new = b"%.*f" % (decimals, coordinates[joint, axis])
                    new = new.replace(b".", b",") if document.comma else new
                else:
                    new = b"" if document.separator else b"NaN"
                pieces[cell] = new.rjust(len(pieces[cell])) if pieces[cell].startswith(b" ") else new
        lines[index] = b"".join(pieces) + lines[index][len(line) :]
    return document.feed.join(lines)


def _decimals(cell: bytes) -> int:
    digits = re.search(rb"[.,](\d+)\s*$", cell)
    return min(len(digits[1]), 12) if digits else 0


def _new(motion: Motion, name: str) -> str:
    names = ["_".join(label.split()) or f"*{place}" for place, label in enumerate(motion.skeleton.names, start=1)]
    rate, frames = f"{motion.fps:.10g}", len(motion)
    points = units.from_metres(np.where(motion.observed[..., None], motion.positions, np.nan), Units(0.001, "y", ""))
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{len(names)}\tmm\t{rate}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{n}\tY{n}\tZ{n}" for n in range(1, len(names) + 1)),
        "",
    ]
    rows = [
        f"{frame + 1}\t{frame / motion.fps:.6f}\t" + "\t".join("" if math.isnan(x) else f"{x:.5f}" for x in row)
        for frame, row in enumerate(points.reshape(frames, -1).tolist())
    ]
    return "\n".join([*head, *rows, ""])
