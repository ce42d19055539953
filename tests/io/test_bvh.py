"""BVH against independent oracles: naive matrices, SciPy, pybvh, bvhio; and byte for byte against itself."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from motionmend import rotations
from motionmend.errors import InputError
from motionmend.io import load, save
from motionmend.io._euler import follow
from motionmend.motion import Motion, Rig, Skeleton, Take, Units
from motionmend.units import from_metres

SMALL = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Chest
  {
    OFFSET 0 5 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 3 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0083333
0 90 0 0 0 0 10 20 30
1 90 0 0 5 0 11 21 31
2 90 0 0 9 0 12 22 32
"""


@pytest.fixture
def put(tmp_path):
    """Writes text or bytes as a BVH file and returns its path."""

    def put(content: str | bytes, name: str = "take.bvh") -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return put


def unchanged_save(path: Path, folder: Path) -> bytes:
    return save(load(path), folder / "unchanged.bvh", force=True).read_bytes()


def turned(take: Take, cells: np.ndarray, by: np.ndarray) -> Take:
    """The take with the local rotations of the cells turned by rotation vectors (radians)."""
    quaternions = take.rig.rotations.copy()
    quaternions[cells] = rotations.multiply(quaternions[cells], rotations.from_rotvec(by))
    return take.with_rig(replace(take.rig, rotations=quaternions))


# Random files, written by a naive generator and posed by naive matrices


def naive_matrix(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return {
        "X": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "Y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "Z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def naive_positions(joints: list[dict], row: list[float]) -> np.ndarray:
    """World positions of one frame: joints are dicts of parent, offset, channels, in file order."""
    values, places = iter(row), []
    for joint in joints:
        local, shift = np.eye(3), np.array(joint["offset"], float)
        for channel in joint["channels"]:
            if channel.endswith("position"):
                shift["XYZ".index(channel[0])] = next(values)
            else:
                local = local @ naive_matrix(channel[0], next(values))
        if joint["parent"] is None:
            places.append((shift, local))
        else:
            origin, turn = places[joint["parent"]]
            places.append((origin + turn @ shift, turn @ local))
    return np.array([origin for origin, _ in places])


NAMES = ["Hips", "joint_Root", "mixamorig:Spine", "left arm", "Bip01 L.Foot", "Ünter", "a", "OFFSET", "MOTION", "End"]
SPELLINGS = ["{:.6f}", "{:.3e}", "{:+.4f}", "{:g}", "{!r}"]


@st.composite
def bvh_files(draw, extra=("ZXYZ",)):
    """(bytes, joints, rows as read) of a random hierarchy, channel order and spelling."""
    count = draw(st.integers(1, 7))
    joints: list[dict] = []
    open_path: list[int] = []
    for joint in range(count):
        # Depth first, as the file nests: the parent is on the path to the joint before, or this is a new root.
        keep = draw(st.integers(0, len(open_path)))
        open_path = open_path[:keep]
        turns = draw(st.sampled_from(["", "Z", "YX", "XYX", "ZZ", *extra, *map("".join, permutations("XYZ"))]))
        shifts = draw(st.sampled_from(["", "Y", "ZX", "XYZ"]))
        channels = [f"{axis}rotation" for axis in turns]
        for axis in shifts:
            channels.insert(draw(st.integers(0, len(channels))), f"{axis}position")
        joints.append(
            {
                "name": draw(st.sampled_from(NAMES)) + str(joint),
                "parent": open_path[-1] if open_path else None,
                "offset": [draw(st.integers(-900, 900)) / 8 for _ in range(3)],
                "channels": channels,
            }
        )
        open_path.append(joint)
    if not any(joint["channels"] for joint in joints):
        joints[0]["channels"] = ["Yrotation"]

    newline = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    indent = draw(st.sampled_from(["\t", "  ", ""]))
    brace = draw(st.sampled_from([" {", newline + "{"]))
    end = draw(st.sampled_from(["End Site", "End site", "END SITE", "End Site tip"]))
    lines, closing = ["HIERARCHY"], []
    for at, joint in enumerate(joints):
        while closing and closing[-1] != joint["parent"]:
            lines.append(indent * (len(closing) - 1) + "}")
            closing.pop()
        pad = indent * len(closing)
        lines.append(pad + ("JOINT " if closing else "ROOT ") + joint["name"] + brace)
        lines.append(pad + indent + "OFFSET " + "\t".join(map(repr, joint["offset"])))
        if joint["channels"] or draw(st.booleans()):
            lines.append(pad + indent + " ".join(["CHANNELS", str(len(joint["channels"])), *joint["channels"]]) + " ")
        if draw(st.booleans()):
            lines.append(pad + indent + end + brace + " OFFSET 0 1 0 }")
        closing.append(at)
    lines += ["}"] * len(closing)
    frames = draw(st.integers(1, 4))
    announced = draw(st.sampled_from([frames, 7, 10**12]))
    lines += ["MOTION", f"Frames:{draw(st.sampled_from([' ', chr(9), '']))}{announced}", "Frame Time: 0.0333333"]
    columns = sum(len(joint["channels"]) for joint in joints)
    seed = draw(st.integers(0, 2**32 - 1))
    gap = draw(st.sampled_from([" ", "\t", "  "]))
    spelling = draw(st.sampled_from(SPELLINGS))
    rows = []
    for values in np.random.default_rng(seed).uniform(-200, 200, (frames, columns)).tolist():
        words = [spelling.format(value) for value in values]
        rows.append([float(word) for word in words])
        lines.append(draw(st.sampled_from(["", " "])) + gap.join(words) + draw(st.sampled_from(["", " ", newline])))
    text = newline.join(lines) + draw(st.sampled_from(["", newline, newline * 3]))
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "latin-1"]))
    return text.encode(encoding), joints, rows


