"""The lines and numbers of a table's text, found fast and never copied more than a piece at a time."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..errors import InputError
from .csv_headers import Layout, split, words

Array = np.ndarray

BOM = b"\xef\xbb\xbf"
LARGEST = 1e20  # nanoseconds since 1970 are 1e18; beyond lies no number that anyone meant
CHUNK = 1 << 22  # bytes turned into numbers at a time
MISSING = {"", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "nil", "missing", "-1.#ind", "1.#qnan"}
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.I)
_BARE = b"\r\n\t ;,"
_TRUTH = {"true": 1.0, "yes": 1.0, "false": 0.0, "no": 0.0}


@dataclass(frozen=True, eq=False)
class Text:
    """A file's bytes and `(lines + 1,)` where each line starts; a byte order mark belongs to no line."""

    raw: bytes
    starts: Array
    path: Path

    @classmethod
    def of(cls, path: Path) -> Text:
        raw = path.read_bytes()
        if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError("the text is UTF-16", where=path, hint="save it as UTF-8")
        if b"\0" in raw:
            raise InputError("this is not text", where=path)
        # Lone carriage returns end lines where there is nothing else (old Macintosh exports).
        end = 10 if b"\n" in raw or b"\r" not in raw else 13
        begin = len(BOM) if raw.startswith(BOM) else 0
        ends = np.flatnonzero(np.frombuffer(raw, np.uint8) == end) + 1
        last = [] if len(ends) and ends[-1] == len(raw) else [len(raw)]
        return cls(raw, np.concatenate([[begin], ends, last]).astype(np.int64), path)

    def __len__(self) -> int:
        return len(self.starts) - 1

    def whole(self, index: int) -> bytes:
        """A line with its end."""
        return self.raw[self.starts[index] : self.starts[index + 1]]

    def line(self, index: int) -> bytes:
        """A line without its end."""
        return self.whole(index).rstrip(b"\r\n")

    def lines(self, first: int, stop: int) -> list[bytes]:
        """Lines without their ends; fewer where the file is over."""
        bounds = self.starts[first : min(stop, len(self)) + 1].tolist()
        return [self.raw[a:b].rstrip(b"\r\n") for a, b in pairwise(bounds)]

    def pick(self, rows: Array) -> list[bytes]:
        """The lines `rows` without their ends."""
        bounds = zip(self.starts[rows].tolist(), self.starts[rows + 1].tolist())
        return [self.raw[a:b].rstrip(b"\r\n") for a, b in bounds]

    def at(self, row: int, column: int | None = None) -> str:
        """Where a line, and a cell in it, stands, for messages; both counted from 1."""
        return f"{self.path}:{row + 1}" + ("" if column is None else f":{column + 1}")

    def lines_saying(self, word: bytes) -> list[int]:
        """Indices of the lines that hold `word` and, but for separators, nothing else."""
        found, at = [], self.raw.find(word)
        while at >= 0:
            row = int(np.searchsorted(self.starts, at, "right")) - 1
            if self.whole(row).strip(_BARE + b'"') == word:
                found.append(row)
            at = self.raw.find(word, int(self.starts[row + 1]))
        return found


def data_rows(text: Text, layout: Layout) -> Array:
    """Indices of the lines that hold data: not blank, and before the blank line that ends a section."""
    rows = np.arange(layout.first, len(text))
    if layout.ends_at_blank:
        # Spreadsheets fill the blank line between two sections with separators.
        end = next((i for i, row in enumerate(rows.tolist()) if not text.whole(row).strip(_BARE)), len(rows))
        rows = rows[:end]
    # Only short lines can be blank.
    short = rows[np.diff(text.starts)[rows] < 8]
    rows = rows[~np.isin(rows, [row for row in short.tolist() if not text.whole(row).strip(b" \r\n")])]
    # Spreadsheets add rows of bare separators at the end.
    if layout.frame is not None or layout.time is not None:
        while len(rows) and not text.whole(rows[-1]).strip(_BARE):
            rows = rows[:-1]
    if not len(rows):
        raise InputError("there are titles but no data", where=text.at(len(text) - 1))
    return rows


def numbers(text: Text, rows: Array, layout: Layout, columns: list[int], comma: bool) -> Array:
    """The cells in `columns` of lines `rows` as float64 `(rows, columns)`, NaN where they are missing.

    Raises InputError for a line with too few or too many cells, and for a cell that is not a number.
    """
    width = len(split(text.line(int(rows[0])), layout.separator))
    if width <= max(columns):
        expected = f"at least {max(columns) + 1}, as the titles say"
        raise InputError(f"{width} columns", where=text.at(int(rows[0])), expected=expected)
    pieces = np.searchsorted(text.starts[rows], range(int(text.starts[rows[0]]), len(text.raw), CHUNK))
    bounds = np.unique([0, *pieces.tolist(), len(rows)]).tolist()
    return np.concatenate([_piece(text, rows[a:b], width, layout, columns, comma) for a, b in pairwise(bounds)])


def _piece(text: Text, rows: Array, width: int, layout: Layout, columns: list[int], comma: bool) -> Array:
    lines = text.pick(rows)
    for line, row in zip(lines, rows):
        plain = b'"' not in line and line.count(layout.separator) == width - 1
        if not plain and (found := len(split(line, layout.separator))) != width:
            raise InputError(
                f"{found} columns", where=text.at(int(row)), expected=f"{width}, as in the rows before",
                hint="is the file cut off?" if row >= len(text) - 2 and found < width else "",
            )  # fmt: skip
    try:
        return _fast(lines, layout.separator, columns, comma)
    except ValueError:
        pass
    out = np.empty((len(lines), len(columns)))
    for i, line in enumerate(lines):
        cells = words(line, layout.separator)
        for k, column in enumerate(columns):
            found = number(cells[column].replace(",", ".") if comma else cells[column])
            if found is None:
                title = f" {layout.titles[column]!r}" if column < len(layout.titles) else ""
                wrong = f"{cells[column][:40]!r} in column{title} is not a number"
                raise InputError(wrong, where=text.at(int(rows[i]), column))
            out[i, k] = found
    return out


def _fast(lines: list[bytes], separator: bytes, columns: list[int], comma: bool) -> Array:
    """The same by NumPy's own parser; ValueError where that cannot tell."""
    # Framed by separators, every empty cell stands between two of them, and the cells are one further right.
    block = separator + (separator + b"\n" + separator).join(lines) + separator
    if comma:
        block = block.replace(b",", b".")
    if b"_" in block or b'"' in block:
        raise ValueError
    empty, nan = separator * 2, separator + b"nan" + separator
    block = block.replace(empty, nan).replace(empty, nan)
    wanted = [column + 1 for column in columns]
    out = np.loadtxt(
        block.decode("latin-1").split("\n"), delimiter=separator.decode(), usecols=wanted, comments=None, ndmin=2
    )
    if len(out) != len(lines) or (np.abs(out) > LARGEST).any():
        raise ValueError
    return out


def number(cell: str) -> float | None:
    """The number in a cell, NaN if it says that there is none, None if it is neither."""
    folded = cell.lower()
    if folded in MISSING:
        return np.nan
    if folded in _TRUTH:
        return _TRUTH[folded]
    value = float(cell) if NUMBER.fullmatch(cell) else np.inf
    return None if abs(value) > LARGEST else value
