"""A network among the fills, on networks whose answer is known: nothing, or so much beside the curves it begins at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import motionmend as mm
from motionmend.body.joints import BODY, JOINT, LIMBS
from motionmend.body.mapping import map_rig
from motionmend.errors import InputError
from motionmend.fills.auto import Auto
from motionmend.fills.points import FILLS
from motionmend.gaps import Gaps
from motionmend.motion import Take, Units
from motionmend.networks.checkpoints import Description
from motionmend.networks.gap_space import ERRORS, OUTPUTS, STRANGERS
from motionmend.networks.loading import completer
from motionmend.repairs import chooser, filling, network_fill
from motionmend.repairs.chooser import NETWORK_WINS, Chooser, network_for, network_rows
from motionmend.repairs.denoising import denoise
from walks import WALK, hidden, walk

LIFT = np.array([0, 0.05, 0], np.float32)


def answering(lift=(0, 0, 0), space="poses_off_curves"):
    """A network that says the truth is so far from the curve."""
    description = Description("xmae", space, 60.0, 60, BODY)
    run = lambda inputs: np.zeros((*inputs["curve"].shape[:3], 3), np.float32) + np.float32(lift)  # noqa: E731
    return network_fill.NetworkFill(completer(description, run))


@pytest.fixture
def install(monkeypatch):
    return lambda *fills: monkeypatch.setattr(network_fill, "installed", lambda: {fill.name: fill for fill in fills})


def gap_of(motion, joints, start, stop):
    observed = motion.observed.copy()
    observed[start:stop, joints] = False
    return hidden(motion, observed)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("limb", ["left_arm", "right_leg"])
def test_a_network_that_adds_nothing_leaves_what_the_fills_did(fps, limb):
    broken = gap_of(walk(fps), LIMBS[limb], round(0.5 * fps), round(1.2 * fps))
    filled, gaps = answering().fill(broken)
    wanted, _ = Auto().fill(broken)
    assert set(gaps.method) == {"xmae"}
    np.testing.assert_allclose(filled.positions, wanted.positions, atol=1e-5)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_what_a_network_adds_comes_on_top_and_dies_away_at_the_seams(fps):
    start, stop = round(0.5 * fps), round(1.2 * fps)
    broken = gap_of(walk(fps), slice(None), start, stop)
    filled, _ = answering(LIFT).fill(broken)
    plain, _ = Auto().fill(broken)
    lifted = filled.positions - plain.positions
    middle = slice(start + round(0.2 * fps), stop - round(0.2 * fps))
    np.testing.assert_allclose(lifted[middle], np.broadcast_to(LIFT, lifted[middle].shape), atol=0.01)
    assert np.abs(lifted[[start, stop - 1]]).max() < 0.01
    assert np.array_equal(filled.positions[broken.observed], broken.positions[broken.observed])


def expecting(metres: float, lift=(0, 0, 0)):
    """A network beside `gap_curves` that says how far off it is; at once so far from the curve where a gap begins."""
    description = Description("mend", "beside_curves", 30.0, 96, BODY, longest=0.75)

    def run(inputs):
        out = np.zeros((*inputs["envelope"].shape[:2], OUTPUTS), np.float32)
        missing = inputs["envelope"] > 0
        out[..., : 3 * len(BODY)] = np.repeat(missing, 3, axis=-1) * np.tile(np.float32(lift), len(BODY))
        out[..., ERRORS] = np.log(metres / STRANGERS)
        return out

    return network_fill.NetworkFill(completer(description, run))


@pytest.mark.parametrize("fps", [30.0, 60.0, 100.0])
@pytest.mark.parametrize("as_points", [True, False])
def test_the_error_that_a_network_expects_is_told(fps, as_points, install):
    take = mm.load(WALK)
    if as_points:
        take = Take(walk(fps), None, None, Units(1.0, "y", "as it is"), "npz", "walk.npz")
    install(expecting(0.012))
    fixed = mm.repair(take, gaps=["1s:1.5s"], method="mend")
    told = [row for row in fixed.report.fills if row.method == "mend"]
    assert told and all(row.expected == pytest.approx(12, rel=1e-3) for row in told)
    assert "expected" in str(fixed.report) and "12 mm" in str(fixed.report)
    assert all(row.expected is None for row in mm.repair(take, gaps=["1s:1.5s"], method="eased").report.fills)


def test_what_a_coarser_network_adds_at_once_begins_where_the_gap_does():
    """At 120 frames a second three of four are seen between the network's last seen frame and its first missing one."""
    broken = gap_of(walk(120.0), slice(None), 100, 160)
    added = expecting(0.01, (0, 0.04, 0)).fill(broken)[0].positions - expecting(0.01).fill(broken)[0].positions
    up = added[..., 1]
    np.testing.assert_allclose(up[120:140], 0.04, atol=1e-3)
    assert np.abs(np.diff(up[98:162], axis=0)).max() < 0.012  # within a tenth of a second, never at once
    assert not up[:100].any() and not up[160:].any()


