"""The benchmark's ground: methods on batches, the XMAE protocol on planted corpora, tables, files and the command."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from motionmend import InputError
from motionmend.benchmark import Clock, classical, protocol, provenance, quality, quick, run, trials, xmae
from motionmend.benchmark.method import Method
from motionmend.benchmark.methods import find, find_all, hold, of_completer
from motionmend.benchmark.results import TRUTH, Cell, Protocol, evenly
from motionmend.benchmark.table import best, decimals_for, table
from motionmend.body import standing
from motionmend.body.joints import BODY, JOINT, LIMBS
from motionmend.cli.main import main
from motionmend.corpora.corpus import ClipInfo, Corpus
from motionmend.corpora.writing import write_corpus
from motionmend.fills.points import FILLS
from motionmend.motion import Motion, Skeleton
from motionmend.networks.checkpoints import Description
from motionmend.networks.completers import NetworkCompleter
from motionmend.repairs import network_fill
from motionmend.repairs.chooser import Chooser
from motionmend.repairs.denoising import denoise

FPS = 60.0
STANDING = np.random.default_rng(3).uniform([-0.5, 0.5, -0.5], [0.5, 1.5, 0.5], (len(BODY), 3))


def wandering(frames: int, seed: int) -> np.ndarray:
    """Smooth motion of all joints, each its own way."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / FPS
    speed, phase = rng.uniform(2, 9, (2, len(BODY), 3))
    return (STANDING + 0.2 * np.sin(speed * time + phase)).astype(np.float32)


def straight(frames: int, seed: int) -> np.ndarray:
    """Every joint on its own straight line at its own constant speed."""
    velocity = np.random.default_rng(seed).uniform(-1, 1, (len(BODY), 3))
    return (STANDING + np.arange(frames)[:, None, None] / FPS * velocity).astype(np.float32)


def corpus_of(path, motions, *, split="test", fps=FPS, skeleton=BODY, lost=()) -> Corpus:
    def clips():
        for number, positions in enumerate(motions):
            observed = np.ones(positions.shape[:2], bool)
            observed[:, list(lost)] = False
            positions = np.where(observed[..., None], positions, np.float32(np.nan))
            yield ClipInfo(f"clip{number}", split=split), Motion(positions, observed, fps, skeleton)

    return write_corpus(path, name="toy", fps=fps, skeleton=skeleton, credit="Made up.", clips=clips())


@pytest.fixture
def walking(tmp_path) -> Corpus:
    return corpus_of(tmp_path / "toy.corpus", [wandering(200, 1), wandering(130, 2), wandering(59, 3)])


@pytest.fixture
def lines(tmp_path) -> Corpus:
    return corpus_of(tmp_path / "lines.corpus", [straight(125, 1), straight(60, 2)])


@pytest.fixture
def brief(monkeypatch):
    """The protocol cut down to two tasks, because drawing all of them takes seconds."""
    every = xmae.trials
    tasks = "arm displaced", "noise on rotations"
    monkeypatch.setattr(xmae, "trials", lambda *asked: [each for each in every(*asked) if each.task in tasks])


def values(cells: list[Cell], task: str, metric: str, method: str) -> list[float]:
    found = [cell.value for cell in cells if (cell.task, cell.metric, cell.method) == (task, metric, method)]
    assert found
    return found


def damaged_batch():
    positions = np.stack([wandering(60, seed) for seed in range(5)])
    observed = np.ones(positions.shape[:3], bool)
    observed[0, 20:40] = False
    observed[1, 10:50, LIMBS["left_arm"]] = False
    observed[2, :5, 3] = False
    observed[3, :, 7] = False
    observed[4] = np.random.default_rng(0).random((60, len(BODY))) < 0.7
    return positions, observed


# Methods on batches -----------------------------------------------------------------------------------------


FILL_NAMES = ["linear", "hermite", "eased", "cubic", "pattern", "bones", "rigid", "auto"]


