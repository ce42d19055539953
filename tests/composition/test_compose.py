"""Blends and chains, held against truth that was planted: turned copies, halves of one take, other sizes and rigs."""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionmend as mm
from follower import follower
from motionmend import rotations
from motionmend.body.joints import BODY, JOINT
from motionmend.body.mapping import map_rig, to_body
from motionmend.cli.main import main
from motionmend.composition.composing import Clip, path_in, person_in
from motionmend.metrics import positional
from motionmend.motion import Take, Units
from motionmend.networks import checkpoints
from motionmend.networks.rows import seen_from
from motionmend.networks.windows import resample
from walks import WALK

ARM = ("RightArm", "RightForeArm", "RightHand")
BLEND = ("blend", "walk.bvh", "-o", "out.bvh", "--from")
BONES = [("right_upper_arm", "right_forearm"), ("right_forearm", "right_hand")]


@pytest.fixture(scope="module")
def walk() -> Take:
    return mm.load(WALK)


@pytest.fixture(scope="module")
def blended(walk) -> Take:
    """An arm from elsewhere in the walk, of a walker who was turned and moved as a whole."""
    return mm.blend(walk, moved(walk, 1.2, (3.0, -4.0)), joints=ARM, frames=(40, 100), at=200, method="eased")


def moved(take: Take, angle: float, by: tuple[float, float]) -> Take:
    """The whole take turned about the vertical by `angle` radians, and moved on the floor."""
    turn = rotations.from_rotvec(np.array([0.0, angle, 0.0]))
    turns, shifts = take.rig.rotations.copy(), take.rig.translations.copy()
    turns[:, 0] = rotations.multiply(turn, turns[:, 0])
    shifts[:, 0] = rotations.apply(turn, shifts[:, 0]) + np.array([by[0], 0, by[1]])
    return take.with_rig(replace(take.rig, rotations=turns, translations=shifts))


def keypoints(take: Take, scale: float, fps: float) -> Take:
    """The take's body as 21 points of another size, at another rate, with names of their own."""
    body = resample(to_body(take.motion, map_rig(take.skeleton, take.motion.positions)), fps)
    motion = replace(body, positions=body.positions * np.float32(scale))
    return Take(motion, None, None, Units(1.0, "y", "made"), "npz", "keypoints.npz")


def bones_seen_from_the_body(take: Take, frames: range) -> np.ndarray:
    """`(bones, frames, 3)` unit vectors of the right arm as the body sees them."""
    mapping = person_in(take)
    points = to_body(take.motion, mapping).positions[frames].astype(float)
    _, heading = path_in(take, mapping)(np.array(frames) / take.fps)
    local = seen_from(points[None], np.zeros((1, len(frames), 2)), heading[None])[0]
    return np.stack([rotations.normalised(local[:, JOINT[end]] - local[:, JOINT[start]]) for start, end in BONES])


def lengths(take: Take) -> np.ndarray:
    return positional.bone_lengths(take.rig.kinematics[0], take.skeleton.parents)[:, 1:]


# Blending


def test_a_blended_arm_is_turned_as_in_the_source(walk, blended):
    """As the body sees it, whichever way that faces."""
    there = bones_seen_from_the_body(blended, range(200, 260))
    np.testing.assert_allclose(there, bones_seen_from_the_body(walk, range(40, 100)), atol=2e-3)


def test_a_blend_of_the_take_with_itself_changes_nothing(walk):
    same = mm.blend(walk, walk, joints=",".join(ARM), frames="100:160", at=100, method="eased")
    turns = rotations.multiply(rotations.inverse(walk.rig.rotations), same.rig.rotations)
    assert np.abs(rotations.to_rotvec(turns[100:160])).max() < 1e-6


