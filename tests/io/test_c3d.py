"""C3D: all six encodings against py-c3d and ezc3d, repairs in place byte by byte, damaged files."""

from __future__ import annotations

import struct
import warnings
from dataclasses import replace

import c3d as pyc3d
import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionmend as mm
from motionmend.errors import InputError
from motionmend.io import c3d, load, save

FRAMES, POINTS, ANALOGS = 7, 5, 6
LABELS = ["LASI", "RASI", "C7", "LKneeAngles", "*4"]
ENCODINGS = [(kind, whole) for kind in ("intel", "dec", "sgi") for whole in (False, True)]
SCALE = 0.125


def floats(kind, numbers):
    """Numbers as the bytes of 32-bit floats of a machine kind, one by one from the definitions."""
    if kind != "dec":
        return b"".join(struct.pack(">f" if kind == "sgi" else "<f", n) for n in numbers)
    out = b""
    for number in numbers:
        high, low = struct.unpack(">HH", struct.pack(">f", number * 4))
        out += struct.pack("<HH", high, low)
    return out


def words(kind, numbers):
    return b"".join(struct.pack(">H" if kind == "sgi" else "<H", int(n) & 0xFFFF) for n in numbers)


def strings(texts, width):
    return bytes([0xFF, 2, width, len(texts)]) + b"".join(t.encode("latin-1").ljust(width) for t in texts)


def build(kind="intel", whole=False, points=None, *, rate=100.0, labels=LABELS, first=11, extra=(), analogs=ANALOGS):
    """A C3D file from the format's definition. `points` is (frames, points, 4): x, y, z, fourth word."""
    points = sample() if points is None else points
    frames, count = points.shape[:2]

    def parameter(name, body):
        return ("p", name, body)

    def number(*n):
        return bytes([2, 0] if len(n) == 1 else [2, 1, len(n)]) + words(kind, n)

    def section(data_block):
        return parameter_section(kind, [*records, (1, "DATA_START", number(data_block)), *extra])

    records = [
        ("g", "POINT", 1), ("g", "ANALOG", 2), ("g", "EVENT", 3),
        (1, "USED", number(count)), (1, "FRAMES", number(frames)),
        (1, "SCALE", b"\4\0" + floats(kind, [SCALE if whole else -SCALE])),
        (1, "RATE", b"\4\0" + floats(kind, [rate])),
        (1, "LABELS", strings(labels, 14)), (1, "UNITS", strings(["mm"], 2)),
        (1, "DESCRIPTIONS", strings(["hip", "hip"], 3)), (2, "DESCRIPTIONS", strings(["force"], 5)),
        (1, "X_SCREEN", strings(["+X"], 2)), (1, "Y_SCREEN", strings(["+Z"], 2)),
        (1, "ANGLES", strings(["LKneeAngles"], 14)),
        (2, "USED", number(analogs)), (2, "SCALE", bytes([4, 1, analogs]) + floats(kind, [0.01] * analogs)),
        (2, "OFFSET", number(*[2048] * analogs)), (2, "GEN_SCALE", b"\4\0" + floats(kind, [0.5])),
        (2, "RATE", b"\4\0" + floats(kind, [rate])), (2, "LABELS", strings([f"F{n}" for n in range(analogs)], 4)),
        (3, "LABELS", strings(["Foot Strike", "Foot Off"], 16)),
    ]
    blocks = len(section(0)) // 512
    header = bytes([2, 0x50]) + words(kind, [count, analogs, first, first + frames - 1, 10])
    header += floats(kind, [SCALE if whole else -SCALE]) + words(kind, [2 + blocks, 1]) + floats(kind, [rate])
    header = header.ljust(512, b"\0")
    data = b""
    for frame in range(frames):
        row = [*points[frame].ravel(), *(frame * 10 + n for n in range(analogs))]
        data += words(kind, row) if whole else floats(kind, row)
    raw = header + section(2 + blocks) + data
    return raw + bytes(-len(raw) % 512)