@pytest.mark.parametrize("name", [*FILL_NAMES, "zero-velocity"])
def test_fills_keep_what_is_observed_and_read_nothing_else(name):
    positions, observed = damaged_batch()
    fill = find(name).fill
    out = fill(positions, observed, FPS, BODY)
    poisoned = np.where(observed[..., None], positions, np.float32(np.nan))
    assert np.array_equal(out[observed], positions[observed])
    assert np.array_equal(out, fill(poisoned, observed, FPS, BODY), equal_nan=True)
    assert np.isfinite(out[[0, 1, 2, 4]]).all() and np.isnan(out[3, :, 7]).all()


@pytest.mark.parametrize("name", FILL_NAMES)
def test_a_batch_is_its_windows_bit_for_bit(name):
    positions, observed = damaged_batch()
    out = find(name).fill(positions, observed, FPS, BODY)
    improve = {name: network.improve for name, network in network_fill.installed().items()}
    completer = Chooser(improve=improve) if name == "auto" else FILLS[name]
    for window, (places, seen) in enumerate(zip(positions, observed)):
        alone = completer.complete(Motion(places, seen, FPS, BODY))
        assert np.array_equal(out[window][alone.observed], alone.positions[alone.observed])
        assert np.isnan(out[window][~alone.observed]).all()


@pytest.mark.parametrize("name", ["savgol", "butterworth"])
def test_a_filtered_batch_is_its_windows_bit_for_bit(name):
    positions, observed = damaged_batch()
    out = find(name).restore(positions, observed, FPS, BODY)
    for window, (places, seen) in enumerate(zip(positions, observed)):
        alone = denoise(Motion(places, seen, FPS, BODY), name)
        assert np.array_equal(out[window][seen], alone.positions[seen])


def test_zero_velocity_holds_the_last_pose():
    positions = np.arange(6, dtype=np.float32)[None, :, None, None] * np.ones((1, 1, 2, 3), np.float32)
    observed = np.array([[0, 1, 0, 0, 1, 0], [0, 0, 0, 0, 0, 0]], bool).T[None]
    held = hold(positions, observed)
    assert held[0, :, 0, 0].tolist() == [1, 1, 1, 1, 4, 4]
    assert np.isnan(held[0, :, 1]).all()
    sample = find("zero-velocity").sample(positions[:, 0], positions[:, 1:], observed[:, 1:], 2, 0)
    assert sample.shape == (1, 2, 5, 2, 3) and not sample.any()


def test_unknown_methods_name_the_nearest():
    with pytest.raises(InputError, match=r"unknown method 'hermit'.*hermite"):
        find("hermit")
    with pytest.raises(InputError, match=r"unknown method 'nearest-carry'.*nearest-carried, nearest"):
        find("nearest-carry")
    with pytest.raises(InputError, match="named twice"):
        find_all(["linear", "linear"])
    with pytest.raises(InputError, match="gone"):
        find("./gone/away")


def constant_network(frames=60, fps=FPS) -> NetworkCompleter:
    """A network that sees the joints all at one place, 1 m up, whatever it is shown."""

    class Space:
        name = "world"

        def encode(self, positions, observed):
            return {"positions": np.where(observed[..., None], positions, 0).astype(np.float32)}, None

        def decode(self, output, _):
            return output

    def answer(inputs):
        return np.broadcast_to(np.float32([0, 1, 0]), inputs["positions"].shape)

    completer = NetworkCompleter(Description("constant", "floor_mean", fps, frames, BODY), answer, budget="none at all")
    completer.space = Space()
    return completer


def test_a_network_restores_everything_and_fills_what_is_missing():
    method = of_completer("constant", constant_network())
    positions, observed = damaged_batch()
    assert (method.restore(positions, observed, FPS, BODY) == [0, 1, 0]).all()
    filled = method.fill(positions, observed, FPS, BODY)
    assert np.array_equal(filled[observed], positions[observed])
    assert (filled[~observed] == [0, 1, 0]).all()
    assert method.budget == "none at all" and method.sample is None