def test_joints_that_the_network_does_not_know_are_left_to_the_fills():
    take = mm.load(WALK)
    observed = take.motion.observed.copy()
    observed[60:140] = False
    broken = hidden(take.motion, observed)
    filled, gaps = answering(LIFT).fill(broken)
    assert filled.observed.all()
    other = gaps.method != "xmae"
    assert 0 < other.sum() < len(gaps)
    assert all("does not know" in gaps.reasons[row] for row in np.flatnonzero(other))


def test_without_a_person_all_is_left_to_the_fills():
    positions = np.cumsum(np.random.default_rng(0).normal(size=(40, 3, 3)), axis=0).astype(np.float32)
    cloud = mm.Motion(positions, np.ones((40, 3), bool), 60.0, mm.Skeleton.cloud(tuple("abc")))
    broken = gap_of(cloud, [1], 10, 20)
    filled, gaps = answering(LIFT).fill(broken)
    assert np.array_equal(filled.positions, Auto().complete(broken).positions)
    assert list(gaps.method) == [Auto().fill(broken)[1].method[0]] and "no person" in gaps.reasons[0]


def test_a_limb_that_is_never_seen_gets_the_networks_own_answer():
    motion = walk(60.0)
    broken = gap_of(motion, LIMBS["left_arm"], 0, len(motion))
    filled, gaps = answering(LIFT).fill(broken)
    assert filled.observed.all() and set(gaps.method) == {"xmae"}
    above = filled.positions[:, BODY.parents[JOINT["left_upper_arm"]]]
    np.testing.assert_allclose(filled.positions[:, JOINT["left_hand"]], above + LIFT, atol=1e-3)


# --- auto -------------------------------------------------------------------------------------------------


@pytest.fixture
def wins(monkeypatch):
    """The network wins all gaps of the whole body of 0.4 to 1 s, and of joints where 12 others are seen."""
    table = {"all points": (0.4, 1.0, 0), "joints": (0.4, 1.0, 12), "body": (0.4, 1.0, 0)}
    monkeypatch.setattr(chooser, "NETWORK_WINS", {"xmae": table})


def test_auto_takes_the_network_where_it_won_and_says_so(wins):
    motion = walk(60.0)
    choosing = Chooser(improve={"xmae": answering(LIFT).improve})
    for joints, seconds, by_network in (
        (slice(None), 0.5, True), (slice(None), 0.3, False), (LIMBS["left_arm"], 0.5, True),
        (LIMBS["left_leg"], 0.5, False), (list(range(1, 21)), 0.5, False),
    ):  # fmt: skip
        broken = gap_of(motion, joints, 30, 30 + round(60 * seconds))
        filled, gaps = choosing.fill(broken)
        plain, _ = Auto().fill(broken)
        assert (set(gaps.method) == {"xmae"}) == by_network, (joints, seconds)
        assert np.allclose(filled.positions, plain.positions, atol=1e-6) != by_network
        if by_network:
            assert all("won on validation" in gaps.reasons[row] for row in range(len(gaps)))


