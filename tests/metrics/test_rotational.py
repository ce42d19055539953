"""LaFAN1's measures against slow twins, hand-made cases, and its protocol on a made-up archive of takes."""

from __future__ import annotations

import cmath
import math
import zipfile

import numpy as np
import pytest

from motionmend import io, rotations
from motionmend.benchmark import lafan1
from motionmend.benchmark.method import Method
from motionmend.errors import InputError
from motionmend.fills.channels import fill_rig
from motionmend.metrics import rotational
from motionmend.motion import Rig
from motionmend.progress import silent


def slow_npss(truth, guess):
    """One sequence and one dimension at a time, the Fourier sums written out."""

    def spectrum(values):
        count = len(values)
        turns = [[cmath.exp(-2j * math.pi * k * n / count) for n in range(count)] for k in range(count)]
        return [sum(value * turn for value, turn in zip(values, row)).real ** 2 for row in turns]

    total = weights = 0.0
    for one, other in zip(truth, guess):
        for dimension in range(one.shape[1]):
            p, q = spectrum(one[:, dimension]), spectrum(other[:, dimension])
            distance, run_p, run_q = 0.0, 0.0, 0.0
            for a, b in zip(p, q):
                run_p, run_q = run_p + a / sum(p), run_q + b / sum(q)
                distance += abs(run_p - run_q)
            total, weights = total + distance * sum(p), weights + sum(p)
    return total / weights


def test_npss_is_its_definition():
    rng = np.random.default_rng(0)
    truth, guess = rng.normal(size=(2, 3, 7, 5))
    assert rotational.npss(truth, guess) == pytest.approx(slow_npss(truth, guess))
    assert rotational.npss(truth, truth) == 0
    # What is measured is the spectrum's shape: neither sign nor size of the guess matter.
    assert rotational.npss(truth, -3 * guess) == pytest.approx(rotational.npss(truth, guess))


def test_npss_by_hand():
    # Four frames: all power in frequency 0 against all in frequency 2: cumulated 1 1 1 1 and 0 0 1 1, two apart.
    still, flicker = np.ones((1, 4, 1)), np.array([1.0, -1, 1, -1])[None, :, None]
    assert rotational.npss(still, flicker) == pytest.approx(2)
    # Beside it a dimension of half the size, a quarter of the power, that was guessed right.
    truth = np.concatenate([still, still / 2], axis=2)
    guess = np.concatenate([flicker, still / 2], axis=2)
    assert rotational.npss(truth, guess) == pytest.approx(2 * 4 / 5)


def test_npss_of_nothing():
    one, nothing = np.ones((1, 4, 1)), np.zeros((1, 4, 1))
    assert math.isnan(rotational.npss(nothing, one))
    assert rotational.npss(one, nothing) == pytest.approx(4)
    both = np.concatenate([one, nothing], axis=2)
    assert rotational.npss(both, np.ones((1, 4, 2))) == pytest.approx(0)


def test_npss_of_blocks_is_that_of_the_whole():
    truth, guess = np.random.default_rng(1).normal(size=(2, 6, 5, 3))
    terms = [rotational.npss_terms(truth[rows], guess[rows]) for rows in (slice(2), slice(2, 6))]
    distance, power = (np.concatenate(parts) for parts in zip(*terms))
    assert rotational.npss_mean(distance, power) == pytest.approx(rotational.npss(truth, guess))


def test_l2p_and_l2q_are_their_definitions():
    rng = np.random.default_rng(2)
    places, guessed = rng.normal(size=(2, 3, 5, 4, 3))
    mean, std = rng.normal(size=(4, 3)), rng.random((4, 3)) + 0.5
    turns, guessed_turns = rotations.normalised(rng.normal(size=(2, 3, 5, 4, 4)))
    found_p, found_q = rotational.l2p(places, guessed, std), rotational.l2q(turns, guessed_turns)
    for window in range(3):
        p = q = 0.0
        for frame in range(5):
            apart = (places[window, frame] - mean) / std - (guessed[window, frame] - mean) / std
            p += math.sqrt(sum(float(x) ** 2 for x in apart.ravel())) / 5
            apart = turns[window, frame] - guessed_turns[window, frame]
            q += math.sqrt(sum(float(x) ** 2 for x in apart.ravel())) / 5
        assert found_p[window] == pytest.approx(p) and found_q[window] == pytest.approx(q)