# The protocol -----------------------------------------------------------------------------------------------


def test_windows_follow_each_other_inside_clips(walking):
    assert xmae.starts(walking, "test").tolist() == [0, 60, 120, 200, 260]
    assert xmae.starts(walking, "test", 2).tolist() == [0, 260]
    assert xmae.starts(walking, "test", 3).tolist() == [0, 120, 260]
    assert evenly(np.arange(7), None).tolist() == evenly(np.arange(7), 9).tolist() == list(range(7))


@pytest.mark.parametrize("seconds, span", [(0.1, (27, 33)), (0.3, (21, 39)), (0.5, (15, 45)), (0.9, (3, 57))])
def test_gaps_are_in_the_middle(seconds, span):
    positions = wandering(60, 0)[None]
    _, hidden, judged = trials.missing([2, 5], round(seconds * 60))(positions, np.random.default_rng(0))
    assert hidden[0, :, 5].nonzero()[0].tolist() == list(range(*span))
    assert np.array_equal(hidden, judged) and hidden.sum() == 2 * (span[1] - span[0])
    _, same, judged = trials.missing([2, 5], round(seconds * 60), everywhere=True)(positions, np.random.default_rng(0))
    assert np.array_equal(hidden, same) and judged.all()


def test_means_are_weighted():
    means = trials.Means()
    means.add({"a": (1.0, 1), "b": (5.0, 0)})
    means.add({"a": (4.0, 2)})
    assert means.value("a") == 3.0 and np.isnan(means.value("b")) and np.isnan(means.value("c"))
    assert list(means.values()) == ["a", "b"]


def test_a_trial_asks_methods_for_what_they_can_do():
    fills, both = find("linear"), of_completer("n", constant_network())
    restores = find("none")

    def doing(does, method):
        return trials.Trial("t", "s", np.zeros(1, int), 60, trials.noisy(1.0), does).doing(method)

    assert [doing("fill", each) for each in (fills, restores, both)] == [fills.fill, None, both.fill]
    assert [doing("restore", each) for each in (fills, restores, both)] == [None, restores.restore, both.restore]
    assert [doing("raw", each) for each in (fills, restores, both)] == [fills.fill, None, both.restore]
    assert [doing("any", each) for each in (fills, restores, both)] == [fills.fill, restores.restore, both.restore]


def test_straight_motion_costs_a_straight_line_nothing(lines):
    cells = xmae.measure(lines, "test", find_all(["linear", "zero-velocity"]))
    for task in ("full skeleton missing", "arm missing", "leg missing", "arm displaced, told where"):
        assert max(values(cells, task, "MPJPE, global", "linear")) < 1e-3
        if "told" not in task:
            assert max(values(cells, task, "seam jump", "linear")) < 1e-2
    # Who stands still falls behind by (1 + … + n) / n = (n + 1) / 2 frames of the mean speed.
    positions, _ = lines.windows(xmae.starts(lines, "test"), 60)
    speeds = np.linalg.norm(positions[:, 1] - positions[:, 0], axis=-1)
    frames = [6, 18, 30, 42, 54]
    expected = [speeds.mean() * 1000 * (n + 1) / 2 for n in frames]
    assert values(cells, "full skeleton missing", "MPJPE, global", "zero-velocity") == pytest.approx(expected, rel=1e-3)
    arms = [speeds[:, LIMBS[side]].mean() for side in xmae.ARM]
    expected = [np.mean(arms) * 1000 * (n + 1) / 2 for n in frames]
    assert values(cells, "arm missing", "MPJPE, global", "zero-velocity") == pytest.approx(expected, rel=1e-3)
    relative = np.linalg.norm(positions[:, 1] - positions[:, 0] - (positions[:, 1] - positions[:, 0])[:, :1], axis=-1)
    expected = [relative.mean() * 1000 * (n + 1) / 2 for n in frames]
    found = values(cells, "full skeleton missing", "MPJPE, root-relative", "zero-velocity")
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_displaced_arm_is_off_by_its_offset(walking):
    windows = xmae.starts(walking, "test")
    truth, _ = walking.windows(windows, 60)
    damage = xmae.displaced(LIMBS["left_arm"], 30)
    damaged, hidden, judged = damage(truth, np.random.default_rng(5))
    offset = (damaged - truth)[:, 20, LIMBS["left_arm"]]
    lengths = np.linalg.norm(offset, axis=-1)
    assert not hidden.any()
    assert (lengths > 0.4999).all() and (lengths < 1.0001).all()
    assert np.ptp(offset, axis=1).max() < 1e-6 and np.ptp(lengths[:, 0]) > 0.01
    assert np.array_equal(judged[0].nonzero()[0], np.repeat(np.arange(15, 45), 3))
    assert np.array_equal(damaged[~judged], truth[~judged])
    cells = xmae.measure(walking, "test", find_all(["none", "linear"]), seed=5)
    expected = lengths[:, 0].mean() * 1000  # the offset of a seed is the same for both arms and for all times
    assert values(cells, "arm displaced", "MPJPE, global", "none") == pytest.approx([expected] * 5, rel=1e-4)
    told = values(cells, "arm displaced, told where", "MPJPE, global", "linear")
    assert told == values(cells, "arm missing", "MPJPE, global", "linear")
    assert not [cell for cell in cells if cell.task == "arm displaced" and cell.method == "linear"]
    assert not [cell for cell in cells if cell.task == "arm missing" and cell.method == "none"]


