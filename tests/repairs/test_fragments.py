"""Tracks without a label: which are offered for a lost marker, which never, and what joining them does to a file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import motionmend as mm
from motionmend.cli.main import main
from motionmend.errors import InputError
from motionmend.motion import Motion, Skeleton
from motionmend.repairs.fragments import Fragment, fragments, unlabelled
from motionmend.repairs.inspecting import inspect
from walks import WALK

FRAMES, FPS = 300, 100.0
PLACES = np.array([[0.2, 0, 0.1], [0, 0.25, 0], [0, 0, 0.3], [-0.2, 0.1, 0], [0.1, -0.2, 0.1], [-0.1, -0.1, -0.2]])
NAMES = ("LKNE", "LTHI", "LASI", "RASI", "SACR", "LSHO")


def body():
    """`(frames, markers, 3)` on a body that turns and wanders, each swaying on it by millimetres."""
    clock = np.arange(FRAMES)[:, None] / FPS
    turn = Rotation.from_rotvec(0.8 * np.sin(clock * [2.0, 3.1, 1.3]))
    sway = 0.003 * np.sin(clock[:, None] * np.linspace(5, 9, 18).reshape(6, 3))
    places = np.stack([turn.apply(PLACES[marker] + sway[:, marker]) for marker in range(6)], axis=1)
    return places + np.sin(clock * [1.1, 0.7, 1.7])[:, None]


def capture(truth, lost, tracks):
    """A cloud whose markers are lost, each (marker, start, stop), with tracks, each (path (frames, 3), start, stop)."""
    positions = np.concatenate([truth] + [np.asarray(path)[:, None] for path, *_ in tracks], axis=1)
    observed = np.ones(positions.shape[:2], bool)
    for marker, start, stop in lost:
        observed[start:stop, marker] = False
    for track, (_, start, stop) in enumerate(tracks, len(NAMES)):
        observed[:, track] = False
        observed[start:stop, track] = True
    names = [*NAMES, *(f"*{track}" for track in range(len(tracks)))]
    seen = np.where(observed[..., None], positions, np.nan).astype(np.float32)
    return Motion(seen, observed, FPS, Skeleton.cloud(names))


def places(found):
    return [(one.track, one.marker, one.start, one.stop) for one in found]


def test_names_of_tracks_that_nobody_labelled():
    yes = ["*0", "*12", "Unlabeled 7", "unlabelled_3", "Unlabeled1234", "uname*4", "New 0012", "Subject:*3"]
    no = ["LKNE", "C_7", "C7", "U1", "New", "newton", "M12", "unlabeled knee", "T*10", ""]
    assert unlabelled(yes).all() and not unlabelled(no).any()


def test_pieces_of_a_lost_marker_are_offered():
    truth = body()
    motion = capture(truth, [(0, 80, 200)], [(truth[:, 0], 85, 120), (truth[:, 0], 130, 198)])
    found = fragments(motion)
    assert places(found) == [(6, 0, 85, 120), (7, 0, 130, 198)]
    assert all(one.metres < 0.01 for one in found)
    late = capture(truth, [(0, 200, FRAMES), (1, 0, 90)], [(truth[:, 0], 206, 260), (truth[:, 1], 30, 84)])
    assert places(fragments(late)) == [(7, 1, 30, 84), (6, 0, 206, 260)]


def test_of_two_lost_at_once_each_gets_its_own():
    truth = body()
    motion = capture(truth, [(0, 80, 200), (1, 90, 190)], [(truth[:, 1], 100, 160), (truth[:, 0], 110, 170)])
    assert places(fragments(motion)) == [(6, 1, 100, 160), (7, 0, 110, 170)]


@pytest.mark.parametrize("off", [0.02, 0.05])
def test_what_is_beside_the_marker_is_no_piece_of_it(off):
    """A reflection that rides along, and a marker of another person that passes by."""
    truth = body()
    beside = truth[:, 0] + off * np.array([0.6, 0, 0.8])
    assert fragments(capture(truth, [(0, 80, 200)], [(beside, 85, 190)])) == []
    passing = truth[140, 0] + (np.arange(FRAMES)[:, None] - 140) / FPS * [1.0, 0, 0.5]
    assert fragments(capture(truth, [(0, 80, 200)], [(passing, 137, 143)])) == []


def test_a_ghost_of_a_marker_that_is_seen_and_two_that_fit_are_not_offered():
    truth = body()
    assert fragments(capture(truth, [(0, 80, 200)], [(truth[:, 1] + 0.002, 85, 190)])) == []
    twins = [(truth[:, 0], 85, 190), (truth[:, 0] + np.array([0.004, 0, 0]), 90, 180)]
    assert fragments(capture(truth, [(0, 80, 200)], twins)) == []


def test_with_too_few_others_nothing_is_offered():
    truth = body()
    lost = [(0, 80, 200), *((marker, 70, 210) for marker in (1, 2, 3))]
    assert fragments(capture(truth, lost, [(truth[:, 0], 85, 190)])) == []
    motion = capture(truth, [(0, 80, 200)], [(truth[:, 0], 85, 190)])
    nobody = Skeleton.cloud([f"*{track}" for track in range(7)])
    assert fragments(replace(motion, skeleton=nobody)) == []


@pytest.fixture
def broken(tmp_path):
    """A C3D whose knee is lost for a while, with a piece of it, and with a reflection of a few frames."""
    truth = body()
    motion = capture(truth, [(0, 80, 200)], [(truth[:, 0], 90, 150), (truth[:, 0] + 1.0, 20, 24)])
    names = motion.skeleton.names
    np.savez(tmp_path / "take.npz", positions=motion.positions, observed=motion.observed, fps=FPS, names=names)
    assert main(["convert", str(tmp_path / "take.npz"), "-o", str(tmp_path / "take.c3d")]) == 0
    return tmp_path / "take.c3d"


def test_inspect_offers_and_repair_joins(broken, tmp_path, capsys):
    take = mm.load(broken)
    assert "90:150  *0 is LKNE" in inspect(take)
    told = json.loads(inspect(take, as_json=True))["fragments"]
    assert [(one["track"], one["marker"], one["start"], one["stop"]) for one in told] == [("*0", "LKNE", 90, 150)]
    assert main(["repair", str(broken), "-o", str(tmp_path / "fixed.c3d"), "--join"]) == 0
    assert "*0 goes on there" in capsys.readouterr().out
    fixed, truth = mm.load(tmp_path / "fixed.c3d"), body()
    np.testing.assert_allclose(fixed.motion.positions[90:150, 0], take.motion.positions[90:150, 6], atol=1e-6)
    assert fixed.motion.observed[:, :6].all()
    assert np.linalg.norm(fixed.motion.positions[:, 0] - truth[:, 0], axis=-1).max() < 0.01
    # Tracks without a label are neither taken away nor continued.
    assert np.array_equal(fixed.motion.observed[:, 6:], take.motion.observed[:, 6:])
    assert np.array_equal(fixed.motion.positions[90:150, 6], take.motion.positions[90:150, 6])
    joined = [fill for fill in mm.repair(take, join=True).report.fills if fill.method == "join"]
    assert [(fill.joints, fill.start, fill.stop, fill.donors) for fill in joined] == [(("LKNE",), 90, 150, ("*0",))]


def test_without_join_nothing_is_joined_and_no_nameless_track_is_continued(broken):
    take = mm.load(broken)
    fixed = mm.repair(take)
    assert {fill.method for fill in fixed.report.fills} == {"average"}
    assert np.array_equal(fixed.motion.observed[:, 6:], take.motion.observed[:, 6:])
    assert {left.why for left in fixed.report.left} == {"a track without a label is not continued"}
    asked = mm.repair(take, lost=["*0:150:155"])
    assert asked.motion.observed[150:155, 6].all() and not asked.motion.observed[155:, 6].any()


def test_a_take_of_channels_has_nothing_to_join():
    with pytest.raises(InputError, match="channels"):
        mm.repair(mm.load(WALK), join=True)


def test_a_fragment_says_who_it_is():
    truth = body()
    one = fragments(capture(truth, [(0, 80, 200)], [(truth[:, 0], 85, 195)]))
    assert one == [Fragment(6, 0, 85, 195, one[0].metres)]