def parameter_section(kind, records):
    section = b""
    for place, (group, name, body) in enumerate(records):
        ident, body = (-body, b"\0") if group == "g" else (group, body + b"\0")
        offset = 0 if place == len(records) - 1 else len(body) + 2
        section += struct.pack("bb", len(name), ident) + name.encode() + words(kind, [offset]) + body
    blocks = -(-(len(section) + 4) // 512)
    section = bytes([1, 0x50, blocks, {"intel": 84, "dec": 85, "sgi": 86}[kind]]) + section
    return section.ljust(blocks * 512, b"\0")


def sample(seed=0):
    """Stored words of a plausible cloud: camera masks and residuals, one occlusion, one all-zero sample."""
    points = np.random.default_rng(seed).integers(-9000, 9000, (FRAMES, POINTS, 4)).astype(float)
    points[..., 3] = 0x0305
    points[2, 0] = 0, 0, 0, -1
    points[3, 1] = 0, 0, 0, 0x0305
    return points


@pytest.fixture
def file(tmp_path):
    def put(raw, name="take.c3d"):
        (tmp_path / name).write_bytes(raw)
        return tmp_path / name

    return put


def millimetres(points, whole):
    return points[..., :3] * (SCALE if whole else 1)


def as_py_c3d_reads(path):
    with path.open("rb") as handle, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "No analog data")
        return np.stack([points for _, points, _ in pyc3d.Reader(handle).read_frames(copy=True)])


def z_up(positions):
    """Metres, Y up, as millimetres, Z up, written out by hand."""
    x, y, z = np.moveaxis(positions.astype(float), -1, 0)
    return 1000 * np.stack([x, -z, y], -1)


@pytest.mark.parametrize("kind, whole", ENCODINGS)
def test_all_encodings_are_read_as_py_c3d_reads_them(kind, whole, file):
    path = file(build(kind, whole))
    take = load(path)
    assert take.skeleton.names == ("LASI", "RASI", "C7", "*4")
    assert (take.fps, take.units.metres, take.units.up) == (100, 0.001, "z")
    expected = np.ones((FRAMES, 4), bool)
    expected[2, 0] = expected[3, 1] = False
    np.testing.assert_array_equal(take.motion.observed, expected)
    assert any("(0, 0, 0)" in note for note in take.notes) and any("1 model output" in note for note in take.notes)

    theirs = as_py_c3d_reads(path)[:, [0, 1, 2, 4], :3]
    mine = z_up(take.motion.positions)
    np.testing.assert_allclose(mine[expected], theirs[expected], rtol=1e-6)
    np.testing.assert_allclose(mine[expected], millimetres(sample(), whole)[:, [0, 1, 2, 4]][expected], rtol=1e-6)


@pytest.mark.parametrize("kind, whole", ENCODINGS)
def test_unchanged_is_byte_identical(kind, whole, file, tmp_path):
    raw = build(kind, whole)
    assert save(load(file(raw)), tmp_path / "out.c3d").read_bytes() == raw