RANDOM = {"deadline": None, "derandomize": True, "suppress_health_check": [HealthCheck.function_scoped_fixture]}


@given(bvh_files())
@settings(max_examples=120, **RANDOM)
def test_any_hierarchy_order_and_spelling(tmp_path, file):
    content, joints, rows = file
    path = tmp_path / "random.bvh"
    path.write_bytes(content)
    take = load(path, unit="cm", up="y")
    assert take.skeleton.names == tuple(joint["name"] for joint in joints)
    assert take.skeleton.parents == tuple(-1 if j["parent"] is None else j["parent"] for j in joints)
    truth = np.array([naive_positions(joints, row) for row in rows]) / 100
    np.testing.assert_allclose(take.rig.kinematics[0], truth, atol=1e-9)
    assert take.motion.observed.all() and take.fps == 30
    assert save(take, path, force=True).read_bytes() == content


# With a fourth rotation channel, which keeps its angle, the planted triple would not come back.
@given(bvh_files(extra=()), st.sampled_from(["y", "z", "-x"]), st.integers(0, 2**32 - 1))
@settings(max_examples=60, **RANDOM)
def test_changed_cells_and_no_others(tmp_path, file, up, seed):
    """Planted turns and shifts that each joint can express come back, and every other word keeps its spelling."""
    content, joints, rows = file
    path = tmp_path / "random.bvh"
    path.write_bytes(content)
    take = load(path, unit="cm", up=up)
    rng = np.random.default_rng(seed)
    cells = rng.random(take.rig.trusted.shape) < 0.3
    # The other file has other numbers in some cells; its turns are planted in the take.
    planted, column = [list(row) for row in rows], 0
    touched = np.zeros((len(rows), len(rows[0])), bool)
    for joint, spec in enumerate(joints):
        span = slice(column, column + len(spec["channels"]))
        for frame in np.flatnonzero(cells[:, joint]):
            planted[frame][span] = rng.uniform(-170, 170, len(spec["channels"])).tolist()
            touched[frame, span] = True
        column = span.stop
    truth = np.array([naive_positions(joints, row) for row in planted])
    other = path.with_name("planted.bvh")
    head, _, _ = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n").partition(b"Frame Time: 0.0333333\n")
    body = "\n".join(" ".join(map(repr, row)) for row in planted)
    other.write_bytes(head + b"Frame Time: 0.0333333\n" + body.encode())
    changed = load(other, unit="cm", up=up).rig
    keep = ~cells[..., None]
    rig = replace(
        take.rig,
        rotations=np.where(keep, take.rig.rotations, changed.rotations),
        translations=np.where(keep, take.rig.translations, changed.translations),
    )
    saved = save(take.with_rig(rig), tmp_path / "saved.bvh", force=True)
    back = load(saved, unit="cm", up=up)
    np.testing.assert_allclose(from_metres(back.rig.kinematics[0], back.units), truth, atol=1e-3)  # 0.01 mm

    was, now = content.split(), saved.read_bytes().split()
    assert len(was) == len(now)
    first = len(was) - touched.size
    assert was[:first] == now[:first]
    kept = ~touched.ravel()
    assert [word for word, keep in zip(was[first:], kept) if keep] == [w for w, keep in zip(now[first:], kept) if keep]
    if not touched.any():
        assert saved.read_bytes() == content


