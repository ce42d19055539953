"""What a table of points says of itself: separator, which columns are whose x, y and z, rate, unit.

Known are the exports of Vicon Nexus, OptiTrack Motive and Qualisys, and plain tables, wide (a column for
each coordinate) and long (a row for each point in each frame). Nothing here looks at the numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from ..errors import InputError
from ..units import SPELLINGS
from ._text import decoded

Array = np.ndarray

Lines = Callable[[int, int], list[bytes]]  # the file's lines from one index to another, without their ends

SEPARATORS = (b"\t", b";", b",")
SEARCHED = 60  # lines in which a header must stand
WIDEST = 50_000  # columns; a line with more is no table of people

_FRAME = re.compile(r"(sub ?)?frames?( ?(number|no|id|index|idx))?|fnum|#")
_TIME = re.compile(
    r"(time ?stamps?|time|t|seconds|sec|milliseconds)"
    r"( ?(in )?[(\[]?(s|sec|secs|seconds|ms|msec|us|µs|ns|milliseconds)[)\]]?)?"
)
_JOINT = re.compile(
    r"((joint|marker|landmark|key ?point|bone|point|body ?part|segment|trajectory)( ?(name|id|label))?|name|label)"
)
_TRUST = re.compile(r"observed|valid|visible|visibility|confidence|conf|score|likelihood|presence")
_AXIS = r"[(\[]?(?:t|pos)?(?P<axis>[xyz])[)\]]?"
_UNIT = r"(?:\s*[(\[](?P<unit>[^)\]]+)[)\]])?"
# Most certain first; among patterns that find equally many points the first wins.
_TITLES = [
    re.compile(pattern, re.I)
    for pattern in (
        rf"(?P<name>.+?)[\s_.:|/\-]+{_AXIS}{_UNIT}",
        rf"(?P<name>.+?)[(\[](?P<axis>[xyz])[)\]]{_UNIT}",
        rf"{_AXIS}[\s_.:|/\-]+(?P<name>.+?){_UNIT}",
        rf"(?P<name>.*[^\s_.:|/\-(\[])(?P<axis>[xyz]){_UNIT}",
        rf"(?P<axis>[xyz])(?P<name>\d+){_UNIT}",
    )
]
_POSITION = re.compile(r"[\s_.:|/\-]+(pos|position|translation|trans|loc|location|coord|coordinates?|world)$", re.I)
# What is no position: always, and where the same name comes with positions too (a marker may be called "acc").
_NO_POSITION = re.compile(
    r"(^|[\s_.:|/\-])(rot|rotation|quat|quaternion|orientation|euler|angles?|velocity|acceleration|force|moment|torque|"
    r"accelerometer|gyroscope|magnetometer)$",
    re.I,
)
_BESIDE = re.compile(r"[\s_.:|/\-](vel|speed|acc|accel|gyro|mag|power|r)$", re.I)
_RATE = re.compile(
    r"(?:frame[ _]?rate|frames per second|fps|frequency|sampl(?:e|ing) rate|\brate)[^0-9\n]{0,20}"
    r"([0-9]+(?:\.[0-9]+)?)",
    re.I,
)
_SAID_UNIT = re.compile(r"\bunits?\b\W{0,4}([a-z]+)", re.I)


@dataclass(frozen=True)
class Layout:
    """Where things are in a table.

    kind : in words, for the notes. names : the points, empty in a long table, whose rows name them.
    columns : `(points, 3)` column indices of x, y, z; `(1, 3)` in a long table.
    first : index of the first line of data; the data end at a blank line if `ends_at_blank`.
    frame, time, joint, trust : columns of frame numbers, times, (long tables) names, and trust, if any.
    """

    kind: str
    separator: bytes
    names: tuple[str, ...]
    columns: Array
    first: int
    titles: tuple[str, ...]
    frame: int | None = None
    time: int | None = None
    joint: int | None = None
    trust: int | None = None
    fps: float | None = None
    unit: str | None = None
    usual: tuple[str, str] = ("m", "y")
    ends_at_blank: bool = False

    @property
    def long(self) -> bool:
        return self.joint is not None


def split(line: bytes, separator: bytes) -> list[bytes]:
    """The cells of a line as they are spelled, quotes and all; separators inside quotes do not count."""
    if not 0 < line.count(b'"') <= 4 * WIDEST:
        return line.split(separator)
    parts = line.split(b'"')
    parts[::2] = [part.replace(separator, b"\0") for part in parts[::2]]
    return b'"'.join(parts).split(b"\0")


def words(line: bytes, separator: bytes) -> list[str]:
    """The cells of a header line, without quotes and outer spaces."""
    return [decoded(cell).strip().strip('"').strip() for cell in split(line, separator)]


def understand(lines: Lines, count: int, sections: Sequence[int], where: object) -> Layout:
    """The layout of a table of `count` lines.

    Parameters
    ----------
    lines : gives the file's lines, the byte order mark removed.
    sections : indices of the lines that say "Trajectories", as Vicon Nexus titles its table of markers.

    Raises
    ------
    InputError : when no columns of x, y and z can be made out.
    """
    head = lines(0, min(count, SEARCHED))
    for at in (0, *sections[:1]):
        for i, line in enumerate(lines(at, min(count, at + SEARCHED))):
            if (columns := max(map(line.count, SEPARATORS)) + 1) > WIDEST:
                raise InputError(f"{columns:,} columns", where=f"{where}:{at + i + 1}", expected=f"at most {WIDEST:,}")
    start = head[0].strip().strip(b'"').lower()
    if start.startswith(b"format version"):
        return _motive(head, where)
    if start.startswith(b"no_of_frames"):
        return _qualisys(head, where)
    if sections:
        return _vicon(lines, count, sections[0], where)
    if section := re.match(rb'"?(devices|model outputs|joints|segments|events)"?[\s,;]*$', start):
        found = f"a Vicon Nexus export of {decoded(section[1]).title()}, without Trajectories"
        raise InputError(found, where=where, hint="export the trajectories too")
    return _plain(head, where)


def _points(names: Sequence[str], axes: Sequence[str], first_column: int = 0) -> tuple[tuple[str, ...], Array]:
    """Complete points of columns that are called `names[i]` and hold the coordinate `axes[i]`.

    A name that comes again, with all its three columns, makes another point, `name_2`.
    """
    found: dict[tuple[str, int], dict[str, int]] = {}
    seen: dict[tuple[str, str], int] = {}
    for column, (name, axis) in enumerate(zip(names, axes), start=first_column):
        if name and axis in ("x", "y", "z"):
            time = seen[name, axis] = seen.get((name, axis), 0) + 1
            found.setdefault((name, time), {})[axis] = column
    whole = {key: at for key, at in found.items() if len(at) == 3}
    columns = np.array([[at[axis] for axis in "xyz"] for at in whole.values()], int).reshape(-1, 3)
    return tuple(name if time == 1 else f"{name}_{time}" for name, time in whole), columns


def _filled_forward(cells: Sequence[str], count: int) -> list[str]:
    filled, last = [], ""
    for cell in [*cells, *[""] * (count - len(cells))][:count]:
        last = cell or last
        filled.append(last)
    return filled


def _plainly(title: str) -> str:
    return re.sub(r"[\s_]+", " ", title).strip().lower()


def _column(titles: Sequence[str], pattern: re.Pattern) -> int | None:
    """The column whose title is of a kind; a name is preferred to an ID."""
    found = [column for column, title in enumerate(titles) if pattern.fullmatch(_plainly(title))]
    return min(found, key=lambda column: (_plainly(titles[column]).endswith(" id"), column), default=None)


def _number(cell: str) -> float | None:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None


def _rate(number: float | None, where: object) -> float | None:
    if number is not None and not 0 < number <= 100_000:
        raise InputError(f"an impossible rate of {number:g} frames per second", where=where)
    return number


def _vicon(lines: Lines, count: int, section: int, where: object) -> Layout:
    head = lines(section, min(count, section + 12))
    at = next((i for i, line in enumerate(head) if re.match(rb'\W*frame\W', line, re.I)), None)
    if at is None or at < 2:
        raise InputError(
            "a 'Trajectories' section without its heading", where=f"{where}:{section + 1}",
            expected="the rate, a row of names and a row that begins Frame, Sub Frame, X, Y, Z below it",
        )
    separator = next((s for s in SEPARATORS if s in head[at]), b",")
    titles = words(head[at], separator)
    names = _filled_forward(words(head[at - 1], separator), len(titles))
    points, columns = _points(names, [title.lower() for title in titles])
    if not points:
        raise InputError("no markers in the 'Trajectories' section", where=f"{where}:{section + at + 1}")
    said = words(head[at + 1], separator) if at + 1 < len(head) else []
    has_units = any(cell.lower() in SPELLINGS for cell in said)
    unit = said[columns[0, 0]] if has_units and columns[0, 0] < len(said) else None
    rates = (_number(words(line, separator)[0]) for line in head[1:at])
    fps = _rate(next((rate for rate in rates if rate is not None), None), f"{where}:{section + 2}")
    return Layout(
        "Vicon Nexus export, its Trajectories", separator, points, columns, section + at + 1 + has_units,
        tuple(f"{name} {title}".strip() for name, title in zip(names, titles)), frame=_column(titles, _FRAME),
        fps=fps, unit=unit, usual=("mm", "z"), ends_at_blank=True,
    )  # fmt: skip


def _motive(head: list[bytes], where: object) -> Layout:
    at = next((i for i, line in enumerate(head) if re.match(rb'\W*frame\W+time', line, re.I)), None)
    rows = [i for i in range(1, at) if head[i].strip(b" ,;\t")] if at else []
    if at is None or len(rows) < 3:
        raise InputError(
            "an OptiTrack Motive export without its heading", where=where,
            expected="rows of types, names, IDs and Rotation or Position above the row Frame, Time (Seconds), X, Y, Z",
        )
    separator = next(s for s in SEPARATORS if s in head[at])
    titles, kinds = words(head[at], separator), words(head[rows[-1]], separator)
    names = words(head[rows[1]], separator)
    kinds += [""] * (len(titles) - len(kinds))
    names += [""] * (len(titles) - len(names))
    axes = [title.lower() if kind.lower() == "position" else "" for title, kind in zip(titles, kinds)]
    points, columns = _points(names, axes)
    if not points:
        raise InputError("no column of this Motive export is a position", where=f"{where}:{rows[-1] + 1}")
    said = words(head[0], separator)
    facts = {key.lower(): value for key, value in zip(said[::2], said[1::2])}
    rate = _number(facts.get("export frame rate") or facts.get("capture frame rate") or "")
    return Layout(
        f"OptiTrack Motive export, version {facts.get('format version', '?')}", separator, points, columns, at + 1,
        tuple(f"{n} {k} {t}".strip() for n, k, t in zip(names, kinds, titles)), frame=0, time=1,
        fps=_rate(rate, f"{where}:1"), unit=facts.get("length units"),
    )  # fmt: skip


def _qualisys(head: list[bytes], where: object) -> Layout:
    facts: dict[str, list[str]] = {}
    at = 0
    while at < len(head) and re.match(rb"[A-Z_]{4,}(\t|$|\s)", head[at]) and not re.match(rb"frame\b", head[at], re.I):
        key, *values = words(head[at], b"\t")
        facts[key.split()[0].upper()] = values or key.split()[1:]
        at += 1
    names = [name for name in facts.get("MARKER_NAMES", []) if name]
    if not names:
        data = " ".join(facts.get("DATA_INCLUDED", ["no data"]))
        raise InputError(f"a Qualisys file of {data}, without MARKER_NAMES", where=where, expected="markers in 3D")
    titles = words(head[at], b"\t") if at < len(head) else []
    if titles and any(re.match("[a-z]", title, re.I) for title in titles):
        at += 1
    cells = len(words(head[at].rstrip(b"\t "), b"\t")) if at < len(head) else 0
    # QTM writes the points alone, or a frame number and a time before them.
    before = cells - 3 * len(names) if cells - 3 * len(names) in (1, 2) else 0
    if len(titles) < before or not "".join(titles[:1]).isidentifier():
        titles = ["Frame", "Time"][:before]
    points, columns = _points([n for n in names for _ in "xyz"], list("xyz") * len(names), before)
    rate = _rate(_number((facts.get("FREQUENCY") or [""])[0]), f"{where}: FREQUENCY")
    return Layout(
        "Qualisys TSV", b"\t", points, columns, at,
        (*titles[:before], *(f"{n} {a}" for n in names for a in "XYZ")), frame=_column(titles[:before], _FRAME),
        time=_column(titles[:before], _TIME), fps=rate, usual=("mm", "z"),
    )  # fmt: skip


def _plain(head: list[bytes], where: object) -> Layout:
    planar = None
    for at, line in enumerate(head):
        for separator in SEPARATORS:
            if separator not in line:
                continue
            titles = words(line, separator)
            above = next((words(head[i], separator) for i in range(at - 1, -1, -1) if head[i].strip()), [])
            found = _long(titles) or _two_rows(above, titles) or _one_row(titles)
            if found and found[2] is not None:
                # Of two rows of titles, that of a time may stand in the upper one.
                titles = [title or over for title, over in zip_longest(titles, above[: len(titles)], fillvalue="")]
                return _finished(found, head, at, separator, titles, where)
            planar = planar or (found and at + 1)
    if planar:
        raise InputError(
            "the points have x and y but no z", where=f"{where}:{planar}", expected="points in space",
            hint="pixels of one camera must be triangulated first",
        )
    raise InputError(
        "no columns of coordinates could be made out", where=where,
        expected="titles such as LASI_X, LASI_Y, LASI_Z, or frame, joint, x, y, z, between commas, semicolons or tabs",
    )


_Found = tuple[str, tuple[str, ...], Array | None, str | None]  # kind, names, columns (None: planar), unit


def _long(titles: list[str]) -> _Found | None:
    plain = [_plainly(title) for title in titles]
    if _column(titles, _JOINT) is None or (_column(titles, _FRAME) is None and _column(titles, _TIME) is None):
        return None
    units = [re.search(r"[(\[]([^)\]]+)[)\]]$", title) for title in plain]
    bare = [re.sub(r"^(pos|position|world|coord) | ?[(\[].*$", "", title) for title in plain]
    if not {"x", "y"} <= set(bare):
        return None
    if "z" not in bare:
        return "long table", (), None, None
    columns = np.array([[bare.index(axis) for axis in "xyz"]])
    unit = units[columns[0, 0]]
    return "long table", (), columns, unit and unit[1]


def _two_rows(above: list[str], titles: list[str]) -> _Found | None:
    axes = [title.lower() for title in titles]
    if sum(axis in ("x", "y", "z") for axis in axes) < 3 or not any(above):
        return None
    names = ["" if _NO_POSITION.search(name) else name for name in _filled_forward(above, len(axes))]
    points, columns = _points(names, axes)
    return ("wide table with two rows of titles", points, columns, None) if points else None


def _one_row(titles: list[str]) -> _Found | None:
    best: _Found | None = None
    planar = False
    for pattern in _TITLES:
        names, axes, units = [], [], []
        for title in titles:
            match = None if _TIME.fullmatch(_plainly(title)) else pattern.fullmatch(title)
            name = _POSITION.sub("", match["name"].strip()) if match else ""
            names.append("" if _NO_POSITION.search(name) else name)
            axes.append(match["axis"].lower() if match else "")
            units.append(match["unit"] if match else None)
        names = ["" if _BESIDE.search(name) and _BESIDE.sub("", name) in names else name for name in names]
        points, columns = _points(names, axes)
        if points and (best is None or len(points) > len(best[1])):
            best = "wide table", points, columns, units[columns[0, 0]]
        with_x, with_y = ({n for n, axis in zip(names, axes) if n and axis == which} for which in "xy")
        planar = planar or bool(with_x & with_y)
    if best:
        return best
    axes = [title.lower() for title in titles]
    if all(axes.count(axis) == 1 for axis in "xyz"):
        return "wide table", ("point",), np.array([[axes.index(axis) for axis in "xyz"]]), None
    return ("wide table", (), None, None) if planar else None


def _finished(
    found: _Found, head: list[bytes], at: int, separator: bytes, titles: list[str], where: object
) -> Layout:
    kind, names, columns, unit = found
    assert columns is not None  # for the type checker: planar tables were refused
    first = at + 1
    below = words(head[first], separator) if first < len(head) else []
    stripped = [cell.strip("()[] ").lower() for cell in below]
    if any(cell in SPELLINGS for cell in stripped) and not any(_number(cell) is not None for cell in below):
        unit = stripped[columns[0, 0]] if columns[0, 0] < len(stripped) else None
        first += 1
    before = decoded(b"\n".join(head[:at]))
    rate, said = _RATE.search(before), _SAID_UNIT.search(before)
    long = kind == "long table"
    return Layout(
        kind, separator, names, columns, first, tuple(titles), frame=_column(titles, _FRAME),
        time=_column(titles, _TIME), joint=_column(titles, _JOINT) if long else None,
        trust=_column(titles, _TRUST) if long else None,
        fps=_rate(float(rate[1]), where) if rate else None, unit=unit or (said and said[1]),
    )  # fmt: skip