def test_only_the_named_joints_and_frames_change(walk, blended, tmp_path):
    mask = np.zeros(walk.trusted.shape, bool)
    mask[152:308, [walk.skeleton.index(name) for name in ARM]] = True
    for name in ("rotations", "translations"):
        assert np.array_equal(getattr(blended.rig, name)[~mask], getattr(walk.rig, name)[~mask])
    before, after = (path.read_bytes().splitlines() for path in (WALK, mm.save(blended, tmp_path / "blended.bvh")))
    first = len(before) - len(walk)
    changed = [line - first for line in range(len(before)) if before[line] != after[line]]
    assert len(before) == len(after) and set(range(200, 260)) <= set(changed) <= set(range(152, 308))
    for line in (first + 152, first + 230):
        assert sum(old != new for old, new in zip(before[line].split(), after[line].split(), strict=True)) <= 9


def test_a_blended_arm_goes_there_and_back_without_a_pop(walk, blended):
    hand = walk.skeleton.index("RightHand")
    steps, own = ([values[:, hand] for values in positional.steps(each.motion.positions)] for each in (blended, walk))
    for values, usual in zip(steps, own):
        assert values[[152, 200, 260, 308]].max() < 2 * np.nanpercentile(usual, 99)
    assert blended.report.checks["seam_jump"]["ok"] and blended.report.checks["seam_kink"]["ok"]
    assert blended.report.checks["changed"]["value"] == 0
    np.testing.assert_allclose(lengths(blended), lengths(walk), atol=1e-6)


def test_an_arm_comes_from_another_rig_size_and_rate(walk):
    source = keypoints(moved(walk, -2.0, (1.0, 1.0)), 1.3, 60.0)
    result = mm.blend(walk, source, joints=ARM, frames=(20, 50), at=200, fade=40, method="eased")
    assert [(piece.start, piece.stop, piece.joints) for piece in result.report.pieces] == [(200, 259, ARM[:2])]
    assert any("RightHand" in note for note in result.report.notes)
    there = bones_seen_from_the_body(result, range(200, 259))
    np.testing.assert_allclose(there, bones_seen_from_the_body(walk, range(40, 99)), atol=1e-2)
    np.testing.assert_allclose(lengths(result), lengths(walk), atol=1e-6)


def test_points_are_blended_too(walk):
    take = keypoints(walk, 1.0, 120.0)
    result = mm.blend(take, walk, joints=["right_forearm", "right_hand"], frames=(40, 100), at=200, method="eased")
    there = bones_seen_from_the_body(result, range(200, 260))
    np.testing.assert_allclose(there, bones_seen_from_the_body(walk, range(40, 100)), atol=2e-3)
    other = np.ones(take.trusted.shape, bool)
    other[152:308, [JOINT["right_forearm"], JOINT["right_hand"]]] = False
    assert np.array_equal(result.motion.positions[other], take.motion.positions[other])


@pytest.mark.skipif("xmae" not in checkpoints.names(), reason="no network is installed")
def test_the_whole_body_is_filled_around_the_joints(walk):
    """All of it changes in the gap, nothing outside, and the arm is still the source's as the filled body sees it."""
    result = mm.blend(walk, walk, joints=ARM, frames=(40, 70), at=200, whole=True, method="xmae")
    assert result.report.checks["changed"]["value"] == 0
    assert np.array_equal(result.rig.rotations[278:], walk.rig.rotations[278:])
    assert np.any(result.rig.rotations[200:230] != walk.rig.rotations[200:230], axis=-1).mean() > 0.7
    arm = bones_seen_from_the_body(result, range(200, 230)), bones_seen_from_the_body(walk, range(40, 70))
    np.testing.assert_allclose(*arm, atol=0.02)
    np.testing.assert_allclose(lengths(result), lengths(walk), atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joints": "RightArmm"}, "walk.bvh.*RightArm"),
        ({"joints": "RightArm:3:9"}, "frames in it"),
        ({"joints": ()}, "no joint was named"),
        ({"joints": "Hips"}, "carries the whole body"),
        ({"frames": "400:420"}, "walk.bvh.*no frame"),
        ({"frames": "x"}, "range"),
        ({"at": 400}, "no frame"),
        ({"at": 330}, "do not fit.*299"),
        ({"at": 20}, "20 frames before"),
        ({"at": 290}, "9 frames after"),
        ({"fade": 0}, "a fade of 0 frames"),
        ({"fade": "soon"}, "a fade: .*soon"),
        ({"method": "magic"}, "magic"),
        ({"joints": "LThumb", "source": True}, "nothing tells how LThumb"),
    ],
)
def test_what_cannot_be_blended_is_said(walk, change, words):
    source = keypoints(walk, 1.0, 60.0) if change.pop("source", False) else walk
    asked = {"joints": ARM, "frames": (20, 80), "at": 150, "method": "eased"} | change
    with pytest.raises(mm.InputError, match=words):
        mm.blend(walk, source, **asked)