# Euler angles


ORDERS = ["".join(order) for order in product("XYZ", repeat=3) if order[0] != order[1] and order[1] != order[2]]


@pytest.mark.parametrize("order", ORDERS)
def test_angles_of_a_smooth_turn_run_on(order):
    rng = np.random.default_rng(ORDERS.index(order))
    knots = np.cumsum(rng.normal(0, 80, (12, 3)), axis=0)
    frames = np.linspace(0, 11, 600)
    angles = np.stack([np.interp(frames, np.arange(12), knot) for knot in knots.T], axis=1)  # winds far, on any branch
    changed = (np.arange(600) % 100) < 60
    changed[590:] = True
    wanted = Rotation.from_euler(order, angles, degrees=True)
    damaged = np.where(changed[:, None], 0.0, np.radians(angles))
    found = follow(order, wanted[changed].as_quat(), damaged, changed)
    assert np.array_equal(found[~changed], damaged[~changed])
    apart = (Rotation.from_euler(order, found) * wanted.inv()).magnitude()
    assert apart.max() < 1e-6
    # Both seams too: no step of a channel is much larger than the curve's own, on any branch and any winding.
    steps, own = np.abs(np.diff(np.degrees(found), axis=0)), np.abs(np.diff(angles, axis=0)).max()
    assert steps.max() < 3 * own


def test_a_run_at_the_start_ends_where_the_kept_frames_begin():
    angles = np.radians(np.linspace([700.0, 100.0, -500.0], [760.0, 130.0, -450.0], 50))
    changed = np.arange(50) < 20
    wanted = Rotation.from_euler("ZXY", angles[changed]).as_quat()
    damaged = np.where(changed[:, None], 0.0, angles)
    np.testing.assert_allclose(follow("ZXY", wanted, damaged, changed), angles, atol=1e-6)


def test_a_take_changed_throughout_stays_near_its_own_angles():
    angles = np.radians(np.linspace([700.0, 100.0, -500.0], [760.0, 130.0, -450.0], 50))
    everywhere = np.ones(50, bool)
    wanted = Rotation.from_euler("ZXY", angles + 0.01).as_quat()
    np.testing.assert_allclose(follow("ZXY", wanted, angles, everywhere), angles + 0.01, atol=1e-6)


@pytest.mark.parametrize("order, middle", [("ZXY", 90.0), ("XYZ", -90.0), ("ZXZ", 0.0), ("XYX", 180.0)])
def test_gimbal_lock_keeps_the_outer_angles_still(order, middle):
    angles = np.radians(np.tile([40.0, middle, 25.0], (30, 1)))
    changed = (np.arange(30) >= 10) & (np.arange(30) < 20)
    wanted = Rotation.from_euler(order, angles[changed]).as_quat()
    found = follow(order, wanted, np.where(changed[:, None], 0.0, angles), changed)
    np.testing.assert_allclose(found, angles, atol=1e-5)


@pytest.mark.parametrize("order", ["X", "Z", "XY", "YX", "ZX", "XZ", "YZ"])
def test_fewer_axes_take_the_nearest_turn_they_can(order):
    wanted = Rotation.random(20, rng=np.random.default_rng(3))
    found = follow(order, wanted.as_quat(), np.zeros((20, len(order))), np.ones(20, bool))
    misses = (Rotation.from_euler(order, found).inv() * wanted).magnitude()
    tried = Rotation.from_euler(order, np.array(list(product(np.linspace(-np.pi, np.pi, 73), repeat=len(order)))))
    for miss, one in zip(misses, wanted):
        assert miss <= (tried.inv() * one).magnitude().min() + 1e-9


# Oddities that are read


