"""Tables of points: every header that is known, and files that come back byte for byte."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionmend as mm
from motionmend.errors import InputError

WIDE = """\
frame,time,LASI_X,LASI_Y,LASI_Z,RASI_X,RASI_Y,RASI_Z
0,0.00,0.11,0.97,0.31,-0.11,0.98,0.32
1,0.01,0.12,0.97,0.33,,,
2,0.02,0.13,0.97,0.35,-0.13,0.98,0.36
"""


def written(tmp_path, text, name="take.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def load(tmp_path, text, name="take.csv", **hints):
    return mm.load(written(tmp_path, text, name), **hints)


def changed(take, frame, point, value):
    """The take with one sample, in metres and Y up, put there and observed."""
    positions, observed = take.motion.positions.copy(), take.motion.observed.copy()
    positions[frame, point], observed[frame, point] = value, True
    return take.with_motion(replace(take.motion, positions=positions, observed=observed))


def saved(take, tmp_path, name="again.csv"):
    return mm.save(take, tmp_path / name, force=True).read_bytes()


def test_a_simple_wide_table(tmp_path):
    take = load(tmp_path, WIDE)
    assert take.skeleton.names == ("LASI", "RASI") and take.fps == 100
    assert take.motion.observed.tolist() == [[True, True], [True, False], [True, True]]
    np.testing.assert_allclose(take.motion.positions[2, 1], [-0.13, 0.98, 0.36], rtol=1e-6)
    assert np.isnan(take.motion.positions[1, 1]).all()
    assert take.notes[0] == "wide table, ',' separated, 2 points, time column \"time\" → 100 fps"


@pytest.mark.parametrize(
    "titles",
    [
        "A_X,A_Y,A_Z,B_X,B_Y,B_Z",
        "A.x,A.y,A.z,B.x,B.y,B.z",
        "A:X,A:Y,A:Z,B:X,B:Y,B:Z",
        "A x,A y,A z,B x,B y,B z",
        "x_A,y_A,z_A,x_B,y_B,z_B",
        "A_tx,A_ty,A_tz,B_tx,B_ty,B_tz",
        "A_pos_x,A_pos_y,A_pos_z,B_pos_x,B_pos_y,B_pos_z",
        "A.Position.X,A.Position.Y,A.Position.Z,B.Position.X,B.Position.Y,B.Position.Z",
        "A(X),A(Y),A(Z),B(X),B(Y),B(Z)",
        "A [x],A [y],A [z],B [x],B [y],B [z]",
        "A X (m),A Y (m),A Z (m),B X (m),B Y (m),B Z (m)",
        '"A_X","A_Y","A_Z","B_X","B_Y","B_Z"',
        "AX,AY,AZ,BX,BY,BZ",
        "A,,,B,,\nX,Y,Z,X,Y,Z",
        "A,A,A,B,B,B\nx,y,z,x,y,z\nm,m,m,m,m,m",
        "A-x,A-y,A-z,B-x,B-y,B-z",
    ],
)
def test_spellings_of_a_wide_header(tmp_path, titles):
    take = load(tmp_path, titles + "\n1,2,3,4,5,6\n7,8,9,10,11,12\n", fps=50)
    assert take.skeleton.names == ("A", "B")
    np.testing.assert_array_equal(take.motion.positions, np.arange(1, 13).reshape(2, 2, 3))


def test_numbered_points_and_a_single_nameless_one(tmp_path):
    assert load(tmp_path, "x1,y1,z1,v1,x2,y2,z2,v2\n1,2,3,0,4,5,6,0\n", fps=1).skeleton.names == ("1", "2")
    take = load(tmp_path, "time,x,y,z\n0,1,2,3\n0.5,4,5,6\n")
    assert take.skeleton.names == ("point",) and take.fps == 2


def test_columns_in_any_order_and_others_between(tmp_path):
    text = "note,A_Z,B_X,A_X,q_w,B_Z,A_Y,B_Y,A_rot_X,A_rot_Y,A_rot_Z\nhello,3,4,1,9,6,2,5,90,91,92\n"
    take = load(tmp_path, text, fps=30)
    assert take.skeleton.names == ("A", "B")
    np.testing.assert_array_equal(take.motion.positions, [[[1, 2, 3], [4, 5, 6]]])
    assert saved(take, tmp_path) == text.encode()


def test_velocities_beside_positions_are_no_points_but_a_marker_may_be_called_so(tmp_path):
    text = "A_X,A_Y,A_Z,A_vel_X,A_vel_Y,A_vel_Z,R_ACC_X,R_ACC_Y,R_ACC_Z\n1,2,3,4,5,6,7,8,9\n"
    assert load(tmp_path, text, fps=30).skeleton.names == ("A", "R_ACC")


NEXUS = (
    "Devices\r\n1000\r\n,,Force - Plate,,\r\nFrame,Sub Frame,Fx,Fy,Fz\r\n,,N,N,N\r\n1,0,1.5,2.5,3.5\r\n1,1,1,2,3\r\n"
    "\r\n"
    "Trajectories\r\n120\r\n,,Ann:LASI,,,Ann:RASI,,\r\nFrame,Sub Frame,X,Y,Z,X,Y,Z\r\n,,mm,mm,mm,mm,mm,mm\r\n"
    "101,0,110.1,-20.25,970.5,,,\r\n102,0,111,-20.5,971,210.125,-21,972\r\n\r\n"
    "Model Outputs\r\n120\r\n,,Ann:CentreOfMass,,\r\nFrame,Sub Frame,X,Y,Z\r\n,,mm,mm,mm\r\n101,0,1,2,3\r\n"
)


@pytest.mark.parametrize("resaved", [False, True])
def test_vicon_nexus_with_other_sections(tmp_path, resaved):
    # Spreadsheets pad every line with separators.
    text = NEXUS
    if resaved:
        text = "".join(line + "," * (7 - line.count(",")) + "\r\n" for line in NEXUS.splitlines())
    take = load(tmp_path, text)
    assert take.skeleton.names == ("Ann:LASI", "Ann:RASI") and take.fps == 120
    np.testing.assert_allclose(take.motion.positions[1], [[0.111, 0.971, 0.0205], [0.210125, 0.972, 0.021]], atol=1e-7)
    assert take.motion.observed.tolist() == [[True, False], [True, True]]
    assert saved(take, tmp_path) == text.encode()
    expected = text.replace("970.5,,,", "970.5,209.987,-21.500,970.000").encode()
    assert saved(changed(take, 0, 1, [0.2099870, 0.97, 0.0215]), tmp_path) == expected


def test_vicon_without_trajectories(tmp_path):
    with pytest.raises(InputError, match="Devices, without Trajectories"):
        load(tmp_path, NEXUS[: NEXUS.index("Trajectories")])


MOTIVE = (
    "Format Version,1.23,Take Name,T1,Capture Frame Rate,240.000000,Export Frame Rate,120.000000,"
    "Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global\n\n"
    ",Type,Bone,Bone,Bone,Bone,Bone,Bone,Bone,Marker,Marker,Marker\n"
    ",Name,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:M1,Ann:M1,Ann:M1\n"
    ",ID,1,1,1,1,1,1,1,2,2,2\n"
    ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position\n"
    "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z\n"
    "0,0.000000,0.1,0.2,0.3,0.9,10.0,900.0,20.0,1.5,2.5,3.5\n"
    "1,0.008333,0.1,0.2,0.3,0.9,11.0,901.0,21.0,,,\n"
)


def test_optitrack_motive(tmp_path):
    take = load(tmp_path, MOTIVE)
    assert take.skeleton.names == ("Ann:Hip", "Ann:M1") and take.fps == 120
    np.testing.assert_allclose(take.motion.positions[0], [[0.01, 0.9, 0.02], [0.0015, 0.0025, 0.0035]], atol=1e-7)
    assert take.motion.observed.tolist() == [[True, True], [True, False]]
    assert "mm (as the file says), y up" in take.units.why
    old = MOTIVE.replace(",Type,", ",,").replace(",Name,", ",,").replace(",ID,", ",,")  # as versions up to 1.22 have it
    assert load(tmp_path, old).skeleton.names == ("Ann:Hip", "Ann:M1")


QUALISYS = (
    "NO_OF_FRAMES\t2\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t2\nFREQUENCY\t200\nNO_OF_ANALOG\t0\nANALOG_FREQUENCY\t0\n"
    "DESCRIPTION\t--\nTIME_STAMP\t2022-06-03, 10:47:36.627\t94247.45\nDATA_INCLUDED\t3D\n"
    "MARKER_NAMES\tx_HeadL\tsacrum\t\nTRAJECTORY_TYPES\tMeasured\tMixed\n"
)


@pytest.mark.parametrize("heading", [False, True])
@pytest.mark.parametrize("before", ["", "1\t0.00000\t"])
def test_qualisys(tmp_path, before, heading):
    titles = "Frame\tTime\t" * bool(before) + "x_HeadL X\tx_HeadL Y\tx_HeadL Z\tsacrum X\tsacrum Y\tsacrum Z\n"
    rows = ["100.000\t200.000\t1700.000\t0.000\t0.000\t0.000", "101.0\t201.0\t1701.0\t10.0\t20.0\t900.0"]
    text = QUALISYS + titles * heading + "".join(before + row + "\n" for row in rows)
    take = load(tmp_path, text, "take.tsv")
    assert take.skeleton.names == ("x_HeadL", "sacrum") and take.fps == 200
    np.testing.assert_allclose(take.motion.positions[1], [[0.101, 1.701, -0.201], [0.01, 0.9, -0.02]], atol=1e-6)
    assert take.motion.observed.tolist() == [[True, False], [True, True]]
    assert any("0, 0, 0" in note for note in take.notes)
    assert saved(take, tmp_path, "again.tsv") == text.encode()
    filled = saved(changed(take, 0, 1, [0.009, 0.9, 0]), tmp_path, "again.tsv")
    assert filled == text.replace("\t0.000\t0.000\t0.000", "\t9.000\t0.000\t900.000").encode()
    # What gets lost is marked as this file marks what is missing.
    lost = saved(take.distrust(np.array([[True, False], [False, False]])), tmp_path, "again.tsv").decode()
    assert lost == text.replace("100.000\t200.000\t1700.000", "0.000\t0.000\t0.000")


LONG = """\
frame,joint,x,y,z,confidence,reprojection_error
0,nose,0.1,1.6,0.2,0.91,3
0,hip,0.1,0.9,0.2,0.80,4
1,nose,0.11,1.61,0.2,0,5
1,hip,0.11,0.91,0.2,0.93,6
3,nose,0.12,1.62,0.2,0.92,7
"""


def test_a_long_table(tmp_path):
    take = load(tmp_path, LONG, fps=30)
    assert take.skeleton.names == ("nose", "hip") and len(take) == 3
    assert take.motion.observed.tolist() == [[True, True], [False, True], [True, False]]
    np.testing.assert_allclose(take.motion.positions[1, 1], [0.11, 0.91, 0.2], rtol=1e-6)
    assert any("line 6" in note and "not consecutive" in note for note in take.notes)
    assert saved(take, tmp_path) == LONG.encode()


def test_filling_a_long_table_mends_rows_and_adds_those_that_lack(tmp_path):
    take = changed(changed(load(tmp_path, LONG, fps=30), 1, 0, [1, 2, 3]), 2, 1, [4, 5, 6])
    take = take.distrust(np.array([[False, True], [False, False], [False, False]]))
    expected = (
        LONG.replace("1,nose,0.11,1.61,0.2,0,5", "1,nose,1.000000,2.000000,3.000000,0.80,5")
        .replace("0,hip,0.1,0.9,0.2,0.80,4", "0,hip,,,,0,4")
        + "3,hip,4.000000,5.000000,6.000000,0.80,7\n"
    )
    assert saved(take, tmp_path) == expected.encode()
    again = mm.load(tmp_path / "again.csv", fps=30)
    assert again.motion.observed.tolist() == [[True, False], [True, True], [True, True]]


def test_a_name_is_preferred_to_an_id_and_a_time_may_stand_in_the_upper_row(tmp_path):
    text = "frame,landmark_id,landmark,x,y,z\n0,0,nose,1,2,3\n0,1,ear,1,2,3\n"
    assert load(tmp_path, text, fps=30).skeleton.names == ("nose", "ear")
    take = load(tmp_path, "Time,LASI,,\n,X,Y,Z\ns,mm,mm,mm\n0,1,2,3\n0.01,4,5,6\n")
    assert take.fps == 100 and take.units.metres == 0.001


def test_a_long_table_in_any_order_of_rows_with_times(tmp_path):
    rows = [f"{time / 50:.2f};{name};{i},5;{time};3,25" for i, name in enumerate("ab") for time in (2, 0, 1)]
    text = "Time (s);Marker;X;Y;Z\r\n" + "\r\n".join(rows)
    take = load(tmp_path, text)
    assert take.fps == 50 and take.skeleton.names == ("a", "b") and "decimal comma" in take.notes[0]
    np.testing.assert_allclose(take.motion.positions[:, 1], [[1.5, t, 3.25] for t in range(3)])
    assert saved(take, tmp_path) == text.encode()
    assert saved(changed(take, 0, 0, [0.25, 0, 1]), tmp_path) == text.replace(
        "0.00;a;0,5;0;3,25", "0.00;a;0,250000;0,000000;1,000000"
    ).encode()


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("last", [True, False])
@pytest.mark.parametrize(("separator", "comma"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_separators_decimals_line_ends_and_marks_are_kept(tmp_path, end, bom, last, separator, comma):
    plain = WIDE if last else WIDE.rstrip("\n")
    spelled = plain.replace(",", separator) if comma == "." else plain.replace(",", separator).replace(".", ",")
    raw = bom + spelled.replace("\n", end).encode()
    take = load(tmp_path, raw)
    np.testing.assert_array_equal(take.motion.positions, load(tmp_path, WIDE, "plain.csv").motion.positions)
    assert saved(take, tmp_path) == raw
    row = separator.join(["1", "0.01", "0.12", "0.97", "0.33", "-0.123457", "0.980000", "0.340000"]).replace(".", comma)
    line = separator.join(["1", "0.01", "0.12", "0.97", "0.33", "", "", ""]).replace(".", comma)
    expected = raw.replace(line.encode(), row.encode())
    assert saved(changed(take, 1, 1, [-0.1234567, 0.98, 0.34]), tmp_path) == expected


@pytest.mark.parametrize("word", ["", "NaN", "nan", "NA", "null", "-", "#N/A", '""'])
def test_words_for_missing(tmp_path, word):
    text = WIDE.replace(",,,\n", f",{word},{word},{word}\n")
    take = load(tmp_path, text)
    assert take.motion.observed.tolist() == [[True, True], [True, False], [True, True]]
    assert saved(take, tmp_path) == text.encode()
    lost = saved(take.distrust(np.array([[True, False], [False, False], [False, False]])), tmp_path).decode()
    bare = word.strip('"')  # only cells that had quotes keep them
    assert lost == text.replace("0.11,0.97,0.31", f"{bare},{bare},{bare}")


def test_a_coordinate_alone_missing_takes_its_sample(tmp_path):
    assert not load(tmp_path, WIDE.replace("0.11,0.97", "0.11,")).motion.observed[0, 0]


def test_zeros_are_missing_unless_signed_or_the_origin(tmp_path):
    text = "A_X,A_Y,A_Z,Hips_X,Hips_Y,Hips_Z\n0,0.0,0,0,0,0\n-0.00,0.00,0.00,0,0,0\n1,1,1,0,0,0\n"
    take = load(tmp_path, text, fps=30)
    assert take.motion.observed.tolist() == [[False, True], [True, True], [True, True]]
    assert any("relative" in note for note in take.notes)
    # A sample filled at the origin must be read again as what it is.
    again = saved(changed(take, 0, 0, [0, 0, 0]), tmp_path)
    assert b"\n-0.000000,0.000000,0.000000," in again
    assert mm.load(tmp_path / "again.csv", fps=30).motion.observed.all()


def test_quotes_are_kept_around_what_changes(tmp_path):
    text = '"time","A, left_X","A, left_Y","A, left_Z"\n"0","1.5","2","3"\n"0.5","","",""\n'
    take = load(tmp_path, text)
    assert take.skeleton.names == ("A, left",) and take.fps == 2
    again = saved(changed(take, 1, 0, [1, 2, 3]), tmp_path).decode()
    assert again == text.replace('"","",""', '"1.000000","2.000000","3.000000"')
    assert list(csv.reader(io.StringIO(again)))[2] == ["0.5", "1.000000", "2.000000", "3.000000"]


@pytest.mark.parametrize(
    ("title", "times", "fps"),
    [
        ("time", ["0.000", "0.017", "0.033", "0.050", "0.067", "0.083", "0.100"], 60),
        ("Time (ms)", ["0", "10", "20", "30"], 100),
        ("time_ms", ["0", "33.3667", "66.7333", "100.1"], 30000 / 1001),
        ("timestamp", ["1000000", "1010000", "1020000"], 100),
        ("t", ["5", "5.04", "5.08", "5.12"], 25),
        ("time", ["0.0", "8.333333", "16.666667", "25.0"], 120),
        ("seconds", ["0", "1", "2"], 1),
    ],
)
def test_the_rate_from_a_column_of_times(tmp_path, title, times, fps):
    text = f"{title},A_X,A_Y,A_Z\n" + "".join(f"{time},1,2,{i + 3}\n" for i, time in enumerate(times))
    take = load(tmp_path, text)
    assert take.fps == pytest.approx(fps, rel=1e-9)
    assert not any("uneven" in note for note in take.notes)


def test_uneven_times_are_told(tmp_path):
    times = np.delete(np.arange(20) / 50, [5, 6])
    text = "time,A_X,A_Y,A_Z\n" + "".join(f"{time:.3f},1,2,3\n" for time in times)
    take = load(tmp_path, text)
    assert take.fps == 50
    assert any("mostly 20 ms, from 20 to 60 ms, 1 of 17" in note for note in take.notes)


def test_the_rate_from_a_header_line_or_the_user(tmp_path):
    table = "A_X,A_Y,A_Z\n1,2,3\n"
    take = load(tmp_path, "# Frame rate: 59.94 Hz\n# units: mm\n" + table)
    assert take.fps == 59.94 and take.motion.positions[0, 0, 0] == np.float32(0.001)
    assert load(tmp_path, "fps,240\n\n" + table).fps == 240
    assert load(tmp_path, "fps,240\n\n" + table, fps=25).fps == 25
    with pytest.raises(InputError, match="--fps"):
        load(tmp_path, table)


def test_clock_times_are_left_alone(tmp_path):
    text = "time,A_X,A_Y,A_Z\n10:24:31.50,1,2,3\n10:24:31.51,4,5,6\n"
    take = load(tmp_path, text, fps=100)
    assert len(take) == 2 and any("no plain numbers" in note for note in take.notes)
    assert saved(take, tmp_path) == text.encode()


@pytest.mark.parametrize(
    ("text", "where", "said"),
    [
        (WIDE.replace("0.97,0.33", "0.97,oops"), ":3:5", "'oops' in column 'LASI_Z'"),
        (WIDE.replace("0.97,0.33", "0.97,0.3.3"), ":3:5", "0.3.3"),
        (WIDE.replace("0.97,0.33", "0.97,inf"), ":3:5", "inf"),
        (WIDE.replace("0.97,0.33", "0.97,1e999"), ":3:5", "1e999"),
        (WIDE.replace("0.97,0.33", "0.97,1e300"), ":3:5", "1e300"),
        (WIDE.replace("0.97,0.33", "0.97,1_000"), ":3:5", "1_000"),
        (WIDE.replace("0.97,0.33", "0.97,0x1F"), ":3:5", "0x1F"),
        (WIDE.replace("1,0.01,", "1,0.01,7,"), ":3", "9 columns; expected 8"),
        (WIDE[:-20], ":4", "cut off"),
        (WIDE.replace("2,0.02", "2,0.005"), ":4:2", "backwards"),
        (WIDE.splitlines(keepends=True)[0], ":1", "no data"),
        ("hello world\n", "", "no columns of coordinates"),
        # an inertial sensor's readings, as APDM writes them
        (",7\nTime,Accelerometer,,,Gyroscope\n,X,Y,Z,X,Y,Z\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n", "", "no columns of coord"),
        ("a_X,a_Y\n1,2\n", ":1", "no z"),
        ("frame,joint,x,y\n1,a,2,3\n", ":1", "no z"),
        (LONG + "3,nose,1,1,1,1,1\n", ":7", "second row for 'nose' in frame 3"),
        (LONG.replace("\n1,hip", "\n,hip"), ":5:1", "without its frame"),
        (LONG.replace("1,hip", "1,"), "", "without a name"),
        ("A_X,A_Y,A_Z," * 20_000 + "\n1,2,3\n", ":1", "60,001 columns"),
        ("A_X,A_Y,A_Z\n" + '"' * 300_000, ":2", "1 columns"),
        ("\n" * 5000, "", "no columns|empty"),
        (b"\xff\xfet\0i\0m\0e\0", "", "UTF-16"),
        (b"A_X,A_Y,A_Z\n1,2,\x003\n", "", "not text"),
        (QUALISYS, "", "no data"),
        (QUALISYS.replace("MARKER_NAMES", "NOTHING"), "", "MARKER_NAMES"),
        (MOTIVE[: MOTIVE.index("Frame,Time")], "", "Motive export without its heading"),
        ("Trajectories\n100\nnothing\n", ":1", "without its heading"),
        ("fps,0\n" + WIDE, "", "impossible rate"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path, text, where, said):
    with pytest.raises(InputError, match=said) as caught:
        load(tmp_path, text)
    assert f"take.csv{where}" in str(caught.value)


def test_many_frames_and_names_for_few_rows_take_no_memory(tmp_path):
    rows = "".join(f"{i},p{i},1,2,3\n" for i in range(20_000))
    with pytest.raises(InputError, match="nearly every point"):
        load(tmp_path, "frame,joint,x,y,z\n" + rows, fps=30)


def test_a_new_table_of_another_take(tmp_path):
    take = load(tmp_path, NEXUS)
    take = changed(replace(take, document=None, format="other"), 0, 1, [0, 0, 0])
    for name in ("new.csv", "new.tsv"):
        text = saved(take, tmp_path, name).decode()
        separator = "\t" if name.endswith("tsv") else ","
        assert text.splitlines()[0].split(separator)[:3] == ["frame", "time", "Ann:LASI_X"]
        again = mm.load(tmp_path / name, unit="m")
        assert again.skeleton.names == take.skeleton.names and again.fps == take.fps
        np.testing.assert_array_equal(again.motion.observed, take.motion.observed)
        np.testing.assert_allclose(again.motion.positions, take.motion.positions, atol=6e-7)


def test_a_real_take_there_and_back(cmu, tmp_path):
    take = mm.load(next(iter(sorted((cmu / "06").glob("*.bvh")))))
    again = mm.load(mm.save(take, tmp_path / "take.csv"))
    assert again.skeleton.names == take.skeleton.names and again.fps == take.fps
    assert again.units.metres == 1 and again.units.up == "y" and again.motion.observed.all()
    np.testing.assert_allclose(again.motion.positions, take.motion.positions, atol=6e-7)


coordinate = st.floats(-3, 3).map(lambda x: round(x, 6))
names = st.lists(
    st.text("abcdefghijklmnopqrstuvw ÄéL0123456789", min_size=1, max_size=8).map(str.strip).filter(bool),
    min_size=1, max_size=4, unique=True,
)  # fmt: skip


@given(names, st.integers(2, 12), st.sampled_from([24.0, 30.0, 59.94, 100.0, 120.0, 1000.0]), st.data())
@settings(max_examples=60, derandomize=True, deadline=None)
def test_new_tables_read_the_same(tmp_path_factory, names, frames, fps, data):
    folder = tmp_path_factory.mktemp("csv")
    shape = (frames, len(names))
    size = frames * len(names)
    positions = np.array(data.draw(st.lists(coordinate, min_size=3 * size, max_size=3 * size)), np.float32)
    observed = np.array(data.draw(st.lists(st.booleans(), min_size=size, max_size=size))).reshape(shape)
    motion = mm.Motion(positions.reshape(*shape, 3), observed, fps, mm.Skeleton.cloud([f"m{n}" for n in names]))
    base = load(folder, WIDE)
    mm.save(replace(base, motion=motion), folder / "new.csv")
    again = mm.load(folder / "new.csv", unit="m", up="y")
    assert again.skeleton == motion.skeleton
    assert again.fps == pytest.approx(fps, rel=2e-6)  # 59.94 and 60000/1001 are as near as that
    np.testing.assert_array_equal(again.motion.observed, observed)
    np.testing.assert_allclose(again.motion.positions[observed], motion.positions[observed], atol=6e-7)


@given(st.sampled_from([WIDE, LONG, NEXUS, MOTIVE, QUALISYS + "1\t2\t3\t4\t5\t6\n"]), st.data())
@settings(max_examples=300, derandomize=True, deadline=None)
def test_damaged_text_gives_a_take_that_is_kept_or_one_clear_error(tmp_path_factory, text, data):
    folder = tmp_path_factory.mktemp("csv")
    raw = bytearray(text.encode())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(raw)))
        cut = data.draw(st.integers(0, 12))
        words = st.sampled_from([b",", b"\n", b"\r", b'"', b"-", b"1e9", b"\t"])
        raw[at : at + cut] = data.draw(st.binary(max_size=6) | words)
    try:
        take = load(folder, bytes(raw), fps=30)
        again = saved(take, folder)
    except InputError:
        return
    assert again == bytes(raw)
    # Filling everything must give a file that reads as filled.
    motion = take.motion
    filled = np.where(motion.observed[..., None], motion.positions, np.float32(0.5))
    full = replace(motion, positions=filled, observed=np.ones_like(motion.observed))
    saved(take.with_motion(full), folder)
    once_more = mm.load(folder / "again.csv", fps=30)
    assert once_more.motion.observed.all() and once_more.skeleton.names == take.skeleton.names