def test_noise_has_the_length_of_a_gaussian(walking):
    cells = xmae.measure(walking, "test", find_all(["none", "savgol"]))
    chi = 2 * np.sqrt(2 / np.pi)  # the mean length of a standard Gaussian vector in three dimensions
    expected = [sigma * 1000 * chi for sigma in xmae.POSITION_SIGMAS]
    assert values(cells, "noise on positions", "MPJPE, global", "none") == pytest.approx(expected, rel=0.02)
    smooth = values(cells, "noise on positions", "MPJPE, global", "savgol")
    assert all(a < b for a, b in zip(smooth, expected))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("convae", ["it also disturbs the path, heading and travel", "short"]),
        ("trajevae", ["does not turn pairs", "counts a window with itself", "its prior's mean"]),
        ("xmae", ["axis-angle", "table 3 is without global translation and rotation", "but the hips'"]),
    ],
)
def test_where_a_table_is_not_the_papers_it_says_so(name, words):
    for word in words:
        assert word in protocol(name).PROTOCOL.describe


def test_noise_on_rotations_keeps_bones_and_hips():
    truth = np.stack([wandering(60, seed) for seed in range(40)])
    sigma = 0.05
    damaged, _, judged = xmae.noisy_turns(sigma)(truth, np.random.default_rng(0))
    bones = [
        np.linalg.norm(each[:, :, 1:] - each[:, :, list(BODY.parents[1:])], axis=-1) for each in (truth, damaged)
    ]
    assert np.allclose(*bones, atol=1e-5) and judged.all()
    still = [joint for joint, parent in enumerate(BODY.parents) if parent <= 0]  # the hips and their children
    assert np.allclose(damaged[:, :, still], truth[:, :, still], atol=1e-6)
    # A shin turned about its upper end by a small Gaussian vector moves by |bone| sigma sqrt(2) in the mean square.
    knee, ankle = JOINT["left_shin"], JOINT["left_foot"]
    thigh = JOINT["left_thigh"]
    moved = np.square(damaged[:, :, knee] - truth[:, :, knee]).sum(axis=-1).mean()
    length = np.square(truth[:, :, knee] - truth[:, :, thigh]).sum(axis=-1).mean()
    assert moved == pytest.approx(2 * sigma**2 * length, rel=0.1)
    assert np.linalg.norm(damaged[:, :, ankle] - truth[:, :, ankle], axis=-1).mean() > 0