def test_missing_samples_of_the_source_are_named(walk):
    source = keypoints(walk, 1.0, 120.0)
    observed = source.motion.observed.copy()
    observed[50:60, JOINT["right_hand"]] = False
    holed = source.with_motion(replace(source.motion, observed=observed))
    with pytest.raises(mm.InputError, match=r"right_hand.*missing"):
        mm.blend(walk, holed, joints=ARM, frames=(40, 70), at=200)


# Chaining


def test_the_second_half_of_a_take_goes_on_from_the_first(walk):
    told = mm.chain([(walk, (0, 170)), (walk, (182, 359))], gap=12, method="eased")
    assert len(told) == len(walk) and told.report.checks["changed"]["value"] == 0
    apart = told.motion.positions[182:] - walk.motion.positions[182:]
    assert np.linalg.norm(apart[0, 0]) < 0.03  # the hips, right after the gap
    turned = rotations.multiply(told.rig.rotations[200, 0], rotations.inverse(walk.rig.rotations[200, 0]))
    assert np.degrees(np.linalg.norm(rotations.to_rotvec(turned))) < 3
    np.testing.assert_allclose(apart[..., 1], 0, atol=1e-6)


def test_seeds_come_back_as_they_were_but_for_their_place(walk, tmp_path):
    told = mm.chain([(walk, (10, 170)), (walk, (200, 359))], gap=60, method="eased")
    assert np.array_equal(told.rig.rotations[:160], walk.rig.rotations[10:170])
    assert np.array_equal(told.rig.translations[:160], walk.rig.translations[10:170])
    assert np.array_equal(told.rig.rotations[220:, 1:], walk.rig.rotations[200:, 1:])
    np.testing.assert_allclose(lengths(told), lengths(walk)[:1].repeat(len(told), 0), atol=1e-6)
    before, after = (path.read_bytes().splitlines() for path in (WALK, mm.save(told, tmp_path / "told.bvh")))
    head = len(before) - len(walk)
    assert after[head : head + 160] == before[head + 10 : head + 170]
    for old, new in zip(before[head + 200 :], after[head + 220 :], strict=True):
        assert old.split()[6:] == new.split()[6:]  # all but the root's position and rotation
    assert [a for a, b in zip(after[:head], before[:head], strict=True) if a != b] == [b"Frames: 379"]
    again = mm.load(tmp_path / "told.bvh")
    np.testing.assert_allclose(again.motion.positions, told.motion.positions, atol=1e-5)


def test_where_a_clip_stands_in_its_file_does_not_matter(walk):
    clips = [(walk, (0, 150)), (walk, (200, 359))]
    told = mm.chain(clips, gap=50, method="eased")
    again = mm.chain([clips[0], (moved(walk, 2.1, (5.0, 6.0)), (200, 359))], gap=50, method="eased")
    np.testing.assert_allclose(again.motion.positions, told.motion.positions, atol=1e-4)


