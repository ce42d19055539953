"""ConvAE's protocol: planted corpora with answers known by hand, the paper's two ways to compare, slow twins."""

from __future__ import annotations

import numpy as np
import pytest

from motionmend.benchmark import convae
from motionmend.benchmark.method import Method
from motionmend.benchmark.methods import find, find_all
from motionmend.benchmark.results import TRUTH
from motionmend.body.joints import BODY, JOINT
from motionmend.corpora.corpus import ClipInfo
from motionmend.corpora.writing import write_corpus
from motionmend.errors import InputError
from motionmend.motion import Motion, Skeleton
from motionmend.networks.rows import body_local

STANDING = np.zeros((21, 3))
for _name, _joint in JOINT.items():
    _side = 1 if _name.startswith("left") else -1 if _name.startswith("right") else 0
    _part = _name.split("_", 1)[-1]
    _x = {"shoulder": 0.05, "upper_arm": 0.2, "forearm": 0.3, "hand": 0.4}.get(_part, 0.1)
    _y = {"hips": 1, "spine": 1.1, "chest": 1.3, "neck": 1.45, "head": 1.6, "shoulder": 1.4, "upper_arm": 1.4,
          "forearm": 1.2, "hand": 1.0, "thigh": 0.95, "shin": 0.5, "foot": 0.1, "toe": 0.05}[_part]  # fmt: skip
    STANDING[_joint] = _side * _x, _y, 0.15 * (_part == "toe")


def turned(positions, angle):
    """Positions turned about the up axis, from +z towards +x; angles `(frames,)` or one."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([x * cos + z * sin, y + 0 * x, z * cos - x * sin], axis=-1)


def corpus_of(path, *clips, skeleton=BODY, fps=60.0):
    def motion(positions):
        positions = np.asarray(positions, np.float32)
        return Motion(positions, np.isfinite(positions).all(axis=-1), fps, skeleton)

    named = [(ClipInfo(f"c{n}", split="validation"), motion(clip)) for n, clip in enumerate(clips)]
    return write_corpus(path / "toy.corpus", name="toy", fps=fps, skeleton=skeleton, clips=named)


def lively(frames, seed=0):
    """Somebody who walks a curve, each joint swaying by itself."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / 60
    sway = 0.1 * np.sin(2 * np.pi * (rng.uniform(0.3, 1.5, (1, 21, 3)) * t + rng.random((1, 21, 3))))
    path = np.stack([np.sin(t[:, 0, 0]), 0 * t[:, 0, 0], 1.2 * t[:, 0, 0]], axis=-1)
    return turned(STANDING + sway, 0.7 * t[:, :, 0]) + path[:, None]


def measured(corpus, found, *tasks, seed=0):
    """The cells of some tasks only."""
    cells = []
    for trial in (trial for trial in convae.trials(corpus, "validation", seed) if trial.task in tasks):
        for name, tally in convae.measure_trial(trial, corpus, found, seed).items():
            cells += tally.cells(trial, name)
    return cells


def values(cells, metric, task=None):
    found = {}
    for cell in cells:
        if cell.metric == metric and (task is None or cell.task == task):
            found[cell.method, cell.setting] = cell.value
    return found


def test_a_straight_walk_is_linear_to_the_bit_and_held_by_zero_velocity(tmp_path):
    speed = 0.02  # metres a frame
    walk = STANDING + np.arange(350)[:, None, None] * np.array([0, 0, speed])
    corpus = corpus_of(tmp_path, walk)
    found = find_all(["linear", "hermite", "zero-velocity"])
    cells = convae.measure(corpus, "validation", found)
    bones = [cell.task in convae.BONE_TASKS.values() for cell in cells]
    assert any(bones) and bones == sorted(bones)  # after the errors
    world = values(cells, convae.WORLD, "infilling")
    for gap in (0, 60, 120):
        assert world["linear", f"{gap} frames"] == pytest.approx(0, abs=1e-3)
        # Held for n frames, it is 1, 2, … n steps behind.
        behind = 100 * speed * (gap + 1) / 2 if gap else 0
        assert world["zero-velocity", f"{gap} frames"] == pytest.approx(behind, abs=1e-2)
    swept = values(cells, convae.WORLD, "gap length")
    for gap in convae.SWEPT_GAPS:
        assert swept["zero-velocity", f"{gap} frames"] == pytest.approx(100 * speed * (gap + 1) / 2, rel=1e-3)
    assert {setting for _, setting in values(cells, convae.WORLD, "context")} == {
        "1 frame", "5 frames", "10 frames", "25 frames", "50 frames"
    }  # fmt: skip
    # A pose that only stands still where it should go on has the right shape: body-local its smoothing alone errs.
    local = values(cells, convae.BODY_LOCAL, "infilling")
    assert local["zero-velocity", "120 frames"] < 0.1 * world["zero-velocity", "120 frames"]
    held = [cell for cell in cells if cell.method == "zero-velocity" and cell.metric == convae.WORLD]
    spread = next(cell.spread for cell in held if cell.setting == "60 frames")
    assert spread == pytest.approx(100 * speed * np.std(np.arange(1, 61)), rel=1e-3)  # over frames, not windows