def test_a_joint_never_seen_counts_nowhere(tmp_path):
    gone = JOINT["left_hand"]
    whole = corpus_of(tmp_path / "whole.corpus", [wandering(60, 1)])
    lacking = corpus_of(tmp_path / "lacking.corpus", [wandering(60, 1)], lost=[gone])
    linear = find_all(["linear", "none"])
    few, all_of_it = (xmae.measure(corpus, "test", linear) for corpus in (lacking, whole))
    assert all(np.isfinite(cell.value) for cell in few)
    truth, _ = whole.windows([0], 60)
    arm = [joint for joint in LIMBS["left_arm"] if joint != gone]
    every = xmae.trials(lacking, "test")
    trial = next(each for each in every if (each.task, each.setting) == ("arm missing", "0.5 s"))
    tally = xmae.measure_trial(trial, lacking, linear, 0)["linear"]
    u = np.arange(1, 31)[:, None, None] / 31
    guess = truth[0, 14, arm] * (1 - u) + truth[0, 45, arm] * u
    expected = np.linalg.norm(guess - truth[0, 15:45][:, arm], axis=-1).mean() * 1000
    assert tally.value("MPJPE, global") == pytest.approx(expected, rel=1e-4)
    assert len(few) == len(all_of_it)


def test_trials_in_blocks_are_the_trials_at_once(walking, monkeypatch):
    named = find_all(["hermite"])
    whole = xmae.measure(walking, "test", named, seed=1)
    monkeypatch.setattr(xmae, "BATCH", 2)
    for one, other in zip(whole, xmae.measure(walking, "test", named, seed=1), strict=True):
        assert replace(one, value=0, spread=0) == replace(other, value=0, spread=0)
        if "missing" in one.task:  # where nothing is drawn
            assert one.value == pytest.approx(other.value, rel=1e-6, abs=1e-6)


def test_a_network_is_measured_both_ways(walking):
    method = of_completer("constant", constant_network())
    cells = xmae.measure(walking, "test", [method])
    truth, _ = walking.windows(xmae.starts(walking, "test"), 60)
    away = np.linalg.norm(truth - np.float32([0, 1, 0]), axis=-1) * 1000
    arms = np.mean([away[:, 15:45, LIMBS[side]].mean() for side in xmae.ARM])
    for task in ("arm missing", "arm displaced", "arm displaced, told where"):
        assert values(cells, task, "MPJPE, global", "constant")[2] == pytest.approx(arms, rel=1e-5)
    assert values(cells, "noise on positions", "MPJPE, global", "constant") == pytest.approx([away.mean()] * 4)
    assert values(cells, "noise on positions", "limb σ", "constant") == [0.0] * 4


def test_quick_numbers_are_the_protocols_own(walking):
    found = quick("xmae", constant_network(), walking, "test", windows=3, seed=2)
    cells = xmae.measure(walking, "test", [of_completer("n", constant_network())], seed=2, limit=3)
    gaps = values(cells, "full skeleton missing", "MPJPE, root-relative", "n")
    assert next(iter(found)) == "full skeleton, root-relative"
    assert found["full skeleton, root-relative"] == pytest.approx(np.mean([gaps[1], gaps[2], gaps[4]]))
    noise = values(cells, "noise on positions", "MPJPE, global", "n")
    assert found["noise 50 mm"] == pytest.approx(noise[2])


def test_quick_numbers_have_classical_ones_beside_them(walking):
    found = quick("xmae", None, walking, "test", windows=3, seed=2)
    assert classical("xmae") == "hermite and butterworth"
    cells = xmae.measure(walking, "test", find_all(["hermite", "butterworth"]), seed=2, limit=3)
    gaps = values(cells, "full skeleton missing", "MPJPE, global", "hermite")
    assert found["full skeleton, global"] == pytest.approx(np.mean([gaps[1], gaps[2], gaps[4]]))
    noise = values(cells, "noise on positions", "MPJPE, global", "butterworth")
    assert found["noise 50 mm"] == pytest.approx(noise[2])


