"""The text of a BVH file → its hierarchy and its table of channels, in the file's own units and axes."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..units import Hints
from ._text import decoded, is_numeric, line_at, number, numbers

Array = np.ndarray

COMMON_RATES = (24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 150, 180, 200, 240, 250, 300, 480, 500, 1000)
_WORD = re.compile(rb"[{}]|[^\s{}]+")
_FRAMES = re.compile(rb"\s*Frames[ \t]*:?[ \t]*(\S+)", re.IGNORECASE)
_FRAME_TIME = re.compile(rb"\s*Frame[ \t_]*Time[ \t]*:?[ \t]*(\S+)", re.IGNORECASE)
_CHANNEL = re.compile(rb"([XYZ])(position|rotation)", re.IGNORECASE)


@dataclass
class Tree:
    """A HIERARCHY, in file units and axes.

    shifts : position channels as (joint, axis 0–2, column). turns : per joint its rotation columns, in order.
    """

    names: list[str]
    parents: list[int]
    offsets: list[list[float]]
    ends: list[tuple[int, list[float]]]
    shifts: list[tuple[int, int, int]]
    turns: list[list[int]]
    orders: list[str]
    columns: int = 0


class Reader:
    """Walks over the bytes of a file and knows on which line it is."""

    def __init__(self, raw: bytes, path: Path):
        self.raw, self.path = raw, path
        self.start = 3 if raw.startswith(b"\xef\xbb\xbf") else 0  # of the last word
        self.at = self.start
        if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError("this is UTF-16 text", where=path, hint="save it as plain text or UTF-8")

    def where(self, offset: int | None = None) -> str:
        return f"{self.path}:{line_at(self.raw, self.start if offset is None else offset)}"

    def word(self, expected: str = "") -> bytes:
        found = _WORD.search(self.raw, self.at)
        if not found:
            raise InputError("the file ends too early", where=self.where(len(self.raw)), expected=expected)
        self.start, self.at = found.span()
        return found[0]

    def wrong(self, word: bytes, expected: str) -> InputError:
        return InputError(f"found {decoded(word[:40])!r}", where=self.where(), expected=expected)

    def hierarchy(self) -> Tree:
        """Everything up to and with the word MOTION."""
        if (word := self.word("HIERARCHY")).upper() != b"HIERARCHY":
            raise self.wrong(word, "HIERARCHY, the first word of a BVH file")
        tree = Tree([], [], [], [], [], [], [])
        path: list[int] = []  # the joints whose braces are open
        while True:
            word = self.word("} or JOINT" if path else "MOTION")
            key = word.upper()
            if key == b"MOTION" and not path:
                break
            if key in (b"ROOT", b"JOINT"):
                if (key == b"ROOT") == bool(path):
                    raise self.wrong(word, "JOINT inside of a joint, and ROOT outside")
                keyword, name = self.start, self.block_name(word)
                path.append(self.joint(tree, name, path[-1] if path else -1, keyword))
            elif key in (b"END", b"ENDSITE") and path:
                self.block_name(word)
                if (word := self.word()).upper() != b"OFFSET":
                    raise self.wrong(word, "OFFSET, which every End Site needs")
                tree.ends.append((path[-1], self.offset()))
                if (word := self.word()) != b"}":
                    raise self.wrong(word, "} after the End Site's OFFSET")
            elif key == b"}" and path:
                path.pop()
            else:
                raise self.wrong(word, "JOINT, End Site or }" if path else "ROOT or MOTION")
        if not tree.names:
            raise InputError("the HIERARCHY has no ROOT", where=self.where())
        if not tree.columns:
            raise InputError("no joint has any channels", where=self.where(), hint="there is no motion in this file")
        return tree

    def block_name(self, keyword: bytes) -> str:
        """What stands between a keyword and its opening brace; names may hold spaces."""
        brace = self.raw.find(b"{", self.at)
        text = self.raw[self.at : brace].strip() if brace >= 0 else b"\n"
        if len(text.splitlines()) > 1 or b"}" in text or brace < 0:
            raise InputError(f"no {{ follows this {decoded(keyword)}", where=self.where())
        self.at = brace + 1
        return decoded(text)

    def joint(self, tree: Tree, name: str, parent: int, keyword: int) -> int:
        """A joint's OFFSET and CHANNELS, after its opening brace; returns its index."""
        joint = len(tree.names)
        offset, turns, order = None, [], ""
        while True:
            back = self.at
            key = self.word("OFFSET").upper()
            if key == b"OFFSET" and offset is None:
                offset = self.offset()
            elif key == b"CHANNELS" and not turns:
                first, keyword_at = len(tree.shifts), self.start
                for axis, is_turn in self.channels():
                    if is_turn:
                        order += "XYZ"[axis]
                        turns.append(tree.columns)
                    elif any(axis == other for _, other, _ in tree.shifts[first:]):
                        found = f"two {'XYZ'[axis]}position channels in one joint"
                        raise InputError(found, where=self.where(keyword_at))
                    else:
                        tree.shifts.append((joint, axis, tree.columns))
                    tree.columns += 1
            else:
                self.at = back
                break
        if offset is None:
            raise InputError(f"joint {name!r} has no OFFSET", where=self.where(keyword))
        tree.names.append(name or f"joint {joint + 1}")
        tree.parents.append(parent)
        tree.offsets.append(offset)
        tree.turns.append(turns)
        tree.orders.append(order)
        return joint

    def offset(self) -> list[float]:
        return [number(self.word("three numbers"), self.where) for _ in range(3)]

    def channels(self) -> list[tuple[int, bool]]:
        """After CHANNELS: (axis, whether it is a rotation) of each."""
        keyword = self.start
        count = number(self.word("the number of channels"), self.where)
        if count < 0 or count != int(count):
            raise InputError(f"{count:g} channels", where=self.where(), expected="a whole number")
        found: list[tuple[int, bool]] = []
        while (match := _CHANNEL.fullmatch(word := self.word("channel names"))) and len(found) <= count:
            found.append((b"XYZ".index(match[1].upper()), match[2].lower() == b"rotation"))
        if len(found) != count:
            also = "" if len(found) > count else f" and then {decoded(word[:40])!r}"
            raise InputError(
                f"CHANNELS says {count:.0f}, but {len(found)} follow{also}", where=self.where(keyword),
                expected="names such as Xposition or Zrotation, as many as are announced",
            )
        self.at = self.start  # the first word after the names is somebody else's
        return found

    def motion_header(self, hints: Hints, notes: list[str]) -> tuple[float, float]:
        """Frames per second, and how many frames are announced."""
        seen: dict[re.Pattern[bytes], re.Match[bytes]] = {}
        for _ in range(2):
            for pattern in (_FRAMES, _FRAME_TIME):
                if pattern not in seen and (match := pattern.match(self.raw, self.at)):
                    seen[pattern] = match
                    self.at = match.end()
        here = self.where(self.at)
        if _FRAMES not in seen:
            raise InputError("no 'Frames:' after MOTION", where=here, expected="Frames: and a number")
        declared = number(seen[_FRAMES][1], lambda: self.where(seen[_FRAMES].start(1)), math.inf)
        if hints.fps:
            return hints.fps, declared
        if _FRAME_TIME not in seen:
            raise InputError("no 'Frame Time:' after Frames", where=here, hint="set --fps if you know it")
        word, where = seen[_FRAME_TIME][1], self.where(seen[_FRAME_TIME].start(1))
        seconds = number(word, lambda: where)
        if not 1e-5 <= seconds <= 10:
            raise InputError(
                f"a frame time of {decoded(word)} s", where=where, expected="seconds a frame, such as 0.008333",
                hint="set --fps if you know it",
            )
        fps = _rate(word, seconds)
        if abs(fps * seconds - 1) > 1e-3:
            notes.append(f"the frame time {decoded(word)} was read as {fps:g} fps; set --fps if it is not that")
        return fps, declared

    def frames(self, tree: Tree, declared: float, notes: list[str]) -> tuple[Array, Array]:
        """The channels `(frames, columns)`, and where each frame's text begins and ends `(frames, 2)`."""
        start, stop = self.at, len(self.raw.rstrip(b"\x1a\0 \t\r\n"))  # some DOS tools end a file in ^Z
        if stop <= start:
            raise InputError("there are no frames after the header", where=self.where(start))
        block = self.raw[start:stop]
        text = np.frombuffer(block, np.uint8)
        is_space = np.concatenate([[True], text <= 32])
        words = np.flatnonzero(is_space[:-1] > is_space[1:])  # where each begins
        breaks = np.flatnonzero((text == 10) | (text == 13))
        lines = np.column_stack([np.append(0, breaks + 1), np.append(breaks, len(text))])
        per_line = np.diff(np.searchsorted(words, np.append(lines[:, 0], len(text))))
        lines, per_line = lines[per_line > 0], per_line[per_line > 0]

        values = numbers(block, len(words)) if is_numeric(block) else None
        if values is None:
            raise self.bad_word(lines + start)
        if np.all(per_line == tree.columns):
            rows = lines
        else:
            rows = self.unusual_rows(tree.columns, declared, lines, per_line, words)
            notes.append("frames do not stand on one line each; they were split by the number of channels")
        if len(rows) != declared:
            notes.append(f"the header announces {declared:.0f} frames, but there are {len(rows)}; those were read")
        if len(rows) * len(tree.names) > max(len(self.raw), 1_000_000):
            raise InputError(
                f"{len(rows)} frames of {len(tree.names)} joints, nearly all without channels", where=self.path
            )
        return values.reshape(-1, tree.columns), rows + start

    def bad_word(self, lines: Array) -> InputError:
        """The error for the first word that is not a number."""
        for start, stop in lines.tolist():
            for word in self.raw[start:stop].split():
                try:
                    number(word, lambda: self.where(start))  # noqa: B023 (called at once)
                except InputError as error:
                    return error
        raise AssertionError("the fast reader refused what the careful one takes")

    def unusual_rows(self, columns: int, declared: float, lines: Array, per_line: Array, words: Array) -> Array:
        """Rows of frames that are wrapped over several lines, or share one.

        Only where the total is what the header announces and every frame begins on a new line or stands on
        one with whole frames only: anything else is damage, and its line is named.
        """
        before = np.cumsum(per_line) - per_line
        into = before % columns
        neat = (into + per_line <= columns) | ((into == 0) & (per_line % columns == 0))
        start = self.at
        if per_line.sum() == declared * columns and neat.all():
            firsts = words[::columns]
            return np.column_stack([firsts, np.append(firsts[1:], lines[-1, 1])])
        line = int(np.flatnonzero(per_line != columns)[0])
        is_last = line == len(lines) - 1 and per_line[line] < columns
        raise InputError(
            f"a frame of {per_line[line]} numbers", where=self.where(start + int(lines[line, 0])),
            expected=f"{columns}, one for each channel",
            hint="the file seems to be cut off: delete its last line to use the rest" if is_last else "",
        )


def _rate(word: bytes, seconds: float) -> float:
    """Frames per second of a frame time as spelled: 0.0083333 means 120, and not 120.0005."""
    digits = word.lower().partition(b"e")[0].partition(b".")[2]
    rate = min((*COMMON_RATES, *(rate / 1.001 for rate in (24, 30, 60, 120))), key=lambda r: abs(1 / r - seconds))
    spelled = len(word) == len(word.lower().partition(b"e")[0]) and len(digits.lstrip(b"0")) >= 2
    return float(rate) if spelled and abs(1 / rate - seconds) < 10.0 ** -len(digits) else 1 / seconds