def test_root_and_heading_are_the_truths_in_body_local_errors(tmp_path):
    corpus = corpus_of(tmp_path, lively(240))

    def elsewhere(positions, observed, fps, skeleton):
        return (turned(lively(240)[None], 1.1) + np.array([3, 0, -2])).astype(np.float32)

    def raised(positions, observed, fps, skeleton):
        return (lively(240)[None] + [0, 0.07, 0]).astype(np.float32)

    trial = next(t for t in convae.trials(corpus, "validation") if t.setting == "60 frames")
    found = convae.measure_trial(trial, corpus, [Method("elsewhere", elsewhere), Method("raised", raised)], 0)
    assert found["elsewhere"].errors[convae.BODY_LOCAL].mean < 1e-3
    assert found["elsewhere"].errors[convae.WORLD].mean > 100
    for metric in (convae.BODY_LOCAL, convae.WORLD):  # the root is on the floor: heights are not aligned
        assert found["raised"].errors[metric].mean == pytest.approx(7, abs=1e-3)


def test_body_local_is_what_a_slow_twin_says():
    positions = np.stack([lively(50, 1), lively(50, 2)]).astype(np.float32)

    def smooth(rows, sigma):
        out = np.empty_like(rows)
        reach = int(4 * sigma + 0.5)
        for frame in range(len(rows)):
            total, weights = np.zeros(rows.shape[1]), 0.0
            for other in range(frame - reach, frame + reach + 1):
                weight = np.exp(-0.5 * ((other - frame) / sigma) ** 2)
                total += weight * rows[min(max(other, 0), len(rows) - 1)]
                weights += weight
            out[frame] = total / weights
        return out

    for window, found in zip(positions.astype(float), body_local(positions)):
        across = (window[:, JOINT["left_thigh"]] - window[:, JOINT["right_thigh"]]
                  + window[:, JOINT["left_upper_arm"]] - window[:, JOINT["right_upper_arm"]])  # fmt: skip
        forward = np.cross(across, [0.0, 1.0, 0.0])  # left x up
        forward[:, 1] = 0
        forward = smooth(forward / np.linalg.norm(forward, axis=-1, keepdims=True), 20.0)
        root = smooth(window[:, 0] * [1, 0, 1], 3.0)
        for frame in range(0, 50, 7):
            angle = np.arctan2(forward[frame, 0], forward[frame, 2])
            assert found[frame] == pytest.approx(turned(window[frame] - root[frame], -angle), abs=1e-5)


def test_an_unmoved_body_faces_forward_over_the_origin():
    poses = np.broadcast_to(turned(STANDING, 2.0) + np.array([5, 0, 7]), (1, 30, 21, 3))
    assert body_local(poses.astype(np.float32))[0, 4] == pytest.approx(STANDING, abs=1e-5)


def test_noise_is_as_large_as_it_says(tmp_path):
    corpus = corpus_of(tmp_path, lively(480))
    cells = measured(corpus, find_all(["none", "butterworth", "linear"]), "noise", "infilling")
    noise = values(cells, convae.WORLD, "noise")
    # The length of a Gaussian vector: sigma * sqrt(8 / pi).
    assert noise["none", "62.5 mm"] == pytest.approx(6.25 * np.sqrt(8 / np.pi), rel=0.01)
    assert noise["none", "93.75 mm"] == pytest.approx(9.375 * np.sqrt(8 / np.pi), rel=0.01)
    assert noise["butterworth", "62.5 mm"] < 0.7 * noise["none", "62.5 mm"]
    assert not any(method == "linear" for method, _ in noise)
    zero = values(cells, convae.WORLD, "infilling")
    assert zero["none", "0 frames"] == zero["linear", "0 frames"] == 0 < zero["butterworth", "0 frames"]
    assert not any(method == "none" and setting != "0 frames" for method, setting in zero)


def test_dropout_and_lost_joints_hide_what_they_say(tmp_path):
    corpus = corpus_of(tmp_path, lively(480), lively(250, 3))
    told = {}

    def fill(positions, observed, fps, skeleton):
        assert np.isnan(positions[~observed]).all() and np.isfinite(positions[observed]).all()
        return np.where(observed[..., None], positions, np.float32(0))

    def restore(positions, observed, fps, skeleton):
        told.setdefault("hidden", []).append(~observed)
        return np.nan_to_num(positions + np.float32([0, 0.05, 0]))

    both = Method("network", fill, restore)
    for trial in convae.trials(corpus, "validation"):
        told.clear()
        tally = convae.measure_trial(trial, corpus, [both], 0).get("network")
        if trial.task == "dropout":
            share = np.concatenate([each.ravel() for each in told["hidden"]]).mean()
            assert share == pytest.approx(float(trial.setting.rstrip("%")) / 100, abs=0.01)
        if trial.task == "joints lost":
            hidden = np.concatenate(told["hidden"])
            lost = {BODY.names[joint] for joint in np.flatnonzero(hidden.any(axis=(0, 1)))}
            assert lost == set(convae.LOST[trial.setting]) and hidden[:, :, [JOINT[name] for name in lost]].all()
            # Raw output over the whole window: what was seen and rewritten counts.
            seen = (21 - len(lost)) / 21
            assert tally.errors[convae.WORLD].mean - 5 * seen == pytest.approx(
                tally.errors[convae.LOST_ONLY].mean * len(lost) / 21, rel=1e-4
            )