def test_l2q_and_l2p_by_hand():
    # Of 22 joints four are turned by 180 degrees: each is sqrt(2) off, together sqrt(8), not a mean over joints.
    turns = np.tile(rotations.IDENTITY, (1, 3, 22, 1))
    guess = turns.copy()
    guess[:, :, :4] = [0, 1, 0, 0]
    assert rotational.l2q(turns, guess)[0] == pytest.approx(math.sqrt(8))
    assert rotational.l2q(turns, -turns)[0] == pytest.approx(2 * math.sqrt(22))  # signs matter
    places = np.zeros((1, 1, 22, 3))
    assert rotational.l2p(places, places + 0.1, np.full((22, 3), 0.2))[0] == pytest.approx(0.5 * math.sqrt(66))


# --- the protocol

# The names and the tree of LaFAN1's 22 joints.
JOINTS = [
    "Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToe", "RightUpLeg", "RightLeg", "RightFoot", "RightToe",
    "Spine", "Spine1", "Spine2", "Neck", "Head", "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand",
    "RightShoulder", "RightArm", "RightForeArm", "RightHand",
]  # fmt: skip
PARENTS = [-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 12, 11, 14, 15, 16, 11, 18, 19, 20]
OFFSETS = np.random.default_rng(7).normal(size=(22, 3)).round(3) * 20


