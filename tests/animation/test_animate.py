"""A pose and paths in, animations out: the pose exact, paths met, bones kept, and all of it told."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionmend as mm
from follower import follower
from motionmend.animation import trajectories
from motionmend.body.joints import BODY, JOINT
from motionmend.body.mapping import map_rig, to_body
from motionmend.cli.main import main
from motionmend.errors import InputError
from motionmend.metrics import positional
from motionmend.motion import Motion, Skeleton, Take, Units
from motionmend.networks import checkpoints
from motionmend.rotations import apply, from_axis
from walks import WALK

FRAME = 60  # of the walk, in mid-stride; the first is a T-pose


@pytest.fixture(scope="module")
def walk() -> Take:
    return mm.load(WALK)


def path_of(take: Take, name: str, start: int = FRAME, stop: int | None = None) -> np.ndarray:
    """Where a joint really goes: it can be reached by its own rig."""
    return take.motion.positions[start:stop, take.skeleton.index(name)].astype(float)


def animated(take, paths=(), **options) -> list[Take]:
    return mm.animate(take, paths, **{"frame": FRAME, "network": follower(), **options})


def off(take: Take, name: str, path: np.ndarray) -> np.ndarray:
    """mm between a joint and its path, frame by frame."""
    return 1000 * np.linalg.norm(path_of(take, name, 0, len(path)) - path[: len(take)], axis=-1)


def bones(take: Take) -> np.ndarray:
    lengths = positional.bone_lengths(take.motion.positions, take.skeleton.parents)
    return lengths[:, np.isfinite(lengths).all(axis=0)]


# What is promised


def test_the_first_frame_is_the_pose_number_for_number(walk, tmp_path):
    (made,) = animated(walk, {"LeftHand": path_of(walk, "LeftHand")})
    assert np.array_equal(made.rig.rotations[0], walk.rig.rotations[FRAME])
    assert np.array_equal(made.rig.translations[0], walk.rig.translations[FRAME])
    mm.save(made, tmp_path / "made.bvh")
    written, original = (path.read_text().splitlines() for path in (tmp_path / "made.bvh", WALK))
    head = next(number for number, line in enumerate(written) if line.startswith("Frames:"))
    assert written[:head] == original[:head] and written[head] == "Frames: 299"
    assert written[head + 1 : head + 3] == [original[head + 1], original[head + 2 + FRAME].strip()]
    again = mm.load(tmp_path / "made.bvh")
    assert again.fps == 120 and len(again) == len(walk) - FRAME
    np.testing.assert_allclose(again.motion.positions, made.motion.positions, atol=1e-5)


@pytest.mark.parametrize(
    "names", [["LeftHand"], ["LeftHand", "RightHand"], ["RightFoot", "LeftHand"], ["Hips"], ["Head", "LeftForeArm"]],
    ids=" ".join,
)  # fmt: skip
def test_paths_that_can_be_reached_are_met_and_bones_kept(walk, names):
    paths = {name: path_of(walk, name) for name in names}
    (made,) = animated(walk, paths, seed=3)
    for name, told in zip(names, made.report.variants[0].control, strict=True):
        error = off(made, name, paths[name])
        assert error.max() < 5 and told.joint == name and not told.unreached
        assert told.result[1] == pytest.approx(error[1:].max(), abs=1e-3) and told.frames == len(made) - 1
        assert told.network[1] > 50  # there was something to mend
    np.testing.assert_allclose(bones(made), np.tile(bones(walk)[FRAME], (len(made), 1)), atol=1e-5)
    variant = made.report.variants[0]
    assert variant.bones[1] < 0.01 < 1 < variant.network_bones[0]


def test_all_joints_at_once_give_the_take_back(walk):
    mapping = map_rig(walk.skeleton, walk.motion.positions)
    names = [walk.skeleton.names[joint] for joint in mapping.found.values()]
    (made,) = animated(walk, {name: path_of(walk, name) for name in names})
    assert max(off(made, name, path_of(walk, name)).max() for name in names) < 5


def test_a_path_that_cannot_be_reached_is_named(walk):
    high = path_of(walk, "LeftHand", FRAME, FRAME + 120)
    high[60:, 1] += np.linspace(0, 2, 60)
    (made,) = animated(walk, {"LeftHand": high})
    (told,) = made.report.variants[0].control
    error = off(made, "LeftHand", high)
    (span,) = told.unreached
    assert span.stop == 120 and span.start > 65
    assert span.by == pytest.approx(error.max(), abs=0.01) and 100 < span.by < 2000
    assert error[: span.start].max() < 5
    assert f"{span.start}:120 by up to {span.by:.0f} mm" in str(made.report)
    steps = positional.steps(made.motion.positions)[0][70:]
    assert np.nanpercentile(steps, 99) < 20 and np.nanmax(steps) < 40  # stretched out it does not shake


def test_corrections_come_and_go_without_a_pop(walk):
    hand = path_of(walk, "LeftHand", FRAME, FRAME + 121) + np.array([0, 0.1, 0])
    keys = np.arange(121) / 120 + 0.5
    (made,) = animated(walk, {"LeftHand": (keys, hand)}, seconds=2.5, network=follower(sway=0, late=0.8))
    error = off(made, "LeftHand", np.concatenate([np.full((60, 3), np.nan), hand]))
    assert np.nanmax(error) < 5
    (told,) = made.report.variants[0].control
    assert told.frames == 121 and told.joined == 0
    jumps = positional.steps(made.motion.positions)[0]
    coming, going = jumps[20:60], jumps[184:230]  # in between it shakes as the hand that the path is from
    assert max(coming.max(), going.max()) < 5


def test_a_path_that_begins_elsewhere_is_joined(walk):
    (made,) = animated(walk, {"LeftHand": path_of(walk, "LeftHand") + np.array([0.1, 0, 0])})
    (told,) = made.report.variants[0].control
    assert told.begins == pytest.approx(100, abs=0.1) and told.joined == 60 and told.result[1] < 5
    assert np.array_equal(made.motion.positions[0], walk.motion.positions[FRAME])
    assert np.nanmax(positional.steps(made.motion.positions)[0][:60, walk.skeleton.index("LeftHand")]) < 10
    assert "its path begins 100 mm from the pose, and is joined by frame 60" in str(made.report)


# Variants


def lowest(take: Take) -> np.ndarray:
    """Height of the lower ball of a foot, frame by frame."""
    return take.motion.positions[:, [take.skeleton.index(f"{side}ToeBase") for side in ("Left", "Right")], 1].min(1)


@pytest.mark.parametrize("rises", [0.3, -0.3])
def test_who_floats_or_sinks_is_put_back_on_the_ground(walk, rises):
    made, raw = (
        animated(walk, seconds=4, network=follower(sway=0, grows=0, rises=rises), raw_floor=flag)[0]
        for flag in (False, True)
    )
    assert abs(lowest(raw)[-1] - lowest(raw)[0]) > 0.4
    assert abs(lowest(made) - lowest(made)[0]).max() < 0.06
    assert abs(lowest(made) - lowest(made)[0])[60:-72].max() < 0.02  # at the end it may be a jump that goes on
    told, as_it_is = (each.report.variants[0] for each in (made, raw))
    assert told.network_floor[1] > 400 and told.floor[1] < 60 and as_it_is.floor[1] > 400


def test_paths_of_the_hips_say_how_high_they_are(walk):
    up = path_of(walk, "Hips", FRAME, FRAME + 240)
    up[:, 1] += np.linspace(0, 0.5, len(up))
    (made,) = animated(walk, {"Hips": up}, network=follower(sway=0, grows=0))
    assert off(made, "Hips", up).max() < 5


def test_the_same_seed_gives_the_same_bits(walk):
    path = {"RightHand": path_of(walk, "RightHand")}
    one, same, other = (animated(walk, path, samples=2, seed=seed) for seed in (7, 7, 8))
    for a, b, c in zip(one, same, other):
        assert np.array_equal(a.rig.rotations, b.rig.rotations)
        assert np.array_equal(a.rig.translations, b.rig.translations)
        assert not np.array_equal(a.rig.rotations, c.rig.rotations)
    assert not np.array_equal(one[0].rig.rotations, one[1].rig.rotations)
    (alone,) = animated(walk, path, samples=1, seed=7)
    assert np.array_equal(alone.rig.rotations, one[0].rig.rotations)


def test_without_diversity_all_are_the_best_guess(walk):
    best, again = (animated(walk, mean=True, seed=seed)[0] for seed in (1, 2))
    assert np.array_equal(best.rig.rotations, again.rig.rotations)
    for each in animated(walk, samples=2, diversity=0.0, seed=5):
        assert np.array_equal(each.rig.rotations, best.rig.rotations)
    far, near = (
        np.abs(animated(walk, diversity=spread)[0].motion.positions - best.motion.positions).max()
        for spread in (1, 0.3)
    )
    assert 0 < near < 0.5 * far


# Lengths and rates


def test_long_animations_show_no_seam(walk):
    keys, hand = np.arange(0, 12.5, 0.5), path_of(walk, "LeftHand", FRAME, FRAME + 1)
    circle = 0.2 * np.stack([np.cos(keys) - 1, np.sin(keys), 0 * keys], axis=1)
    for paths in ({}, {"LeftHand": (keys, hand + circle)}):
        (made,) = animated(walk, paths, seconds=12, seed=2)
        assert len(made) == 1440
        seam = made.report.variants[0].seam
        assert seam.ok and len(seam.frames) == 7 and seam.frames[0] == 180
        assert seam.value < 1.0
        # A network that stretches bones would double them by then, if each window began where the last one ended.
        assert made.report.variants[0].network_bones[1] < 100


@pytest.mark.parametrize("fps", [24.0, 50.0, 59.94, 120.0, 240.0])
def test_any_rate(walk, fps):
    take = replace(walk, motion=replace(walk.motion, fps=fps))
    path = path_of(walk, "LeftHand")[: round(fps)]
    (made,) = animated(take, {"LeftHand": path})
    assert made.fps == fps and len(made) == len(path)
    assert off(made, "LeftHand", path).max() < 5


@pytest.mark.parametrize("frames", [1, 2, 3, 30])
def test_short_ones(walk, frames):
    (made,) = animated(walk, {"LeftHand": path_of(walk, "LeftHand")}, frames=frames)
    assert len(made) == frames and np.array_equal(made.motion.positions[0], walk.motion.positions[FRAME])


def test_how_long_it_is(walk):
    assert len(animated(walk)[0]) == 240
    assert len(animated(walk, {"LeftHand": ([0.0, 1.25], np.zeros((2, 3)))})[0]) == 151
    assert len(animated(walk, seconds=0.5)[0]) == 60


# Rigs and formats


@pytest.mark.parametrize("suffix", ["npz", "csv", "c3d", "trc", "bvh"])
def test_every_format(walk, tmp_path, suffix):
    source = tmp_path / f"walk.{suffix}"
    mm.save(walk, source) if suffix != "bvh" else shutil.copy(WALK, source)
    take = mm.load(source)
    path = path_of(take, "LeftHand")
    (made,) = animated(take, {"LeftHand": path})
    assert np.array_equal(made.motion.positions[0], take.motion.positions[FRAME])
    assert made.motion.observed.all() and off(made, "LeftHand", path).max() < 5
    mm.save(made, tmp_path / f"made.{suffix}")
    again = mm.load(tmp_path / f"made.{suffix}")
    assert len(again) == len(made) and again.fps == pytest.approx(take.fps, rel=1e-4)
    np.testing.assert_allclose(again.motion.positions, made.motion.positions, atol=1e-4)


def test_markers_hang_on_their_bones(walk):
    """Points that are none of the body's joints keep their distance from both ends of a bone."""
    names = list(walk.skeleton.names)
    joints = [names.index("LeftForeArm"), names.index("LeftHand")]
    marker = walk.motion.positions[:, joints].mean(axis=1, keepdims=True) + np.float32(0.01)
    positions = np.concatenate([walk.motion.positions, marker], axis=1)
    observed = np.ones(positions.shape[:2], bool)
    positions[FRAME, names.index("LThumb")], observed[FRAME, names.index("LThumb")] = np.nan, False
    cloud = Skeleton((*names, "marker"), (*walk.skeleton.parents, -1))
    take = Take(Motion(positions, observed, 120.0, cloud), None, None, Units(1.0, "y", ""), "npz", "made.npz")
    (made,) = animated(take, {"LeftHand": path_of(walk, "LeftHand")})
    apart = np.linalg.norm(made.motion.positions[:, joints] - made.motion.positions[:, -1:], axis=-1)
    np.testing.assert_allclose(apart, np.tile(apart[0], (len(made), 1)), atol=1e-5)
    assert not made.motion.observed[:, names.index("LThumb")].any()


