"""Files ↔ takes: one module a format, one table.

In: a path, and what its user knows better than the file. Out: a `Take` in metres with Y up, or the file written back.
Units and axes are converted here and nowhere else. It must not know damage, repairs or networks.

A format is a module with `read(path, hints) -> Take` and, if it can be written, `write(take, path)`. A
reader keeps in `take.document` whatever it needs to write the file back exactly; a writer that gets a take
of its own format replaces only the samples that differ from what was read, and one that gets another
format's take writes a new file.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..motion import Take
from ..units import Hints


@dataclass(frozen=True)
class Format:
    name: str  # also the module in this package
    suffixes: tuple[str, ...]
    reads: bool
    writes: bool
    looks_like: Callable[[bytes], bool]  # given the first 512 bytes


def _starts_with_word(word: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.removeprefix(b"\xef\xbb\xbf").lstrip()[: len(word)].upper() == word


FORMATS = {
    format.name: format
    for format in (
        Format("bvh", (".bvh",), True, True, _starts_with_word(b"HIERARCHY")),
        Format("amc", (".amc",), True, False, lambda head: b":FULLY-SPECIFIED" in head.upper()),
        Format("c3d", (".c3d",), True, True, lambda head: head[1:2] == b"\x50" and head[:1] != b"P"),
        Format("trc", (".trc",), True, True, _starts_with_word(b"PATHFILETYPE")),
        Format("npz", (".npz",), True, True, lambda head: head[:4] in (b"PK\x03\x04", b"PK\x05\x06")),
        Format("csv", (".csv", ".tsv", ".txt"), True, True, lambda _: False),
        Format("glb", (".glb",), False, True, lambda head: head[:4] == b"glTF"),
    )
}


def load(
    path: str | os.PathLike,
    *,
    unit: str | None = None,
    up: str | None = None,
    fps: float | None = None,
    asf: str | os.PathLike | None = None,
) -> Take:
    """Read a take from a BVH, AMC, C3D, TRC, CSV or NPZ file.

    Parameters
    ----------
    path : the file; its suffix names the format.
    unit, up, fps : override what the file says or what would be guessed: "cm", "z", 120.
    asf : the skeleton of an AMC file, where it is not the one beside it.

    Raises
    ------
    InputError : for whatever is wrong with the file, with its line where there is one.
    """
    path = Path(path)
    hints = Hints(unit, up, fps, None if asf is None else str(asf))
    if not path.is_file():
        raise InputError("no such file" if not path.exists() else "this is a folder", where=path)
    format = format_of(path)
    with path.open("rb") as file:
        head = file.read(512)
    if not head.strip():
        raise InputError("the file is empty", where=path)
    other = next((other for other in FORMATS.values() if other.looks_like(head)), None)
    if other and other != format:
        hint = f"rename it to {other.suffixes[0]}"
        raise InputError(f"this is {other.name.upper()} inside", where=path, hint=hint)
    if not format.reads:
        raise InputError(f"{format.name.upper()} can be written but not read", where=path)
    return importlib.import_module(f".{format.name}", __name__).read(path, hints)


def save(take: Take, path: str | os.PathLike, *, force: bool = False) -> Path:
    """Write a take; its samples that were not changed come out as they were read.

    The file appears under its name only when it is whole. InputError if it exists and `force` is not
    given, or if the format cannot hold the take.
    """
    path = Path(path)
    format = format_of(path)
    if not format.writes:
        name = format.name.upper()
        raise InputError(f"{name} can be read but not written", where=path, hint="write .bvh instead")
    if path.exists() and not force:
        hint = "choose another name, or overwrite it with --force"
        raise InputError("the file exists", where=path, hint=hint)
    if not path.parent.is_dir():
        raise InputError("no such folder", where=path.parent)
    _check_rig_drives(take)
    module = importlib.import_module(f".{format.name}", __name__)
    write_whole(path, lambda temporary: module.write(take, temporary))
    return path


def held(take: Take, frame: int, frames: int) -> Take:
    """A take in which one frame of another lasts for so many. Written as BVH its numbers are those of the file, if it
    was one; otherwise it becomes a new file."""
    again = np.full(frames, frame)
    if take.rig is None:
        motion = replace(take.motion, positions=take.motion.positions[again], observed=take.motion.observed[again])
        return replace(take, motion=motion, document=None)
    rig = replace(
        take.rig, rotations=take.rig.rotations[again], translations=take.rig.translations[again],
        trusted=take.rig.trusted[again],
    )  # fmt: skip
    document = None
    if take.format == "bvh" and take.document is not None:
        document = importlib.import_module(".bvh", __name__).held(take, frame, frames)
    return replace(take.with_rig(rig), document=document)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with a temporary name beside `path`, then rename: all of the file appears or none."""
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def sha256_of(*paths: Path) -> str:
    """SHA-256 of the files, one appended to the other."""
    found = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            hashlib.file_digest(file, lambda: found)
    return found.hexdigest()


def format_of(path: Path) -> Format:
    """The format a path's suffix names."""
    for format in FORMATS.values():
        if path.suffix.lower() in format.suffixes:
            return format
    known = ", ".join(suffix for format in FORMATS.values() for suffix in format.suffixes)
    hint = "Blender turns FBX into BVH, and imports GLB" if path.suffix.lower() == ".fbx" else ""
    raise InputError(f"unknown suffix {path.suffix!r}", where=path, expected=f"one of {known}", hint=hint)


def _check_rig_drives(take: Take) -> None:
    if take.rig is not None and len(take):
        positions = take.rig.kinematics[0]
        if np.abs(positions - take.motion.positions).max() > 1e-3:
            raise InputError(
                "the positions were changed but the channels were not", where=take.source,
                hint="turn positions into channels with motionmend.fit(take, positions)",
            )
