"""TRC: what programs write, cell-exact round trips, repairs that change their own cells only, bad files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionmend as mm
from motionmend.errors import InputError
from motionmend.io import load, save
from motionmend.motion import Units

KEYS = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
NAMES = "Frame#\tTime\tLASI\t\t\tR.ASIS\t\t\tC7\t\t"
AXES = "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3"
ROWS = [
    "1\t0.000\t617.25\t1055.28\t170.78\t639.61\t1044.26\t-88.91\t430.87\t1301.26\t29.97",
    "2\t0.010\t\t\t\t640.61\t1045.26\t-87.91\t431.87\t1302.26\t30.97",
    "3\t0.020\t619.25\t1057.28\t172.78\t641.61\t1046.26\t-86.91\t432.87\t1303.26\t31.97",
    "4\t0.030\t620.25\t1058.28\t173.78\t0.0\t0.0\t0.0\tNaN\tNaN\tNaN",
    "5\t0.040\t621.25\t1059.28\t174.78",
]
MISSING = [(1, 0), (3, 1), (3, 2), (4, 1), (4, 2)]


def text(rows=ROWS, *, rate="100.00", frames=None, markers=3, unit="mm", keys=KEYS, names=NAMES, axes=AXES, blank=True):
    values = f"{rate}\t{rate}\t{len(rows) if frames is None else frames}\t{markers}\t{unit}\t{rate}\t1\t{len(rows)}"
    head = ["PathFileType\t4\t(X/Y/Z)\twalk.trc", keys, values, names, axes, *([""] if blank else [])]
    return "\n".join([*head, *rows, ""])


@pytest.fixture
def file(tmp_path):
    def put(content, name="take.trc"):
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
        return tmp_path / name

    return put


def observed(missing=MISSING, shape=(5, 3)):
    mask = np.ones(shape, bool)
    for at in missing:
        mask[at] = False
    return mask


def test_an_opensim_file(file):
    take = load(file(text()))
    assert take.skeleton.names == ("LASI", "R.ASIS", "C7") and not take.skeleton.has_bones
    assert (take.fps, take.units.metres, take.units.up) == (100, 0.001, "y")
    np.testing.assert_array_equal(take.motion.observed, observed())
    np.testing.assert_allclose(take.motion.positions[0, 0], [0.61725, 1.05528, 0.17078], rtol=1e-6)
    np.testing.assert_allclose(take.motion.positions[4, 0], [0.62125, 1.05928, 0.17478], rtol=1e-6)
    assert any("(0, 0, 0)" in note for note in take.notes)


VARIANTS = {
    "CRLF": text().replace("\n", "\r\n"),
    "lone CR": text().replace("\n", "\r"),
    "BOM": "\ufeff" + text(),
    "BOM and CRLF": "\ufeff" + text().replace("\n", "\r\n"),
    "no blank line": text(blank=False),
    "blank line of tabs": text().replace("\n\n", "\n" + "\t" * 12 + "\n"),
    "blank lines at the end": text() + "\n\n",
    "no newline at the end": text([*ROWS[:4], ROWS[4] + "\t" * 6]).rstrip("\n"),
    "trailing tabs": "\n".join(line + "\t\t" for line in text().split("\n")[:-1]) + "\n",
    "trailing tab and blank": "\n".join(line + "\t " if line[:1].isdigit() else line for line in text().split("\n")),
    "frame numbers from 23": text([f"{23 + n}{row[1:]}" for n, row in enumerate(ROWS)]),
    "padded cells": text([row.replace("\t\t\t\t", 3 * "\t     NaN" + "\t").replace("\t", "\t ") for row in ROWS]),
    "two tabs between names, a column late": text(names="Frame#\tTime\t\tLASI\t\tR.ASIS\t\tC7", axes="\t" + AXES),
    "no axes row": text().replace(AXES + "\n", ""),
    "decimal commas": text().replace(".", ",").replace("R,ASIS", "R.ASIS").replace("walk,trc", "walk.trc"),
    "commas between": text([*ROWS[:4], ROWS[4] + "\t" * 6]).replace("\t", ","),
    "header in blanks": text().replace("\t4\t", "  4\t").replace("\t5\t3\tmm", "\t\t  5\t\t 3\t\t mm"),
    "metres": text(unit="m"),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_variants_mean_the_same_and_come_back_byte_for_byte(variant, file, tmp_path):
    raw = VARIANTS[variant].encode()
    take = load(file(raw))
    plain = load(file(text(), "plain.trc"))
    factor = 1000 if variant == "metres" else 1
    assert take.skeleton.names == plain.skeleton.names and take.fps == 100
    np.testing.assert_array_equal(take.motion.observed, plain.motion.observed)
    np.testing.assert_allclose(take.motion.positions, plain.motion.positions * factor, rtol=1e-6)
    assert save(take, tmp_path / "out.trc").read_bytes() == raw


@pytest.mark.parametrize("variant", VARIANTS)
def test_repairs_change_their_own_cells_and_nothing_else(variant, file, tmp_path):
    raw = VARIANTS[variant].encode()
    take = load(file(raw), unit="mm")
    positions, trust = take.motion.positions.copy(), take.motion.observed.copy()
    positions[1, 0] = 0.6182501, 1.05628, 0.17178  # was empty: filled
    positions[4, 2] = 0.4, 1.3, 0.03  # the row had ended before it: filled
    trust[1, 0] = trust[4, 2] = True
    trust[2, 1] = False  # found wrong, could not be filled
    save(take.with_motion(replace(take.motion, positions=positions, observed=trust)), tmp_path / "out.trc")
    out = (tmp_path / "out.trc").read_bytes()

    feed = b"\n" if b"\n" in raw else b"\r"
    before, after = raw.split(feed), out.split(feed)
    assert len(before) == len(after)
    first = next(n for n, line in enumerate(before) if line[:1].isdigit() and n > 3)
    assert [n - first for n, (a, b) in enumerate(zip(before, after)) if a != b] == [1, 2, 4]
    separator = b"," if variant == "commas between" else b"\t"
    for row, mine in ((1, range(2, 5)), (2, range(5, 8)), (4, range(8, 11))):
        old, new = before[first + row].split(separator), after[first + row].split(separator)
        untouched = [n for n in range(min(len(old), len(new))) if n not in mine]
        assert [old[n].rstrip(b"\r") for n in untouched] == [new[n].rstrip(b"\r") for n in untouched]
        assert before[first + row].endswith(b"\r") == after[first + row].endswith(b"\r")
    assert after[first + 2].replace(b" ", b"").split(separator)[5:8] == [b"", b"", b""]
    filled = after[first + 1].replace(b" ", b"").replace(b",", b"." if separator == b"\t" else b",").split(separator)
    assert filled[2:5] == [b"618.250", b"1056.280", b"171.780"]

    again = load(tmp_path / "out.trc", unit="mm", up="y").motion
    np.testing.assert_array_equal(again.observed, trust)
    np.testing.assert_allclose(again.positions[trust], positions[trust], atol=1e-6)


def test_rows_separated_by_blanks(file, tmp_path):
    rows = [f"  {n}  0.0{n}   1.5 {n}.25  -3.125   4 5 6" for n in range(1, 4)]
    content = text(rows, markers=2, names="Frame# Time  A B", axes="   X1 Y1 Z1 X2 Y2 Z2")
    take = load(file(content))
    np.testing.assert_allclose(1000 * take.motion.positions[2], [[1.5, 3.25, -3.125], [4, 5, 6]])
    trust = take.motion.observed.copy()
    trust[1, 0] = False
    saved = save(take.with_motion(replace(take.motion, observed=trust)), tmp_path / "out.trc")
    out = saved.read_text().split("\n")
    assert out[7] == "  2  0.02   NaN NaN  NaN   4 5 6"
    assert out[:7] + out[8:] == content.split("\n")[:7] + content.split("\n")[8:]
    np.testing.assert_array_equal(load(tmp_path / "out.trc").motion.observed, trust)


def test_the_columns_decimals_are_kept_and_metres_get_enough(file, tmp_path):
    rows = [f"{n}\t{n}\t1.25\t1.1234567\t1" for n in range(3)]
    content = text(rows, markers=1, unit="m", names="Frame#\tTime\tA", axes="\t\tX1\tY1\tZ1")
    take = load(file(content))
    positions = take.motion.positions.copy()
    positions[1, 0] = 0.5, 1.5, 2.5
    saved = save(take.with_motion(replace(take.motion, positions=positions)), tmp_path / "out.trc")
    assert saved.read_text().split("\n")[7] == "1\t1\t0.5000000\t1.5000000\t2.5000000"


def test_unnamed_markers_after_the_named_ones_are_kept_but_not_read(file, tmp_path):
    rows = [*ROWS[:1], ROWS[0] + "\t1\t2\t3\t4\t5\t6\t"]
    take = load(file(text(rows)))
    assert len(take.skeleton) == 3 and any("up to 2 unnamed" in note for note in take.notes)
    assert save(take, tmp_path / "out.trc").read_text() == text(rows)


def test_odd_names_and_counts_are_noted(file):
    names = "Frame#\tTime\tA\t\t\t\t\t\tA\t\t"
    take = load(file(text(frames=7, markers=2, names=names)))
    assert take.skeleton.names == ("A", "*2", "A_2")
    for said in ("NumFrames is 7 but there are 5", "NumMarkers is 2 but 3", "A_2"):
        assert any(said in note for note in take.notes)


def test_a_clock_that_disagrees_is_noted(file):
    rows = [f"{n}\t{n * 0.02:.3f}\t1\t2\t3" for n in range(1, 20)]
    take = load(file(text(rows, markers=1, names="Frame#\tTime\tA", axes="\t\tX1\tY1\tZ1")))
    assert take.fps == 100 and any("runs at 50 frames" in note for note in take.notes)


def test_the_rate_can_be_said(file):
    path = file(text(rate="0"))
    with pytest.raises(InputError, match=r"take\.trc:3: a DataRate of 0"):
        load(path)
    take = load(path, fps=50, unit="cm", up="z")
    assert (take.fps, take.units.metres, take.units.up) == (50, 0.01, "z")
    np.testing.assert_allclose(take.motion.positions[0, 0], [6.1725, 1.7078, -10.5528], rtol=1e-6)


def test_a_whole_person_tells_what_is_up(file):
    """A standing Plug-in Gait subject, Z up: the head is 1.7 m above the toes along the file's z."""
    markers = {"LFHD": (100, 900, 1700), "RFHD": (100, 750, 1700), "LBHD": (-50, 900, 1690), "RBHD": (-50, 750, 1690),
               "C7": (-60, 825, 1500), "LASI": (90, 950, 980), "RASI": (90, 700, 980), "LPSI": (-90, 870, 1000),
               "RPSI": (-90, 780, 1000), "LKNE": (0, 1000, 500), "RKNE": (0, 650, 500), "LANK": (0, 980, 90),
               "RANK": (0, 670, 90), "LTOE": (150, 960, 40), "RTOE": (150, 690, 40)}  # fmt: skip
    names = "Frame#\tTime\t" + "\t\t\t".join(markers)
    axes = "\t\t" + "\t".join(f"X{n}\tY{n}\tZ{n}" for n in range(1, 16))
    row = "\t".join(str(x) for xyz in markers.values() for x in xyz)
    take = load(file(text([f"{n}\t{n / 100}\t{row}" for n in range(1, 9)], markers=15, names=names, axes=axes)))
    assert take.units.up == "z"
    assert take.motion.positions[:, 0, 1] == pytest.approx(1.7)