# Quality ----------------------------------------------------------------------------------------------------


def test_quality_sees_what_was_planted():
    truth = np.stack([straight(60, 1)])
    touched = np.zeros((1, 60, len(BODY)), bool)
    touched[:, 20:40] = True
    still = quality.measure(truth, truth, touched, FPS, BODY)
    assert still["seam jump"][0] < 1e-3 and still["jitter"][0] < 1
    assert still["bone-length change"][0] > 0  # straight lines are no body
    moved = truth.copy()
    moved[:, 20:40] += np.float32([0.03, 0, 0])
    seen = quality.measure(truth, moved, touched, FPS, BODY)
    assert seen["seam jump"][0] == pytest.approx(30, rel=1e-3)
    assert seen["jitter"][0] > 100


def test_quality_of_standing_feet():
    truth = np.tile(STANDING.astype(np.float32), (1, 60, 1, 1))
    slid = truth.copy()
    slid[0, 20:40, JOINT["left_foot"], 0] += np.arange(20) * 0.001  # 60 mm/s
    touched = np.zeros((1, 60, len(BODY)), bool)
    touched[:, 20:40, JOINT["left_foot"]] = True
    assert quality.measure(truth, truth, touched, FPS, BODY)["foot skate"] == (0.0, 21)
    # 19 steps of 1 mm, the one back of 19 mm, and the first of none, at 60 a second
    assert quality.measure(truth, slid, touched, FPS, BODY)["foot skate"][0] == pytest.approx(38 * 60 / 21, rel=1e-3)
    stretched = truth.copy()
    stretched[:, 30, JOINT["head"]] = 2 * truth[:, 30, JOINT["head"]] - truth[:, 30, JOINT["neck"]]
    touched[:, 30, JOINT["head"]] = True
    bone = np.linalg.norm(STANDING[JOINT["head"]] - STANDING[JOINT["neck"]]) * 1000
    change, _ = quality.measure(truth, stretched, touched, FPS, BODY)["bone-length change"]
    assert change == pytest.approx(bone, rel=1e-3)


# Tables and files -------------------------------------------------------------------------------------------


def toy_cells(rows, metric="MPJPE"):
    places = [(name, *place) for name, pair in rows.items() for place in zip("ab", pair)]
    return [Cell("t", setting, name, metric, value, None, "mm") for name, setting, value in places]


def test_tables_bold_the_best_and_dash_what_cannot():
    about = Protocol("p", 60, 60, "mm", "")
    cells = toy_cells({"x": (10.04, 3.0), "y": (10.01, np.nan)})
    assert table(cells, ["x", "y", "z"], about).splitlines() == [
        "|  | a | b |",
        "| --- | ---: | ---: |",
        "| x | **10.0** | 3.0 |",
        "| y | **10.0** | – |",
        "| z | – | – |",
    ]
    stray = toy_cells({TRUTH: (1.0, 1.0), "x": (2.0, 2.0), "w": (3.0, 3.0)})
    assert [line.split(" | ")[0] for line in table(stray, ["x"], about).splitlines()[2:]] == ["| w", "| x", "| truth"]
    high = replace(about, highest=("MPJPE",))
    assert best([cells[0], replace(cells[2], value=20.0)], high, 1) == {"y"}
    assert best([cells[0], cells[2]], replace(about, unjudged=("MPJPE",)), 1) == set()
    assert best(toy_cells({TRUTH: (1, 1), "x": (2, 2)})[:2], about, 1) == set()
    spread = [replace(cell, spread=1.25) for cell in toy_cells({"x": (10.0, 3.0)})]
    assert "| x | 10.0 ± 1.2 | 3.0 ± 1.2 |" in table(spread, ["x"], replace(about, spread=True))
    assert "| x | 99.8 |" in table([replace(cells[0], value=99.84, unit="%")], ["x"], about)
    assert [decimals_for([value]) for value in (345.0, 34.5, 3.45, 0.0345)] == [0, 1, 2, 3]