def test_a_position_channel_replaces_the_offset(put):
    text = SMALL.replace("CHANNELS 3 Zrotation", "CHANNELS 4 Yposition Zrotation").replace("10 20 30", "7 0 0 0")
    text = text.replace("11 21 31", "7 0 0 0").replace("12 22 32", "7 0 0 0").replace("OFFSET 0 5 0", "OFFSET 1 5 2")
    take = load(put(text), unit="cm", up="y")
    np.testing.assert_allclose(take.rig.translations[0, 1], [0.01, 0.07, 0.02])
    np.testing.assert_allclose(take.rig.offsets[1], [0.01, 0.05, 0.02])
    assert take.rig.moves.tolist() == [True, True]


def test_the_rows_count_and_not_the_header(put):
    take = load(put(SMALL.replace("Frames: 3", "Frames: 1000000000000")))
    assert len(take) == 3
    assert any("1000000000000" in note for note in take.notes)


def test_frames_wrapped_over_lines_are_read_and_written_back(put, tmp_path):
    head, _, rows = SMALL.partition("0.0083333\n")
    wrapped = head + "0.0083333\n" + rows.replace(" 0 0 ", " 0 0\n  ")
    path = put(wrapped)
    take = load(path)
    np.testing.assert_array_equal(take.motion.positions, load(put(SMALL, "plain.bvh")).motion.positions)
    assert take.notes and unchanged_save(path, tmp_path) == path.read_bytes()
    cells = np.array([[False, False], [False, True], [False, False]])
    saved = save(turned(take, cells, np.array([[0.1, 0.0, 0.0]])), tmp_path / "saved.bvh").read_text().splitlines()
    was = wrapped.splitlines()
    assert [now for now, old in zip(saved, was) if now != old] == [saved[-3]] and len(saved) == len(was)


def test_all_frames_on_one_line(put, tmp_path):
    head, _, rows = SMALL.partition("0.0083333\n")
    path = put(head + "0.0083333\n" + " ".join(rows.split()))
    assert np.array_equal(load(path).motion.positions, load(put(SMALL, "plain.bvh")).motion.positions)
    assert unchanged_save(path, tmp_path) == path.read_bytes()


def test_joints_of_one_name_are_told_apart(put, tmp_path):
    path = put(SMALL.replace("Chest", "Hips"))
    take = load(path)
    assert take.skeleton.names == ("Hips", "Hips_2") and take.notes
    assert unchanged_save(path, tmp_path) == path.read_bytes()


@pytest.mark.parametrize(
    "spelled, fps",
    [
        ("0.0083333", 120), ("0.00833333", 120), ("0.008333", 120), ("0.0333333", 30), ("0.0166666", 60),
        ("0.041667", 24), ("0.0333667", 30 / 1.001), ("0.01", 100), ("0.02", 50), ("0.025", 40), ("8.333333e-3", 120),
        ("0.033", 30), ("1.0", 1),
    ],
)  # fmt: skip
def test_the_rate_that_a_frame_time_means(put, spelled, fps):
    assert load(put(SMALL.replace("0.0083333", spelled))).fps == pytest.approx(fps, rel=1e-6)


def test_the_frame_time_may_be_overruled(put, tmp_path):
    path = put(SMALL.replace("0.0083333", "0"))
    with pytest.raises(InputError, match=r"take\.bvh:18: a frame time of 0 s.*--fps"):
        load(path)
    take = load(path, fps=100)
    assert take.fps == 100
    assert save(take, tmp_path / "saved.bvh").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("spelled", ["frame time:0.0083333", "Frame Time 0.0083333", "FrameTime : 0.0083333"])
def test_odd_spellings_of_the_header(put, spelled):
    text = SMALL.replace("Frame Time: 0.0083333", spelled).replace("Frames: 3", "FRAMES : 3")
    text = text.replace("MOTION", "Motion")
    assert load(put(text)).fps == 120


def test_up_z_is_turned_and_back(put, tmp_path):
    path = put(SMALL.replace("0 90 0 0 0 0", "3 4 90 10 20 30"))
    plain, upright = load(path, unit="m", up="y"), load(path, unit="m", up="z")
    x, y, z = np.moveaxis(plain.rig.kinematics[0], -1, 0)
    np.testing.assert_allclose(upright.rig.kinematics[0], np.stack([x, z, -y], axis=-1), atol=1e-12)
    assert save(upright, tmp_path / "saved.bvh").read_bytes() == path.read_bytes()


