"""NPZ archives, opened with suspicion: what they say of themselves is checked before anything is unpacked."""

from __future__ import annotations

import io
import math
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from ..errors import InputError

Array = np.ndarray

RATIO = 50  # more than captures of this size compress by; deflate itself ends at 1032
FREE = 1 << 26  # bytes that any archive may hold, whatever its ratio
_UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError, MemoryError),
    *(ValueError, TypeError, SyntaxError, tokenize.TokenError, OverflowError, RecursionError),
)


class Archive:
    """The arrays of an NPZ file by their keys. Nothing is ever unpickled.

    Raises InputError for archives that are broken, that would unpack to far more than their size, or that
    hold two arrays of one name; and, when such an array is asked for, for objects and for a header that
    does not fit its data.
    """

    def __init__(self, raw: bytes, path: Path):
        self.raw, self.path = raw, path
        self._members: dict[str, zipfile.ZipInfo] = {}
        with self._explained():
            self._zip = zipfile.ZipFile(io.BytesIO(raw))
        for info in self._zip.infolist():
            key = info.filename.removesuffix(".npy")
            if key in self._members:
                raise InputError(f"two arrays are called {key!r}", where=path)
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise InputError(f"{key!r} is compressed in a way that NumPy does not write", where=path)
            self._members[key] = info
        total = sum(info.file_size for info in self._members.values())
        if total > max(FREE, RATIO * len(raw)):
            raise InputError(
                f"{len(raw):,} bytes that would unpack to {total:,}", where=path,
                expected=f"at most {RATIO} times the file", hint="if it is real, save it with np.savez, uncompressed",
            )  # fmt: skip

    @property
    def keys(self) -> set[str]:
        return set(self._members)

    def shape(self, key: str) -> tuple[int, ...]:
        """The shape that an array's header states; the array itself is not touched."""
        with self._explained(), self._zip.open(self._members[key]) as file:
            return _header(file)[0]

    def array(self, key: str) -> Array | None:
        """An array, or None if there is none under this key."""
        if key not in self._members:
            return None
        info = self._members[key]
        with self._explained(), self._zip.open(info) as file:
            shape, dtype, length = _header(file)
        if dtype.hasobject:
            raise InputError(
                f"{key!r} is an array of Python objects, which could run code when opened", where=self.path,
                expected="numbers", hint="save it as a plain one: np.savez(path, positions=np.asarray(x, float), …)",
            )  # fmt: skip
        data = info.file_size - length
        if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != data:
            found = f"{key!r} says that it is {shape} of {dtype}, but it has {data:,} bytes"
            raise InputError(found, where=self.path, hint="is the file cut off?")
        with self._explained(), self._zip.open(info) as file:
            array = np.lib.format.read_array(file, allow_pickle=False)
            file.read()  # to the end, where the checksum is compared
        if dtype.kind == "U" and array.size and int(_code_points(array).max()) > sys.maxunicode:
            raise InputError(f"{key!r} is no text", where=self.path, hint="is the file damaged?")
        return array

    def rewritten(self, path: Path, arrays: Mapping[str, Array]) -> None:
        """Write the archive with `arrays` in place of those of the same keys, all else as it is."""
        with self._explained(), zipfile.ZipFile(path, "w") as target:
            for key, info in self._members.items():
                # A fresh entry: the old one's sizes and flags belong to the old file.
                entry = zipfile.ZipInfo(info.filename, info.date_time)
                entry.compress_type, entry.external_attr = info.compress_type, info.external_attr
                with target.open(entry, "w", force_zip64=True) as file:
                    if key in arrays:
                        np.lib.format.write_array(file, arrays[key], allow_pickle=False)
                    else:
                        file.write(self._zip.read(info))

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except _UNREADABLE as error:
            said = str(error).strip().splitlines()[0][:120] if str(error).strip() else type(error).__name__
            raise InputError(f"the archive cannot be read ({said})", where=self.path, hint="is it cut off?") from error


def _code_points(text: Array) -> Array:
    """The numbers of the characters of a text array; Python crashes on some that are none."""
    return np.ascontiguousarray(text.astype(text.dtype.newbyteorder("="))).reshape(-1).view(np.uint32)


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype, int]:
    version = np.lib.format.read_magic(file)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = reader(file)
    return shape, dtype, file.tell()
