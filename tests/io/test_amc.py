"""AMC and ASF against a naive reader with matrices; and every way in which the two files can disagree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motionmend.errors import InputError
from motionmend.io import load, save

ASF = """# made by hand
:version 1.10
:name figure
:units
  mass 1.0
  length 0.45
  angle deg
:documentation
   begin as you like
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name thigh
     direction 0.6 -0.8 0
     length 7
     axis 10 20 30 XYZ
     dof rx ry rz
     limits (-160.0 20.0)
            (-70.0 70.0)
            (-60.0 70.0)
  end
  begin
     id 2
     name shin
     direction 0 -1 0
     length 6
     axis 40 -50 60 ZXY
     dof rz rx
  end
  begin
     id 3
     name foot
     direction 0 0 1
     length 2
     axis 0 0 0 XYZ
  end
  begin
     id 4
     name tail
     direction 0 0.6 -0.8
     length 3
     axis 5 5 5 XYZ
     dof ry
  end
:hierarchy
  begin
    root thigh tail
    thigh shin
    shin foot
  end
"""
AMC = """#!OML:ASF figure.ASF
:FULLY-SPECIFIED
:DEGREES
1
root 1 17 -3 10 20 30
thigh 11 -12 13
shin 14 -15
tail 16
2
root 1.5 17 -3.5 11 21 31
thigh 12 -13 1.4e1
shin 15 -16
tail 17
3
root 2 17 -4 12 22 32
thigh 13 -14 15
shin 16 -17
tail 18
"""
UNIT = 0.0254 / 0.45


@pytest.fixture
def put(tmp_path):
    """Writes an AMC file with its ASF and returns the former's path."""

    def put(amc: str = AMC, asf: str = ASF, name: str = "07_01.amc", asf_name: str = "07.asf") -> Path:
        (tmp_path / asf_name).write_bytes(asf.encode())
        (tmp_path / name).write_bytes(amc.encode())
        return tmp_path / name

    return put