def test_a_rig_without_toes(walk):
    for take, options in (
        (walk, {"map": {"left_toe": "", "right_toe": ""}}),
        (without(walk, "LeftToeBase", "RightToeBase"), {}),
    ):
        path = path_of(take, "RightFoot")
        (made,) = animated(take, {"RightFoot": path}, **options)
        assert off(made, "RightFoot", path).max() < 5
        assert "the rig has no left_toe, right_toe" in str(made.report)
        with pytest.raises(InputError, match="the rig has no joint for left_toe"):
            animated(take, {"left_toe": path}, **options)


def test_a_rig_without_hands(walk):
    hands = ("LeftHand", "LeftFingerBase", "LeftHandIndex1", "LThumb")
    for take, options in (
        (walk, {"map": {"left_hand": "", "right_hand": ""}}),
        (without(walk, *hands, *(name.replace("Left", "Right").replace("LT", "RT") for name in hands)), {}),
    ):
        elbow = path_of(take, "RightForeArm")
        (made,) = animated(take, {"RightForeArm": elbow}, **options)
        assert off(made, "RightForeArm", elbow).max() < 5
        assert "the rig has no left_hand, right_hand" in str(made.report)
        assert np.isfinite(made.motion.positions).all() and np.array_equal(
            made.motion.positions[0], take.motion.positions[FRAME]
        )


