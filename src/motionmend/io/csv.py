"""CSV, TSV and TXT tables of points, read and written; which tables are known stands in csv_headers.py.

A sample is missing where a cell of it is empty or says so (NaN, NA, null, -), where all three are exactly
zero, or where a long table's observed or confidence column is zero. Three zeros of which one has a minus sign
are a rounded measurement and count. Writing back replaces the cells of samples that changed, with the column's
decimals or a micrometre, whichever is finer, and leaves every other byte as it was; a sample that is not
trusted when it is written is marked missing as the file marks such.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..body.measures import measure
from ..errors import InputError
from ..motion import Motion, Skeleton, Take, Units
from ..units import Hints, from_metres, resolve, to_metres
from ._text import decoded
from .csv_cells import MISSING, NUMBER, Text, data_rows, numbers
from .csv_headers import Layout, split, understand, words
from .csv_times import rate

Array = np.ndarray

_ORIGIN = re.compile(r"(^|[\W_])(mid ?)?(hips?|pelvis|root|origin)$", re.I)


@dataclass(frozen=True, eq=False)
class Table:
    """A file as read.

    rows : `(frames, points)` line index of each sample, -1 where a long table has no row for it.
    motion : what was read, to see what has changed since. missing, trusted : how the file spells a missing
        coordinate and, in a trust column, a sample that may be used.
    """

    text: Text
    layout: Layout
    rows: Array
    motion: Motion
    comma: bool
    missing: bytes
    trusted: bytes


def read(path: Path, hints: Hints) -> Take:
    """The take in a table of points; InputError names the line and, for a bad cell, its number in the row."""
    text = Text.of(path)
    layout = understand(text.lines, len(text), text.lines_saying(b"Trajectories"), path)
    rows = data_rows(text, layout)
    comma = layout.separator != b"," and any(re.search(rb"\d,\d", line) for line in text.pick(rows[:50]))
    layout, notes = _without_clock_times(layout, words(text.line(rows[0]), layout.separator))
    extras = [column for column in (layout.frame, layout.time, layout.trust) if column is not None]
    table = numbers(text, rows, layout, [*layout.columns.flat, *extras], comma)
    points = table[:, : layout.columns.size].reshape(len(rows), -1, 3)
    counts = dict(zip(extras, table[:, layout.columns.size :].T))
    lines, trusted = rows, b""
    if layout.trust is not None:
        points[~(counts[layout.trust] > 0)] = np.nan
        trusted = _least_trusted(text, layout, rows, counts[layout.trust])
    if layout.long:
        layout, rows, points, counts = _pivoted(text, layout, rows, points, counts)
        lines = rows.max(axis=1)
    else:
        rows = np.broadcast_to(rows[:, None], points.shape[:2])
    observed = _observed(points, layout.names, notes)
    points[~observed] = np.nan

    fps, why, remarks = rate(text, layout, hints, counts, lines)
    skeleton = Skeleton.cloud(layout.names)
    units = resolve(
        hints, said_unit=layout.unit, usual_unit=layout.usual[0], usual_up=layout.usual[1],
        **measure(skeleton, points),
    )  # fmt: skip
    motion = Motion(to_metres(points, units).astype(np.float32), observed, fps, skeleton)
    separator = {b"\t": "tab", b";": "';'", b",": "','"}[layout.separator]
    decimals = "decimal comma, " if comma else ""
    points_said = f"{len(skeleton)} point" + "s" * (len(skeleton) > 1)
    notes.insert(0, f"{layout.kind}, {separator} separated, {decimals}{points_said}, {why}")
    document = Table(text, layout, rows, motion, comma, _missing(text, layout, rows, observed), trusted)
    return Take(motion, None, document, units, "csv", str(path), (*notes, *remarks))


def _without_clock_times(layout: Layout, cells: list[str]) -> tuple[Layout, list[str]]:
    """The layout without columns of times or frames that are no plain numbers, such as 10:24:31.5."""
    notes = []
    for what in ("time", "frame"):
        column = getattr(layout, what)
        if column is not None and column < len(cells) and not NUMBER.fullmatch(cells[column].replace(",", ".")):
            layout = replace(layout, **{what: None})
            notes.append(f"column {layout.titles[column]!r} holds no plain numbers and is not used")
    return layout, notes


def _observed(points: Array, names: tuple[str, ...], notes: list[str]) -> Array:
    observed = np.isfinite(points).all(-1)
    zero = observed & (points == 0).all(-1) & ~np.signbit(points).any(-1)
    for j in np.flatnonzero(zero.all(0)):
        if _ORIGIN.search(names[j]) and not zero.all():
            zero[:, j] = False
            notes.append(f"{names[j]} is 0, 0, 0 in every frame: positions are relative to it")
    if zero.any():
        notes.append(f"{zero.sum()} samples that are exactly 0, 0, 0 are taken as missing")
    return observed & ~zero


def _pivoted(
    text: Text, layout: Layout, rows: Array, points: Array, counts: dict[int, Array]
) -> tuple[Layout, Array, Array, dict[int, Array]]:
    """A long table's lines as frames and points: names, line indices, `(frames, points, 3)`, times per frame."""
    key = layout.frame if layout.frame is not None else layout.time
    if key is None:
        raise InputError("a long table whose frames have no numbers", where=text.at(layout.first))
    without = np.flatnonzero(np.isnan(counts[key]))
    if len(without):
        raise InputError("a row without its frame", where=text.at(int(rows[without[0]]), key))
    column = layout.joint or 0
    order: dict[bytes, int] = {}
    point = [order.setdefault(split(line, layout.separator)[column], len(order)) for line in text.pick(rows)]
    names = tuple(words(name, layout.separator)[0] for name in order)
    if len(set(names)) < len(names) or "" in names:
        raise InputError("rows without a name, or with one that is spelled in two ways", where=text.path)
    frames, first, frame = np.unique(counts[key], return_index=True, return_inverse=True)
    if len(frames) * len(names) > 20 * len(rows) + 1000:
        found = f"{len(rows)} rows for {len(names)} points in {len(frames)} frames"
        raise InputError(found, where=text.path, expected="a row for nearly every point in every frame")
    table = np.full((len(frames), len(names)), -1)
    # From the last row to the first, so that of two rows for one sample the first stays.
    table[frame[::-1], point[::-1]] = rows[::-1]
    twice = np.flatnonzero(table[frame, point] != rows)
    if len(twice):
        found = f"a second row for {names[point[twice[0]]]!r} in frame {counts[key][twice[0]]:g}"
        raise InputError(found, where=text.at(int(rows[twice[0]])), hint="keep one person, or one camera, in a file")
    positions = np.full((*table.shape, 3), np.nan)
    positions[frame, point] = points[:, 0]
    return replace(layout, names=names), table, positions, {at: values[first] for at, values in counts.items()}