def test_the_same_call_writes_the_same_bytes(walking, tmp_path, brief):
    out = tmp_path / "results"
    call = ("xmae", walking, "test", ["none", "butterworth", "savgol", "auto"], out)
    run(*call, seed=4, limit=2)
    names = {path.name for path in out.iterdir()}
    first = {name: (out / name).read_bytes() for name in names - {"runtime.json"}}
    (out / "mine.txt").write_text("keep me")
    run(*call, seed=4, limit=2, force=True)
    assert {name: (out / name).read_bytes() for name in first} == first
    assert {"results.json", "table.md", "runtime.json", "arm_displaced.png", "noise_on_rotations.png"} <= names
    assert (out / "mine.txt").read_text() == "keep me"
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".results")]

    said = json.loads((out / "results.json").read_text())
    assert said["header"]["corpus"]["sha256"] == walking.sha256
    assert (said["header"]["seed"], said["header"]["windows"], said["header"]["limit"]) == (4, 2, 2)
    assert said["header"]["command"] == (
        f"motionmend benchmark xmae --corpus {walking.path} --split test --methods none,butterworth,savgol,auto "
        f"--seed 4 --limit 2 -o {out}"
    )
    page = (out / "table.md").read_text()
    for told in (walking.sha256, "Made up.", "--limit 2", "a quick look", "| auto |"):
        assert told in page
    runtime = json.loads((out / "runtime.json").read_text())["runtime"]
    assert set(runtime) == {"none", "butterworth", "savgol"} and set(runtime["none"]) == {"restore"}


def test_the_command_in_the_header_gives_the_same_numbers(walking, tmp_path, capsys, brief):
    results = run("xmae", walking.path, "test", ["linear", "none"], seed=3)
    assert main([*results.header["command"].split()[1:], "-o", str(tmp_path / "results")]) == 0
    said = json.loads((tmp_path / "results" / "results.json").read_text())
    assert [Cell(**cell) for cell in said["cells"]] == results.cells
    assert "of linear" in capsys.readouterr().out


def test_other_seeds_give_other_damage(walking):
    named = find_all(["none"])
    cells = [xmae.measure(walking, "test", named, seed=seed) for seed in (0, 1)]
    one, other = (values(each, "arm displaced", "MPJPE, global", "none") for each in cells)
    assert one != other


def test_a_folder_that_is_there_is_not_touched(walking, tmp_path, brief):
    out = tmp_path / "results"
    out.mkdir()
    with pytest.raises(InputError, match="exists"):
        run("xmae", walking, "test", ["linear"], out)
    (out / "arm_gone.png").write_bytes(b"old")
    (out / "holiday.png").write_bytes(b"mine")
    (out / "results.json").write_text('{"figures": ["arm_gone.png", "../holiday.png"]}')
    run("xmae", walking, "test", ["none"], out, limit=1, force=True)
    assert not (out / "arm_gone.png").exists() and (out / "holiday.png").exists()
    with pytest.raises(InputError, match="no such folder"):
        run("xmae", walking, "test", ["linear"], tmp_path / "a" / "b")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="a file"):
        run("xmae", walking, "test", ["linear"], tmp_path / "file", force=True)