def without(take: Take, *names: str) -> Take:
    """As points, without some."""
    kept = [joint for joint, name in enumerate(take.skeleton.names) if name not in names]
    skeleton = Skeleton.cloud([take.skeleton.names[joint] for joint in kept])
    motion = Motion(take.motion.positions[:, kept], take.motion.observed[:, kept], take.fps, skeleton)
    return Take(motion, None, None, Units(1.0, "y", ""), "npz", "made.npz")


def test_guessed_toes_are_where_toes_are(walk):
    from motionmend.animation.subject import puppet

    take = without(walk, "LeftToeBase", "RightToeBase")
    pose = puppet(take, FRAME, 2, map_rig(take.skeleton, take.motion.positions)).pose
    for ours, name in (("left_toe", "LeftToeBase"), ("right_toe", "RightToeBase")):
        assert np.linalg.norm(pose[JOINT[ours]] - path_of(walk, name)[0]) < 0.1


def test_hinges_and_a_skeleton_with_files_of_its_own(cmu, tmp_path):
    take = mm.load(cmu / "16" / "16_35.amc")
    mapping = map_rig(take.skeleton, take.motion.positions)
    names = [take.skeleton.names[mapping.found[name]] for name in ("left_hand", "right_foot")]
    paths = {name: path_of(take, name) for name in names}
    (made,) = animated(take, paths)
    assert all(off(made, name, paths[name]).max() < 5 for name in names)
    mm.save(made, tmp_path / "made.bvh")
    np.testing.assert_allclose(mm.load(tmp_path / "made.bvh").motion.positions, made.motion.positions, atol=1e-3)