@pytest.mark.parametrize(
    "content, message",
    [
        ("", "empty"),
        ("hello\n" * 9, r"take\.trc:1: the first line begins with 'hello'"),
        (b"\x00\xff\x01" * 300, r"take\.trc:1: the first line"),
        (text().encode("utf-16"), r"take\.trc:1: the first line"),
        ("HIERARCHY\nROOT Hips\n", "BVH inside"),
        ("\n".join(text().split("\n")[:3]), r"ends in line 3; expected a header"),
        (text([]), "no frames"),
        (text(names="Frame#\tTime"), r"take\.trc:4: no markers"),
        (text(rate="fast"), r"take\.trc:3: datarate is 'fast'"),
        (text(rate="1e9"), r"take\.trc:3: a DataRate of 1e\+09"),
        (text(rate="-100"), r"take\.trc:3: a DataRate of -100"),
        (text([*ROWS[:2], ROWS[2] + "\t5"]), r"take\.trc:9: 12 columns; expected 11"),
        (text([*ROWS[:2], ROWS[2].rsplit("\t", 1)[0], ROWS[3]]), r"take\.trc:9: 10 columns; expected 11"),
        (text([*ROWS[:2], ROWS[2].replace("619.25", "619,25")]), r"take\.trc:9: a comma among numbers"),
        (text([*ROWS[:2], ROWS[2].replace("619.25", "six")]), r"take\.trc:9: 'six' is not a number"),
        (text([*ROWS[:2], ROWS[2].replace("619.25", "6 19")]), r"take\.trc:9: '6 19' is not a number"),
        (text([*ROWS[:2], ROWS[2].replace("619.25", "6_19")]), r"take\.trc:9: '6_19' is not a number"),
        (text([*ROWS[:2], "end of file\t\t"]), r"take\.trc:9: 'end of file' is not a number"),
        (text([*ROWS[:2], ROWS[2][1:]]), r"take\.trc:9: the row has no frame number"),
        (text(frames=900)[: len(text()) - 10], r"take\.trc:11: 4 columns; expected 11"),
        (text(["1\t0\t1 2\t\t3", "2\t0\t1\t2\t3"], markers=1, names="Frame#\tTime\tA"), "'1 2' is not a number"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(content, message, file):
    with pytest.raises(InputError, match=message):
        load(file(content))


def test_huge_declared_counts_cost_nothing(file):
    names = "Frame#\tTime" + "\tA\t\t" * 60_000
    with pytest.raises(InputError, match="far shorter"):
        load(file(text([f"{n}\t0" for n in range(2000)], names=names)))
    assert len(load(file(text(frames=10**12, markers=10**12)))) == 5


def test_a_take_from_elsewhere_becomes_a_standard_file(tmp_path):
    rng = np.random.default_rng(2)
    trust = rng.random((6, 4)) > 0.3
    positions = np.where(trust[..., None], rng.normal(size=(6, 4, 3)), np.nan).astype(np.float32)
    skeleton = mm.Skeleton(("Hips", "Left Foot", "a:b", ""), (-1, 0, 1, 2))
    take = mm.Take(mm.Motion(positions, trust, 119.88012, skeleton), None, None, Units(1.0, "y", ""), "npz", "walk.npz")
    path = save(take, tmp_path / "new.trc")
    lines = path.read_text().split("\n")
    assert lines[0] == "PathFileType\t4\t(X/Y/Z)\twalk.trc"
    assert lines[2].split("\t")[:5] == ["119.88012", "119.88012", "6", "4", "mm"]
    assert lines[3].split("\t") == ["Frame#", "Time", "Hips", "", "", "Left_Foot", "", "", "a:b", "", "", "*4", "", ""]
    assert lines[6].split("\t")[:2] == ["1", "0.000000"] and {len(line.split("\t")) for line in lines[6:-1]} == {14}
    again = load(path)
    np.testing.assert_array_equal(again.motion.observed, trust)
    np.testing.assert_allclose(again.motion.positions[trust], positions[trust], atol=1e-7)
    assert again.fps == pytest.approx(119.88012) and again.notes == ()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), variant=st.sampled_from(sorted(VARIANTS)))
def test_any_repair_comes_back_from_the_file(tmp_path_factory, seed, variant):
    folder = tmp_path_factory.mktemp("repair")
    (folder / "take.trc").write_bytes(VARIANTS[variant].encode())
    take = load(folder / "take.trc", unit="mm", up="y")
    rng = np.random.default_rng(seed)
    changed = rng.random((5, 3)) < 0.4
    positions, trust = take.motion.positions.copy(), (take.motion.observed | changed) & (rng.random((5, 3)) < 0.8)
    positions[changed] = rng.uniform(-1, 1, (changed.sum(), 3))
    save(take.with_motion(mm.Motion(positions, trust, take.fps, take.skeleton)), folder / "out.trc")
    if not trust.any() and variant == "decimal commas":
        return
    again = load(folder / "out.trc", unit="mm", up="y").motion
    np.testing.assert_array_equal(again.observed, trust)
    same = trust & ~changed
    np.testing.assert_array_equal(again.positions[same], take.motion.positions[same])
    np.testing.assert_allclose(again.positions[trust], positions[trust], atol=0.6e-6)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    variant=st.sampled_from(sorted(VARIANTS)),
    changes=st.lists(st.tuples(st.integers(0, 700), st.sampled_from(b"0159.,-+eE\t\r\n\0 \xffNa_;")), max_size=8),
    keep=st.floats(0.3, 1.0),
)
def test_damaged_files_load_or_are_refused(tmp_path_factory, variant, changes, keep):
    raw = bytearray(VARIANTS[variant].encode())
    for at, value in changes:
        raw[at % len(raw)] = value
    raw = bytes(raw[: int(len(raw) * keep)])
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "take.trc").write_bytes(raw)
    try:
        take = load(folder / "take.trc")
    except InputError as error:
        assert "take.trc" in str(error)
        return
    assert save(take, folder / "out.trc").read_bytes() == raw
