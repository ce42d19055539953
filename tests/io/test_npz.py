"""NPZ archives: what was good comes back value for value, and what could do harm is refused before it does."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionmend as mm
from motionmend.errors import InputError

RNG = np.random.default_rng(3)


def saved(tmp_path, name="take.npz", **arrays):
    path = tmp_path / name
    np.savez(path, **arrays)
    return path


def person(frames=20):
    """Six joints of a person of 1.7 m or so, in metres, Y up, that walk along x."""
    names = ["Hips", "Spine", "Head", "LeftUpLeg", "LeftLeg", "LeftFoot"]
    rest = np.array([[0, 0.95, 0], [0, 1.1, 0], [0, 1.55, 0], [0.1, 0.9, 0], [0.1, 0.49, 0], [0.1, 0.08, 0]])
    walk = np.linspace(0, 1, frames)[:, None, None] * [1.0, 0, 0]
    return names, np.array([-1, 0, 1, 0, 3, 4]), rest + walk + RNG.normal(0, 0.01, (frames, 6, 3))


def filled(take, value=(1.0, 2.0, 3.0)):
    """The take with everything observed, and `value` in metres where it was not."""
    motion = take.motion
    positions = np.where(motion.observed[..., None], motion.positions, np.float32(value))
    return take.with_motion(replace(motion, positions=positions, observed=np.ones_like(motion.observed)))


def test_what_is_read_is_what_was_saved(tmp_path):
    names, parents, positions = person()
    observed = RNG.random(positions.shape[:2]) > 0.2
    path = saved(tmp_path, positions=positions, observed=observed, fps=50.0, names=names, parents=parents, unit="m")
    take = mm.load(path)
    assert take.skeleton.names == tuple(names) and take.skeleton.parents == tuple(parents) and take.fps == 50
    np.testing.assert_array_equal(take.motion.observed, observed)
    np.testing.assert_allclose(take.motion.positions[observed], positions[observed], atol=1e-6)
    assert np.isnan(take.motion.positions[~observed]).all()


def test_unit_and_axis_as_the_file_says(tmp_path):
    path = saved(tmp_path, positions=np.array([[[1000.0, 2000, 3000]]]), fps=1, unit=np.bytes_(b"mm"), up="z")
    np.testing.assert_allclose(mm.load(path).motion.positions, [[[1, 3, -2]]], atol=1e-6)
    np.testing.assert_allclose(mm.load(path, unit="cm", up="y").motion.positions, [[[10, 20, 30]]], atol=1e-5)


@pytest.mark.parametrize("dtype", ["<f2", "<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_unchanged_save_keeps_keys_dtypes_order_and_values(tmp_path, dtype, order):
    _, parents, positions = person()
    positions = np.asarray(positions, dtype, order=order)
    positions[3, 2] = np.nan
    other = {"betas": RNG.normal(size=10), "label": np.array("walk"), "empty": np.zeros((0, 4))}
    path = saved(tmp_path, positions=positions, fps=np.float32(30), parents=parents, **other)
    again = mm.save(mm.load(path), tmp_path / "again.npz")
    before, after = np.load(path), np.load(again)
    assert before.files == after.files
    for key in before.files:
        assert before[key].dtype == after[key].dtype and before[key].shape == after[key].shape
        assert before[key].flags.f_contiguous == after[key].flags.f_contiguous
        assert before[key].tobytes() == after[key].tobytes()


def test_only_changed_samples_change(tmp_path):
    names, _, positions = person()
    positions = (positions * 1000).astype(np.float64)
    observed = np.ones(positions.shape[:2], np.uint8) * 255
    observed[5, 1] = 0
    path = saved(tmp_path, positions=positions, observed=observed, fps=50, names=names, unit="mm", up="y", extra=[1, 2])
    take = filled(mm.load(path))
    take = take.distrust(np.arange(20 * 6).reshape(20, 6) == 7)  # frame 1, joint 1
    after = np.load(mm.save(take, tmp_path / "again.npz"))
    expected = positions.copy()
    expected[5, 1] = [1000, 2000, 3000]
    np.testing.assert_allclose(after["positions"][5, 1], expected[5, 1], rtol=1e-6)
    untouched = np.ones((20, 6), bool)
    untouched[5, 1] = False
    np.testing.assert_array_equal(after["positions"][untouched], positions[untouched])
    seen = observed.copy()
    seen[5, 1], seen[1, 1] = 1, 0
    np.testing.assert_array_equal(after["observed"], seen)
    assert after["observed"].dtype == np.uint8 and after["extra"].tolist() == [1, 2]


def test_without_observed_what_is_missing_is_nan(tmp_path):
    _, _, positions = person()
    take = mm.load(saved(tmp_path, positions=positions, fps=50))
    mask = np.zeros((20, 6), bool)
    mask[4:6, 2] = True
    after = np.load(mm.save(take.distrust(mask), tmp_path / "again.npz"))["positions"]
    np.testing.assert_array_equal(np.isnan(after).all(-1), mask)
    np.testing.assert_array_equal(after[~mask], positions[~mask])


def test_integers_in_millimetres_are_kept_as_such(tmp_path):
    names, _, positions = person()
    observed = np.ones((20, 6), bool)
    observed[2, 2] = False
    stored = np.rint(positions * 1000).astype(np.int16)
    path = saved(tmp_path, positions=stored, observed=observed, fps=50, names=names, unit="mm")
    after = np.load(mm.save(filled(mm.load(path), (0.1234, 1, 2)), tmp_path / "again.npz"))["positions"]
    assert after.dtype == np.int16 and after[2, 2].tolist() == [123, 1000, 2000]
    with pytest.raises(InputError, match="int16"):
        mm.save(filled(mm.load(path), (99.0, 1, 2)), tmp_path / "third.npz")
    assert not (tmp_path / "third.npz").exists()


def test_a_new_archive_of_another_take_reads_the_same(tmp_path):
    names, parents, positions = person()
    positions[3, 3] = np.nan
    take = mm.load(saved(tmp_path, positions=positions, fps=24000 / 1001, names=names, parents=parents))
    take = replace(take, format="other", document=None)
    again = mm.load(mm.save(take, tmp_path / "new.npz"))
    assert again.skeleton == take.skeleton and again.fps == take.fps
    np.testing.assert_array_equal(again.motion.observed, take.motion.observed)
    np.testing.assert_array_equal(again.motion.positions, take.motion.positions)
    assert "m (as the file says), y up (as the file says)" in again.units.why


def test_infinite_and_absurd_numbers_are_missing(tmp_path):
    positions = np.ones((4, 1, 3))
    positions[1, 0, 0], positions[2, 0, 1], positions[3, 0, 2] = np.inf, 1e300, np.nan
    take = mm.load(saved(tmp_path, positions=positions, fps=30))
    assert take.motion.observed[:, 0].tolist() == [True, False, False, False]


def test_names_may_be_bytes_or_absent(tmp_path):
    positions = np.zeros((2, 2, 3)) + 1
    take = mm.load(saved(tmp_path, positions=positions, fps=[30], names=np.array([b"H\xc3\xa9", b"b"])))
    assert take.skeleton.names == ("Hé", "b")
    assert mm.load(saved(tmp_path, positions=positions, fps=30)).skeleton.names == ("joint_00", "joint_01")


def test_roots_are_spelled_in_several_ways(tmp_path):
    positions = np.ones((2, 4, 3))
    for parents in ([-1, 0, 1, -1], [0, 0, 1, 3], np.array([2**32 - 1, 0, 1, 3], np.uint32), [-1.0, 0.0, 1.0, -1.0]):
        take = mm.load(saved(tmp_path, positions=positions, fps=30, parents=np.array(parents)))
        assert take.skeleton.parents == (-1, 0, 1, -1)
    for parents in ([1, 0, -1, -1], [1, -1, 1, 1]):
        take = mm.load(saved(tmp_path, positions=positions, fps=30, parents=np.array(parents)))
        assert not take.skeleton.has_bones and any("parents" in note for note in take.notes)


GOOD = {"positions": np.ones((4, 2, 3)), "fps": np.array(30.0)}


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"positions": np.ones((4, 6))}, "np.reshape"),
        ({"positions": np.ones((4, 2, 2))}, "shape"),
        ({"positions": np.ones((0, 2, 3))}, "none of them 0"),
        ({"positions": np.ones((4, 2, 3), bool)}, "bool"),
        ({"positions": np.ones((4, 2, 3), complex)}, "complex"),
        ({"positions": np.full((4, 2, 3), "1.0")}, "<U3"),
        ({"positions": np.full((4, 2, 3), None)}, "Python objects"),
        ({"fps": np.nan}, "impossible rate"),
        ({"fps": -1}, "impossible rate"),
        ({"fps": 1e300}, "impossible rate"),
        ({"fps": "fast"}, "one number"),
        ({"fps": [30, 60]}, "one number"),
        ({"observed": np.ones((4, 3))}, "observed"),
        ({"observed": np.full((4, 2), "yes")}, "observed"),
        ({"names": np.array(["a", "b", "c"])}, "2 names"),
        ({"names": np.array(["a", None])}, "Python objects"),
        ({"parents": [-1]}, "2 indices"),
        ({"parents": [-1, 0.5]}, "2 indices"),
        ({"parents": [-1, 7]}, "below 2"),
        ({"parents": [-1, np.nan]}, "2 indices"),
    ],
)
def test_wrong_arrays_are_named(tmp_path, arrays, said):
    with pytest.raises(InputError, match=said):
        mm.load(saved(tmp_path, **{**GOOD, **arrays}))


def test_a_missing_rate_can_be_given(tmp_path):
    path = saved(tmp_path, positions=GOOD["positions"])
    with pytest.raises(InputError, match="--fps"):
        mm.load(path)
    assert mm.load(path, fps=25).fps == 25


@pytest.mark.parametrize(("width", "model"), [(72, "SMPL"), (156, "SMPL-H"), (165, "SMPL-X")])
def test_amass_is_told_what_it_needs(tmp_path, width, model):
    path = saved(
        tmp_path, poses=np.zeros((7, width)), trans=np.zeros((7, 3)), betas=np.zeros(16), gender="male",
        mocap_framerate=120.0, dmpls=np.zeros((7, 8)),
    )  # fmt: skip
    with pytest.raises(InputError, match=rf"{model} body in 7 frames.*smplx.*positions=") as caught:
        mm.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("width, model", [(69, "SMPL"), (63, "SMPL-X")])
def test_parameters_of_a_body_model_are_told_what_they_need(tmp_path, width, model):
    path = saved(tmp_path, body_pose=np.zeros((7, width)), global_orient=np.zeros((7, 3)), transl=np.zeros((7, 3)))
    with pytest.raises(InputError, match=rf"angles of a {model} body in 7 frames.*smplx"):
        mm.load(path)


def test_human36m_is_told_what_it_needs(tmp_path):
    takes = np.array({"S1": {"Walking": np.zeros((5, 32, 3))}}, dtype=object)
    with pytest.raises(InputError, match=r"Human3\.6M.*data build h36m"):
        mm.load(saved(tmp_path, positions_3d=takes))


def test_pickles_never_run(tmp_path):
    class Bomb:
        def __reduce__(self):
            return exec, ("raise SystemExit('ran')",)

    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "|O", "fortran_order": False, "shape": (1,)})
    for key in ("positions", "fps", "observed", "names", "parents", "unit"):
        path = saved(tmp_path, **{k: v for k, v in GOOD.items() if k != key})
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(f"{key}.npy", header.getvalue() + pickle.dumps(Bomb()))
        with pytest.raises(InputError, match="Python objects"):
            mm.load(path)


def test_objects_under_other_keys_are_carried_unopened(tmp_path):
    path = saved(tmp_path, **GOOD, info=np.array({"who": "S1"}, dtype=object))
    again = mm.save(mm.load(path), tmp_path / "again.npz")
    with zipfile.ZipFile(path) as before, zipfile.ZipFile(again) as after:
        assert before.read("info.npy") == after.read("info.npy")


def npy(shape, data=b"", descr="<f8"):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": descr, "fortran_order": False, "shape": shape})
    return header.getvalue() + data


@pytest.mark.parametrize("shape", [(4, 2, 3), (10**6, 10**6, 3), (-4, -2, 3), (2**40, 2**40, 3), (1, 10**12, 0)])
def test_a_header_that_does_not_fit_its_data_allocates_nothing(tmp_path, shape):
    path = saved(tmp_path, fps=30)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("positions.npy", npy(shape, b"\0" * 24 * (0 not in shape)))
    with pytest.raises(InputError, match=r"positions"):
        mm.load(path)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("positions.npy", "w", force_zip64=True) as file:
            file.write(npy((1_000_000, 10, 3)))
            for _ in range(240):
                file.write(bytes(1_000_000))
        archive.writestr("fps.npy", npy((), struct.pack("<d", 30)))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(InputError, match="unpack to"):
        mm.load(path)


def test_overlapping_copies_of_one_bomb_count_each(tmp_path):
    # A small member, listed thousands of times in the directory under other names (a "better zip bomb").
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("aaaaa.npy", npy((12_500,), bytes(100_000)))
    raw = inner.getvalue()
    start = raw.index(b"PK\x01\x02")
    entry = raw[start : raw.index(b"PK\x05\x06")]
    entries = b"".join(entry.replace(b"aaaaa", f"{i:05d}".encode()) for i in range(5000))
    end = struct.pack("<4sHHHHIIH", b"PK\x05\x06", 0, 0, 5000, 5000, len(entries), start, 0)
    path = tmp_path / "bomb.npz"
    path.write_bytes(raw[:start] + entries + end)
    with pytest.raises(InputError, match="unpack to"):
        mm.load(path)


def test_two_arrays_of_one_name(tmp_path):
    path = saved(tmp_path, **GOOD)
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("fps.npy", npy((), struct.pack("<d", 60)))
    with pytest.raises(InputError, match="two arrays"):
        mm.load(path)


def test_every_truncation_is_refused(tmp_path):
    _, _, positions = person(3)
    raw = saved(tmp_path, positions=positions, fps=30).read_bytes()
    path = tmp_path / "cut.npz"
    for length in range(4, len(raw), 13):
        path.write_bytes(raw[:length])
        with pytest.raises(InputError):
            mm.load(path)


@given(st.binary(min_size=1, max_size=8), st.integers(0, 10**6))
@settings(max_examples=150, derandomize=True, deadline=None)
def test_damaged_bytes_give_a_take_or_one_clear_error(tmp_path_factory, junk, at):
    path = saved(tmp_path_factory.mktemp("npz"), positions=np.ones((2, 2, 3)), fps=30, names=["a", "b"])
    raw = bytearray(path.read_bytes())
    at %= len(raw)
    raw[at : at + len(junk)] = junk
    path.write_bytes(raw)
    try:
        take = mm.load(path)
        mm.save(take, path, force=True)
    except InputError:
        pass