def _missing(text: Text, layout: Layout, rows: Array, observed: Array) -> bytes:
    """How the file spells a missing coordinate; an empty cell if it never does."""
    for frame, point in np.argwhere(~observed & (rows >= 0))[:50]:
        cells = split(text.line(int(rows[frame, point])), layout.separator)
        trio = {cells[column].strip(b' "') for column in layout.columns[0 if layout.long else point]}
        spelled = trio.pop()
        if not trio and (decoded(spelled).lower() in MISSING or not spelled.strip(b"0.,")):
            return spelled
    return b""


def _least_trusted(text: Text, layout: Layout, rows: Array, trust: Array) -> bytes:
    """The lowest trust above zero, as spelled: a filled sample shall not look better than a measured one."""
    if not (trust > 0).any():
        return b"1"
    least = int(rows[np.argmin(np.where(trust > 0, trust, np.inf))])
    return split(text.line(least), layout.separator)[layout.trust or 0]


def write(take: Take, path: Path) -> None:
    """Write a take: into the table that it was read from, or as a new wide table in metres, Y up."""
    table, motion = take.document, take.motion
    same = isinstance(table, Table) and (table.motion.skeleton, table.motion.fps) == (motion.skeleton, motion.fps)
    with path.open("wb") as file:
        file.writelines(_mended(table, take) if same and len(table.motion) == len(motion) else _new(take, path))