def test_hips_that_move_below_a_root_that_does_not(bandai):
    take = mm.load(sorted((bandai / "data").glob("*.bvh"))[0])
    path = path_of(take, "Hand_L", 0)
    (made,) = animated(take, {"Hand_L": path}, frame=0)
    assert off(made, "Hand_L", path).max() < 5
    root = [joint for joint, parent in enumerate(take.skeleton.parents) if parent < 0]
    assert np.array_equal(made.motion.positions[:, root], np.tile(take.motion.positions[:1, root], (len(made), 1, 1)))


# What the network says itself


def test_raw_is_the_network_s_own_word(walk):
    path = {"LeftHand": path_of(walk, "LeftHand")}
    raw, loose, off_path, mended = (
        animated(walk, path, raw_bones=bones, raw_paths=paths, raw_floor=True)[0]
        for bones, paths in ((True, True), (True, False), (False, True), (False, False))
    )
    assert raw.skeleton == loose.skeleton == BODY and raw.rig is None
    told = [each.report.variants[0] for each in (raw, loose, off_path, mended)]
    assert told[0].control[0].result == pytest.approx(told[0].control[0].network, abs=1e-3)
    assert told[0].bones == pytest.approx(told[0].network_bones, abs=1e-3)
    assert told[1].control[0].result[1] < 5 and told[1].bones == pytest.approx(told[1].network_bones, abs=1e-2)
    assert told[2].control[0].result[1] > 50 and told[2].bones[1] < 0.01
    assert told[3].control[0].result[1] < 5 and told[3].bones[1] < 0.01


# Paths