def test_of_several_networks_the_first_that_won_is_taken(monkeypatch):
    table = {"xmae": {"all points": (0.4, 1.0, 0)}, "convae": {"all points": (0.8, 3.0, 0)}}
    monkeypatch.setattr(chooser, "NETWORK_WINS", table)
    chosen = [network_for("all points", seconds, 0, table) for seconds in (0.3, 0.5, 0.9, 1.0, 2.9, 3.0)]
    assert chosen == ["", "xmae", "xmae", "convae", "convae", ""]
    assert network_for("all points", 0.9, 0, ["convae"]) == "convae"
    assert network_for("markers", 0.9, 20, table) == ""


def test_what_no_fill_has_written_is_not_shown_to_the_network(wins):
    """A gap of more than a second at the end is left as the file has it: with numbers, but none to go by."""
    motion = walk(60.0)
    observed = motion.observed.copy()
    observed[40:70], observed[75:, LIMBS["left_arm"]] = False, False
    broken = hidden(motion, observed)
    wrong = np.where(observed[..., None], motion.positions, np.float32(77))
    choosing = Chooser(improve={"xmae": network_fill.required("xmae").improve})
    ours, theirs = (choosing.complete(each) for each in (broken, replace(broken, positions=wrong)))
    assert not ours.observed[75:, LIMBS["left_arm"]].any()
    assert np.array_equal(ours.positions[ours.observed], theirs.positions[ours.observed])


def test_network_rows_are_gaps_with_both_ends_of_joints_it_knows(wins):
    motion = walk(60.0)
    observed = motion.observed.copy()
    observed[:30], observed[60:90], observed[100:104] = False, False, False
    gaps = Gaps.of(observed)
    mapping = replace(map_rig(BODY, motion.positions), joints=(*range(20), -1))
    rows = network_rows(gaps, ["all points"] * len(gaps), observed, 60.0, mapping, ["xmae"])
    assert {(int(gaps.joint[row]), int(gaps.start[row])) for row in rows} == {(joint, 60) for joint in range(20)}


# --- rigs -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lift", [(0, 0, 0), (0, 0.05, 0)], ids=["nothing", "lifted"])
def test_a_rig_is_posed_as_the_network_says_and_nothing_else_moves(install, monkeypatch, lift):
    install(answering(lift))
    take = mm.load(WALK)
    fixed = mm.repair(take, gaps=[(100, 160)], method="xmae")
    monkeypatch.setattr(chooser, "NETWORK_WINS", {"xmae": {}})
    plain = mm.repair(take, gaps=[(100, 160)], method="auto")
    moved = fixed.motion.positions - plain.motion.positions
    assert np.array_equal(np.delete(fixed.motion.positions, range(100, 160), 0),
                          np.delete(take.motion.positions, range(100, 160), 0))  # fmt: skip
    known = [joint for joint in map_rig(take.skeleton, take.motion.positions).joints if joint >= 0]
    wanted = np.broadcast_to(lift, (len(known), 3))
    np.testing.assert_allclose(moved[130, known], wanted, atol=0.01 if any(lift) else 1e-4)
    methods = {row.method for row in fixed.report.fills}
    assert "xmae" in methods and any("hangs on it" in row.why for row in fixed.report.fills if row.method != "xmae")


def test_auto_asks_the_network_for_rigs_too(install, wins):
    install(answering(LIFT))
    take = mm.load(WALK)
    fixed = mm.repair(take, gaps=[(100, 172)])
    assert any(row.method == "xmae" and "won on validation" in row.why for row in fixed.report.fills)
    short = mm.repair(take, gaps=[(100, 130)])
    assert not any(row.method == "xmae" for row in short.report.fills)