def bvh(seed, frames, fps=30, still=False, joints=22):
    """The text of a take: ZYX turns, centimetres, positions at the root only."""
    rng = np.random.default_rng(seed)
    lines = ["HIERARCHY"]

    def joint(at, depth):
        pad, kind = "\t" * depth, "ROOT" if at == 0 else "JOINT"
        channels = "6 Xposition Yposition Zposition" if at == 0 else "3"
        lines.extend([f"{pad}{kind} {JOINTS[at]}", pad + "{", f"{pad}\tOFFSET {' '.join(map(str, OFFSETS[at]))}"])
        lines.append(f"{pad}\tCHANNELS {channels} Zrotation Yrotation Xrotation")
        below = [child for child in range(joints) if PARENTS[child] == at]
        for child in below:
            joint(child, depth + 1)
        if not below:
            lines.extend([f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\tOFFSET 0 1 0", pad + "\t}"])
        lines.append(pad + "}")

    joint(0, 0)
    lines.extend(["MOTION", f"Frames: {frames}", f"Frame Time: {1 / fps:.6f}"])
    clock = np.arange(frames)[:, None] / fps
    values = 40 * np.sin(clock * rng.uniform(1, 3, 3 + 3 * joints) + rng.uniform(0, 6, 3 + 3 * joints))
    values[:, :3] += clock * [60, 0, 30] + [0, 90, 0]
    if still:
        values[:] = values[0]
    lines.extend(" ".join(f"{value:.4f}" for value in row) for row in values)
    return "\n".join(lines) + "\n"


TAKES = {
    "walk1_subject1.bvh": (1, 95),
    "dance2_subject3.bvh": (2, 71),
    "run1_subject5.bvh": (3, 150),
    "walk1_subject5.bvh": (4, 66),
    "notes_subject9.bvh": (5, 66),
}


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    path = tmp_path_factory.mktemp("lafan1") / "lafan1.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, (seed, frames) in TAKES.items():
            file.writestr(name, bvh(seed, frames))
        file.writestr("__MACOSX/._walk1_subject5.bvh", "not a take")
        file.writestr("read_me.txt", "nothing")
    return path


@pytest.fixture(scope="module")
def folder(archive, tmp_path_factory):
    path = tmp_path_factory.mktemp("lafan1") / "BVH"
    with zipfile.ZipFile(archive) as file:
        file.extractall(path)
    return path


def slerp(p, q, t):
    """Shoemake's formula on two lists of four."""
    dot = sum(a * b for a, b in zip(p, q))
    if dot < 0:
        q, dot = [-b for b in q], -dot
    angle = math.acos(min(dot, 1.0))
    if angle < 1e-9:
        return list(p)
    return [(math.sin((1 - t) * angle) * a + math.sin(t * angle) * b) / math.sin(angle) for a, b in zip(p, q)]


def slow_windows(folder, names, length, stride):
    """Each window's world quaternions and positions as lists of frames, and its local turns and root: the long way."""
    found = []
    for name in sorted(names):
        rig = io.load(folder / name, unit="cm", up="y").rig
        assert rig is not None
        turns = rig.rotations.copy()
        for frame in range(1, len(turns)):
            for joint in range(22):
                if turns[frame, joint] @ turns[frame - 1, joint] < 0:
                    turns[frame, joint] *= -1
        start = 0
        while start + length < len(turns):
            local, root = turns[start : start + length].copy(), rig.translations[start : start + length, 0].copy()
            root[:, 0] -= sum(root[:, 0]) / length
            root[:, 2] -= sum(root[:, 2]) / length
            forward = rotations.apply(local[9, 0], np.array([0.0, 1, 0]))
            angle = math.atan2(-forward[2], forward[0])  # about y, from x to where the root's Y axis points
            back = rotations.from_axis("y", np.array(-angle))
            local[:, 0] = rotations.multiply(back, local[:, 0])
            root = rotations.apply(back, root)
            found.append((local, root))
            start += stride
    return found


def world(local, root):
    """Quaternions and positions of one pose, joint by joint."""
    turns, places = [], []
    for joint, parent in enumerate(PARENTS):
        if parent < 0:
            turns.append(local[joint])
            places.append(root)
        else:
            turns.append(rotations.multiply(turns[parent], local[joint]))
            places.append(places[parent] + rotations.apply(turns[parent], OFFSETS[joint] / 100))
    return np.array(turns), np.array(places)


def slow_protocol(test, mean, std, missing):
    rows = {"zero-velocity": [], "interpolation": []}
    for local, root in test:
        for name, found in rows.items():
            frames = []
            for frame in range(10, 10 + missing):
                t = (frame - 9) / (missing + 1) if name == "interpolation" else 0
                guess = np.array([slerp(a, b, t) for a, b in zip(local[9].tolist(), local[10 + missing].tolist())])
                place = (1 - t) * root[9] + t * root[10 + missing]
                frames.append((world(local[frame], root[frame]), world(guess, place)))
            found.append(frames)
    out = {}
    for name, found in rows.items():
        q = [[np.linalg.norm(a[0] - b[0]) for a, b in window] for window in found]
        p = [[np.linalg.norm((a[1] - mean) / std - (b[1] - mean) / std) for a, b in window] for window in found]
        truth, guess = (np.array([[pair[side][0].ravel() for pair in w] for w in found]) for side in (0, 1))
        out[name] = {"L2Q": np.mean(q), "L2P": np.mean(p), "NPSS": slow_npss(truth, guess)}
    return out


def test_the_protocol_is_what_the_public_evaluation_does(archive, folder):
    cells = lafan1.measure(archive, "test", [], lengths=(5, 15))
    found = {(cell.setting, cell.method, cell.metric): cell.value for cell in cells}
    assert len(found) == len(cells) == 2 * 2 * 3
    train = slow_windows(folder, [name for name in TAKES if "subject1" in name or "subject3" in name], 50, 20)
    test = slow_windows(folder, [name for name in TAKES if "subject5" in name], 65, 40)
    places = np.array([world(q, x)[1] for local, root in train for q, x in zip(local, root)])
    for missing in (5, 15):
        for method, expected in slow_protocol(test, places.mean(axis=0), places.std(axis=0), missing).items():
            for metric, value in expected.items():
                got = found[f"{missing} frames", method, metric]
                assert got == pytest.approx(value, rel=1e-6), (missing, method, metric)


def test_a_folder_gives_the_same_and_limit_takes_fewer(archive, folder):
    assert lafan1.measure(folder, "test", [], lengths=(5,)) == lafan1.measure(archive, "test", [], lengths=(5,))
    _, every = lafan1._read(archive, (5,), None, silent)
    _, some = lafan1._read(archive, (5,), 2, silent)
    assert len(every) == 3 + 1 and len(some) == 2  # a window needs a frame more than it has, as published
    np.testing.assert_array_equal(some.rotations, every.rotations[[0, 3]])


def test_windows_are_centred_and_face_x(archive):
    _, windows = lafan1._read(archive, (5,), None, silent)
    places, turns = windows.world()
    np.testing.assert_allclose(places[:, :, 0, [0, 2]].mean(axis=1), 0, atol=1e-9)
    facing = rotations.apply(turns[:, 9, 0], np.array([0.0, 1, 0]))
    assert (facing[:, 0] > 0).all()
    np.testing.assert_allclose(facing[:, 2], 0, atol=1e-9)


def test_rig_fills_of_many_windows_are_those_of_each(archive):
    _, windows = lafan1._read(archive, (5,), None, silent)
    windows = windows[:, :26]
    for name in ("linear", "hermite", "cubic", "rigid"):
        together = lafan1.rig_fill(name)(windows)
        assert together.rotations.shape == (4, 15, 22, 4)
        for at in range(4):
            known = np.ones((26, 22), bool)
            known[10:25] = False
            one = windows[at]
            rig = Rig(
                one.skeleton, one.rotations, one.translations, known, OFFSETS / 100, np.arange(22) == 0, ("ZYX",) * 22
            )
            alone = fill_rig(rig, 30.0, name)[0]
            dots = np.abs(np.sum(alone.rotations[10:25] * together.rotations[at], axis=-1))
            np.testing.assert_allclose(dots, 1, atol=1e-9)
            np.testing.assert_allclose(together.translations[at], alone.translations[10:25], atol=1e-9)
        run = np.concatenate([windows.rotations[:, 9:10], together.rotations], axis=1)
        assert (np.sum(run[:, 1:] * run[:, :-1], axis=-1) > 0).all()  # no flips


def test_no_way_reads_what_is_missing(archive):
    _, windows = lafan1._read(archive, (5,), None, silent)
    windows = windows[:, :21]
    broken = lafan1.Windows(windows.skeleton, windows.rotations.copy(), windows.translations.copy())
    broken.rotations[:, 10:20] = np.nan
    broken.translations[:, 10:20] = np.nan
    for way in (lafan1.zero_velocity, lafan1.interpolation, lafan1.rig_fill("hermite")):
        one, other = way(windows), way(broken)
        np.testing.assert_array_equal(one.rotations, other.rotations)
        np.testing.assert_array_equal(one.translations, other.translations)
        assert np.isfinite(one.rotations).all() and np.isfinite(one.translations).all()


def test_rows_are_the_baselines_and_the_methods_that_turn_rigs(archive):
    cells = lafan1.measure(archive, "test", [Method("hermite"), Method("nearest")], lengths=(5,), limit=2)
    assert [cell.method for cell in cells if cell.metric == "L2Q"] == ["zero-velocity", "interpolation", "hermite"]
    assert {(cell.metric, cell.unit) for cell in cells} == {("L2Q", ""), ("L2P", ""), ("NPSS", "")}
    values = {(cell.method, cell.metric): cell.value for cell in cells}
    for metric in ("L2Q", "L2P"):  # on smooth motion the fill that knows velocities wins
        assert values["hermite", metric] < values["interpolation", metric] < values["zero-velocity", metric]


@pytest.mark.parametrize(
    ("takes", "message"),
    [
        ({"run1_subject5.bvh": bvh(0, 80)}, "too few takes"),
        ({"run1_subject5.bvh": bvh(0, 60), "run1_subject1.bvh": bvh(0, 80)}, "too few takes"),
        ({"run1_subject1.bvh": bvh(0, 80, fps=60)}, "60 fps"),
        ({"run1_subject1.bvh": bvh(0, 80), "run1_subject2.bvh": bvh(0, 80, joints=14)}, "another skeleton"),
        ({"run1_subject1.bvh": bvh(0, 80, still=True), "run1_subject5.bvh": bvh(0, 80)}, "do not move"),
    ],
)
def test_what_is_not_lafan1_is_refused(takes, message, tmp_path):
    for name, text in takes.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        lafan1.measure(tmp_path, "test", [])


def test_wrong_sources_splits_and_lengths_are_refused(archive, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        lafan1.measure(tmp_path / "lafan1.zip", "test", [])
    broken = tmp_path / "broken.zip"
    broken.write_bytes(archive.read_bytes()[:5000])
    with pytest.raises(InputError, match="archive cannot be read"):
        lafan1.measure(broken, "test", [])
    with pytest.raises(InputError, match="no split 'validation'"):
        lafan1.measure(archive, "validation", [])
    with pytest.raises(ValueError, match="1 to 54"):
        lafan1.measure(archive, "test", [], lengths=(55,))
