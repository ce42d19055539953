"""Loaders of the data sets that may not be passed on, on made-up files of their layouts with known truth in them."""

from __future__ import annotations

import sys
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest

from motionmend.corpora.corpus import Dropped
from motionmend.corpora.datasets import amass, h36m, holden, lafan1
from motionmend.corpora.datasets.raw import Raw
from motionmend.errors import InputError


def write_bvh(path: Path, names, parents, offsets, roots, frame_time="0.033333") -> None:
    """A BVH of bones that never turn: a joint is where its root is, plus the offsets along its chain."""

    def lines(joint: int, indent: str):
        yield f"{indent}{'ROOT' if parents[joint] < 0 else 'JOINT'} {names[joint]}"
        yield indent + "{"
        yield f"{indent}  OFFSET {' '.join(f'{x:.6f}' for x in offsets[joint])}"
        shifts = "6 Xposition Yposition Zposition" if parents[joint] < 0 else "3"
        yield f"{indent}  CHANNELS {shifts} Zrotation Yrotation Xrotation"
        below = [child for child, parent in enumerate(parents) if parent == joint]
        for child in below:
            yield from lines(child, indent + "  ")
        if not below:
            yield from (f"{indent}  End Site", indent + "  {", f"{indent}    OFFSET 0 0 1", indent + "  }")
        yield indent + "}"

    text = ["HIERARCHY", *lines(0, ""), "MOTION", f"Frames: {len(roots)}", f"Frame Time: {frame_time}"]
    turns = " 0" * 3 * len(names)
    text += [" ".join(f"{x:.6f}" for x in root) + turns for root in roots]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(text) + "\n")


def chain_sums(parents, offsets) -> np.ndarray:
    """Each joint's offset from the root."""
    sums = np.zeros((len(parents), 3))
    for joint, parent in enumerate(parents):
        if parent >= 0:
            sums[joint] = sums[parent] + offsets[joint]
    return sums


def split_up(found) -> tuple[list[Raw], list[Dropped]]:
    found = list(found)
    return [each for each in found if isinstance(each, Raw)], [each for each in found if isinstance(each, Dropped)]


def silent(_: str) -> None:
    pass


# ── Human3.6M ───────────────────────────────────────────────────────────────────────────────────────────────────

H36M_NAMED = {"Hip": 0, "RHip": 1, "RFoot": 3, "LHip": 6, "LFoot": 8, "Spine": 12, "Head": 15, "LShoulder": 17,
              "LWrist": 19, "RShoulder": 25, "RWrist": 27}  # fmt: skip


def h36m_takes(frames: int = 4) -> dict[str, dict[str, np.ndarray]]:
    def take(number: int) -> np.ndarray:
        points = np.zeros((frames, 32, 3), np.float32)
        points[..., 0] = number  # x: which take
        points[..., 1] = np.arange(frames)[:, None] / 8  # y: the frame
        points[..., 2] = np.arange(32) / 16  # z, up: the joint
        return points

    return {
        "S9": {"Walking 1": take(2), "Walking": take(1)},
        "S1": {"Directions": take(0)},
        "S11": {"Photo": take(3)},
    }


def test_h36m(tmp_path):
    np.savez_compressed(tmp_path / "data_3d_h36m.npz", positions_3d=h36m_takes())
    raws, dropped = split_up(h36m.read(tmp_path, stage=silent))
    assert not dropped
    assert [(raw.name, raw.subject, raw.split) for raw in raws] == [
        ("S1_Directions", "S1", "train"), ("S9_Walking", "S9", "test"), ("S9_Walking_1", "S9", "test"),
        ("S11_Photo", "S11", "test"),
    ]  # fmt: skip
    for number, raw in enumerate(raws):
        motion = raw.motion
        assert motion.fps == 50 and motion.positions.shape == (4, 17, 3) and motion.observed.all()
        for name, joint in H36M_NAMED.items():
            # z up becomes y up: (x, y, z) → (x, z, −y).
            points = motion.positions[:, motion.skeleton.index(name)]
            want = np.stack([np.full(4, number), np.full(4, joint / 16), -np.arange(4) / 8], axis=-1)
            np.testing.assert_allclose(points, want, atol=1e-6)