def written(folder: Path, text: str) -> Path:
    path = folder / "path.csv"
    path.write_text(text)
    return path


def read(path: Path) -> trajectories.Trajectory:
    return trajectories.read(path, JOINT["left_hand"], "LeftHand", Units(0.01, "z", ""), 50.0)


def test_a_csv_of_times_or_frames_in_the_file_s_units(tmp_path):
    timed = read(written(tmp_path, "t,x,y,z\n0,100,0,0\n0.5,0,100,0\n1,0,0,100\n"))
    np.testing.assert_allclose(timed.points, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    np.testing.assert_allclose(timed.times, [0, 0.5, 1])
    framed = read(written(tmp_path, "\ufeffFrame; X ;y;z;note\r\n25;1,5;2;3;a\r\n\r\n75;1;2;3;b\r\n"))
    np.testing.assert_allclose(framed.times, [0.5, 1.5])
    np.testing.assert_allclose(framed.points[0], [0.015, 0.03, -0.02])
    clipped, given = framed.at(np.arange(0, 2, 0.02), 0.01)
    assert given.sum() == 51 and given[25] and given[75] and np.isfinite(clipped).all()


def test_sparse_keys_are_joined_smoothly():
    keys = np.array([0, 0.3, 0.5, 1.0])
    curve = trajectories.trajectory(0, "Hips", np.stack([keys**2, keys, 0 * keys], axis=1), keys, fps=50.0)
    times = np.linspace(0, 1, 101)
    points, given = curve.at(times, 0.005)
    np.testing.assert_allclose(points[:, :2], np.stack([times**2, times], axis=1), atol=1e-12)  # parabolas exactly
    assert given.all()
    one = trajectories.trajectory(0, "Hips", np.ones((1, 3)), [0.5], fps=50.0)
    assert one.at(times, 0.005)[1].sum() == 1


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", None, "the file is empty"),
        ("\n\n", None, "the file is empty"),
        ("t,x,y,z\n", 1, "titles but no keys"),
        ("a,x,y,z\n0,1,2,3\n", 1, "no column is called t or frame"),
        ("t,x,y\n0,1,2\n", 1, "no column is called z"),
        ("0,1,2,3\n1,1,2,3\n", 1, "no column is called t or frame, x, y, z"),
        ("t,x,y,z\n0,1,2,3\n0.5,1,nan,3\n", 3, "'nan' in column 'y' is not a finite number"),
        ("t,x,y,z\n0,1,2,3\n\n0.5,1,,3\n", 4, "'' in column 'y' is not a finite number"),
        ("t,x,y,z\n0,1,2,here\n", 2, "'here' in column 'z' is not a finite number"),
        ("t,x,y,z\n0,1,2\n", 2, "3 columns"),
        ("t,x,y,z\n0,1,2,3\n0.5,1,2,3\n0.5,1,2,3\n", 4, "t 0.5 after 0.5"),
        ("frame,x,y,z\n5,1,2,3\n3,1,2,3\n", 3, "frame 3 after 5"),
        ("t,x,y,z\n-1,1,2,3\n", 2, "t -1; expected numbers from 0 on"),
    ],
)
def test_what_is_wrong_with_a_csv_is_said_with_its_line(tmp_path, text, line, words):
    path = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        read(path)
    assert words in str(error.value)
    assert str(error.value).startswith(f"{path}:{line}: " if line else f"{path}: ")


def test_what_is_wrong_with_arrays_and_names_is_said(walk):
    fine = path_of(walk, "LeftHand")
    for paths, words in (
        ({"LeftHnd": fine}, "no joint is named 'LeftHnd'. Did you mean LeftHand"),
        ({"LThumb": fine}, "LThumb stands for none of the 21 joints"),
        ({"LeftHand": fine[:0]}, "it has no keys"),
        ({"LeftHand": np.where(np.arange(len(fine))[:, None] == 5, np.nan, fine)}, "key 5 is not finite"),
        ({"LeftHand": fine[:, :2]}, r"points \(299, 2\)"),
        ({"LeftHand": "nowhere.csv"}, "nowhere.csv: no such file"),
        ({"LeftHand": ([0, 1, 1], fine[:3])}, "time goes from 1 to 1 s at key 2"),
        ([("LeftHand", fine), ("LeftHand", fine)], "two paths are given for LeftHand at 0 s"),
    ):
        with pytest.raises(InputError, match=words):
            animated(walk, paths)
    for options, words in (
        ({"frame": 359}, "there is no frame 359; expected one from 0 to 358"),
        ({"frames": 0}, "an animation of 0 frames"),
        ({"seconds": -1.0}, "an animation of -1 s"),
        ({"seconds": float("nan")}, "an animation of nan s"),
        ({"seconds": 1.0, "frames": 5}, "both seconds and frames"),
        ({"samples": 0}, "0 samples"),
        ({"diversity": 2.0}, "diversity 2"),
        ({"mean": True, "samples": 3}, "the best guess is one"),
        ({"joints": ["LeftHand"]}, "joints are named of no other take"),
        ({"network": "xmae"}, "xmae fills what is missing"),
    ):
        with pytest.raises(InputError, match=words):
            animated(walk, **options)
    with pytest.raises(InputError, match="begins at 5 s, after the last"):
        animated(walk, {"LeftHand": ([5.0, 6.0], fine[:2])}, seconds=1)