def test_mistakes_are_named(walking, tmp_path, capsys):
    with pytest.raises(InputError, match=r"unknown protocol 'xmea'.*xmae"):
        run("xmea", walking, "test", ["linear"])
    with pytest.raises(InputError, match=r"no clip is in the split 'validation'.*test"):
        run("xmae", walking, "validation", ["linear"])
    with pytest.raises(InputError, match="no method"):
        run("xmae", walking, "test", [])
    with pytest.raises(InputError, match="at least 1"):
        run("xmae", walking, "test", ["linear"], limit=0)
    slow = corpus_of(tmp_path / "slow.corpus", [wandering(200, 1)], fps=50.0)
    with pytest.raises(InputError, match=r"50 fps.*60 fps.*data build .* --fps 60"):
        run("xmae", slow, "test", ["linear"])
    short = corpus_of(tmp_path / "short.corpus", [wandering(59, 1)])
    with pytest.raises(InputError, match="no whole window of 60 frames"):
        run("xmae", short, "test", ["linear"])
    points = Skeleton.cloud(("hips", "b"))
    native = corpus_of(tmp_path / "native.corpus", [wandering(60, 1)[:, :2]], skeleton=points)
    with pytest.raises(InputError, match="without --native"):
        run("xmae", native, "test", ["linear"])
    assert main(["benchmark", "xmae", "-o", str(tmp_path / "x")]) == 1
    assert "Say --corpus" in capsys.readouterr().err
    assert main(["benchmark", "lafan1", "--corpus", str(walking.path), "-o", str(tmp_path / "x")]) == 1
    assert "Say --source" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_quality_sees_feet_that_slide():
    """A body that stands on its feet, and one that is pushed along by 2 mm a frame while they should stand."""
    truth = np.tile((standing.STANDING + standing.UPRIGHT)[None, None], (1, 60, 1, 1))
    touched = np.zeros((1, 60, len(BODY)), bool)
    touched[:, 20:40] = True
    slid = truth.copy()
    slid[:, 20:40, :, 0] += 0.002 * np.arange(20)[:, None]
    slid[:, 40:, :, 0] += 0.002 * 19
    still, moved = (quality.measure(truth, each, touched, FPS, BODY)["foot skate"] for each in (truth, slid))
    assert still[0] == pytest.approx(0, abs=1e-3) and still[1] > 0
    assert moved[0] == pytest.approx(2 * FPS, rel=0.15) and moved[1] == still[1]


def test_every_protocol_says_what_it_is():
    for name in ("xmae", "lafan1"):
        module = protocol(name)
        assert module.PROTOCOL.name == name and module.PROTOCOL.describe and callable(module.measure)


def test_the_clock_leaves_out_the_first_call(monkeypatch):
    ticks = iter([0.0, 100.0, 200.0, 203.0, 300.0, 301.0])
    monkeypatch.setattr("time.perf_counter", lambda: next(ticks))
    clock = Clock()
    linear = clock.timed(Method("linear", fill=lambda *_: np.zeros(1)))
    for _ in range(3):
        linear.fill(np.zeros((2, 10, 1, 3)))
    assert clock.table() == {"linear": {"fill": {"seconds_per_frame": 0.1, "ratio": 1.0}}}


def test_the_commit_is_that_of_the_checkout(tmp_path, monkeypatch):
    def git(*words: str) -> str:
        identity = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        return subprocess.run(
            ["git", "-C", str(tmp_path), *identity, *words], capture_output=True, text=True, check=True
        ).stdout.strip()

    module = tmp_path / "package" / "benchmark" / "provenance.py"
    module.parent.mkdir(parents=True)
    for path in (module, module.parents[1] / "__init__.py"):
        path.write_text("")
    monkeypatch.setattr(provenance, "__file__", str(module))
    assert provenance.commit() == ""  # installed, and in no checkout
    git("init", "-q")
    assert provenance.commit() == ""  # inside somebody else's
    git("add", "-A")
    git("commit", "-qm", "all")
    assert provenance.commit() == git("rev-parse", "HEAD") != ""
    module.write_text("changed\n")
    assert provenance.commit() == git("rev-parse", "HEAD") + "+"
    assert provenance.machine().endswith("cores")


def test_asking_for_help_loads_nothing_heavy():
    code = (
        "import sys\nfrom motionmend.cli.main import main\n"
        "try:\n    main(['benchmark', '--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = 'torch', 'scipy', 'matplotlib', 'onnxruntime'\n"
        "print(*[name for name in heavy if name in sys.modules], file=sys.stderr)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stderr.split() == [] and "--train-corpus" in ran.stdout