def test_ten_thousand_joints_deep(put):
    depth = 10_000
    text = "HIERARCHY\nROOT r { OFFSET 0 0 0 CHANNELS 1 Yrotation\n"
    text += "JOINT j { OFFSET 0 1 0 \n" * depth + "}" * (depth + 1)
    take = load(put(text + "\nMOTION\nFrames: 2\nFrame Time: 0.1\n1\n2\n"), unit="cm", up="y")
    assert take.motion.positions[0, -1, 1] == pytest.approx(depth / 100)


# What is refused, and where


@pytest.mark.parametrize(
    "old, new, line, says",
    [
        ("1 90 0 0 5 0 11 21 31", "1 90 0 0 5 0 11 21", 20, "a frame of 8 numbers; expected 9"),
        ("1 90 0 0 5 0 11 21 31", "1 90 0 0 5 0 11 21 31 9", 20, "a frame of 10 numbers; expected 9"),
        ("2 90 0 0 9 0 12 22 32\n", "2 90 0 0 9", 21, "cut off"),
        ("2 90 0", "2 nan 0", 21, "'nan' is not a finite number"),
        ("2 90 0", "2 -inf 0", 21, "'-inf' is not a finite number"),
        ("2 90 0", "2 1e999 0", 21, "'1e999' is not a finite number"),
        ("2 90 0", "2 1e300 0", 21, "'1e300' is absurdly large"),
        ("2 90 0", "2 -1.#IND 0", 21, "'-1.#IND' is not a finite number"),
        ("2 90 0", "2 90,5 0", 21, "'90,5' has a comma"),
        ("2 90 0", "2 9_0 0", 21, "'9_0' is not a number"),
        ("2 90 0", "2 0x1f 0", 21, "'0x1f' is not a number"),
        ("2 90 0 0", "2 90-0 0 0", 21, "'90-0' is not a number"),
        ("2 90 0", "2 9.0.1 0", 21, "'9.0.1' is not a number"),
        ("2 90 0", "2 x\x00 0", 21, "is not a number"),
        ("OFFSET 0 5 0", "OFFSET 0 nan 0", 8, "'nan'"),
        ("OFFSET 0 5 0", "OFFSET 0 -1e99 0", 8, "'-1e99' is absurdly large"),
        ("OFFSET 0 5 0", "OFFSET 0 5", 9, "'CHANNELS' is not a number"),
        ("CHANNELS 3", "CHANNELS 4", 9, "CHANNELS says 4, but 3 follow"),
        ("CHANNELS 3", "CHANNELS 2", 9, "CHANNELS says 2, but 3 follow"),
        ("CHANNELS 3", "CHANNELS 99999999999", 9, "but 3 follow"),
        ("CHANNELS 3", "CHANNELS -1", 9, "-1 channels"),
        ("CHANNELS 3 Zrotation", "CHANNELS 3 Wrotation", 9, "Wrotation"),
        ("Xposition Yposition", "Xposition Xposition", 5, "two Xposition"),
        ("    OFFSET 0 5 0\n", "", 6, "'Chest' has no OFFSET"),
        ("  JOINT Chest\n  {", "  JOINT Chest\n", 6, "no { follows"),
        ("  }\n}\nMOTION", "}\nMOTION", 15, "found 'MOTION'"),
        ("  }\n}\nMOTION", "  }\n}\n}\nMOTION", 16, "found '}'"),
        ("ROOT", "JOINT", 2, "found 'JOINT'"),
        ("MOTION", "", 17, "expected ROOT or MOTION"),
        ("Frames: 3\n", "", 17, "no 'Frames:'"),
        ("Frames: 3", "Frames: many", 17, "'many' is not a number"),
        ("Frame Time: 0.0083333\n", "", 17, "no 'Frame Time:'"),
        ("0.0083333", "0,0083333", 18, "has a comma"),
        ("0.0083333", "1e-9", 18, "a frame time of 1e-9"),
        ("0.0083333", "-0.01", 18, "a frame time of -0.01"),
    ],
)
def test_one_clear_error_with_its_line(put, old, new, line, says):
    assert old in SMALL
    with pytest.raises(InputError) as caught:
        load(put(SMALL.replace(old, new, 1)))
    assert says in str(caught.value)
    assert f"take.bvh:{line}:" in str(caught.value)