def _mended(table: Table, take: Take) -> Iterator[bytes]:
    """The file's bytes with the samples replaced that are not what was read."""
    text, layout, was, now = table.text, table.layout, table.motion, take.motion
    differs = now.observed & (~was.observed | (now.positions != was.positions).any(-1))
    lost = was.observed & ~now.observed
    changed = np.argwhere(differs | lost)
    where = _line_of(table, changed)
    order = np.argsort(where, kind="stable")
    changed, where = changed[order], where[order]
    values = from_metres(now.positions[changed[:, 0], changed[:, 1]], take.units)
    usable = now.observed[changed[:, 0], changed[:, 1]]
    decimals = _decimals(table, take.units)
    done, i = 0, 0
    while i < len(changed):
        row = int(where[i])
        yield text.raw[done : text.starts[row]]
        done = int(text.starts[row + 1])
        whole = text.whole(row)
        body_of_line = whole.rstrip(b"\r\n")
        end = whole[len(body_of_line) :]
        cells = [split(body_of_line, layout.separator)]
        while i < len(changed) and where[i] == row:
            frame, point = changed[i]
            if table.rows[frame, point] >= 0:
                target = cells[0]
            else:
                # A long table without a row for the sample gets one, below the last row of its frame.
                target = split(body_of_line, layout.separator)
                target[layout.joint or 0] = _name_of(table, point)
                cells.append(target)
            _put(target, table, point, values[i] if usable[i] else None, decimals)
            i += 1
        yield (end or b"\n").join(layout.separator.join(line) for line in cells) + end
    yield text.raw[done:]


def _line_of(table: Table, samples: Array) -> Array:
    """The line in which each of `samples (n, 2)` stands, or after which it is to be added."""
    rows = table.rows[samples[:, 0], samples[:, 1]]
    return np.where(rows >= 0, rows, table.rows[samples[:, 0]].max(axis=1, initial=-1))


def _name_of(table: Table, point: int) -> bytes:
    row = int(table.rows[:, point].max())
    return split(table.text.line(row), table.layout.separator)[table.layout.joint or 0]


def _put(cells: list[bytes], table: Table, point: int, value: Array | None, decimals: Array) -> None:
    columns = table.layout.columns[0 if table.layout.long else point]
    digits = decimals[0 if table.layout.long else point]
    spelled = [table.missing] * 3 if value is None else _spelled(value, digits)
    for column, word in zip(columns, spelled):
        old = cells[column]
        word = word.replace(b".", b",") if table.comma else word
        word = b'"' + word + b'"' if old.lstrip().startswith(b'"') else word
        cells[column] = old[: len(old) - len(old.lstrip(b" "))] + word
    if table.layout.trust is not None:
        distrusted = {b"True": b"False", b"true": b"false", b"TRUE": b"FALSE", b"yes": b"no"}.get(table.trusted, b"0")
        cells[table.layout.trust] = distrusted if value is None else table.trusted


def _spelled(value: Array, digits: Array) -> list[bytes]:
    """A point's coordinates as text; never three plain zeros, which would read as missing."""
    found = [f"{number:.{places}f}" for number, places in zip(value, digits)]
    if not any(word.strip("0.") for word in found):
        found[0] = "-" + found[0]
    return [word.encode() for word in found]


def _decimals(table: Table, units: Units) -> Array:
    """Decimals for each coordinate: as many as its column has in its first rows, and at least a micrometre."""
    enough = max(0, int(np.ceil(6 + np.log10(units.metres) - 1e-9)))
    decimals = np.full(table.layout.columns.shape, enough)
    for line in table.text.pick(np.unique(table.rows[table.rows >= 0])[:20]):
        cells = split(line, table.layout.separator)
        for at, column in np.ndenumerate(table.layout.columns):
            found = re.search(rb"[.,](\d+)", cells[column])
            if found:
                decimals[at] = max(decimals[at], len(found[1]))
    return decimals


def _new(take: Take, path: Path) -> Iterator[bytes]:
    separator = "\t" if path.suffix.lower() == ".tsv" else ","
    motion = take.motion
    clean = [re.sub(rf'[\s{separator}"]+', " ", name) for name in motion.skeleton.names]
    titles = ["frame", "time", *(f"{name}_{axis}" for name in clean for axis in "XYZ")]
    yield (separator.join(titles) + "\n").encode()
    line = separator.join(["%d", "%.6f", *["%.6f"] * (3 * len(clean))]) + "\n"
    for frame in range(len(motion)):
        points = np.round(motion.positions[frame].astype(np.float64), 6)
        # Three plain zeros would read as missing; a minus sign says that this one was measured.
        points[(points == 0).all(-1), 0] = -0.0
        points[~motion.observed[frame]] = np.nan
        yield (line % (frame, frame / motion.fps, *points.ravel().tolist())).replace("nan", "").encode()
