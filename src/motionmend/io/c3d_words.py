"""The words of a C3D file: numbers in its six encodings, and the parameter section."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from ._text import decoded

Array = np.ndarray


@dataclass(frozen=True)
class Encoding:
    """How a file stores numbers. order : "<" or ">". dec : VAX floats. whole : points are 16-bit integers."""

    order: str
    dec: bool
    whole: bool = False

    @property
    def word(self) -> np.dtype:
        return np.dtype(f"{self.order}i2" if self.whole else "<u4" if self.dec else f"{self.order}f4")

    def decode(self, words: Array) -> Array:
        """Stored words as float32; integers unscaled."""
        return _from_dec(words) if self.dec and not self.whole else words.astype(np.float32)

    def encode(self, numbers: Array) -> Array:
        """Numbers as words to store."""
        if self.whole:
            return np.rint(numbers).astype(self.word)
        return _to_dec(numbers) if self.dec else numbers.astype(self.word)

    def float_at(self, raw: bytes, at: int) -> float:
        kind = np.dtype("<u4") if self.dec else np.dtype(f"{self.order}f4")
        word = np.frombuffer(raw, kind, 1, at)
        return float(_from_dec(word)[0] if self.dec else word[0])


# A VAX F float is an IEEE one with its 16-bit halves swapped and an exponent two greater.
def _from_dec(words: Array) -> Array:
    swapped = (words >> np.uint32(16)) | (words << np.uint32(16))
    return swapped.astype(np.uint32).view(np.float32) / np.float32(4)


def _to_dec(numbers: Array) -> Array:
    bits = np.ascontiguousarray(numbers * 4, np.float32).view(np.uint32)
    return ((bits >> np.uint32(16)) | (bits << np.uint32(16))).astype("<u4")


@dataclass(frozen=True)
class Parameter:
    """One entry of the parameter section. kind : -1 characters, 1 bytes, 2 16-bit integers, 4 floats."""

    kind: int
    shape: tuple[int, ...]
    data: bytes
    encoding: Encoding

    def strings(self) -> list[str]:
        if self.kind != -1:
            return []
        width = self.shape[0] if self.shape else 1
        cells = [self.data[at : at + width] for at in range(0, len(self.data), width)] if width else []
        return [text(cell) for cell in cells]

    def numbers(self) -> list[float]:
        if self.kind not in (1, 2, 4):
            return []
        if self.kind == 4:
            return [self.encoding.float_at(self.data, at) for at in range(0, len(self.data) - 3, 4)]
        # Counts beyond 32,767 are stored in the same 16 bits.
        kind = f"{self.encoding.order}u2" if self.kind == 2 else "u1"
        return np.frombuffer(self.data, kind).astype(float).tolist()


def parameters(raw: bytes, start: int, encoding: Encoding) -> tuple[dict[str, Parameter], int]:
    """The parameter section as "GROUP:NAME" → Parameter, and the byte where it stops making sense (0: nowhere).

    Every record names the offset of the next one. A damaged one may point anywhere: the walk goes on behind
    what was read, so that it ends and no byte is read twice.
    """
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Parameter]] = []
    at, broken = start + 4, 0
    while at + 2 <= len(raw) and raw[at]:
        length, group = abs(struct.unpack_from("b", raw, at)[0]), struct.unpack_from("b", raw, at + 1)[0]
        link = at + 2 + length
        if link + 5 > len(raw) or not group or length > 127:
            broken = at
            break
        name = text(raw[at + 2 : link]).upper()
        (offset,) = struct.unpack_from(f"{encoding.order}H", raw, link)
        end = link + 2
        if group < 0:
            groups[-group] = name
        else:
            parameter = _parameter(raw, link + 2, encoding)
            if parameter is None:
                broken = at
                break
            found.append((group, name, parameter))
            end += 2 + len(parameter.shape) + len(parameter.data)
        if not offset:
            break
        at = max(link + offset, end)
    return {f"{groups[group]}:{name}": parameter for group, name, parameter in found if group in groups}, broken


def _parameter(raw: bytes, at: int, encoding: Encoding) -> Parameter | None:
    """The parameter whose type byte is at `at`, or None if it cannot be one."""
    kind, dimensions = struct.unpack_from("bB", raw, at)
    shape = tuple(raw[at + 2 : at + 2 + dimensions])
    size = abs(kind)
    for extent in shape:
        size *= extent
    begin = at + 2 + dimensions
    if kind not in (-1, 1, 2, 4) or dimensions > 7 or begin + size > len(raw):
        return None
    return Parameter(kind, shape, raw[begin : begin + size], encoding)


def text(cell: bytes) -> str:
    """A label or name: up to the first NUL, without the blanks that pad it."""
    return decoded(cell).split("\0")[0].strip()
