"""What the readers of plain text share: strict numbers, and where in the file one stands."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable

import numpy as np

from ..errors import InputError

Array = np.ndarray

NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def decoded(word: bytes) -> str:
    """Text of a name: UTF-8, or Latin-1 where it is not that."""
    try:
        return word.decode()
    except UnicodeDecodeError:
        return word.decode("latin-1")


def line_at(raw: bytes, offset: int) -> int:
    """The number of the line, from 1, on which byte `offset` stands; lines may end in LF, CRLF or CR."""
    return 1 + (raw.count(b"\n", 0, offset) or raw.count(b"\r", 0, offset))


LARGEST = 1e12  # far beyond any length, angle or time in a file; what is larger overflows sooner or later


def number(word: bytes, where: Callable[[], str], largest: float = LARGEST) -> float:
    """One finite number; InputError says what is wrong with the word, and asks `where` only then."""
    is_number = NUMBER.fullmatch(word)
    if is_number and abs(float(word)) <= largest:
        return float(word)
    shown = repr(decoded(word[:40]))
    if is_number and math.isfinite(float(word)):
        raise InputError(f"{shown} is absurdly large", where=where())
    if b"," in word:
        raise InputError(f"{shown} has a comma in it", where=where(), expected="decimal points and spaces")
    if is_number or word.lower().lstrip(b"+-").startswith((b"nan", b"inf", b"1.#")):
        raise InputError(f"{shown} is not a finite number", where=where(), hint="the program that wrote it failed")
    raise InputError(f"{shown} is not a number", where=where())


def is_numeric(block: bytes) -> bool:
    """Whether only the characters of plain numbers and white space occur."""
    return not block.translate(None, b"0123456789+-.eE \t\r\n\v\f")


def numbers(block: bytes, count: int) -> Array | None:
    """The `count` words of a numeric block as float64, fast; None if `number` would refuse any of them.

    np.fromstring alone is lax: it reads "1-2" as two numbers and stops early at what it does not understand.
    After `is_numeric`, a word that is read as several numbers shows in the count.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            values = np.fromstring(block, sep=" ")
        except (DeprecationWarning, ValueError):
            return None
    fine = len(values) == count and (count == 0 or np.abs(values).max() <= LARGEST)
    return values if fine else None