@pytest.mark.parametrize("kind, whole", ENCODINGS)
def test_repairs_change_their_own_words_and_nothing_else(kind, whole, file, tmp_path):
    raw = build(kind, whole)
    take = load(file(raw))
    positions, observed = take.motion.positions.copy(), take.motion.observed.copy()
    positions[2, 0] = 0.5, 1.0, -0.25  # was missing: filled
    positions[4, 3] = 0.1, 0.2, 0.3  # was there: found wrong and replaced
    observed[2, 0] = True
    observed[5, 1] = False  # found wrong, could not be filled
    fixed = take.with_motion(replace(take.motion, positions=positions, observed=observed))
    out = save(fixed, tmp_path / "out.c3d").read_bytes()

    size, record = 2 if whole else 4, 4 * POINTS + ANALOGS
    data = len(raw) - -(-FRAMES * record * size // 512) * 512
    allowed = set()
    for frame, point in ((2, 0), (4, 4), (5, 1)):
        begin = data + (frame * record + 4 * point) * size
        allowed |= set(range(begin, begin + 4 * size))
    differing = {n for n, (a, b) in enumerate(zip(raw, out)) if a != b}
    assert len(out) == len(raw) and differing and differing <= allowed

    theirs = as_py_c3d_reads(tmp_path / "out.c3d")
    near = SCALE * 0.51 if whole else 1e-3
    np.testing.assert_allclose(theirs[2, 0, :3], [500, 250, 1000], atol=near)
    np.testing.assert_allclose(theirs[4, 4, :3], [100, -300, 200], atol=near)
    assert theirs[2, 0, 3] == theirs[4, 4, 3] == 0
    assert theirs[5, 1, 3] < 0 and theirs[3, 1, 3] > 0  # marked; the file's own zeros stay as they were
    again = load(tmp_path / "out.c3d").motion
    np.testing.assert_array_equal(again.observed, observed)


def test_ezc3d_reads_the_repaired_file_with_analog_and_events(file, tmp_path):
    take = load(file(build()))
    observed = take.motion.observed.copy()
    observed[1, 2] = False
    save(take.with_motion(replace(take.motion, observed=observed)), tmp_path / "out.c3d")
    before, after = ezc3d.c3d(str(tmp_path / "take.c3d")), ezc3d.c3d(str(tmp_path / "out.c3d"))
    np.testing.assert_array_equal(before["data"]["analogs"], after["data"]["analogs"])
    assert after["parameters"]["EVENT"]["LABELS"]["value"] == ["Foot Strike", "Foot Off"]
    assert after["header"]["points"]["first_frame"] == 10
    assert np.isnan(after["data"]["points"][:3, 2, 1]).all()
    assert after["data"]["meta_points"]["residuals"][0, 2, 1] == -1


def test_a_filled_sample_beyond_16_bits_is_refused(file, tmp_path):
    take = load(file(build(whole=True)))
    positions = take.motion.positions.copy()
    positions[0, 0] = 5.0  # 16 bits of 0.125 mm reach to 4.1 m
    with pytest.raises(InputError, match="16-bit"):
        save(take.with_motion(replace(take.motion, positions=positions)), tmp_path / "out.c3d")
    assert not (tmp_path / "out.c3d").exists()


def test_a_take_from_elsewhere_becomes_a_new_file(tmp_path):
    rng = np.random.default_rng(1)
    skeleton = mm.Skeleton(tuple(f"joint{n}" for n in range(300)), (-1, *range(299)))
    observed = rng.random((20, 300)) > 0.1
    positions = rng.normal(size=(20, 300, 3)).astype(np.float32)
    motion = mm.Motion(np.where(observed[..., None], positions, np.float32(np.nan)), observed, 59.94, skeleton)
    take = mm.Take(motion, None, None, c3d.Units(1.0, "y", ""), "npz", "made up")
    path = save(take, tmp_path / "new.c3d")

    there = ezc3d.c3d(str(path))
    parameters = there["parameters"]["POINT"]
    assert parameters["UNITS"]["value"] == ["mm"] and parameters["Y_SCREEN"]["value"] == ["+Z"]
    assert parameters["LABELS"]["value"] + parameters["LABELS2"]["value"] == list(skeleton.names)
    x, y, z = there["data"]["points"][:3].transpose(0, 2, 1)
    np.testing.assert_allclose(np.stack([x, z, -y], -1)[observed] / 1000, positions[observed], atol=1e-6)
    residuals = there["data"]["meta_points"]["residuals"][0].T
    assert np.isnan(x[~observed]).all() and (residuals[~observed] == -1).all() and (residuals[observed] == 0).all()

    again = load(path)
    np.testing.assert_array_equal(again.motion.observed, observed)
    np.testing.assert_allclose(again.motion.positions[observed], positions[observed], atol=1e-6)
    assert again.skeleton.names == skeleton.names and abs(again.fps - 59.94) < 1e-5


def test_a_new_file_longer_than_16_bits_can_count(tmp_path):
    frames = 70_000
    positions = np.broadcast_to(np.linspace(0.5, 1, frames, dtype=np.float32)[:, None, None], (frames, 1, 3)).copy()
    motion = mm.Motion(positions, np.ones((frames, 1), bool), 240.0, mm.Skeleton.cloud(["A"]))
    path = save(mm.Take(motion, None, None, c3d.Units(1.0, "y", ""), "csv", "made up"), tmp_path / "long.c3d")
    assert len(load(path)) == frames
    np.testing.assert_allclose(ezc3d.c3d(str(path))["data"]["points"][0, 0], 1000 * positions[:, 0, 0], rtol=1e-6)
    theirs = as_py_c3d_reads(path)
    assert len(theirs) == frames


def test_labels_beyond_255_duplicates_and_blanks(file):
    points = np.ones((2, 258, 4)) * 100
    labels = [f"M{n}" for n in range(255)]
    path = file(build(points=points, labels=labels, extra=[(1, "LABELS2", strings(["M0", "", "M7"], 8))]))
    take = load(path)
    assert take.skeleton.names == (*labels, "M0_2", "*257", "M7_2")
    assert any("twice" in note and "M0_2" in note for note in take.notes)


@pytest.mark.parametrize("screen, up", [("+Y", "y"), ("+Z", "z"), ("X+", "x"), ("-Z", "z")])
def test_the_screen_axes_tell_what_is_up(screen, up, file):
    raw = build()
    take = load(file(raw.replace(strings(["+Z"], 2), strings([screen], 2))))
    assert take.units.up == up


def test_what_the_user_says_wins(file):
    raw = build(rate=0)
    with pytest.raises(InputError, match="rate"):
        load(file(raw))
    take = load(file(raw), fps=50, unit="cm", up="y")
    assert (take.fps, take.units.metres, take.units.up) == (50, 0.01, "y")


def test_long_takes_are_counted_beyond_the_header(file):
    raw = bytearray(build(points=np.full((300, 1, 4), 5.0), labels=["A"], analogs=1))
    raw[6:10] = words("intel", [1, 65535])  # the header says that it cannot count that far
    assert len(load(file(bytes(raw)))) == 300  # POINT:FRAMES can


def test_a_cut_off_take_is_refused_with_both_counts(file):
    raw = build(points=np.full((300, 4, 4), 5.0), labels=["A", "B", "C", "D"])
    with pytest.raises(InputError, match=r"take\.c3d: 300 frames are declared but the file holds \d+"):
        load(file(raw[: len(raw) // 2]))


@pytest.mark.parametrize(
    "raw, message",
    [
        (b"", "empty"),
        (b"\x02\x50short", "not a C3D file"),
        (b"\x02\x50" + bytes(510), "parameter section"),
        (b"\xff\x50" + bytes(1022), "parameter section"),
        (b"HIERARCHY" + bytes(1000), "BVH inside"),
        (bytes(range(256)) * 8, "not a C3D file"),
        (build(points=np.zeros((3, 0, 4)), labels=[]), "no points, only analog"),
        (build(points=np.ones((3, 1, 4)), labels=["LKneeAngles"]), "model outputs"),
        (build(rate=-5.0), "rate"),
        (build(rate=1e9), "rate"),
        (build(rate=float("nan")), "rate"),
    ],
)
def test_what_cannot_be_a_take_is_refused(raw, message, file):
    with pytest.raises(InputError, match=message):
        load(file(raw))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    kind=st.sampled_from(["intel", "dec", "sgi"]),
    whole=st.booleans(),
    changes=st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), max_size=12),
    keep=st.floats(0.3, 1.0),
)
def test_damaged_files_load_or_are_refused(tmp_path_factory, kind, whole, changes, keep):
    raw = bytearray(build(kind, whole))
    for at, value in changes:
        raw[at % len(raw)] = value
    raw = bytes(raw[: int(len(raw) * keep)])
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "take.c3d").write_bytes(raw)
    try:
        take = load(folder / "take.c3d")
    except InputError as error:
        assert "take.c3d" in str(error)
        return
    assert take.motion.positions.nbytes <= 2 * len(raw)
    assert save(take, folder / "out.c3d").read_bytes() == raw


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["intel", "dec", "sgi"]), whole=st.booleans())
def test_any_repair_comes_back_from_the_file(tmp_path_factory, seed, kind, whole):
    folder = tmp_path_factory.mktemp("repair")
    (folder / "take.c3d").write_bytes(build(kind, whole, sample(seed)))
    take = load(folder / "take.c3d")
    rng = np.random.default_rng(seed)
    changed = rng.random(take.motion.observed.shape) < 0.3
    positions, observed = take.motion.positions.copy(), take.motion.observed | changed
    positions[changed] = rng.uniform(-1, 1, (changed.sum(), 3))
    observed &= rng.random(observed.shape) < 0.8
    save(take.with_motion(mm.Motion(positions, observed, take.fps, take.skeleton)), folder / "out.c3d")
    again = load(folder / "out.c3d").motion
    np.testing.assert_array_equal(again.observed, observed)
    same = observed & ~changed
    np.testing.assert_array_equal(again.positions[same], take.motion.positions[same])
    new = observed & changed
    np.testing.assert_allclose(again.positions[new], positions[new], atol=SCALE * 0.51e-3 if whole else 1e-6)
