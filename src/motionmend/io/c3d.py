"""C3D files: read in all six encodings, and repaired in place.

The format (c3d.org) is blocks of 512 bytes: a header, a parameter section, then one record a frame: four
words a point (x, y, z, and a word that holds residual and camera mask, negative = no measurement), then the
frame's analog samples. Words are 16-bit integers to be scaled, or 32-bit floats; Intel, DEC or SGI order.

Reading is our own: ezc3d, an independent oracle in the tests, refuses SGI files and those of several vendors,
crashes on some damaged ones, and rewrites on saving what it need not (encoding, parameters, analog words).
Writing back changes the words of repaired samples in the bytes of the original; all other bytes stay.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .. import units
from ..body.measures import measure
from ..errors import InputError
from ..motion import Motion, Skeleton, Take, Units
from ..units import Hints
from . import _points
from .c3d_new import new_file
from .c3d_words import Encoding, Parameter
from .c3d_words import parameters as parameters_of

Array = np.ndarray

BLOCK = 512
NOT_POSITIONS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")


@dataclass(frozen=True, eq=False)
class Document:
    """A C3D file as read, and where its points lie in the bytes.

    raw : the whole file. data : the byte where the first frame starts. stride : words a frame.
    columns : `(joints,)` the file's point that is each joint of the motion. scale : file units per integer.
    motion : what the reader made of it; a sample that differs from it was changed since.
    parameters : "GROUP:NAME" → Parameter.
    """

    raw: bytes = field(repr=False)
    encoding: Encoding
    data: int
    stride: int
    scale: float
    columns: Array
    motion: Motion
    parameters: dict[str, Parameter] = field(repr=False)


def read(path: Path, hints: Hints) -> Take:
    """A take of the points of a C3D file; its model outputs (angles, forces, …) stay in the document.

    Missing: a residual below zero, and what `_points.present` says.
    """
    raw = path.read_bytes()
    if len(raw) < BLOCK or raw[1] != 0x50:
        raise InputError("this is not a C3D file", where=path, expected="a header of 512 bytes with 0x50 as second")
    notes: list[str] = []
    start = max(raw[0] - 1, 1) * BLOCK
    if start + 4 > len(raw):
        raise InputError(
            "the file ends before its parameter section", where=path, expected=f"one at byte {start}, of {len(raw)}"
        )
    if raw[start + 3] not in (84, 85, 86):
        notes.append(f"the processor type {raw[start + 3]} is unknown; read as Intel")
    encoding = Encoding(">" if raw[start + 3] == 86 else "<", raw[start + 3] == 85)
    points, analogs, first, last = struct.unpack_from(f"{encoding.order}4H", raw, 2)
    data_block, samples = struct.unpack_from(f"{encoding.order}2H", raw, 16)
    section = raw[: (data_block - 1) * BLOCK] if data_block > 1 else raw
    parameters, broken = parameters_of(section, start, encoding)
    if broken:
        notes.append(f"the parameter section breaks off at byte {broken}; what follows there was not understood")
    if not points:
        raise InputError("the file has no points, only analog channels", where=path, expected="marker trajectories")

    def number(name: str) -> float:
        """A parameter's value: two 16-bit words are one number, the low word first; 0 if there is none."""
        found = parameters.get(name)
        low, high = [*(found.numbers() if found else []), 0, 0][:2]
        value = low + 65536 * high if found and found.kind == 2 else low
        return value if np.isfinite(value) else 0

    scale = encoding.float_at(raw, 12) or number("POINT:SCALE")
    if not np.isfinite(scale) or not scale:
        raise InputError(f"the scale of the points is {scale}", where=path, expected="a number other than zero")
    if scale > 0 and abs(number("POINT:SCALE") / scale - 1) > 0.01:
        notes.append(f"POINT:SCALE is {number('POINT:SCALE'):g} but the header's {scale:g} was used")
    encoding = Encoding(encoding.order, encoding.dec, scale > 0)
    data = (data_block - 1) * BLOCK
    if not start < data < len(raw):
        data = (int(number("POINT:DATA_START")) - 1) * BLOCK
    if not start < data < len(raw):
        raise InputError(
            f"the data should start at byte {(data_block - 1) * BLOCK}, but the file has {len(raw)}", where=path,
            hint="the file is cut off or damaged; export it again",
        )
    cut = number("TRIAL:ACTUAL_END_FIELD") - number("TRIAL:ACTUAL_START_FIELD") + 1
    declared = (
        last - first + 1 if last < 65535 else 0,
        cut if "TRIAL:ACTUAL_END_FIELD" in parameters else 0,
        number("POINT:LONG_FRAMES"),
        number("POINT:FRAMES"),
    )
    # "Analog samples per frame" means all channels' together; some writers count channels.
    strides = (4 * points + analogs, 4 * points + analogs * samples)
    frames, stride = _layout(path, (len(raw) - data) // encoding.word.itemsize, declared, strides)

    labels = _labels(parameters, points)
    outputs = _outputs(parameters)
    columns = np.array([p for p in range(points) if labels[p] not in outputs], int)
    if len(columns) < points:
        notes.append(f"{points - len(columns)} model outputs (angles, forces, …) are kept but are no markers")
    if not len(columns):
        raise InputError("all points are model outputs (angles, forces, …)", where=path, expected="markers")
    skeleton = Skeleton.cloud(_points.unique([labels[p] for p in columns], notes))

    words = _words(raw, encoding, data, frames, stride)[:, : 4 * points].reshape(frames, points, 4)[:, columns]
    with np.errstate(all="ignore"):  # damaged words may be signalling NaNs, or overflow
        numbers = encoding.decode(words)
        positions = numbers[..., :3] * np.float32(scale if encoding.whole else 1)
    observed = _points.present(positions, ~(numbers[..., 3] < 0), notes)
    positions = np.where(observed[..., None], positions, np.float32(np.nan))

    fps = hints.fps or encoding.float_at(raw, 20) or number("POINT:RATE")
    if not 0 < fps <= 100_000:
        raise InputError(f"a rate of {fps} frames per second", where=path, hint="say the rate with --fps")
    said_up, usual_up = _said_up(parameters)
    conversion = units.resolve(
        hints, said_unit=_said_unit(parameters), said_up=said_up, usual_unit="mm", usual_up=usual_up,
        **measure(skeleton, positions),
    )
    motion = Motion(units.to_metres(positions, conversion), observed, float(fps), skeleton)
    document = Document(raw, encoding, data, stride, scale, columns, motion, parameters)
    return Take(motion, None, document, conversion, "c3d", str(path), tuple(notes))


def _words(raw: bytes | bytearray, encoding: Encoding, data: int, frames: int, stride: int) -> Array:
    """The stored words, `(frames, stride)`, as a view into `raw`."""
    return np.frombuffer(raw, encoding.word, frames * stride, data).reshape(frames, stride)


def _layout(path: Path, words: int, declared: tuple[float, ...], strides: tuple[int, ...]) -> tuple[int, int]:
    """How many frames there are, and of how many words: the first that fill the file to its last block, or fit.

    A header counts to 65,535 only, and cutting tools forget one place or another.
    """
    counts = [int(count) for count in declared if 0 < count < 2**32]
    fits = [(count, stride) for stride in strides for count in counts if count * stride <= words]
    if fits:
        return next(((count, stride) for count, stride in fits if words - count * stride < BLOCK), fits[0])
    raise InputError(
        f"{counts[0] if counts else 0} frames are declared but the file holds {words // strides[0]}", where=path,
        hint="the file is cut off or damaged; export it again",
    )


def _family(parameters: dict[str, Parameter], name: str) -> Iterator[str]:
    """The strings of POINT:NAME, NAME2, NAME3, …: a parameter holds 255 at most."""
    for suffix in ("", *map(str, range(2, 300))):
        if f"POINT:{name}{suffix}" not in parameters:
            return
        yield from parameters[f"POINT:{name}{suffix}"].strings()


def _labels(parameters: dict[str, Parameter], points: int) -> list[str]:
    """A label for every point; one that has none is called by its place, "*12", as is usual."""
    labels = list(_family(parameters, "LABELS"))[:points]
    labels += [""] * (points - len(labels))
    return [label or f"*{place}" for place, label in enumerate(labels, start=1)]


def _outputs(parameters: dict[str, Parameter]) -> set[str]:
    """The labels of points that are no positions, by POINT:ANGLES and its like and by POINT:TYPE_GROUPS."""
    types = list(_family(parameters, "TYPE_GROUPS"))[::2]
    names = {*NOT_POSITIONS, *(name.upper() for name in types)} - {"", "LABELS"}
    return {label for name in names for label in _family(parameters, name)} - {""}


def _said_unit(parameters: dict[str, Parameter]) -> str | None:
    """POINT:UNITS; four-letter fields have cut "metres" to "mete"."""
    said = next((text.lower() for text in _family(parameters, "UNITS")), "")
    cut = (name for name in units.SPELLINGS if len(said) >= 4 and name.startswith(said))
    return said if said in units.SPELLINGS else next(cut, None)


def _said_up(parameters: dict[str, Parameter]) -> tuple[str | None, str]:
    """The axis that POINT:Y_SCREEN draws upwards, and the axis to assume if nothing better tells.

    A minus sign there says how a viewer turned the screen, not that people stand on their heads (Qualisys
    writes "-Z" for takes that are Z up), and so the body decides first then.
    """
    said = next(iter(_family(parameters, "Y_SCREEN")), "").lower().strip()
    axis = said.strip("+-")
    if axis not in ("x", "y", "z"):
        return None, "z"
    return (None if "-" in said else axis), axis


def write(take: Take, path: Path) -> None:
    """Write the take: into the bytes it was read from, or as a new file if it came from another format.

    In the original bytes a filled sample gets its new coordinates and residual 0, which the format defines as
    "not measured, computed"; one that is no longer trusted and was not filled gets NaN and residual -1 (zeros
    and -1 where the encoding has no NaN).
    """
    document, motion = take.document, take.motion
    if isinstance(document, Document) and motion.positions.shape == document.motion.positions.shape:
        path.write_bytes(_patched(document, motion, take.units, take.source))
    elif len(motion.skeleton) > 65_535:
        raise InputError(f"{len(motion.skeleton)} points", where=take.source, expected="65,535 at most in a C3D file")
    else:
        path.write_bytes(new_file(motion))


def _patched(document: Document, motion: Motion, conversion: Units, source: str) -> bytes | bytearray:
    filled, lost = _points.changes(document.motion, motion)
    if not (filled | lost).any():
        return document.raw
    encoding, raw = document.encoding, bytearray(document.raw)
    words = _words(raw, encoding, document.data, len(motion), document.stride)

    def put(which: Array, xyz: Array, residual: float) -> None:
        frames, joints = np.nonzero(which)
        numbers = np.column_stack([xyz, np.full(len(xyz), residual)])
        words[frames[:, None], 4 * document.columns[joints][:, None] + np.arange(4)] = encoding.encode(numbers)

    xyz = units.from_metres(motion.positions[filled], conversion)
    if encoding.whole:
        xyz /= document.scale
        if len(xyz) and not np.abs(xyz).max() <= 32767:
            raise InputError(
                f"a repaired marker is farther out than this file's 16-bit numbers reach "
                f"({32767 * document.scale:g} of its units)", where=source, hint="write .trc or .csv instead",
            )
    put(filled, xyz, 0)
    nowhere = 0.0 if encoding.whole or encoding.dec else np.nan
    put(lost, np.full((int(lost.sum()), 3), nowhere), -1)
    return raw