def test_a_clip_of_another_size_keeps_its_rotations(walk):
    rig = walk.rig
    large = replace(rig, translations=rig.translations * 1.2, offsets=rig.offsets * 1.2)
    giant = replace(walk.with_rig(large), document=None, source="giant.bvh")
    told = mm.chain([(walk, (0, 150)), (giant, (200, 359))], gap=50, method="eased")
    assert np.array_equal(told.rig.rotations[200:, 1:], rig.rotations[200:, 1:])
    plain = mm.chain([(walk, (0, 150)), (walk, (200, 359))], gap=50, method="eased")
    np.testing.assert_allclose(told.motion.positions, plain.motion.positions, atol=1e-4)
    assert any("giant.bvh" in note and "0.83" in note for note in told.report.notes)


def test_a_clip_of_another_skeleton_is_fitted(walk, tmp_path):
    other = keypoints(walk, 1.25, 60.0)
    told = mm.chain([(walk, (0, 150)), (other, (100, 180))], gap=50, method="eased")
    assert len(told) == 150 + 50 + 159
    assert {note.split(" ")[0] for note in told.report.notes} >= {"keypoints.npz"}
    np.testing.assert_allclose(lengths(told), lengths(walk)[:1].repeat(len(told), 0), atol=1e-6)
    bodies = [to_body(each.motion, map_rig(each.skeleton, each.motion.positions)).positions for each in (told, walk)]
    for upper, middle, lower in (("thigh", "shin", "foot"), ("upper_arm", "forearm", "hand")):
        bends = []
        for body in bodies:
            limb = [body[200:359, JOINT[f"left_{part}"]].astype(float) for part in (upper, middle, lower)]
            bones = rotations.normalised(limb[1] - limb[0]), rotations.normalised(limb[2] - limb[1])
            bends.append(np.degrees(np.arccos(np.clip(np.sum(bones[0] * bones[1], axis=-1), -1, 1))))
        assert np.abs(bends[0] - bends[1]).max() < 1.5
    assert np.abs(bodies[0][200:, 0, 1] - bodies[1][200:, 0, 1]).max() < 0.03
    assert len(mm.load(mm.save(told, tmp_path / "told.bvh"))) == len(told)


@pytest.mark.parametrize("second", ["the same", "another"])
def test_a_root_that_stands_on_the_floor_goes_on_standing(walk, second):
    """As in rigs of games: the hips travel below a joint that never moves."""
    rig, none = walk.rig, np.zeros((1, 3))
    skeleton = mm.Skeleton(("Floor", *walk.skeleton.names), (-1, *(parent + 1 for parent in walk.skeleton.parents)))
    still = np.broadcast_to(rotations.IDENTITY, (len(walk), 1, 4))
    rig = replace(
        rig, skeleton=skeleton, rotations=np.concatenate([still, rig.rotations], axis=1),
        translations=np.concatenate([np.zeros((len(walk), 1, 3)), rig.translations], axis=1),
        trusted=np.ones((len(walk), len(skeleton)), bool), offsets=np.concatenate([none, rig.offsets]),
        moves=np.array([True, *rig.moves]), orders=("ZYX", *rig.orders), ends=(),
    )  # fmt: skip
    take = replace(walk, document=None, rig=rig, motion=rig.motion(walk.fps))
    other = take if second == "the same" else keypoints(walk, 1.25, 120.0)
    told = mm.chain([(take, (0, 150)), (other, (200, 359))], gap=50, method="eased")
    assert not told.motion.positions[:, 0].any()
    plain = mm.chain([(walk, (0, 150)), (walk, (200, 359))], gap=50, method="eased")
    feet = [walk.skeleton.index(name) for name in ("Hips", "LeftFoot", "RightFoot", "LeftHand")]
    apart = told.motion.positions[:, 1:][:, feet] - plain.motion.positions[:, feet]
    assert np.abs(apart).max() < (1e-4 if second == "the same" else 0.02)