def test_what_cannot_be_filled_is_a_dash_and_no_quality(tmp_path):
    corpus = corpus_of(tmp_path, lively(240))
    cells = measured(corpus, find_all(["linear"]), "joints lost")
    lost = [cell for cell in cells if cell.method == "linear"]
    assert lost and all(np.isnan(cell.value) for cell in lost)


def test_bone_lengths_are_percentiles_against_the_truth(tmp_path):
    corpus = corpus_of(tmp_path, lively(240))

    def stretched(positions, observed, fps, skeleton):
        truth = lively(240)[None].astype(np.float32)
        spine = truth[:, :, JOINT["spine"]]
        truth[:, :, JOINT["chest"]] = spine + 1.2 * (truth[:, :, JOINT["chest"]] - spine)
        return np.where(observed[..., None], positions, truth)

    cells = measured(corpus, [Method("stretched", stretched)], "infilling")
    gap = [cell for cell in cells if cell.task == "bone lengths, gap of 120 frames" and cell.method == "stretched"]
    assert {cell.setting for cell in gap} == {f"{share}th percentile" for share in (5, 25, 50, 75, 95)}
    for cell in gap:
        assert cell.value == pytest.approx(120 if cell.metric == "spine" else 100, abs=0.01)
    assert set(convae.figures(cells)) == {"bone_lengths_gap_of_120_frames", "bone_lengths_whole_window"}


def test_windows_are_whole_and_every_120_frames(tmp_path):
    broken = lively(480)
    broken[100, 3] = np.nan
    armless = lively(300)
    armless[:, JOINT["left_hand"]] = np.nan
    corpus = corpus_of(tmp_path, lively(479), lively(239), broken, armless)
    starts = convae.starts(corpus, "validation")
    assert starts.tolist() == [0, 120, 479 + 239 + 120, 479 + 239 + 240, 479 + 239 + 480]
    # A joint that was never seen is nobody's error.
    cells = measured(corpus, find_all(["linear"]), "infilling")
    assert np.isfinite(values(cells, convae.WORLD, "infilling")["linear", "60 frames"])


def test_the_same_call_gives_the_same_cells_and_methods_do_not_touch_each_other(tmp_path):
    corpus = corpus_of(tmp_path, lively(240))
    alone = measured(corpus, find_all(["savgol"]), "noise", seed=3)
    both = measured(corpus, find_all(["none", "savgol"]), "noise", seed=3)
    own = [cell for cell in both if cell.method in ("savgol", TRUTH)]
    assert sorted(map(repr, own)) == sorted(map(repr, alone))
    other = measured(corpus, find_all(["savgol"]), "noise", seed=4)
    assert repr(other) != repr(alone)


def test_quick_is_a_mean_of_what_the_protocol_says(tmp_path):
    corpus = corpus_of(tmp_path, lively(360))
    hermite = find("hermite")
    few = convae.quick(hermite, corpus, "validation", windows=2)
    full = values(measured(corpus, [hermite], "infilling"), convae.BODY_LOCAL)
    assert next(iter(few)) == "infilling, body-local"
    assert few["60 frames"] == pytest.approx(full["hermite", "60 frames"])
    assert few["infilling, body-local"] == pytest.approx((few["60 frames"] + few["120 frames"]) / 2)


def test_what_cannot_be_measured_is_said(tmp_path):
    short = corpus_of(tmp_path, lively(100))
    with pytest.raises(InputError, match="no whole window of 240 frames"):
        convae.measure(short, "validation", [])
    other = Skeleton(("hips", "head"), (-1, 0))
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match="not BODY's"):
        convae.measure(corpus_of(tmp_path / "b", np.zeros((300, 2, 3)), skeleton=other), "validation", [])


def test_a_rig_without_toes_has_boxes_for_the_bones_it_has(tmp_path):
    clip = lively(240)
    clip[:, [JOINT["left_toe"], JOINT["right_toe"]]] = np.nan
    cells = convae.measure(corpus_of(tmp_path, clip), "validation", find_all(["linear"]))
    boxes = {cell.metric for cell in cells if cell.task in convae.BONE_TASKS.values()}
    assert boxes and boxes < set(convae.BONES)
    assert set(convae.figures(cells)) == {"bone_lengths_gap_of_120_frames", "bone_lengths_whole_window"}
