"""Arrays that a file has stored as Python pickles: what is in them comes out, and nothing in them is run."""

from __future__ import annotations

import io as streams
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from motionmend.corpora.datasets import h36m
from motionmend.corpora.datasets._objects import archive_of, numbers, objects
from motionmend.errors import InputError


def save_objects(path: Path, key: str, value, protocol: int) -> Path:
    """What np.savez writes for an array of objects, with any protocol of pickle."""
    array = np.empty((), object)
    array[()] = value
    stream = streams.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": ()})
    stream.write(pickle.dumps(array, protocol=protocol))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(f"{key}.npy", stream.getvalue())
    return path


ARRAYS = {
    "float32": np.arange(24, dtype=np.float32).reshape(2, 4, 3) / 7,
    "float64": np.linspace(-1, 1, 6).reshape(3, 2),
    "columns first": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "big-endian": np.arange(5, dtype=">i4"),
    "empty": np.zeros((0, 32, 3), np.float32),
    "zero": np.array(3.5),
}


@pytest.mark.parametrize("protocol", [2, 3, 4])
@pytest.mark.parametrize("array", ARRAYS.values(), ids=ARRAYS)
def test_arrays_in_objects_come_out_as_they_went_in(tmp_path, array, protocol):
    path = save_objects(tmp_path / "x.npz", "things", {"S1": {"Walking é": array}, "n": [1, 2.5, "w"]}, protocol)
    found = objects(archive_of(path), "things")
    assert set(found) == {"S1", "n"} and found["n"] == [1, 2.5, "w"]
    out = numbers(found["S1"]["Walking é"], path)
    np.testing.assert_array_equal(out, array)
    assert out.dtype == array.dtype.newbyteorder("=")


def test_lists_of_arrays(tmp_path):
    ragged = np.empty(2, object)
    ragged[:] = [np.ones((2, 3)), np.zeros((5, 3), np.float32)]
    np.savez_compressed(tmp_path / "x.npz", clips=ragged, flat=np.arange(6.0).reshape(2, 3))
    archive = archive_of(tmp_path / "x.npz")
    assert [numbers(each, "").shape for each in objects(archive, "clips")] == [(2, 3), (5, 3)]
    np.testing.assert_array_equal(objects(archive, "flat"), np.arange(6.0).reshape(2, 3))


class Hostile:
    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_nothing_in_a_file_is_run(tmp_path, protocol):
    trap = tmp_path / "sprung"
    save_objects(tmp_path / "data_3d_h36m.npz", "positions_3d", {"S1": {"Walking": Hostile(trap)}}, protocol)
    with pytest.raises(InputError, match="cannot be read safely"):
        list(h36m.read(tmp_path, stage=lambda _: None))
    assert not trap.exists()
    pickle.loads(pickle.dumps(Hostile(trap)))  # the trap does work
    assert trap.exists()


def test_pickles_that_lie(tmp_path):
    array = pickle.dumps(np.ones((2, 3), np.float32), protocol=4)
    bodies = {
        "cut": array[:-20],
        "shape": array.replace(b"K\x02K\x03\x86", b"K\x7fK\x7f\x86"),
        "type": array.replace(b"\x8c\x02f4", b"\x8c\x02O8"),
        "builtin": b"cbuiltins\neval\n(S'1+1'\ntR.",
        "memo": b"\x80\x04]r\xff\xff\xff\x7f.",
        "size": b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.",
        "loop": b"\x80\x04]\x94h\x00a.",
        "text": b"\x80\x04\x8c\x02hi.",
        "nothing": b"",
    }
    for name, body in bodies.items():
        stream = streams.BytesIO()
        np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": ()})
        path = tmp_path / f"{name}.npz"
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("x.npy", stream.getvalue() + body)
        with pytest.raises(InputError):
            numbers(objects(archive_of(path), "x"), path)