def test_rates_differ(walk, tmp_path):
    told = mm.chain([(walk, (0, 150)), (walk, (200, 359))], gap="0.5s", fps=60, method="eased")
    assert (len(told), told.fps) == (75 + 30 + 80, 60)
    assert np.array_equal(told.rig.rotations[105:, 1:], walk.rig.rotations[200::2, 1:])
    again = mm.load(mm.save(told, tmp_path / "told.bvh"))
    assert (len(again), again.fps) == (185, 60)
    odd = Clip.of(walk, (100, 200), 90.0)
    assert len(odd) == 75 and not odd.exact
    at = np.round(odd.seconds * walk.fps).astype(int)[::3]
    np.testing.assert_allclose(odd.motion.positions[::3], walk.motion.positions[at], atol=1e-5)


def test_points_are_chained_too(walk, tmp_path):
    take = keypoints(walk, 1.0, 120.0)
    told = mm.chain([(take, (0, 150)), (take, (200, 359))], gap=50, method="eased")
    assert np.array_equal(told.motion.positions[:150], take.motion.positions[:150])
    bones = (positional.bone_lengths(each.motion.positions[200:], BODY.parents)[:, 1:] for each in (told, take))
    np.testing.assert_allclose(*bones, atol=1e-5)
    again = mm.load(mm.save(told, tmp_path / "told.npz"))
    assert np.array_equal(again.motion.positions, told.motion.positions)


def test_each_gap_may_have_its_length(walk):
    told = mm.chain([(walk, (at, at + 60)) for at in (0, 100, 200)], gap=["0.25s", 50], method="linear")
    assert [(piece.start, piece.stop) for piece in told.report.pieces] == [(0, 60), (90, 150), (200, 260)]
    assert {(fill.start, fill.stop) for fill in told.report.fills} == {(60, 90), (150, 200)}


@pytest.mark.parametrize(
    ("clips", "options", "words"),
    [
        ([], {}, "no clip"),
        ([(0, 60)], {}, "one clip"),
        ([(0, 60), (400, 500)], {}, "walk.bvh.*no frame"),
        ([(0, 60), (100, 160)], {"gap": 0}, "a gap of 0 frames"),
        ([(0, 60), (100, 160)], {"gap": "5,6"}, "2 gaps for 2 clips"),
        ([(0, 60), (100, 160)], {"gap": "long"}, "a gap: .*long"),
        ([(0, 60), (100, 160)], {"method": "magic"}, "magic"),
        ([(0, 60), (100, 160)], {"fps": -1}, "frames per second"),
    ],
)
def test_what_cannot_be_chained_is_said(walk, clips, options, words):
    with pytest.raises(mm.InputError, match=words):
        mm.chain([(walk, frames) for frames in clips], **options)


def test_clips_that_cannot_be_chained_are_named(walk):
    points = keypoints(walk, 1.0, 120.0)
    with pytest.raises(mm.InputError, match=r"walk.bvh.*not those of keypoints.npz"):
        mm.chain([points, walk])
    skeleton = mm.Skeleton.cloud([f"M{number}" for number in range(8)])
    shaken = np.random.default_rng(0).normal(size=(50, 8, 3)).astype(np.float32)
    dots = mm.Motion(shaken, np.ones((50, 8), bool), 120.0, skeleton)
    nobody = Take(dots, None, None, points.units, "npz", "dots.npz")
    with pytest.raises(mm.InputError, match=r"dots.npz: no human body"):
        mm.chain([walk, nobody])
    with pytest.raises(mm.InputError, match=r"dots.npz: no human body"):
        mm.blend(walk, nobody, joints=ARM, frames=(3, 30), at=200)


# Commands