STANDING = {  # a person of 1.7 m who faces −y, z up
    0: (0, 0, 0.93), 1: (-0.13, 0, 0.93), 2: (-0.13, 0, 0.48), 3: (-0.13, 0, 0.07), 6: (0.13, 0, 0.93),
    7: (0.13, 0, 0.48), 8: (0.13, 0, 0.07), 12: (0, 0, 1.16), 13: (0, 0, 1.42), 14: (0, -0.06, 1.52), 15: (0, 0, 1.64),
    17: (0.15, 0, 1.39), 18: (0.18, 0, 1.11), 19: (0.19, 0, 0.86), 25: (-0.15, 0, 1.39), 26: (-0.18, 0, 1.11),
    27: (-0.19, 0, 0.86),
}  # fmt: skip


def test_h36m_becomes_a_corpus(tmp_path):
    from motionmend.corpora.building import build

    take = np.zeros((100, 32, 3), np.float32)
    for joint, place in STANDING.items():
        take[:, joint] = place
    take[..., 1] -= np.arange(100)[:, None] / 50  # walks on at 1 m/s
    np.savez_compressed(tmp_path / "data_3d_h36m.npz", positions_3d={"S9": {"Walking": take}})
    corpus = build("h36m", tmp_path, tmp_path / "h36m.corpus", fps=50)
    (clip,) = corpus.clips
    assert not corpus.dropped and (clip.name, clip.split, clip.frames) == ("S9_Walking", "test", 100)
    motion = corpus.motion(clip)
    for name, place in {"hips": (0, 0.93, 1.98), "left_hand": (0.19, 0.86, 1.98)}.items():
        found = motion.positions[99, motion.skeleton.index(name)]
        np.testing.assert_allclose(found, [place[0], place[1] - clip.floor, place[2]], atol=2e-3)


def test_h36m_of_another_layout(tmp_path):
    path = tmp_path / "data_3d_h36m.npz"
    with pytest.raises(InputError, match="no such archive"):
        list(h36m.read(tmp_path, stage=silent))
    wrong = [
        ({"positions_2d": {"S1": {}}}, "2D keypoints"),
        ({"positions_3d": np.zeros((5, 32, 3))}, "no dict of subjects"),
        ({"positions_3d": {"S1": np.zeros((5, 32, 3))}}, "no dict of subjects"),
        ({"positions_3d": {"S1": {"Walking": np.zeros((5, 17, 3))}}}, r"\(frames, 32, 3\)"),
        ({"positions_3d": {"S1": {"Walking": "text"}}}, "a str where an array"),
    ]
    for arrays, message in wrong:
        np.savez(path, **arrays)  # type: ignore
        with pytest.raises(InputError, match=message):
            list(h36m.read(tmp_path, stage=silent))
    path.write_bytes(b"PK\x03\x04 cut off")
    with pytest.raises(InputError, match="cannot be read"):
        list(h36m.read(tmp_path, stage=silent))
    np.savez(path, positions_3d={"S1": {"Walking": np.zeros((0, 32, 3), np.float32)}, "S2": {}})  # type: ignore
    _, dropped = split_up(h36m.read(tmp_path, stage=silent))
    assert [each.file.split("/")[1] for each in dropped] == ["S2", "S1"]


# ── Holden et al. ───────────────────────────────────────────────────────────────────────────────────────────────


def exported(points: np.ndarray) -> np.ndarray:
    """Rows of 73 from `(frames, 21, 3)` world positions in units, step by step as the authors describe them.

    The facing here is a given smooth angle of each frame rather than one taken from hips and shoulders: how it was
    found does not matter to the way back.
    """
    from scipy.ndimage import gaussian_filter1d
    from scipy.spatial.transform import Rotation

    frames = len(points)
    root = gaussian_filter1d(points[:, 0] * [1, 0, 1], 3, axis=0, mode="nearest")
    to_front = [Rotation.from_euler("Y", 0.4 * np.sin(t / 20) + 0.02 * t) for t in range(frames)]
    rows = []
    for t in range(frames - 1):
        local = to_front[t].apply(np.vstack([root[t], points[t]]) - root[t])
        velocity = to_front[t + 1].apply(root[t + 1] - root[t])
        turn = (to_front[t + 1] * to_front[t].inv()).as_euler("YXZ")[0]
        rows.append(np.concatenate([local.ravel(), velocity[[0, 2]], [turn], [1, 0, 0, 1]]))
    return np.array(rows)


