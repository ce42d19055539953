"""A memory as one file, mapped rather than read: arrays in the layout of safetensors, nothing that could run.

Eight bytes say how long the JSON header is; it names each array's dtype, shape and place; the arrays follow. In its
`__metadata__` stands what else a session is.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io import write_whole
from ..motion import Skeleton
from .sessions import RATE, Remembered, Session

Array = np.ndarray

SUFFIX = ".memory"
VERSION = "1"
ARRAYS = ("positions", "trust", "offsets", "rotations", "shifts")
DTYPES = {"F32": np.dtype("<f4"), "U8": np.dtype("u1")}
LARGEST_HEADER = 1 << 28


@dataclass(frozen=True)
class Memory:
    """Takes that teach, by skeleton. Made by `motionmend.learn`."""

    sessions: tuple[Session, ...]

    @property
    def seconds(self) -> float:
        return sum(map(len, self.sessions)) / RATE

    def __str__(self) -> str:
        """What it holds, a line a skeleton."""
        lines = []
        for session in self.sessions:
            takes, seconds = len(session.takes), len(session) / RATE
            length = f"{seconds:.0f} s" if seconds < 60 else f"{seconds / 60:.1f} min"
            what = "joints" if session.skeleton.has_bones else "markers"
            count = len(session.skeleton) if session.offsets is None else len(session.offsets)
            kind = ", channels" if session.offsets is not None else ""
            lines.append(
                f"  {takes} take{'s' * (takes > 1)}, {length}, {count} {what}{kind}: "
                + ", ".join(take.name for take in session.takes[:4])
                + (", …" if takes > 4 else "")
            )
        return "\n".join(lines)

    def save(self, path: str | os.PathLike, *, force: bool = False) -> Path:
        """Write it; InputError if the file exists and `force` is not given."""
        path = Path(path)
        if path.suffix != SUFFIX:
            raise InputError(f"a memory is called {SUFFIX}", where=path, hint=f"say {path.with_suffix(SUFFIX).name}")
        if path.exists() and not force:
            raise InputError("the file exists", where=path, hint="choose another name, or overwrite it with --force")
        if not path.parent.is_dir():
            raise InputError("no such folder", where=path.parent)
        write_whole(path, self._write)
        return path

    def _write(self, path: Path) -> None:
        arrays = {
            f"{number}.{name}": np.ascontiguousarray(getattr(session, name))
            for number, session in enumerate(self.sessions)
            for name in ARRAYS
            if getattr(session, name) is not None
        }
        said = [
            {"names": each.skeleton.names, "parents": each.skeleton.parents, "takes": [asdict(t) for t in each.takes]}
            for each in self.sessions
        ]
        header: dict[str, Any] = {
            "__metadata__": {"format": "motionmend.memory", "version": VERSION, "sessions": json.dumps(said)}
        }
        done = 0
        for key, array in arrays.items():
            dtype = next(name for name, dtype in DTYPES.items() if dtype == array.dtype)
            header[key] = {"dtype": dtype, "shape": array.shape, "data_offsets": [done, done + array.nbytes]}
            done += array.nbytes
        words = json.dumps(header).encode()
        words += b" " * (-len(words) % 64)  # arrays begin at a multiple of 8
        with path.open("wb") as file:
            file.write(len(words).to_bytes(8, "little") + words)
            for array in arrays.values():
                file.write(array.data)

    @classmethod
    def open(cls, path: str | os.PathLike) -> Memory:
        """Map a memory that was saved.

        Raises
        ------
        InputError : if it is none, is cut off, or is of another version.
        """
        path = Path(path)
        header, start = _header(path)
        said = header.pop("__metadata__", {})
        if not isinstance(said, dict) or said.get("format") != "motionmend.memory":
            raise InputError("this is no memory of motionmend", where=path, hint=_AGAIN)
        if said.get("version") != VERSION:
            found = f"a memory of version {said.get('version')}"
            raise InputError(found, where=path, expected=f"version {VERSION}", hint=_AGAIN)
        mapped = np.memmap(path, np.uint8, "r")
        try:
            told = json.loads(said["sessions"])
            return cls(tuple(_session(each, number, header, mapped[start:]) for number, each in enumerate(told)))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"this memory is damaged: {error}", where=path, hint=_AGAIN) from None


_AGAIN = "make it again with `motionmend learn`"


def _header(path: Path) -> tuple[dict[str, Any], int]:
    if not path.is_file():
        raise InputError("no such file" if not path.exists() else "this is a folder", where=path)
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        words = file.read(length) if length <= min(LARGEST_HEADER, path.stat().st_size) else b""
    try:
        header = json.loads(words)
    except ValueError:
        header = None
    if not isinstance(header, dict):
        raise InputError("this is no memory of motionmend", where=path, hint=_AGAIN)
    return header, 8 + length


def _session(told: dict[str, Any], number: int, header: dict[str, Any], data: Array) -> Session:
    def array(name: str) -> Array | None:
        entry = header.get(f"{number}.{name}")
        if entry is None:
            return None
        first, last = entry["data_offsets"]
        dtype, shape = DTYPES[entry["dtype"]], tuple(entry["shape"])
        if not 0 <= first <= last <= len(data) or last - first != math.prod(shape) * dtype.itemsize:
            raise ValueError(f"{name} is cut off")
        return data[first:last].view(dtype).reshape(shape).view(np.ndarray)

    skeleton = Skeleton(tuple(told["names"]), tuple(told["parents"]))
    takes = tuple(Remembered(**take) for take in told["takes"])
    positions, trust, *channels = (array(name) for name in ARRAYS)
    if positions is None or trust is None:
        raise ValueError("it has no positions")
    session = Session(skeleton, takes, positions, trust, *channels)
    session.check()
    return session