def test_both_commands_write_a_take_and_a_report(here, capsys):
    arm = ["--from", "walk.bvh", "--joints", ",".join(ARM), "--frames", "40:100", "--at", "200", "--method", "eased"]
    assert main(["blend", "walk.bvh", *arm, "-o", "arm.bvh"]) == 0
    assert "200:260" in capsys.readouterr().out
    clips = ["arm.bvh:0:150", "walk.bvh", "--gap", "0.5s", "--method", "eased"]
    assert main(["chain", *clips, "-o", "told.bvh", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(Path("told.bvh.report.json").read_text())
    assert len(mm.load("told.bvh")) == 150 + 60 + 359
    assert main(["chain", "arm.bvh", "walk.bvh", "-o", "told.bvh"]) == 1
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        ["chain", "walk.bvh", "-o", "out.bvh"],
        ["chain", "-o", "out.bvh"],
        ["chain", "walk.bvh", "nowhere.bvh", "-o", "out.bvh"],
        ["chain", "walk.bvh", "cut.bvh", "-o", "out.bvh"],
        ["chain", "walk.bvh", "walk.bvh", "--gap", "0", "-o", "out.bvh"],
        ["chain", "walk.bvh", "walk.bvh:500:600", "-o", "out.bvh"],
        ["chain", "walk.bvh", "walk.bvh", "-o", "out.amc"],
        ["chain", "walk.bvh", "walk.bvh", "-o", "walk.bvh", "--force"],
        ["chain", "walk.bvh", "walk.bvh", "-o", "nowhere/out.bvh"],
        [*BLEND, "cut.bvh", "--joints", "RightArm", "--frames", "1:9", "--at", "99"],
        [*BLEND, "walk.bvh", "--joints", "Arm", "--frames", "1:9", "--at", "99"],
        [*BLEND, "walk.bvh", "--joints", "RightArm", "--frames", "1:9", "--at", "9"],
    ],
    ids=" ".join,
)
def test_what_is_wrong_is_said_in_one_line(here, capsys, command):
    whole = Path("walk.bvh").read_text()
    Path("cut.bvh").write_text(whole[: whole.index("Frame Time")] + "Frame Time: 0.00833333\n")
    before = sorted(here.iterdir())
    assert main(command) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("motionmend: ") and said.err.count("\n") == 1
    assert sorted(here.iterdir()) == before
    assert Path("walk.bvh").read_text() == whole


IN_BLENDER = """
import json, sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_anim.bvh(filepath=sys.argv[1])
[body] = [each for each in bpy.data.objects if each.type == "ARMATURE"]
found = []
for frame in (0, 120, 249):
    bpy.context.scene.frame_set(frame + 1)
    places = {bone.name: (body.matrix_world @ bone.matrix).translation for bone in body.pose.bones}
    found.append({name: [p.x, p.z, -p.y] for name, p in places.items()})  # Blender is Z up
with open(sys.argv[2], "w") as file:
    json.dump(found, file)
"""


@pytest.mark.parametrize("what", ["chain", "blend", "animate"])
def test_blender_opens_what_was_made(walk, blended, tmp_path, what):
    python = os.environ.get("MOTIONMEND_BPY_PYTHON")
    if not python:
        pytest.skip("no Blender: MOTIONMEND_BPY_PYTHON does not name a Python that has bpy")
    if what == "animate":
        (told,) = mm.animate(walk, {"LeftHand": walk.motion.positions[60:310, 20]}, frame=60, network=follower())
    elif what == "chain":
        told = mm.chain([(walk, (0, 100)), (walk, (200, 300))], gap=50, method="eased")
    else:
        told = blended
    (tmp_path / "script.py").write_text(IN_BLENDER)
    mm.save(told, tmp_path / "told.bvh")
    command = [python, *(str(tmp_path / name) for name in ("script.py", "told.bvh", "out.json"))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for frame, places in zip((0, 120, 249), json.loads((tmp_path / "out.json").read_text()), strict=True):
        found = np.array([places[name] for name in told.skeleton.names]) * told.units.metres
        np.testing.assert_allclose(found, told.motion.positions[frame], atol=1e-3)