def walk(frames: int, seed: int = 0) -> np.ndarray:
    """`(frames, 21, 3)` points that wander over the floor in units of 6.25 cm."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / 30
    path = np.cumsum(rng.normal(0, 0.1, (frames, 1, 3)), axis=0) * [1, 0, 1] + [30, 15, -20]
    return path + rng.normal(0, 5, (21, 3)) + np.sin(time + rng.uniform(0, 6, (21, 3)))


def windows_of(rows: np.ndarray) -> list[np.ndarray]:
    """Windows of 240 every 120 rows; the short ones padded with still end poses."""
    windows = []
    for start in range(0, len(rows) - 30, 120):
        window = rows[start : start + 240]
        short = 240 - len(window)
        left, right = window[:1].repeat(short - short // 2, axis=0), window[-1:].repeat(short // 2, axis=0)
        left[:, 66:69] = right[:, 66:69] = 0
        windows.append(np.concatenate([left, window, right]))
    return windows


def from_first_frame(points: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """World points as the loader can know them: root of the first frame at the origin, its facing to the front."""
    first = rows[0, 3:66].reshape(21, 3)
    # The turn and shift on the floor that bring the first pose to the first row.
    a, b = points[0, :, ::2] - points[0, :, ::2].mean(0), first[:, ::2] - first[:, ::2].mean(0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    flat = (points[..., ::2] - points[0, :, ::2].mean(0)) @ turn.T + first[:, ::2].mean(0)
    return np.stack([flat[..., 0], points[..., 1], flat[..., 1]], axis=-1)


def test_holden_rows_become_the_world_again():
    points = walk(500)
    rows = exported(points)
    found = holden.world(rows)
    assert found.dtype == np.float32
    want = 0.0625 * from_first_frame(points, rows)[:-1]
    np.testing.assert_allclose(found, want, atol=2e-5)
    assert np.ptp(want[:, 0, 0]) > 0.2  # it did go somewhere


@pytest.mark.parametrize("frames", [240, 241, 300, 359, 360, 361, 391, 479, 480, 600, 700, 45, 239])
def test_holden_windows_are_joined(frames):
    takes = [exported(walk(frames + 1, seed)) for seed in (1, 2)]
    whole = holden.joined([window for rows in takes for window in windows_of(rows)])
    assert len(whole) == 2
    for found, rows in zip(whole, takes):
        # A remainder of at most 30 rows never came into a window.
        assert len(rows) - 30 <= len(found) <= len(rows)
        np.testing.assert_array_equal(found, rows[: len(found)])


def test_holden_npz(tmp_path):
    takes = {name: exported(walk(400, seed)) for seed, name in enumerate(("cmu", "mhad", "edin_kinect"))}
    for name, rows in takes.items():
        np.savez_compressed(tmp_path / f"data_{name}.npz", clips=np.array(windows_of(rows)), classes=np.zeros(3))
    raws, dropped = split_up(holden.read(tmp_path, stage=silent))
    assert [(raw.name, raw.split) for raw in raws] == [("cmu_0000", ""), ("mhad_0000", "")]
    assert [each.file for each in dropped] == ["data_edin_kinect.npz"]
    assert raws[0].motion.fps == 60 and raws[0].floor == 0
    np.testing.assert_allclose(raws[0].motion.positions, holden.world(takes["cmu"]), atol=1e-6)
    heights = 0.0625 * walk(400, 0)[:-1, :, 1]
    np.testing.assert_allclose(raws[0].motion.positions[..., 1], heights, atol=1e-5)


def test_holden_as_kaufmann_prepares_it(tmp_path):
    rows = exported(walk(400))
    ragged = np.empty(2, object)
    ragged[:] = [rows, rows[:100]]
    for folder, clips in (("raw", ragged), ("train", np.array(windows_of(rows))), ("valid", rows[None, :240])):
        (tmp_path / folder).mkdir()
        np.savez_compressed(tmp_path / folder / "data_hdm05.npz", clips=clips)
    raws, _ = split_up(holden.read(tmp_path, stage=silent))
    assert [(raw.name, raw.split, len(raw.motion)) for raw in raws] == [
        ("hdm05_train_0000", "train", 399), ("hdm05_validation_0000", "validation", 240),
    ]  # fmt: skip
    raws, _ = split_up(holden.read(tmp_path / "raw", stage=silent))
    assert [len(raw.motion) for raw in raws] == [399, 100]


HOLDEN_31 = (
    "Hips", "LHipJoint", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase", "RHipJoint", "RightUpLeg",
    "RightLeg", "RightFoot", "RightToeBase", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head",
    "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand", "LeftFingerBase", "LeftHandIndex1", "LThumb",
    "RightShoulder", "RightArm", "RightForeArm", "RightHand", "RightFingerBase", "RightHandIndex1", "RThumb",
)  # fmt: skip
HOLDEN_PARENTS = [-1, 0, 1, 2, 3, 4, 0, 6, 7, 8, 9, 0, 11, 12, 13, 14, 15, 13, 17, 18, 19, 20, 21, 20, 13, 24, 25, 26,
                  27, 28, 27]  # fmt: skip
HOLDEN_KEPT = [0, 2, 3, 4, 5, 7, 8, 9, 10, 12, 13, 15, 16, 18, 19, 20, 22, 25, 26, 27, 29]


def test_holden_bvh(tmp_path):
    offsets = np.random.default_rng(0).normal(0, 3, (31, 3)).round(3)
    roots = np.array([[0, 16, 0], [0.5, 16, 1], [1, 16, 2.5]])
    processed = tmp_path / "data" / "processed"
    write_bvh(processed / "cmu" / "05_02.bvh", HOLDEN_31, HOLDEN_PARENTS, offsets, roots, "0.041667")  # a lie
    write_bvh(processed / "cmu" / "rest.bvh", HOLDEN_31, HOLDEN_PARENTS, offsets, roots[:1])
    write_bvh(processed / "edin_misc" / "odd.bvh", HOLDEN_31[:6], HOLDEN_PARENTS[:6], offsets, roots)
    write_bvh(processed / "edin_terrain" / "hill.bvh", HOLDEN_31, HOLDEN_PARENTS, offsets, roots)
    raws, dropped = split_up(holden.read(tmp_path, stage=silent))
    assert [(raw.name, raw.file, raw.subject) for raw in raws] == [
        ("cmu_05_02", "data/processed/cmu/05_02.bvh", "cmu_05")
    ]
    assert {Path(each.file).name for each in dropped} == {"rest.bvh", "odd.bvh", "edin_terrain"}
    motion = raws[0].motion
    assert motion.fps == 120
    want = 0.0625 * (roots[:, None] + chain_sums(HOLDEN_PARENTS, offsets)[HOLDEN_KEPT])
    np.testing.assert_allclose(motion.positions, want, atol=1e-5)


def test_holden_of_another_layout(tmp_path):
    with pytest.raises(InputError, match="no take"):
        list(holden.read(tmp_path, stage=silent))
    for clips, message in (
        (np.zeros((3, 240, 69)), r"clips of float64 \(240, 69\)"),
        (np.zeros((240, 73)), "clips of"),
        (np.zeros((1, 240, 73), int), "clips of int"),
    ):
        np.savez(tmp_path / "data_cmu.npz", clips=clips)
        with pytest.raises(InputError, match=message):
            list(holden.read(tmp_path, stage=silent))
    np.savez(tmp_path / "data_cmu.npz", windows=np.zeros(3))
    with pytest.raises(InputError, match="it holds windows"):
        list(holden.read(tmp_path, stage=silent))


# ── LaFAN1 ──────────────────────────────────────────────────────────────────────────────────────────────────────

LAFAN1_PARENTS = [-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 12, 11, 14, 15, 16, 11, 18, 19, 20]


def lafan1_folder(folder: Path) -> np.ndarray:
    """Two whole takes and two odd ones; the positions in metres of the first."""
    offsets = np.random.default_rng(1).normal(0, 20, (22, 3)).round(3)
    roots = np.array([[0, 90, 0], [10, 91, -5], [20, 92, -10.0]])
    names = lafan1.JOINTS
    write_bvh(folder / "walk1_subject5.bvh", names, LAFAN1_PARENTS, offsets, roots)
    write_bvh(folder / "aiming1_subject1.bvh", names, LAFAN1_PARENTS, offsets, roots)
    write_bvh(folder / "dance1_subject2.bvh", names[:14], LAFAN1_PARENTS[:14], offsets, roots)
    write_bvh(folder / "run1_subject3.bvh", names, LAFAN1_PARENTS, offsets, roots, "0.016667")
    (folder / "license.txt").write_text("no take")
    return 0.01 * (roots[:, None] + chain_sums(LAFAN1_PARENTS, offsets))


@pytest.mark.parametrize("zipped", [False, True], ids=["folder", "zip"])
def test_lafan1(tmp_path, zipped):
    want = lafan1_folder(tmp_path / "unpacked")
    source = tmp_path / "unpacked"
    if zipped:
        source = tmp_path / "zipped"
        source.mkdir()
        with zipfile.ZipFile(source / "lafan1.zip", "w", zipfile.ZIP_DEFLATED) as file:
            for path in (tmp_path / "unpacked").iterdir():
                file.write(path, f"lafan1/../../{path.name}")  # a name that would leave the folder
    raws, dropped = split_up(lafan1.read(source, stage=silent))
    assert [(raw.name, raw.subject, raw.split) for raw in raws] == [
        ("aiming1_subject1", "subject1", "train"), ("walk1_subject5", "subject5", "test"),
    ]  # fmt: skip
    assert [Path(each.file).name for each in dropped] == ["dance1_subject2.bvh", "run1_subject3.bvh"]
    assert "14 joints" in dropped[0].reason and "22" in dropped[0].reason and "60 fps" in dropped[1].reason
    assert raws[1].file == ("lafan1.zip/walk1_subject5.bvh" if zipped else "walk1_subject5.bvh")
    motion = raws[1].motion
    assert motion.fps == 30
    np.testing.assert_allclose(motion.positions, want, atol=1e-5)


def test_lafan1_of_another_layout(tmp_path):
    with pytest.raises(InputError, match="no take"):
        list(lafan1.read(tmp_path, stage=silent))
    (tmp_path / "lafan1.zip").write_text("version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(InputError, match="git lfs pull"):
        list(lafan1.read(tmp_path, stage=silent))
    with zipfile.ZipFile(tmp_path / "lafan1.zip", "w") as file:
        file.writestr("notes.txt", "")
    with pytest.raises(InputError, match="no take in the archive"):
        list(lafan1.read(tmp_path, stage=silent))


# ── AMASS ───────────────────────────────────────────────────────────────────────────────────────────────────────

MADE: list[tuple] = []


def fake_smplx():
    """A body model whose joint j is at trans + (j, sum of betas, first body angle): x, y, z with z up."""
    torch = pytest.importorskip("torch")
    module = types.ModuleType("smplx")

    def create(folder, model_type, gender, num_betas, **options):
        MADE.append((Path(folder).name, model_type, gender, num_betas, tuple(sorted(options))))

        def model(global_orient, body_pose, transl, betas, **rest):
            frames = len(transl)
            assert global_orient.shape == (frames, 3) and betas.shape == (frames, num_betas)
            assert body_pose.shape == (frames, 69 if model_type == "smpl" else 63)
            assert all(len(part) == frames and not part.any() for part in rest.values())
            wanted = {"smpl": 0, "smplh": 2, "smplx": 6}
            assert len(rest) == wanted[model_type]
            joints = torch.zeros(frames, 60, 3)
            joints[..., 0] = torch.arange(60)
            joints[..., 1] = betas.sum(1, keepdim=True)
            joints[..., 2] = body_pose[:, :1]
            return types.SimpleNamespace(joints=joints + transl[:, None])

        return model

    module.create = create  # type: ignore
    return module


@pytest.fixture
def smplx(monkeypatch):
    MADE.clear()
    monkeypatch.setitem(sys.modules, "smplx", fake_smplx())


def save_take(path: Path, *, frames=300, fps=120.0, width=156, gender: object = "male", key="mocap_framerate", **more):
    rng = np.random.default_rng(len(path.name))
    poses, trans = rng.normal(size=(frames, width)), rng.normal(size=(frames, 3))
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {key: np.array(fps), "poses": poses, "trans": trans, "betas": np.full(16, 0.125)}
    np.savez(path, **(arrays | {"gender": np.array(gender), "dmpls": np.zeros((frames, 8))} | more))
    return poses, trans


def models(source: Path) -> None:
    for name in ("smplh/SMPLH_MALE.npz", "smplh/SMPLH_FEMALE.pkl", "smplx/SMPLX_NEUTRAL.npz", "smpl/SMPL_MALE.pkl"):
        path = source / "body_models" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_amass(tmp_path, smplx):
    models(tmp_path)
    poses, trans = save_take(tmp_path / "CMU" / "05" / "05_02_poses.npz")
    save_take(tmp_path / "SSM_synced" / "x" / "a_poses.npz", fps=60.0, gender=b"female", frames=5)
    smplx_take = tmp_path / "HDM05" / "bd" / "b_stageii.npz"
    save_take(smplx_take, width=165, gender="neutral", key="mocap_frame_rate", frames=2)
    save_take(tmp_path / "GRAB" / "s1" / "c_poses.npz", width=72, frames=3)
    save_take(tmp_path / "KIT" / "3" / "d_poses.npz", fps=100.0)
    save_take(tmp_path / "CMU" / "05" / "e_poses.npz", trans=np.zeros((7, 3)))
    save_take(tmp_path / "CMU" / "05" / "f_poses.npz", gender="neutral")
    np.savez(tmp_path / "CMU" / "05" / "shape.npz", betas=np.zeros(16))
    raws, dropped = split_up(amass.read(tmp_path, stage=silent))
    assert [(raw.name, raw.subject, raw.split, raw.motion.fps, len(raw.motion)) for raw in raws] == [
        ("CMU_05_05_02", "CMU_05", "train", 120, 300),
        ("GRAB_s1_c", "GRAB_s1", "", 120, 3),
        ("HDM05_bd_b", "HDM05_bd", "validation", 120, 2),
        ("SSM_synced_x_a", "SSM_synced_x", "test", 60, 5),
    ]
    reasons = {Path(each.file).name: each.reason for each in dropped}
    assert set(reasons) == {"d_poses.npz", "e_poses.npz", "f_poses.npz"}
    assert "100 fps" in reasons["d_poses.npz"] and "(7, 3)" in reasons["e_poses.npz"]
    assert "SMPLH_NEUTRAL" in reasons["f_poses.npz"]
    # One model for each kind, gender and number of shapes; hands without principal components.
    assert ("body_models", "smplh", "male", 16, ("ext", "use_pca")) in MADE and len(MADE) == len(set(MADE)) == 4
    motion = raws[0].motion
    assert motion.positions.shape == (300, 22, 3) and motion.observed.all()
    for joint in (0, 1, 15, 21):
        x, y, z = trans[:, 0] + joint, trans[:, 1] + 2, trans[:, 2] + poses[:, 3]
        np.testing.assert_allclose(motion.positions[:, joint], np.stack([x, z, -y], -1), atol=1e-5)


def test_amass_maps_to_every_joint_of_body():
    from motionmend.body.mapping import map_rig

    mapping = map_rig(amass.SKELETON)
    assert len(mapping.found) == 21 and mapping.unmapped == ("spine2",)


def test_amass_of_another_layout(tmp_path, smplx, monkeypatch):
    with pytest.raises(InputError, match="no take"):
        list(amass.read(tmp_path, stage=silent))
    save_take(tmp_path / "CMU" / "05" / "05_02_poses.npz", frames=3)
    with pytest.raises(InputError, match="no body models"):
        list(amass.read(tmp_path, stage=silent))
    models(tmp_path)
    for wrong in ({"poses": np.zeros((3, 90))}, {"betas": np.zeros((2, 16))}, {"gender": np.array(3)}):
        save_take(tmp_path / "CMU" / "05" / "05_02_poses.npz", frames=3, **wrong)
        raws, dropped = split_up(amass.read(tmp_path, stage=silent))
        assert not raws and len(dropped) == 1
    monkeypatch.setitem(sys.modules, "smplx", None)
    with pytest.raises(InputError, match="needs the package smplx"):
        list(amass.read(tmp_path, stage=silent))