def test_without_an_installed_network_auto_does_without_and_the_method_is_refused(install):
    install()
    take = mm.load(WALK)
    assert mm.repair(take, gaps=[(100, 172)]).report.repaired
    with pytest.raises(InputError, match="no network named 'xmae' is installed"):
        filling.fill(take, "xmae")


def test_paper_like_networks_fill_by_their_own_answer():
    """Without curves to begin at there is no difference to add: the answer itself, its seams met."""
    description = Description("flat", "floor_mean", 60.0, 60, BODY)
    flat = network_fill.NetworkFill(completer(description, lambda inputs: 0 * inputs["positions"]))
    motion = walk(60.0)
    broken = gap_of(motion, [JOINT["left_hand"]], 30, 60)
    filled, _ = flat.fill(broken)
    steps = np.linalg.norm(np.diff(filled.positions[:, JOINT["left_hand"]], axis=0), axis=-1)
    assert steps[[29, 59]].max() < 0.1 and not np.allclose(filled.positions, FILLS["eased"].complete(broken).positions)


# --- denoising --------------------------------------------------------------------------------------------


def test_a_network_that_only_fills_is_refused_for_denoising():
    with pytest.raises(InputError, match="it cannot denoise"):
        denoise(walk(60.0), answering().completer)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_a_network_rewrites_what_it_knows_and_leaves_what_is_missing(fps):
    motion = gap_of(walk(fps), [4], 40, 50)
    network = answering(LIFT, "poses_on_curves").completer
    smooth = denoise(motion, network)
    assert np.array_equal(smooth.observed, motion.observed)
    seen = motion.observed & (np.arange(len(motion)) > 9)[:, None]  # the take begins with a jump
    lifted = (smooth.positions - motion.positions)[seen]
    np.testing.assert_allclose(lifted, np.broadcast_to(LIFT, lifted.shape), atol=0.02)


def test_the_network_that_ships_for_denoising_is_found_by_its_network_name_and_beats_the_filters():
    clean = walk(60.0)
    noise = np.random.default_rng(0).normal(0, 0.03, clean.positions.shape).astype(np.float32)
    noisy = replace(clean, positions=clean.positions + noise)
    ours, filters = denoise(noisy, "xmae"), [denoise(noisy, each) for each in ("butterworth", "savgol")]
    left, *others = (float(np.linalg.norm(each.positions - clean.positions, axis=-1).mean())
                     for each in (ours, *filters))  # fmt: skip
    assert left < 0.8 * min(others)


def test_unknown_ways_to_denoise_name_the_nearest():
    with pytest.raises(InputError, match="Did you mean butterworth"):
        denoise(walk(60.0), "butterwort")


# --- the network that ships -------------------------------------------------------------------------------


def test_the_network_that_ships_is_found_and_better_than_the_fills_where_auto_takes_it():
    """On a walk it has seen in training: whether it is there and put in the right place, not how good it is."""
    motion = walk(60.0)
    broken = gap_of(motion, LIMBS["right_leg"], 40, 80)
    network = network_fill.required("mend")
    with_it, gaps = Chooser(improve={"mend": network.improve}).fill(broken)
    without = Auto().complete(broken)
    assert set(gaps.method) == {"mend"}
    ours, theirs = (np.linalg.norm(each.positions - motion.positions, axis=-1)[~broken.observed].mean()
                    for each in (with_it, without))  # fmt: skip
    assert ours < 0.9 * theirs


@pytest.mark.parametrize("kind", sorted(NETWORK_WINS["convae"]))
def test_one_network_takes_over_where_the_other_ends(kind):
    asked = [network_for(kind, seconds, len(BODY), NETWORK_WINS) for seconds in np.arange(0.4, 6.0, 0.1)]
    assert "" not in asked and asked == sorted(asked, reverse=True)  # mend, …, convae, …