def test_a_pose_without_a_whole_person_is_refused(walk):
    observed = walk.motion.observed.copy()
    observed[FRAME, walk.skeleton.index("LeftForeArm")] = False
    holed = Take(replace(walk.motion, observed=observed), None, None, walk.units, "npz", "holed.npz")
    with pytest.raises(InputError, match=r"holed.npz: frame 60 has no left_forearm; expected a whole person"):
        animated(holed)
    cloud = Skeleton.cloud([f"M{joint}" for joint in range(len(walk.skeleton))])
    noise = np.random.default_rng(0).normal(size=walk.motion.positions.shape).astype(np.float32)
    with pytest.raises(InputError, match="no human body was found"):
        animated(Take(Motion(noise, observed, 120.0, cloud), None, None, walk.units, "npz", "cloud.npz"))


# Paths of another take


def test_a_take_s_own_paths_lead_it_as_it_went(walk):
    (made,) = animated(walk, like=walk, joints=["LeftHand", "RightFoot"], frame=0)
    for told in made.report.variants[0].control:
        assert told.begins < 1 and told.joined == 0 and told.result[1] < 5
    np.testing.assert_allclose(path_of(made, "LeftHand", 0), path_of(walk, "LeftHand", 0), atol=5e-3)


def test_paths_are_turned_moved_and_scaled_to_the_pose(walk):
    body = to_body(walk.motion, map_rig(walk.skeleton, walk.motion.positions))
    turn = from_axis("y", np.array(2.0))
    points = (apply(turn, walk.motion.positions.astype(float)) * 0.5 + [3, 0.4, -1]).astype(np.float32)
    slow = Motion(points, walk.motion.observed, 60.0, walk.skeleton)
    other = Take(slow, None, None, Units(1.0, "y", ""), "npz", "other.npz")
    (path,) = trajectories.from_take(other, ["LeftHand"], body, 0)
    np.testing.assert_allclose(path.points, path_of(walk, "LeftHand", 0), atol=2e-3)
    np.testing.assert_allclose(path.times, np.arange(len(walk)) / 60)
    with pytest.raises(InputError, match=r"other.npz: no joint is named 'Left'"):
        trajectories.from_take(other, ["Left"], body, 0)


# The command line


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> Path:
    """An exported network, small and untrained."""
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    import torch

    from motionmend.networks.export import export, halved
    from motionmend.networks.windows import cut
    from tiny import TinyDream, TinyDreamConfig
    from walks import walk as at_rate

    torch.manual_seed(0)
    real = cut(at_rate(TinyDream.fps).positions, np.array([0, 20]), TinyDream.frames)
    folder = tmp_path_factory.mktemp("networks") / "dream"
    dream = halved(TinyDream(TinyDreamConfig(), len(BODY)))
    export(dream, folder, skeleton=BODY, windows=(real, np.ones(real.shape[:3], bool)))
    return folder


@pytest.fixture
def here(here, walk) -> Path:
    keys = path_of(walk, "LeftHand")[::12] / walk.units.metres
    rows = [f"{12 * key},{x:.5f},{y:.5f},{z:.5f}" for key, (x, y, z) in enumerate(keys)]
    Path("hand.csv").write_text("\n".join(["frame,x,y,z", *rows, ""]))
    return here


