"""A new C3D file of a motion: Intel floats, millimetres, Z up."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from .. import units
from ..motion import Motion, Units

Array = np.ndarray

BLOCK = 512
MOST = 65_535  # what 16 bits can count to


def new_file(motion: Motion) -> bytes:
    """The bytes of a C3D file of at most 65,535 joints or markers; unobserved samples are NaN, residual -1."""
    frames, points = motion.observed.shape
    # DATA_START stands in the section whose length it depends on, but takes two bytes whatever it is.
    start = 2 + len(_parameters(motion, 0)) // BLOCK
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, points, 0, 1, min(frames, MOST), 0, -1.0, start, 0, motion.fps)
    words = np.empty((frames, points, 4), "<f4")
    words[..., :3] = units.from_metres(motion.positions, Units(0.001, "z", ""))
    words[..., 3] = 0
    words[~motion.observed] = np.nan, np.nan, np.nan, -1
    # No padding to a whole block: where 16 bits do not hold the count, ezc3d reads frames to the end of the file.
    return b"".join([_filled(header), _parameters(motion, start), words.tobytes()])


def _filled(block: bytes) -> bytes:
    return block + bytes(-len(block) % BLOCK)


def _parameters(motion: Motion, start: int) -> bytes:
    frames, points = motion.observed.shape
    labels = [name.encode() for name in motion.skeleton.names]
    records = [
        _group(1, "POINT"), _group(2, "ANALOG"), _group(3, "TRIAL"),
        _record(1, "USED", _words(points)),
        _record(1, "FRAMES", _words(min(frames, MOST))),
        _record(1, "LONG_FRAMES", _floats(frames)),
        _record(1, "DATA_START", _words(start)),
        _record(1, "SCALE", _floats(-1)),
        _record(1, "RATE", _floats(motion.fps)),
        _record(1, "UNITS", _strings([b"mm"])),
        _record(1, "X_SCREEN", _strings([b"+X"])),
        _record(1, "Y_SCREEN", _strings([b"+Z"])),
        _record(2, "USED", _words(0)),
        # Counts of frames that may need more than 16 bits are two words, the low one first.
        _record(3, "ACTUAL_START_FIELD", _words(1, 0)),
        _record(3, "ACTUAL_END_FIELD", _words(frames % 65_536, frames // 65_536)),
        *_in_families("LABELS", labels),
        *_in_families("DESCRIPTIONS", [b""] * points),
    ]  # fmt: skip
    section = b"".join(records) + b"\0\0"
    blocks = -(-(len(section) + 4) // BLOCK)
    # The section's own count has one byte; readers go by the records.
    return _filled(bytes([1, 0x50, min(blocks, 255), 84]) + section)


def _in_families(name: str, texts: list[bytes]) -> list[bytes]:
    """NAME, NAME2, NAME3, …: one parameter holds 255 strings."""
    groups = [texts[at : at + 255] for at in range(0, len(texts), 255)] or [[]]
    return [_record(1, name + ("" if n == 1 else str(n)), _strings(group)) for n, group in enumerate(groups, 1)]


def _group(ident: int, name: str) -> bytes:
    return struct.pack("bb", len(name), -ident) + name.encode() + struct.pack("<HB", 3, 0)


def _record(group: int, name: str, value: bytes) -> bytes:
    return struct.pack("bb", len(name), group) + name.encode() + struct.pack("<H", len(value) + 3) + value + b"\0"


def _words(*numbers: int) -> bytes:
    shape = bytes([0]) if len(numbers) == 1 else bytes([1, len(numbers)])
    return b"\2" + shape + struct.pack(f"<{len(numbers)}H", *numbers)


def _floats(number: float) -> bytes:
    return b"\4\0" + struct.pack("<f", number)


def _strings(texts: Sequence[bytes]) -> bytes:
    """Strings of one width, padded with blanks; a name that is longer than a byte can say is cut."""
    width = min(max([1, *map(len, texts)]), 255)
    return bytes([0xFF, 2, width, len(texts)]) + b"".join(text[:width].ljust(width) for text in texts)
