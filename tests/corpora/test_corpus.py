"""Corpora: what is written comes back, windows are what a slow loop cuts, a build keeps, trims and drops rightly."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import json
import pickle
import re
import shutil

import numpy as np
import pytest

from motionmend.body.joints import BODY, JOINT
from motionmend.cli.main import main
from motionmend.constraints.ground import ground
from motionmend.corpora.building import build, read_splits
from motionmend.corpora.corpus import ClipInfo, Corpus, Dropped
from motionmend.corpora.datasets import cmu as cmu_reader
from motionmend.corpora.datasets.reading import asf_of, t_pose
from motionmend.corpora.poses import draw_sheet
from motionmend.corpora.writing import write_corpus
from motionmend.errors import InputError
from motionmend.motion import Motion

# A person of 1.7 m who stands, in metres: height and, to the left, across.
STANDING = {
    "hips": (0.95, 0), "spine": (1.05, 0), "chest": (1.2, 0), "neck": (1.45, 0), "head": (1.55, 0),
    "shoulder": (1.42, 0.03), "upper_arm": (1.40, 0.18), "forearm": (1.12, 0.2), "hand": (0.88, 0.22),
    "thigh": (0.9, 0.1), "shin": (0.5, 0.1), "foot": (0.08, 0.1), "toe": (0.03, 0.1),
}  # fmt: skip
FORWARD = {"toe": 0.13, "forearm": -0.02, "shin": 0.03}


def pose(arms="down"):
    """`(21, 3)` of that person, who faces z."""
    points = np.zeros((len(BODY), 3))
    for name, joint in JOINT.items():
        side, _, part = name.partition("_")
        sign = {"left": 1, "right": -1}.get(side, 0)
        height, across = STANDING[part if sign else name]
        if arms == "out" and part in ("forearm", "hand"):
            height, across = 1.40, {"forearm": 0.46, "hand": 0.7}[part]
        points[joint] = sign * across, height, FORWARD.get(part, 0) if arms == "down" else 0
    return points


def person(frames=90, fps=60.0, seed=0, floor=0.0):
    """The person sways: each joint by up to 2 cm, smoothly, round a body that drifts by half a metre a second."""
    rng = np.random.default_rng(seed)
    clock = np.arange(frames)[:, None, None] / fps
    phases, rates = rng.uniform(0, 6, (1, len(BODY), 3)), rng.uniform(1, 4, (1, len(BODY), 3))
    sway = 0.02 * np.sin(phases + rates * clock)
    sway[:, [joint for name, joint in JOINT.items() if name.endswith(("foot", "toe"))], 1] = 0
    positions = pose() + sway + clock * [0.5, 0, 0] + [0, floor, 0]
    return Motion(positions.astype(np.float32), np.ones((frames, len(BODY)), bool), fps, BODY)


def save(path, motion, **more):
    """As an NPZ file that the readers know."""
    path.parent.mkdir(parents=True, exist_ok=True)
    positions = np.where(motion.observed[..., None], motion.positions, np.nan)
    names, parents = motion.skeleton.names, motion.skeleton.parents
    arrays = {"positions": positions, "fps": motion.fps, "names": names, "parents": parents, "unit": "m", "up": "y"}
    np.savez(path, **(arrays | more))


def with_holes(motion, seed, share=0.1):
    observed = np.random.default_rng(seed).random(motion.observed.shape) >= share
    return Motion(motion.positions, observed, motion.fps, motion.skeleton)


def written(path, clips, **more):
    kept = {"name": "made up", "fps": 60.0, "skeleton": BODY, "licence": "CC0-1.0", "credit": "nobody"}
    return write_corpus(path, clips=clips, **(kept | more))


@pytest.fixture
def small(tmp_path):
    """Three clips of 40, 55 and 9 frames, the first two of train."""
    clips = []
    for number, (frames, split) in enumerate([(40, "train"), (55, "train"), (9, "test")]):
        clips.append((ClipInfo(f"clip{number}", split=split), with_holes(person(frames, seed=number), number, 0.004)))
    return written(tmp_path / "small.corpus", clips)


def bytes_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


# What is written comes back -------------------------------------------------------------------------------


def test_round_trip(tmp_path):
    motions = [with_holes(person(50, seed=seed), seed) for seed in range(3)]
    motions[1].observed[7] = False
    known = "ab" * 32, "s", "train", 120.0, "rig", "MIT", -0.25, ("note",)
    infos = [ClipInfo(f"c{number}", f"a/c{number}.bvh", *known) for number in range(3)]
    dropped = [Dropped("bad.bvh", "it is empty")]
    written(tmp_path / "a.corpus", zip(infos, motions), dropped=dropped)
    corpus = Corpus.open(tmp_path / "a.corpus")
    assert (corpus.name, corpus.fps, corpus.dtype, corpus.licence, corpus.credit) == (
        "made up", 60.0, "float32", "CC0-1.0", "nobody",
    )  # fmt: skip
    assert corpus.skeleton == BODY and corpus.dropped == tuple(dropped) and len(corpus) == 150
    for number, (clip, info, motion) in enumerate(zip(corpus.clips, infos, motions)):
        assert (clip.start, clip.frames) == (50 * number, 50)
        assert all(getattr(clip, name) == value for name, value in vars(info).items())
        back = corpus.motion(clip)
        np.testing.assert_array_equal(back.observed, motion.observed)
        assert back.positions.dtype == np.float32 and np.isnan(back.positions[~back.observed]).all()
        # Two roundings, of an offset below 2 m and of a position below 4 m, each to half a unit in the 24th bit.
        error = np.abs(back.positions.astype(float) - motion.positions)[back.observed]
        assert error.max() <= 2**-24 + 2**-23
    assert corpus.damaged() == ""
    assert pickle.loads(pickle.dumps(corpus)).clips == corpus.clips


def test_float16_is_good_to_half_a_millimetre_far_from_the_origin(tmp_path):
    motion = person(60)
    far = Motion(motion.positions + np.float32([30, 0, -40]), motion.observed, motion.fps, BODY)
    corpus = written(tmp_path / "h.corpus", [(ClipInfo("far"), far)], dtype="float16")
    # Joints are within 2 m of the hips, where float16 has 10 bits behind the point; below 1 m it has 11.
    error = np.abs(corpus.motion(corpus.clips[0]).positions.astype(float) - far.positions)
    assert error.max() <= 2**-11 + 2**-18
    near = np.abs(far.positions - far.positions[:, :1]) < 0.99
    assert error[near].max() <= 2**-12 + 2**-18
    assert corpus.offsets.dtype == np.float16


def test_windows_and_starts_are_what_a_slow_loop_finds(small):
    motions = [small.motion(clip) for clip in small.clips]
    for length, stride, whole, pad in [
        (10, 3, False, False), (10, 3, True, False), (12, 5, True, True), (9, 9, False, True), (48, 4, False, True),
        (60, 7, False, True), (1, 1, True, False),
    ]:  # fmt: skip
        for split in ("train", "test", "validation"):
            expected, cuts = [], []
            for clip, motion in zip(small.clips, motions):
                if clip.split != split:
                    continue
                first = 0
                while first + length <= clip.frames or (pad and first == 0):
                    seen = motion.observed[first : first + length]
                    if not whole or seen.all():  # every joint is observed somewhere in these clips
                        expected.append(clip.start + first)
                        cuts.append([min(first + step, clip.frames - 1) for step in range(length)])
                    first += stride
            starts = small.starts(split, length, stride, whole=whole, pad=pad)
            assert starts.tolist() == expected
            positions, observed = small.windows(starts, length)
            assert positions.shape == (len(starts), length, len(BODY), 3) and observed.shape == positions.shape[:3]
            for row, (start, frames) in enumerate(zip(expected, cuts)):
                owner = next(i for i, clip in enumerate(small.clips) if clip.start <= start < clip.start + clip.frames)
                np.testing.assert_array_equal(positions[row], motions[owner].positions[frames])
                np.testing.assert_array_equal(observed[row], motions[owner].observed[frames])


def test_whole_windows_do_not_ask_for_joints_that_the_clip_never_has(tmp_path):
    motion = person(30)
    motion.observed[:, JOINT["left_toe"]] = False
    motion.observed[12, JOINT["head"]] = False
    corpus = written(tmp_path / "t.corpus", [(ClipInfo("a", split="train"), motion)])
    assert corpus.starts("train", 10, 1, whole=True).tolist() == [0, 1, 2, *range(13, 21)]


def test_windows_begin_in_a_clip(small):
    for start in (-1, len(small)):
        with pytest.raises(IndexError):
            small.windows(np.array([0, start]), 5)


def test_origins_fall_back_on_what_is_observed(tmp_path):
    motion = person(4)
    motion.observed[1, 0] = False
    motion.observed[2] = False
    corpus = written(tmp_path / "o.corpus", [(ClipInfo("a"), motion)])
    expected = [motion.positions[0, 0], motion.positions[1, 1:].mean(axis=0), np.zeros(3)]
    np.testing.assert_allclose(corpus.origins[:3], expected, atol=0.5 / 1024 + 1e-6)
    assert not corpus.motion(corpus.clips[0]).observed[2].any()


# What is no corpus ----------------------------------------------------------------------------------------


def test_nothing_but_a_corpus_is_ever_replaced(tmp_path, small):
    clips = [(ClipInfo("new"), person(20))]
    with pytest.raises(InputError, match="--force"):
        written(small.path, clips)
    assert written(small.path, clips, force=True).clips[0].name == "new"
    (small.path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        written(small.path, clips, force=True)
    other = tmp_path / "precious"
    other.mkdir()
    for target in (other, tmp_path / "file"):
        if target != other:
            target.write_text("mine")
        with pytest.raises(InputError, match="not a corpus"):
            written(target, clips, force=True)
        assert target.exists()
    with pytest.raises(InputError, match="no such folder"):
        written(tmp_path / "nowhere" / "a.corpus", clips)
    assert {path.name for path in tmp_path.iterdir()} == {"small.corpus", "precious", "file"}


def test_a_failed_write_leaves_nothing_and_keeps_the_old(tmp_path, small):
    def breaks():
        yield ClipInfo("a"), person(20)
        raise InputError("the disk sulks")

    before = bytes_of(small.path)
    with pytest.raises(InputError, match="sulks"):
        written(small.path, breaks(), force=True)
    with pytest.raises(InputError, match="no clip"):
        written(tmp_path / "none.corpus", [])
    with pytest.raises(InputError, match="two clips"):
        written(tmp_path / "twice.corpus", [(ClipInfo("a"), person(9)), (ClipInfo("a"), person(9))])
    assert bytes_of(small.path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["small.corpus"]


@pytest.mark.parametrize("name", ["origins.npy", "offsets.npy", "observed.npy", "corpus.json"])
def test_truncated_and_missing_files_are_named(small, name):
    path = small.path / name
    content = path.read_bytes()
    for cut in (len(content) - 40, 100, 0):
        path.write_bytes(content[:cut])
        with pytest.raises(InputError, match=re.escape(name)):
            Corpus.open(small.path)
    path.unlink()
    with pytest.raises(InputError, match=re.escape(name)):
        Corpus.open(small.path)


def test_foreign_and_altered_tables(small):
    path = small.path / "corpus.json"
    table = json.loads(path.read_text())
    for change, found in [
        ({"version": 2}, "version 2"), ({"clips": []}, "follow"), ({"dtype": "float16"}, "offsets"),
        ({"clips": table["clips"][:2]}, "origins"), ({"skeleton": {"names": ["a"], "parents": [-1]}}, "offsets"),
        ({"clips": [{"name": "x"}]}, "damaged"), ({"fps": "?"}, "damaged"),
    ]:  # fmt: skip
        path.write_text(json.dumps(table | change))
        with pytest.raises(InputError, match=found):
            Corpus.open(small.path)
    path.write_text("[1, 2]")
    with pytest.raises(InputError, match="not the table"):
        Corpus.open(small.path)
    for place, found in [(small.path.parent, "no corpus.json"), (path, "not a corpus"), (small.path / "no", "no such")]:
        with pytest.raises(InputError, match=found):
            Corpus.open(place)


def test_a_flipped_bit_shows_in_the_data_hash(small):
    path = small.path / "offsets.npy"
    content = bytearray(path.read_bytes())
    content[-1000] ^= 1
    path.write_bytes(content)
    assert "data hash" in Corpus.open(small.path).damaged()
    assert main(["data", "show", str(small.path)]) == 1


def test_a_damaged_head_of_an_array_is_named(small):
    path = small.path / "origins.npy"
    content = path.read_bytes()
    for place in range(128):
        path.write_bytes(content[:place] + bytes([content[place] ^ 2]) + content[place + 1 :])
        with contextlib.suppress(InputError):
            Corpus.open(small.path)
    path.write_bytes(content.replace(b"}", b" ", 1))
    with pytest.raises(InputError, match=r"origins\.npy"):
        Corpus.open(small.path)


def test_names_that_are_not_utf8_come_back(tmp_path):
    name = b"l\xfcft".decode(errors="surrogateescape")
    corpus = written(tmp_path / "x.corpus", [(ClipInfo(name, f"{name}.bvh"), person())])
    assert (corpus.clips[0].name, corpus.damaged()) == (name, "")
    draw_sheet(corpus, tmp_path / "x.png")


# Building -------------------------------------------------------------------------------------------------


@pytest.fixture
def raw(tmp_path):
    """A folder of takes: two good ones, and one each of what cannot be a clip."""
    folder = tmp_path / "raw"
    save(folder / "a" / "walk.npz", person(121, fps=120.0, seed=1))
    save(folder / "b" / "walk.npz", person(40, fps=30.0, seed=2))
    save(folder / "short.npz", person(8))
    prop = Motion(person(60).positions[:, :3], np.ones((60, 3), bool), 60.0, type(BODY).cloud(["p1", "p2", "p3"]))
    save(folder / "prop.npz", prop)
    save(folder / "giant.npz", person(60), positions=person(60).positions * 4)
    (folder / "broken.bvh").write_text("HIERARCHY\nROOT")
    (folder / "LICENSE.txt").write_text("as you like")
    return folder


def test_build_of_a_folder(raw, tmp_path):
    corpus = build("folder", raw, tmp_path / "x.corpus", fps=60)
    assert [clip.name for clip in corpus.clips] == ["a/walk", "b/walk"]
    assert [clip.file_fps for clip in corpus.clips] == [120, 30]
    assert [clip.frames for clip in corpus.clips] == [61, 79]
    # Half the rate is every other frame; double the rate keeps every frame that there was.
    first, second = (corpus.motion(clip).positions for clip in corpus.clips)
    np.testing.assert_allclose(first, person(121, 120.0, 1).positions[::2], atol=1e-6)
    np.testing.assert_allclose(second[::2], person(40, 30.0, 2).positions, atol=1e-6)
    assert corpus.clips[0].sha256 == hashlib.sha256((raw / "a" / "walk.npz").read_bytes()).hexdigest()
    reasons = {each.file: each.reason for each in corpus.dropped}
    assert set(reasons) == {"short.npz", "prop.npz", "giant.npz", "broken.bvh"}
    assert "too short" in reasons["short.npz"] and "m tall" in reasons["giant.npz"]
    assert "person" in reasons["prop.npz"] and reasons["broken.bvh"].startswith("line 2:")
    assert str(tmp_path) not in (corpus.path / "corpus.json").read_text()


def test_two_builds_are_byte_identical(raw, tmp_path):
    first = build("folder", raw, tmp_path / "x.corpus", fps=50, dtype="float16")
    moved = shutil.copytree(raw, tmp_path / "elsewhere" / "raw")
    second = build("folder", moved, tmp_path / "y.corpus", fps=50, dtype="float16")
    assert bytes_of(first.path) == bytes_of(second.path)
    names = {"corpus.json", "origins.npy", "offsets.npy", "observed.npy", "contacts.npy"}
    assert set(bytes_of(first.path)) == names


def test_a_local_corpus_knows_neither_where_bodies_are_nor_how_they_face(tmp_path):
    """One take as it is and one turned and led round a circle are the same poses; hips stay, all face +z."""
    still = person(120, seed=3)
    inside = still.positions - np.arange(120)[:, None, None] / 60 * np.array([0.5, 0, 0])
    angle = 0.6 + np.arange(120)[:, None] / 60
    x, y, z = np.moveaxis(inside, -1, 0)
    around = np.stack([x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)], axis=-1)
    around += np.stack([4 * np.sin(angle / 2), 0 * angle, 4 * np.cos(angle / 2)], axis=-1)
    for name, positions in (("a", inside), ("b", around)):
        save(tmp_path / "raw" / f"{name}.npz", still, positions=positions.astype(np.float32))
    corpus = build("folder", tmp_path / "raw", tmp_path / "x.corpus", local=True)
    assert corpus.name == "raw-local" and len(corpus.clips) == 2
    assert corpus.contacts is None  # in the body's own eyes it is the ground that moves
    one, other = (corpus.motion(clip).positions for clip in corpus.clips)
    # Twenty frames of smoothing lag behind at the ends of a turn of a radian a second.
    np.testing.assert_allclose(one[60:-60], other[60:-60], atol=0.02)
    assert np.abs(one - other).max() < 0.25 < 4
    for poses in (one, other):
        assert np.abs(poses[:, 0, [0, 2]]).max() < 0.05 and abs(np.median(poses[:, 0, 1]) - 0.95) < 0.03
        across = poses[:, JOINT["left_thigh"]] - poses[:, JOINT["right_thigh"]]
        assert (across[:, 0] > 0.9 * np.linalg.norm(across[:, [0, 2]], axis=1)).all()
    plain = build("folder", tmp_path / "raw", tmp_path / "y.corpus")
    assert np.abs(np.diff([plain.motion(clip).positions for clip in plain.clips], axis=0)).max() > 3
    with pytest.raises(InputError, match="BODY's joints"):
        build("folder", tmp_path / "raw", tmp_path / "z.corpus", local=True, native=True)


def test_splits_rates_and_subjects_from_a_table(raw, tmp_path):
    table = raw / "splits.csv"  # beside the takes, where it must not be taken for one
    rows = ["file,split,fps,subject,remark", "a/walk.npz,test,60,,x", "gone.npz,train,,,", "b/walk.npz,train,,ann,"]
    table.write_text("\r\n".join(rows), encoding="utf-8-sig")
    corpus = build("folder", raw, tmp_path / "x.corpus", splits=table)
    said = [(clip.split, clip.subject, clip.file_fps) for clip in corpus.clips]
    assert said == [("test", "", 60), ("train", "ann", 30)]
    assert [clip.frames for clip in corpus.clips] == [121, 79]
    assert [clip.name for clip in corpus.in_split("test")] == ["a/walk"]
    dropped = {each.file for each in corpus.dropped}
    assert "gone.npz" in dropped and "splits.csv" not in dropped


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("name,split\na,train", "no column file"),
        ("file,split\na,train\nb,dev", r"t\.csv:3: a split named 'dev'"),
        ("file,split\na,train\na,test", r"t\.csv:3: a is listed twice"),
        ("file,split,fps\na,train,fast", r"t\.csv:2: a rate of 'fast'"),
        ("file,split,fps\na,train,0", "rate"),
        ("", "no column file"),
    ],
)
def test_bad_tables_of_splits(tmp_path, text, found):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=found):
        read_splits(tmp_path / "t.csv")


def test_a_t_pose_is_cut_off_at_both_ends(tmp_path):
    motion = person(90)
    out = pose("out")
    blend = np.clip(np.concatenate([(np.arange(30) - 9) / 20, np.ones(40), (80 - np.arange(20) - 70) / 14]), 0, 1)
    blend = (3 * blend**2 - 2 * blend**3)[:, None, None]
    positions = (blend * motion.positions + (1 - blend) * out).astype(np.float32)
    planted = t_pose(Motion(positions, motion.observed, 60.0, BODY))
    assert planted[:10].all() and planted[80:].all() and not planted[30:70].any()
    save(tmp_path / "raw" / "t.npz", Motion(positions, motion.observed, 60.0, BODY))
    corpus = build("folder", tmp_path / "raw", tmp_path / "x.corpus")
    (clip,) = corpus.clips
    start = np.flatnonzero(~planted)[0]
    assert clip.frames == (~planted).sum() and 10 <= start < 20
    np.testing.assert_allclose(corpus.motion(clip).positions, positions[~planted], atol=1e-6)
    assert any("T-pose cut off" in note for note in clip.notes)


def test_t_pose_needs_arms_and_legs():
    bent = pose("out")
    bent[JOINT["left_hand"]] += [-0.2, 0.25, 0]
    sitting = pose("out")
    sitting[[JOINT["left_foot"], JOINT["right_foot"]]] += [0, 0.3, 0.3]
    poses = np.array([pose("out"), pose(), bent, sitting, pose("out")], np.float32)
    observed = np.ones(poses.shape[:2], bool)
    observed[4, JOINT["right_hand"]] = False
    assert t_pose(Motion(poses, observed, 60.0, BODY)).tolist() == [True, False, False, False, False]


def test_the_ground_is_where_feet_stand():
    assert ground(person()) == pytest.approx(0, abs=0.01)
    assert ground(person(floor=-0.7)) == pytest.approx(-0.7, abs=0.01)
    ankles = person(floor=0.4)
    ankles.observed[:, [JOINT["left_toe"], JOINT["right_toe"]]] = False
    assert ground(ankles) == pytest.approx(0.4, abs=0.02)
    ankles.observed[:, JOINT["left_shin"] :] = False
    ankles.observed[0, JOINT["left_hand"]] = True
    assert np.isfinite(ground(ankles))


@pytest.mark.parametrize(("planted", "kept"), [(0.1, 0.0), (-0.9, -0.9)])
def test_a_files_own_floor_is_kept_unless_the_feet_are_far_from_it(tmp_path, planted, kept):
    save(tmp_path / "raw" / "t.npz", person(floor=planted))
    corpus = build("folder", tmp_path / "raw", tmp_path / "x.corpus")
    assert corpus.clips[0].floor == pytest.approx(kept, abs=0.01)
    lowest = np.nanmin(corpus.motion(corpus.clips[0]).positions[..., 1])
    assert lowest == pytest.approx(0.03 + planted - kept, abs=0.01)


def test_what_is_untrusted_is_unobserved(tmp_path):
    motion = with_holes(person(120), seed=4, share=0.01)
    motion.positions[60, JOINT["left_hand"]] += 0.4  # a jump, out and back
    motion.observed[50:70, JOINT["left_hand"]] = True
    save(tmp_path / "raw" / "t.npz", motion)
    corpus = build("folder", tmp_path / "raw", tmp_path / "x.corpus")
    observed = corpus.motion(corpus.clips[0]).observed
    assert not observed[60, JOINT["left_hand"]] and not observed[~motion.observed].any()
    assert (observed != motion.observed).sum() <= 3
    assert any("untrusted" in note for note in corpus.clips[0].notes)


def test_native_keeps_the_joints_and_drops_other_skeletons(tmp_path):
    motion = person(60)
    names = (*BODY.names, "prop")
    skeleton = type(BODY)(names, (*BODY.parents, -1))
    positions = np.concatenate([motion.positions, motion.positions[:, -1:] + np.float32(0.1)], axis=1)
    save(tmp_path / "raw" / "a.npz", Motion(positions, np.ones((60, 22), bool), 60.0, skeleton))
    save(tmp_path / "raw" / "b.npz", motion)
    corpus = build("folder", tmp_path / "raw", tmp_path / "x.corpus", native=True)
    assert corpus.skeleton.names == names and [clip.name for clip in corpus.clips] == ["a"]
    np.testing.assert_allclose(corpus.motion(corpus.clips[0]).positions, positions, atol=1e-6)
    assert corpus.dropped[0].file == "b.npz" and "21 joints" in corpus.dropped[0].reason


def test_build_refuses_before_it_works(raw, tmp_path):
    target = tmp_path / "x.corpus"
    for found, dataset, source, more in [
        ("no data set", "cnu", raw, {}),
        ("rate of 0", "folder", raw, {"fps": 0}),
        ("rate of nan", "folder", raw, {"fps": float("nan")}),
        ("no such folder", "folder", tmp_path / "none", {}),
        ("a file", "folder", raw / "broken.bvh", {}),
        ("no take", "folder", raw.parent / "empty", {}),
        ("no AMC or BVH", "cmu", raw.parent / "empty", {}),
        ("no take", "reactidle", raw, {}),
        ("no clip", "bandai", raw, {}),
        ("dtype", "folder", raw, {"dtype": "int8"}),
    ]:
        (tmp_path / "empty").mkdir(exist_ok=True)
        with pytest.raises(InputError, match=found):
            build(dataset, source, target, **more)
        assert not target.exists()
    (tmp_path / "dangling").symlink_to("nowhere")
    with pytest.raises(InputError, match="exists already"):
        build("folder", raw, tmp_path / "dangling")
    with pytest.raises(InputError, match=r"no clip to write.*b\.npz \(0\.08 s"):
        save(tmp_path / "bad" / "b.npz", person(5))
        build("folder", tmp_path / "bad", target)


def test_every_dropped_file_has_a_reason_that_helps(tmp_path):
    """No file name said twice, no option that `data build` lacks, and one bad file does not stop the others."""
    raw = tmp_path / "raw"
    raw.mkdir()
    save(raw / "good.npz", person())
    save(raw / "slow.npz", person(40, fps=5.0))
    save(raw / "x.y.npz", person(seed=1))
    shutil.copy(raw / "x.y.npz", raw / "x.npz")
    shutil.copy(raw / "x.y.npz", raw / "x.npz.npz")  # the stem of this one is the name of the one before
    (raw / "x.bvh").write_text("HIERARCHY\nROOT")
    (raw / "alone.amc").write_text(":FULLY-SPECIFIED\n")
    (raw / "rate.bvh").write_text(
        "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n"
        "End Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 2\nFrame Time: 0\n0 0 0\n0 0 0\n"
    )
    corpus = build("folder", raw, tmp_path / "x.corpus")
    reasons = {each.file: each.reason for each in corpus.dropped}
    assert {clip.file for clip in corpus.clips} | set(reasons) == {path.name for path in raw.iterdir()}
    for file, reason in reasons.items():
        assert not reason.startswith(file) and str(tmp_path) not in reason and "--fps" not in reason, reason
    assert "5 fps are too few" in reasons["slow.npz"] and "--splits" in reasons["slow.npz"]
    assert "beside it, with the same name" in reasons["alone.amc"] and "--asf" not in reasons["alone.amc"]
    assert reasons["rate.bvh"].startswith("line 13: ") and "--splits" in reasons["rate.bvh"]
    assert "of the same name" in reasons["x.npz.npz"]


def test_an_amc_takes_the_skeleton_of_its_own_name(tmp_path):
    for name in ("walk.asf", "WALK_01.ASF", "other.asf"):
        (tmp_path / name).touch()
    assert asf_of(tmp_path / "walk_01.amc") == tmp_path / "WALK_01.ASF"
    assert asf_of(tmp_path / "Walk_02.amc") == tmp_path / "walk.asf"
    assert asf_of(tmp_path / "run.amc") is None


@pytest.mark.parametrize("table", [b"file,subject,split,fps\n\xff", b"file,subject\na,b"], ids=["bytes", "columns"])
def test_a_bad_cmu_csv_is_named(tmp_path, table):
    (tmp_path / "01").mkdir()
    (tmp_path / "01" / "01_01.amc").touch()
    (tmp_path / "cmu.csv").write_bytes(table)
    with pytest.raises(InputError, match=r"cmu\.csv.*not a table of trials"):
        build("cmu", tmp_path, tmp_path / "x.corpus")


def test_a_cmu_file_that_cannot_be_opened_is_dropped(tmp_path, monkeypatch):
    def refused(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(cmu_reader, "_source", refused)
    (tmp_path / "01_01.amc").write_text("x")
    (found,) = cmu_reader.read(tmp_path)
    assert found == Dropped("01_01.amc", "Permission denied")


def test_one_trial_in_two_files_is_one_clip(cmu, tmp_path):
    chosen(cmu, tmp_path, "16/16_11.amc")
    (tmp_path / "cmu.csv").unlink()
    shutil.copytree(tmp_path / "cmu" / "16", tmp_path / "cmu" / "again")
    corpus = build("cmu", tmp_path, tmp_path / "x.corpus")
    assert [clip.file for clip in corpus.clips] == ["16/16_11.amc"]
    assert [each.file for each in corpus.dropped] == ["again/16_11.amc"]


def test_commands(raw, tmp_path, capsys):
    target, sheet = tmp_path / "x.corpus", tmp_path / "poses.png"
    assert main(["data", "build", "folder", "--source", str(raw), "-o", str(target)]) == 0
    said = capsys.readouterr().out
    assert "2 clips" in said and "broken.bvh: line " in said
    assert main(["data", "build", "folder", "--source", str(raw), "-o", str(target)]) == 1
    assert "--force" in capsys.readouterr().err
    assert main(["data", "list", str(tmp_path)]) == 0
    assert str(target) in capsys.readouterr().out
    assert main(["data", "show", str(target), "--sheet", str(sheet)]) == 0
    said = capsys.readouterr().out
    for word in ("2 clips", "never observed: none", "short.npz: 0.13 s are too short", "unknown", "arrays have it"):
        assert word in said
    from matplotlib.image import imread

    pixels = imread(sheet)[..., :3].reshape(-1, 3)
    for colour in ("#2a9d8f", "#e4572e"):  # left and right limbs
        wanted = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        assert (np.abs(pixels - wanted).max(axis=1) < 0.02).sum() > 100
    assert main(["data", "show", str(target), "--sheet", str(sheet)]) == 1
    assert main(["data", "show", str(raw)]) == 1
    (target / "offsets.npy").write_bytes(b"")
    assert main(["data", "list", str(tmp_path)]) == 1
    assert "offsets.npy" in capsys.readouterr().err


# Real captures --------------------------------------------------------------------------------------------


def chosen(cmu, folder, *files):
    """Some real trials in the layout of the database, with a table of them."""
    with (folder / "cmu.csv").open("w", newline="") as table:
        writer = csv.writer(table)
        writer.writerow(["trial", "file", "subject", "split", "fps"])
        for file in files:
            subject, _, name = file.partition("/")
            place = folder / "cmu" / subject
            place.mkdir(parents=True, exist_ok=True)
            shutil.copy(cmu / file, place)
            for skeleton in (cmu / subject).glob("*.asf"):
                shutil.copy(skeleton, place)
            writer.writerow([name[:-4], file, subject, "validation" if subject == "16" else "train", 120])


def legs(corpus, clip):
    positions = corpus.motion(clip).positions
    thigh, shin, foot = (positions[0, JOINT[f"left_{part}"]] for part in ("thigh", "shin", "foot"))
    return np.linalg.norm(shin - thigh) + np.linalg.norm(foot - shin)


def test_some_of_cmu(cmu, tmp_path):
    chosen(cmu, tmp_path, "131/131_02.bvh", "131/131_03.bvh", "131/131_12.amc", "07/07_01.bvh", "07/07_12.bvh",
           "35/35_01.bvh", "16/16_11.amc")  # fmt: skip
    # The same trial with bones a tenth longer: what a wrong unit looks like.
    text = (tmp_path / "cmu" / "131" / "131_02.bvh").read_text()
    numbers = re.compile(r"(OFFSET\s+)(\S+) (\S+) (\S+)")
    longer = numbers.sub(lambda m: m[1] + " ".join(str(1.1 * float(m[axis])) for axis in (2, 3, 4)), text)
    (tmp_path / "cmu" / "131" / "131_02.bvh").write_text(longer)
    (tmp_path / "cmu" / "131" / "131_99.bvh").write_text(text)
    corpus = build("cmu", tmp_path, tmp_path / "x.corpus")
    clips = {clip.name: clip for clip in corpus.clips}
    assert set(clips) == {"131_03", "131_12", "07_01", "35_01", "16_11"}
    reasons = {each.file: each.reason for each in corpus.dropped}
    assert "legs of" in reasons["131/131_02.bvh"] and "07/07_12.bvh" in reasons
    assert reasons["131/131_99.bvh"] == "not listed in cmu.csv"
    # AMC and BVH with 31 joints: the same person has the same legs, and the ground is y = 0.
    assert legs(corpus, clips["131_03"]) == pytest.approx(legs(corpus, clips["131_12"]), rel=0.005)
    assert clips["131_03"].floor == clips["131_12"].floor == clips["35_01"].floor == 0
    assert clips["16_11"].split == "validation" and clips["131_12"].subject == "131"
    # What the conversions put before the capture is gone, 8 frames of 317 and 1 of 359; the rest begins without a jump.
    assert clips["07_01"].frames == (317 - 8 + 1) // 2 and clips["35_01"].frames == (359 - 1) // 2
    for clip in corpus.clips:
        steps = np.linalg.norm(np.diff(corpus.motion(clip).positions, axis=0), axis=-1)
        assert np.nanmax(steps[:10]) < 1.5 * np.nanmax(steps[10:])
        motion = corpus.motion(clip)
        lowest = np.where(motion.observed, motion.positions[..., 1], np.inf).min(axis=1)
        assert -0.05 < np.percentile(lowest, 5) < 0.09
    assert not corpus.motion(clips["07_01"]).observed[:, JOINT["left_toe"]].any()
    asf = (cmu / "16" / "16.asf").read_bytes()
    assert clips["16_11"].sha256 == hashlib.sha256((cmu / "16" / "16_11.amc").read_bytes() + asf).hexdigest()
    assert "mocap.cs.cmu.edu" in corpus.credit


def test_cmu_without_its_table(cmu, tmp_path):
    chosen(cmu, tmp_path, "35/35_01.bvh", "49/49_01.amc")
    (tmp_path / "cmu.csv").unlink()
    corpus = build("cmu", tmp_path / "cmu", tmp_path / "x.corpus", fps=30)
    assert [(clip.name, clip.split) for clip in corpus.clips] == [("35_01", "train"), ("49_01", "test")]
    assert all("want of cmu.csv" in clip.notes[0] for clip in corpus.clips)
    assert corpus.fps == 30 and corpus.clips[0].frames == -(-358 // 4)


def test_some_of_reactidle(reactidle, tmp_path):
    place = tmp_path / "genuine"
    place.mkdir()
    (tmp_path / "acted").mkdir()
    shutil.copy(reactidle / "genuine" / "003_genuine.bvh", place)
    corpus = build("reactidle", tmp_path, tmp_path / "x.corpus", fps=24, dtype="float16")
    (clip,) = corpus.clips
    assert (clip.frames, clip.split, clip.licence) == (918, "train", "MIT")
    observed = corpus.motion(clip).observed
    lacking = {name for name, joint in JOINT.items() if not observed[:, joint].any()}
    assert lacking == {"spine", "left_hand", "right_hand", "left_toe", "right_toe"}
    # Ankles stand 0.08 legs, 5 cm, over the ground.
    ankles = corpus.motion(clip).positions[:, [JOINT["left_foot"], JOINT["right_foot"]], 1]
    assert np.median(ankles.min(axis=1)) == pytest.approx(0.055, abs=0.02)


@pytest.mark.slow
def test_all_of_cmu(cmu, tmp_path):
    table = cmu.parent / "cmu.csv"
    if not table.exists():
        from captures import PACKS

        shutil.copy(PACKS / "cmu.csv", table)
    corpus = build("cmu", cmu, tmp_path / "x.corpus")
    for split, minutes in (("train", 47.2), ("validation", 4.3), ("test", 11.7)):
        assert round(sum(clip.frames for clip in corpus.in_split(split)) / 3600, 1) == minutes
    assert len(corpus.clips) == 371 and [each.file for each in corpus.dropped] == ["07/07_12.bvh"]
    lengths = [legs(corpus, clip) for clip in corpus.clips]
    assert np.nanmin(lengths) > 0.75 and np.nanmax(lengths) < 0.95


def test_contacts_are_kept_and_follow_from_the_positions(tmp_path, small):
    stands = small.contacts
    assert stands is not None and stands.shape == (len(small), 4) and set(np.unique(stands)) <= {-1, 0, 1}
    (small.path / "contacts.npy").unlink()
    older = Corpus.open(small.path)
    assert older.contacts is None and not older.damaged()
