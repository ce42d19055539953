"""Memories kept in files: the same arrays back, the same bytes from any order, one line for what is wrong."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import motionmend as mm
from motionmend.memory.sessions import BRIDGED, SEEN, UNKNOWN, grid, remember
from motionmend.memory.storing import Memory
from strollers import as_point_take, as_points, as_rig_take, stroll


@pytest.fixture(scope="module")
def memory() -> Memory:
    rigs = [as_rig_take(stroll(seed, 3.0), name=f"s{seed}.bvh") for seed in (1, 2)]
    return mm.learn([*rigs, as_point_take(as_points(stroll(3, 3.0)), "points.npz")])


def same(one: Memory, other: Memory) -> bool:
    arrays = ("positions", "trust", "offsets", "rotations", "shifts")
    return len(one.sessions) == len(other.sessions) and all(
        a.takes == b.takes and a.skeleton == b.skeleton and (a.offsets is None) == (b.offsets is None) and all(
            np.array_equal(getattr(a, name), getattr(b, name)) for name in arrays if getattr(a, name) is not None
        )
        for a, b in zip(one.sessions, other.sessions)
    )  # fmt: skip


def test_a_memory_comes_back_from_its_file_mapped(memory, tmp_path):
    path = memory.save(tmp_path / "session.memory")
    again = Memory.open(path)
    assert same(memory, again) and again.seconds == pytest.approx(9, abs=0.2)
    base = again.sessions[0].positions
    while base.base is not None and not isinstance(base, np.memmap):
        base = base.base
    assert isinstance(base, np.memmap)
    assert "2 takes, 6 s, 9 joints, channels: s1.bvh, s2.bvh" in str(again)
    with pytest.raises(mm.InputError, match="exists"):
        memory.save(path)


def test_it_is_what_the_safetensors_library_reads(memory, tmp_path):
    numpy = pytest.importorskip("safetensors.numpy")
    found = numpy.load_file(memory.save(tmp_path / "session.memory"))
    for number, session in enumerate(memory.sessions):
        assert np.array_equal(found[f"{number}.positions"], session.positions)
        assert np.array_equal(found[f"{number}.trust"], session.trust)


def test_the_order_of_takes_does_not_matter_and_copies_count_once(tmp_path):
    takes = [as_rig_take(stroll(seed, 3.0), name=f"s{seed}.bvh") for seed in (1, 2, 3)]
    copy = replace(takes[0], source="a copy.bvh")
    orders = [*takes, copy], [copy, *takes[::-1]], [mm.learn([takes[1], copy]), takes[0], takes[2]]
    paths = [mm.learn(each).save(tmp_path / f"{number}.memory") for number, each in enumerate(orders)]
    assert len({path.read_bytes() for path in paths}) == 1
    assert len(Memory.open(paths[0]).sessions[0].takes) == 3


@pytest.mark.parametrize("kept", [0, 5, 100, 2000, -1])
def test_a_memory_cut_off_is_said_to_be(memory, tmp_path, kept):
    path = memory.save(tmp_path / "session.memory")
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(mm.InputError, match=r"session\.memory: .*memory"):
        Memory.open(path)


def test_other_files_and_versions_are_refused(memory, tmp_path):
    path = memory.save(tmp_path / "session.memory")
    whole = path.read_bytes()
    length = int.from_bytes(whole[:8], "little")

    def rewritten(change):
        header = json.loads(whole[8 : 8 + length])
        change(header)
        words = json.dumps(header).encode()
        path.write_bytes(len(words).to_bytes(8, "little") + words + whole[8 + length :])
        return path

    with pytest.raises(mm.InputError, match="version 9"):
        Memory.open(rewritten(lambda header: header["__metadata__"].update(version="9")))
    with pytest.raises(mm.InputError, match="no memory of motionmend"):
        Memory.open(rewritten(lambda header: header["__metadata__"].update(format="other")))
    for change in (
        lambda header: header["0.positions"].update(shape=[1, 2, 3]),
        lambda header: header["0.positions"].update(data_offsets=[-4, 8]),
        lambda header: header["0.positions"].update(dtype="F64"),
        lambda header: header.pop("0.trust"),
        lambda header: header["__metadata__"].update(sessions="[{}]"),
        lambda header: header["__metadata__"].update(sessions="{"),
    ):
        with pytest.raises(mm.InputError, match="damaged"):
            Memory.open(rewritten(change))


def test_short_holes_are_bridged_to_be_compared_and_long_ones_are_unknown():
    motion = as_points(stroll(0, 3.0, fps=30.0), 30.0)
    seen = motion.observed.copy()
    seen[10:13, 4] = seen[30:60, 5] = seen[:2, 6] = False
    session = remember(replace(motion, observed=seen), None, "holes")
    expected = np.full(seen.shape, SEEN, np.uint8)
    expected[10:13, 4], expected[30:60, 5], expected[:2, 6] = BRIDGED, UNKNOWN, UNKNOWN
    assert np.array_equal(session.trust, expected)
    between = session.positions[[9, 13], 4]
    np.testing.assert_allclose(session.positions[11, 4], between.mean(axis=0), atol=1e-6)


@pytest.mark.parametrize("fps", [24.0, 29.97, 30.0, 59.94, 60.0, 100.0, 120.0, 250.0])
@pytest.mark.parametrize("frames", [1, 2, 7, 240])
def test_times_at_the_memorys_rate_lie_in_the_middle_of_the_take(fps, frames):
    at, beyond = grid(frames, fps)
    times = (at + beyond) / fps
    assert times[0] >= 0 and times[-1] <= (frames - 1) / fps + 1e-9
    if len(times) > 1:
        np.testing.assert_allclose(np.diff(times), 1 / 30, rtol=0.01)
    slack = (frames - 1) / fps - times[-1] - times[0]
    assert abs(slack) <= 1 / fps + 1e-9


def test_what_diagnosis_distrusts_does_not_teach():
    take = as_point_take(as_points(stroll(1, 4.0)))
    broken = mm.plant(take, gaps=[(100, 130)], held=[([4], 160, 200)])
    (session,) = mm.learn([broken]).sessions
    assert (session.trust[52:63] != SEEN).all() and (session.trust[82:98, 4] != SEEN).all()
    assert (session.trust[:48] == SEEN).all()


def test_what_cannot_teach_is_said(tmp_path):
    for teachers, words in (
        ([], "nothing to learn"),
        ([tmp_path], "no take is in this folder"),
        ([tmp_path / "none.bvh"], "no such file"),
        ([as_point_take(as_points(stroll(0, 0.2)))], "too short"),
    ):
        with pytest.raises(mm.InputError, match=words):
            mm.learn(teachers)
    with pytest.raises(mm.InputError, match=r"session\.memory"):
        mm.learn([as_point_take(as_points(stroll(0, 3.0)))]).save(tmp_path / "session.npz")