@pytest.mark.parametrize("newline", ["\r\n", "\r"])
def test_lines_are_counted_in_any_newline(put, newline):
    with pytest.raises(InputError, match=r"take\.bvh:20: 'x'"):
        load(put(SMALL.replace("1 90 0", "x 90 0").replace("\n", newline)))


def test_every_truncation_is_refused_or_read(put):
    """Cut anywhere: an InputError, or the frames that are whole."""
    for length in range(1, len(SMALL), 7):
        try:
            take = load(put(SMALL[:length]))
        except InputError as error:
            assert "take.bvh" in str(error)
        else:
            assert 1 <= len(take) <= 3


@pytest.mark.parametrize(
    "content, says",
    [
        (b"HIERARCHY\nMOTION\nFrames: 1\nFrame Time: 0.1\n1\n", "no ROOT"),
        (b"HIERARCHY\nROOT a { OFFSET 0 0 0 }\nMOTION\nFrames: 1\nFrame Time: 0.1\n1\n", "any channels"),
        (SMALL.encode("utf-16"), "UTF-16"),
        (bytes(range(256)) * 40, "expected HIERARCHY"),
        (SMALL.partition("0 90")[0].encode(), "no frames"),
    ],
)
def test_what_is_no_motion_is_refused(put, content, says):
    with pytest.raises(InputError, match=says):
        load(put(content))


def test_joints_without_channels_cannot_fill_the_memory(put):
    text = "HIERARCHY\nROOT r { OFFSET 0 0 0 CHANNELS 1 Yrotation\n" + "JOINT j { OFFSET 0 1 0 }\n" * 3000 + "}"
    with pytest.raises(InputError, match="nearly all without channels"):
        load(put(text + "\nMOTION\nFrames: 5000\nFrame Time: 0.1\n" + "1\n" * 5000))


# New files


def joints_and_tips() -> Skeleton:
    return Skeleton(("hips", "spine", "left leg", "tail"), (-1, 0, 0, 1))


def test_a_rig_of_another_format_becomes_a_new_file(tmp_path):
    skeleton, rng = joints_and_tips(), np.random.default_rng(5)
    offsets = rng.normal(0, 0.3, (4, 3))
    translations = np.broadcast_to(offsets, (40, 4, 3)).copy()
    translations[:, 0] = np.cumsum(rng.normal(0, 0.02, (40, 3)), axis=0)
    translations[:, 3] += rng.normal(0, 0.01, (40, 3))  # moves, though it never said so
    rig = Rig(
        skeleton, Rotation.random(160, rng=rng).as_quat().reshape(40, 4, 4), translations, np.ones((40, 4), bool),
        offsets, np.array([True, False, False, False]), ("XYZ", "", "X", "YZX"), ((2, np.array([0.0, -0.4, 0.0])),),
    )  # fmt: skip
    take = Take(rig.motion(50), rig, None, Units(0.01, "z", ""), "amc", "x.amc")
    back = load(save(take, tmp_path / "new.bvh"), unit="cm", up="y")
    assert back.fps == 50
    found = [back.skeleton.index(name) for name in skeleton.names]  # depth first now
    np.testing.assert_allclose(back.motion.positions[:, found], take.motion.positions, atol=1e-5)
    assert {joint: tuple(offset) for joint, offset in back.rig.ends}[back.skeleton.index("left leg")] == (0, -0.4, 0)


def test_bones_without_turns_become_joints_that_shift(tmp_path):
    skeleton = joints_and_tips()
    positions = np.random.default_rng(1).normal(0, 1, (20, 4, 3)).astype(np.float32)
    motion = Motion(positions, np.ones((20, 4), bool), 120.0, skeleton)
    take = Take(motion, None, None, Units(0.001, "z", ""), "trc", "x.trc")
    back = load(save(take, tmp_path / "new.bvh"), unit="mm", up="y")
    found = [back.skeleton.index(name) for name in skeleton.names]
    np.testing.assert_allclose(back.motion.positions[:, found], positions, atol=1e-6)

    missing = motion.observed.copy()
    missing[3, 1] = False
    with pytest.raises(InputError, match="1 samples are missing"):
        save(replace(take, motion=replace(motion, observed=missing)), tmp_path / "missing.bvh")
    cloud = replace(motion, skeleton=Skeleton.cloud(skeleton.names))
    with pytest.raises(InputError, match="cloud of markers"):
        save(replace(take, motion=cloud), tmp_path / "cloud.bvh")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new.bvh"]