def test_variants_into_a_folder(here, walk, network, capsys):
    command = ["animate", "walk.bvh", "--frame", "60", "--trajectory", "LeftHand=hand.csv", "--network", str(network)]
    assert main([*command, "--samples", "3", "--seed", "7", "-o", "variants/", "--picture", "variants.png"]) == 0
    said = capsys.readouterr().out
    assert "written: variants (3 takes)" in said and "report:  variants/walk.report.json" in said
    names = {path.name for path in Path("variants").iterdir()}
    assert names == {"walk_1.bvh", "walk_2.bvh", "walk_3.bvh", "walk.report.json"}
    report = json.loads(Path("variants/walk.report.json").read_text())
    assert [each["output"] for each in report["variants"]] == [f"variants/walk_{number}.bvh" for number in (1, 2, 3)]
    assert all(each["control"][0]["result"][1] < 5 for each in report["variants"])
    assert len({Path(f"variants/walk_{number}.bvh").read_bytes() for number in (1, 2, 3)}) == 3
    made = mm.load("variants/walk_1.bvh")
    assert off(made, "LeftHand", path_of(walk, "LeftHand")[::12].repeat(12, axis=0))[::12].max() < 5
    assert Path("variants.png").read_bytes().startswith(b"\x89PNG")
    assert main([*command, "--seed", "7", "-o", "one.bvh"]) == 0
    assert Path("one.bvh").read_bytes() == Path("variants/walk_1.bvh").read_bytes()
    assert main([*command, "--samples", "3", "-o", "variants"]) == 1
    assert "the file exists" in capsys.readouterr().err


def test_like_another_take_raw_and_json(here, network, capsys):
    options = ["--like", "walk.bvh", "--joints", "LeftHand,RightHand", "--seconds", "1", "--network", str(network)]
    assert main(["animate", "walk.bvh", *options, "-o", "follow.bvh", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [each["joint"] for each in report["variants"][0]["control"]] == ["LeftHand", "RightHand"]
    assert main(["animate", "walk.bvh", *options, "-o", "raw.bvh", "--raw", "--mean"]) == 0
    assert set(mm.load("raw.bvh").skeleton.names) == set(BODY.names)
    assert main(["animate", "walk.bvh", *options, "-o", "mean", "--mean"]) == 0
    assert Path("mean/walk_mean.bvh").is_file()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--trajectory", "LeftHnd=hand.csv"], "Did you mean LeftHand"),
        (["--trajectory", "LeftHand"], "cannot read the trajectory 'LeftHand'"),
        (["--trajectory", "LeftHand=bad.csv"], "bad.csv:2: "),
        (["--like", "nobody.bvh", "--joints", "LeftHand"], "nobody.bvh"),
        (["--like", "walk.bvh"], "no joints are named"),
        (["--fps", "0"], "impossible rate"),
        (["--frame", "-1"], "there is no frame -1"),
        (["--samples", "2"], "several variants need a folder"),
        (["--picture", "out.xyz"], "the picture is a PNG"),
        (["-o", "walk.bvh", "--force"], "this would overwrite the take itself"),
        (["-o", "out.amc"], "read but not written"),
    ],
    ids=lambda each: " ".join(each) if isinstance(each, list) else "",
)
def test_what_is_wrong_is_said_in_one_line(here, network, capsys, options, words):
    Path("bad.csv").write_text("t,x,y,z\n0,1,2,nan\n")
    before = sorted(here.iterdir())
    output = [] if "-o" in options else ["-o", "out.bvh"]
    assert main(["animate", "walk.bvh", *output, "--network", str(network), *options]) == 1
    said = capsys.readouterr()
    assert said.out == "" and words in said.err and said.err.count("\n") == 1
    assert sorted(here.iterdir()) == before


def test_without_a_network_it_says_what_to_do(here, capsys, monkeypatch):
    monkeypatch.setattr(checkpoints, "names", lambda: ["xmae"])
    assert main(["animate", "walk.bvh", "-o", "out.bvh"]) == 1
    said = capsys.readouterr().err
    assert "no network named 'trajevae' is installed" in said and "motionmend train trajevae" in said
    assert said.count("\n") == 1 and not Path("out.bvh").exists()


def test_it_runs_where_torch_is_not(here, network):
    code = (
        "import sys; sys.modules.update(torch=None, onnx=None, safetensors=None)\n"
        "import motionmend as mm\n"
        f"(made,) = mm.animate(mm.load('walk.bvh'), frames=9, network={str(network)!r})\n"
        "mm.save(made, 'out.bvh')"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    assert len(mm.load("out.bvh")) == 9
