"""Arrays of Python objects in NPZ archives, read without letting the file run anything.

NumPy stores such arrays as a pickle, which is a program. Here it only builds numbers, text, lists, tuples and dicts,
and notes whom it wanted to call and with what. The names that pickled arrays need are known; any other is
refused. Nothing that a file names is ever imported or called: the bytes of an array are looked at as what they say
they are.
"""

from __future__ import annotations

import io
import math
import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...io.npz_archive import Archive

Array = np.ndarray

_ARRAY, _DTYPE, _BYTES = "array", "dtype", "bytes"
_KNOWN = {
    ("numpy.core.multiarray", "_reconstruct"): _ARRAY,
    ("numpy._core.multiarray", "_reconstruct"): _ARRAY,
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): _DTYPE,
    # How old protocols spell bytes: latin-1 text, and none for no bytes.
    ("_codecs", "encode"): _BYTES,
    ("__builtin__", "bytes"): _BYTES,
}


class _Call:
    """What a pickle wanted to be made: a name, its arguments, and the state it was to be given. Does nothing itself."""

    __slots__ = ("arguments", "name", "state")

    def __init__(self, name: str, arguments: tuple):
        self.name, self.arguments, self.state = name, arguments, None

    def __setstate__(self, state):
        self.state = state


class _Name:
    """Stands for a function or class that a pickle names."""

    __slots__ = ("name",)

    def __init__(self, name: str):
        self.name = name

    def __call__(self, *arguments):
        return _Call(self.name, arguments)

    def __setstate__(self, state):
        raise pickle.UnpicklingError("it would change a function")


# The machine written in Python: the one in C makes room for whatever size a file claims.
class _Inert(pickle._Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _KNOWN:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        return _Name(_KNOWN[module, name])


def objects(archive: Archive, key: str) -> Any:
    """What an array of objects holds: the object itself where there is one, else the list of them.

    Arrays inside are opaque until `numbers` is asked for them. An array of numbers comes as it is. InputError for a
    pickle that asks for anything but arrays, numbers, text, lists and dicts, or that is broken.
    """
    where = f"{archive.path}:{key}"
    try:
        with zipfile.ZipFile(io.BytesIO(archive.raw)) as file:
            raw = io.BytesIO(file.read(f"{key}.npy"))
        version = np.lib.format.read_magic(raw)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        if not header(raw)[2].hasobject:
            return archive.array(key)
        made = _Inert(raw, encoding="latin1").load()
    except Exception as error:  # a pickle can go wrong in any way
        said = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"its Python objects cannot be read safely ({said})", where=where, expected="arrays, dicts and text only",
            hint="get the file from where its makers publish it",
        ) from None  # fmt: skip
    held = _state(made, where)[4]
    if not isinstance(held, list):
        raise InputError("an array of objects without objects", where=where)
    return held[0] if len(held) == 1 and _state(made, where)[1] == () else held


def numbers(value: Any, where: object) -> Array:
    """An array that `objects` found, as an array of numbers; InputError if it is none."""
    if isinstance(value, np.ndarray):
        return value
    _, shape, dtype, fortran, data = _state(value, where)
    if isinstance(data, _Call) and data.name == _BYTES:
        data = data.arguments[0] if data.arguments else ""
    if isinstance(data, str):
        data = data.encode("latin1", "ignore")  # what is none has another length then
    kind = _kind(dtype)
    sizes = isinstance(shape, tuple) and all(isinstance(size, int) and size >= 0 for size in shape)
    if kind is None or not sizes or not isinstance(data, bytes) or math.prod(shape) * kind.itemsize != len(data):
        raise InputError("an array that does not hold the numbers it says", where=where, hint="is the file damaged?")
    return np.ndarray(shape, kind, data, order="F" if fortran else "C").astype(kind.newbyteorder("="))


def _state(value: Any, where: object) -> tuple:
    state = value.state if isinstance(value, _Call) and value.name == _ARRAY else None
    if not (isinstance(state, tuple) and len(state) == 5):
        raise InputError(f"a {type(value).__name__.strip('_').lower()} where an array should be", where=where)
    return state


def _kind(dtype: Any) -> np.dtype | None:
    """The type of number that a pickled dtype states, or None if it is another thing."""
    if not (isinstance(dtype, _Call) and dtype.name == _DTYPE and dtype.arguments and isinstance(dtype.state, tuple)):
        return None
    code, order = dtype.arguments[0], dtype.state[1] if len(dtype.state) > 1 else ""
    if not (isinstance(code, str) and re.fullmatch("[iu][1248]|f[248]", code) and order in ("<", ">", "=", "|")):
        return None
    return np.dtype(order + code)


def archive_of(path: Path) -> Archive:
    """An archive by its path; InputError if it is none."""
    try:
        return Archive(path.read_bytes(), path)
    except OSError as error:
        raise InputError(error.strerror or "it cannot be read", where=path) from None