def turn(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    other = {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]]}
    return np.array({**other, "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}[axis])


def naive(asf: Path, amc: Path, wanted: list[int]) -> dict[int, dict[str, np.ndarray]]:
    """Where each bone begins, per wanted frame (0-based), in file units: as simple and as slow as can be.

    It follows the ends of bones, as a viewer does: a bone points along the product of all turns down to its own,
    applied to its direction.
    """
    bones, above, now, section = {}, {}, {}, ""
    for line in asf.read_text(errors="replace").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0].startswith(":"):
            section = words[0]
        elif section == ":bonedata":
            if words[0] == "begin":
                now = {"dof": []}
            elif words[0] == "end":
                bones[now["name"]] = now
            elif words[0] in ("direction", "axis"):
                now[words[0]] = [float(word) for word in words[1:4]]
                now["order"] = words[-1].lower()
            elif words[0] == "length":
                now["length"] = float(words[1])
            elif words[0] == "dof":
                now["dof"] = words[1:]
            elif words[0] == "name":
                now["name"] = words[1]
        elif section == ":hierarchy" and words[0] not in ("begin", "end"):
            above.update(dict.fromkeys(words[1:], words[0]))
    frames: list[dict[str, list[float]]] = []
    for line in amc.read_text().splitlines():
        words = line.split()
        if len(words) == 1 and words[0].isdigit():
            if len(frames) > max(wanted):
                break
            frames.append({})
        elif frames:
            frames[-1][words[0]] = [float(word) for word in words[1:]]

    def pose(frame: dict[str, list[float]], name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(begin, end, world turn) of a bone."""
        if name == "root":
            x, y, z, *angles = frame["root"]
            world = turn("z", angles[2]) @ turn("y", angles[1]) @ turn("x", angles[0])
            return np.array([x, y, z]), np.array([x, y, z]), world
        bone = bones[name]
        _, begin, world = pose(frame, above[name])
        axes, moved = np.eye(3), np.eye(3)
        for letter, angle in zip(bone["order"], bone["axis"]):
            axes = turn(letter, angle) @ axes
        for dof, angle in zip(bone["dof"], frame.get(name, [])):
            moved = turn(dof[1], angle) @ moved
        world = world @ axes @ moved @ np.linalg.inv(axes)
        return begin, begin + world @ np.array(bone["direction"]) * bone["length"], world

    return {at: {name: pose(frames[at], name)[0] for name in ["root", *bones]} for at in wanted}


def assert_like_naive(amc: Path, asf: Path, frames: list[int]) -> None:
    take = load(amc)
    for frame, places in naive(asf, amc, frames).items():
        truth = np.array([places[name] for name in take.skeleton.names]) * UNIT
        np.testing.assert_allclose(take.rig.kinematics[0][frame], truth, atol=1e-6)


def test_a_figure_with_odd_axes(put):
    path = put()
    take = load(path)
    assert take.skeleton.names == ("root", "thigh", "shin", "foot", "tail")
    assert take.skeleton.parents == (-1, 0, 1, 2, 0)
    assert take.rig.orders == ("XYZ", "XYZ", "XYZ", "", "XYZ") and take.rig.moves.tolist() == [True] + [False] * 4
    assert take.units.metres == UNIT and take.fps == 120 and any("--fps" in note for note in take.notes)
    assert_like_naive(path, path.with_name("07.asf"), [0, 1, 2])
    ends = dict(take.rig.ends)
    np.testing.assert_allclose(ends[3], [0, 0, 2 * UNIT])
    assert set(ends) == {3, 4}


@pytest.mark.parametrize(
    "amc",
    [
        AMC.replace("\n", "\r\n"),
        AMC.replace("thigh 12 -13 1.4e1\nshin 15 -16", "shin 15 -16\nthigh 12 -13 1.4e1"),  # another order in one frame
        AMC.replace("\n1\n", "\n901\n").replace("\n2\n", "\n902\n").replace("\n3\n", "\n903\n"),
        AMC.replace("#!OML", "# a remark\n\n#!OML") + "\n\n",
        AMC.rstrip(),
    ],
)
def test_other_spellings_mean_the_same(put, amc):
    plain, other = load(put()), load(put(amc, name="07_02.amc"))
    np.testing.assert_array_equal(other.motion.positions, plain.motion.positions)


def test_radians(put):
    lines = []
    for line in AMC.replace(":DEGREES", ":RADIANS").splitlines():
        words = line.split()
        angles = 4 if words[0] == "root" else 1
        if len(words) > 1 and words[0][0] != "#":
            words[angles:] = [repr(np.radians(float(word)).item()) for word in words[angles:]]
        lines.append(" ".join(words))
    asf = ASF.replace("angle deg", "angle rad")
    asf = asf.replace("axis 10 20 30", "axis 0.17453292519943 0.34906585039887 0.5235987755983")
    asf = asf.replace("axis 40 -50 60", "axis 0.69813170079773 -0.87266462599716 1.0471975511966")
    asf = asf.replace("axis 5 5 5", "axis 0.087266462599716 0.087266462599716 0.087266462599716")
    other = load(put("\n".join(lines), asf, name="08_02.amc", asf_name="08.asf"))
    np.testing.assert_allclose(other.motion.positions, load(put()).motion.positions, atol=1e-6)


def test_the_user_knows_better(put):
    take = load(put(), fps=60, unit="cm")
    assert take.fps == 60 and not take.notes
    np.testing.assert_allclose(take.rig.translations[0, 0], [0.01, 0.17, -0.03])


def test_which_skeleton(put, tmp_path):
    path = put(asf_name="figure.asf")
    assert len(load(path)) == 3  # the only one there
    (tmp_path / "other.ASF").write_text("nothing")
    with pytest.raises(InputError, match=r"several ASF skeletons.*--asf"):
        load(path)
    assert len(load(path, asf=tmp_path / "figure.asf")) == 3
    (tmp_path / "07.ASF").write_text(ASF)
    assert len(load(path)) == 3
    with pytest.raises(InputError, match=r"nowhere\.asf: no such file"):
        load(path, asf=tmp_path / "nowhere.asf")
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "07_01.amc").write_text(AMC)
    with pytest.raises(InputError, match="no ASF skeleton beside it"):
        load(alone / "07_01.amc")


@pytest.mark.parametrize(
    "old, new, line, says",
    [
        ("thigh 12 -13 1.4e1\n", "", 13, "frame 2 has no line for 'thigh'"),
        ("tail 18\n", "", 17, "frame 3 has no line for 'tail'"),
        ("shin 15 -16", "shim 15 -16", 12, "no bone is called 'shim' in the ASF. Did you mean shin, thigh?"),
        ("shin 15 -16", "shin 15", 12, "1 numbers for 'shin'; expected 2"),
        ("shin 15 -16", "shin 15 -16 17", 12, "3 numbers for 'shin'; expected 2"),
        ("shin 15 -16", "shin 15 nan", 12, "'nan' is not a finite number"),
        ("shin 15 -16", "shin 15 1_6", 12, "'1_6' is not a number"),
        ("shin 15 -16", "shin 15 -16\nshin 15 -16", 13, "a second line for 'shin'"),
        ("\n3\n", "\n4\n", 14, "frame 4 follows frame 2"),
        ("\n3\n", "\n1\n", 14, "frame 1 follows frame 2"),
        ("\n1\n", "\n", 4, "found 'root' before the first frame"),
        ("1.5 17", "1,5 17", 10, "'1,5' has a comma"),
    ],
)
def test_one_clear_error_in_the_amc(put, old, new, line, says):
    assert old in AMC
    with pytest.raises(InputError) as caught:
        load(put(AMC.replace(old, new, 1)))
    assert says in str(caught.value) and f"07_01.amc:{line}:" in str(caught.value)


@pytest.mark.parametrize(
    "old, new, where, says",
    [
        ("direction 0 -1 0", "direction 0 -1", ":30", "the line ends too early"),
        ("direction 0 -1 0", "direction 0 nan 0", ":30", "'nan'"),
        ("     length 6\n", "", ":27", "a bone without length"),
        ("name shin", "name thigh", ":34", "a second bone is called 'thigh'"),
        ("ZXY", "ZXX", ":32", "axis order 'ZXX'"),
        ("dof rz rx", "dof rz l", ":33", "freedom 'l'"),
        ("    shin foot\n", "", "", "'foot' does not hang on the root"),
        ("root thigh tail", "root tail", "", "does not hang on the root"),
        ("shin foot", "shin foot thigh", ":54", "'thigh' has two parents"),
        ("root thigh tail\n", "root tail\n foot thigh\n", "", "does not hang on the root"),
        ("shin foot", "shin feet", ":54", "no bone is called 'feet'"),
        ("order TX TY TZ RX RY RZ", "", "", "no 'order'"),
        (ASF, ":version 1.1\n", "", "no bones"),
        (ASF, "\x00\xff" * 50, "", "no bones"),
    ],
)
def test_one_clear_error_in_the_asf(put, old, new, where, says):
    assert old in ASF
    with pytest.raises(InputError) as caught:
        load(put(asf=ASF.replace(old, new, 1)))
    assert says in str(caught.value) and f"07.asf{where}: " in str(caught.value)


@pytest.mark.parametrize("amc", [":FULLY-SPECIFIED\n:DEGREES\n", ":FULLY-SPECIFIED\n1\n", "# nothing\n"])
def test_no_frames(put, amc):
    with pytest.raises(InputError, match=r"07_01\.amc:\d"):
        load(put(amc))


def test_every_truncation_is_refused_or_read(put):
    for length in range(1, len(AMC), 5):
        try:
            take = load(put(AMC[:length]))
        except InputError as error:
            assert "07_01.amc" in str(error)
        else:
            assert 1 <= len(take) <= 3


def test_it_becomes_a_bvh_file(put, tmp_path):
    take = load(put())
    back = load(save(take, tmp_path / "new.bvh"), unit="asf", up="y")
    assert back.skeleton == take.skeleton and back.fps == 120
    np.testing.assert_allclose(back.motion.positions, take.motion.positions, atol=1e-6)
    with pytest.raises(InputError, match="AMC can be read but not written"):
        save(take, tmp_path / "new.amc")


def test_real_files_like_the_naive_reader(cmu):
    takes = sorted(cmu.rglob("*.amc"))
    for path in takes[:: len(takes) // 8]:
        assert_like_naive(path, next(path.parent.glob("*.asf")), [0, 60])


def test_a_real_take_becomes_a_bvh_file(cmu, tmp_path):
    path = cmu / "16" / "16_11.amc"
    if not path.is_file():
        path = sorted((cmu / "16").glob("*.amc"))[0]
    take = load(path)
    back = load(save(take, tmp_path / "new.bvh"), unit="asf", up="y")
    found = [back.skeleton.index(name) for name in take.skeleton.names]
    np.testing.assert_allclose(back.motion.positions[:, found], take.motion.positions, atol=2e-6)
    # Channels run on: nowhere a step of anything like a full turn.
    steps = np.abs(np.diff(back.document.channels, axis=0))
    assert steps.max() < 120


@pytest.mark.slow
def test_every_real_file(cmu):
    takes = sorted(cmu.rglob("*.amc"))
    for path in takes:
        take = load(path)
        assert np.isfinite(take.motion.positions).all()
        assert_like_naive(path, next(path.parent.glob("*.asf")), [len(take) // 2])
    print(f"{len(takes)} files agree with the naive reader")