# Real captures


def pybvh_positions(path: Path) -> np.ndarray | None:
    import pybvh

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return pybvh.read_bvh_file(str(path)).joint_positions()
        except Exception:  # it refuses position channels below the root, and more
            return None


def bvhio_positions(path: Path, names: tuple[str, ...], frames: list[int]) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its own imports
        import bvhio

    root = bvhio.readAsHierarchy(str(path))
    places = []
    for frame in frames:
        root.loadPose(frame)
        found = {joint.Name: np.array(list(joint.PositionWorld)) for joint, _, _ in root.layout()}
        places.append([found[name] for name in names])
    return np.array(places)


def check_real(path: Path, folder: Path) -> float | None:
    """Unchanged save is byte-identical; the largest difference to pybvh in mm, None where it cannot read the file."""
    take = load(path)
    assert save(take, folder / "unchanged.bvh", force=True).read_bytes() == path.read_bytes()
    assert np.isfinite(take.motion.positions).all() and take.motion.observed.all()
    theirs = pybvh_positions(path)
    if theirs is None:
        return None
    ours = from_metres(take.rig.kinematics[0], take.units)
    return float(np.abs(ours - theirs).max() * take.units.metres * 1000)


def spread(paths: list[Path], count: int) -> list[Path]:
    return [paths[int(at)] for at in np.linspace(0, len(paths) - 1, count)]


@pytest.fixture(scope="module")
def real(cmu, reactidle, bandai) -> dict[str, list[Path]]:
    return {folder.name: sorted(folder.rglob("*.bvh")) for folder in (cmu, reactidle, bandai)}


def test_real_files_come_back_byte_for_byte(real, tmp_path):
    cmu, idle, bandai = real.values()
    compared = 0
    for path in [*spread(cmu, 12), *spread(idle, 2), *spread(bandai, 12)]:
        apart = check_real(path, tmp_path)
        assert apart is None or apart < 1e-3, path
        compared += apart is not None
    assert compared >= 12


def test_real_files_as_bvhio_poses_them(real):
    for paths in real.values():
        path = min(paths, key=lambda path: path.stat().st_size)
        take = load(path)
        if path.stat().st_size < 2_000_000:
            frames = [0, len(take) // 2, len(take) - 1]
            theirs = bvhio_positions(path, take.skeleton.names, frames) * take.units.metres
            ours = from_metres(take.rig.kinematics[0][frames], take.units) * take.units.metres
            np.testing.assert_allclose(ours, theirs, atol=2e-6)  # it computes in single precision


def test_a_planted_repair_of_real_files(real, tmp_path):
    for path in [spread(paths, 3)[1] for paths in real.values()]:
        take = load(path)
        frames, joints = take.rig.trusted.shape
        rng = np.random.default_rng(2)
        cells = np.zeros((frames, joints), bool)
        cells[frames // 3 : frames // 3 + 25] = True
        cells[frames // 2 : frames // 2 + 12, rng.permutation(joints)[:3]] = True
        cells[:2, 1] = True
        fixed = turned(take, cells, rng.normal(0, 0.2, (int(cells.sum()), 3)))
        saved = save(fixed, tmp_path / path.name)
        back = load(saved)
        assert np.abs(back.motion.positions - fixed.motion.positions).max() < 1e-5
        was, now = path.read_bytes().splitlines(True), saved.read_bytes().splitlines(True)
        first = len(was) - frames
        assert len(was) == len(now)
        assert {at - first for at, (a, b) in enumerate(zip(was, now)) if a != b} == set(np.flatnonzero(cells.any(1)))
        kept = ~cells
        np.testing.assert_array_equal(back.rig.rotations[kept], take.rig.rotations[kept])


@pytest.mark.slow
def test_every_real_file(real, tmp_path):
    worst, compared = 0.0, 0
    for path in [path for paths in real.values() for path in paths]:
        apart = check_real(path, tmp_path)
        if apart is not None:
            worst, compared = max(worst, apart), compared + 1
    print(f"{compared} files compared with pybvh, at most {worst:.2e} mm apart")
    assert compared > 100 and worst < 1e-3
