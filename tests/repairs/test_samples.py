"""Gaps filled in many ways: what differs and what must not, with a network whose answers are known and with ours."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionmend as mm
from follower import follower
from motionmend.body.joints import BODY, JOINT, LIMBS
from motionmend.body.mapping import map_rig
from motionmend.cli.main import main
from motionmend.errors import InputError
from motionmend.fills.auto import Auto
from motionmend.motion import Motion, Skeleton, Take, Units
from motionmend.networks.loading import load_completer
from motionmend.repairs import filling, network_fill, varied_fill
from motionmend.repairs.chooser import NETWORK_WINS
from motionmend.repairs.varied_fill import ASTRAY, VariedFill
from rigs import as_take, random_rig
from walks import WALK, hidden, walk

ARM = list(LIMBS["left_arm"])


def way(variant=1, seed=7, **options) -> VariedFill:
    return VariedFill(follower(**options), seed=seed, variant=variant)


def broken(fps: float, *gaps) -> Motion:
    """The walk without these joints from a second to another."""
    motion = walk(fps)
    observed = motion.observed.copy()
    for joints, start, stop in gaps:
        observed[round(start * fps) : round(stop * fps), joints] = False
    return hidden(motion, observed)


def kinks(motion: Motion, positions: np.ndarray) -> np.ndarray:
    """Second differences, mm, wherever one of their three frames lies across a seam from the others."""
    bend = 1000 * np.linalg.norm(np.diff(positions.astype(float), 2, axis=0), axis=-1)
    inside = motion.observed[1:-1]
    return bend[(inside != motion.observed[2:]) | (inside != motion.observed[:-2])]


def as_points(take: Take) -> Take:
    return Take(take.motion, None, None, Units(1.0, "y", "made"), "npz", "walk.npz")


@pytest.fixture(scope="module")
def take() -> Take:
    return mm.load(WALK)


@pytest.fixture
def alike(monkeypatch):
    """From when this is called on, the network's samples are all alike: what is left is the base."""
    return lambda: monkeypatch.setattr(varied_fill, "_generative", lambda _: follower(sway=0))


# --- points -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", [30.0, 50.0, 60.0, 120.0])
@pytest.mark.parametrize("joints", [slice(None), ARM], ids=["body", "arm"])
def test_variants_differ_inside_and_nowhere_else(fps, joints):
    motion = broken(fps, (joints, 0.8, 1.8))
    lost = ~motion.observed
    made = [way(variant).fill(motion) for variant in (1, 2, 3)]
    base = Auto().complete(motion).positions
    for positions, gaps in ((filled.positions, gaps) for filled, gaps in made):
        assert set(gaps.method) == {"follower"}
        assert np.array_equal(positions[~lost], motion.positions[~lost])
        away = np.linalg.norm(positions - base, axis=-1)[lost]
        assert 0.002 < away.max() < 0.5
    apart = [np.linalg.norm(made[one][0].positions - made[other][0].positions, axis=-1)[lost].max()
             for one, other in ((0, 1), (1, 2), (0, 2))]  # fmt: skip
    assert min(apart) > 0.001


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("gaps", [
    [(slice(None), 0.8, 1.8)],
    [(ARM, 0.8, 1.8)],
    [(ARM, 0.5, 1.3), (slice(None), 1.0, 1.6), ([JOINT["head"]], 1.5, 2.2)],
    [(slice(None), 2.4, 9)],
], ids=["body", "arm", "overlapping", "end"])  # fmt: skip
def test_no_seam_pops(fps, gaps):
    motion = broken(fps, *gaps)
    base = Auto().complete(motion).positions
    filled = way(sway=0.1).complete(motion).positions
    far = 1000 * np.linalg.norm(filled - base, axis=-1).max()
    assert far > 25
    assert (kinks(motion, filled) <= 1.1 * kinks(motion, base) + 0.02 * far * (60 / fps) ** 2).all()


def test_what_is_added_is_the_sample_less_the_best_guess():
    """At the network's own rate, from the pose before the gap; halfway through nothing is faded."""
    motion = broken(50.0, (slice(None), 0.8, 2.0))
    added = way(2, seed=5).complete(motion).positions - Auto().complete(motion).positions
    noise = np.random.default_rng((5, 2, 39)).standard_normal((1, 4), dtype=np.float32)[0]
    clock = np.arange(65, 75)
    waves = noise[:3] @ np.sin(np.outer([3, 5, 7], (clock - 39) / 100))
    wanted = 0.03 * waves[:, None, None] * (np.linspace(0, 1, len(BODY))[:, None] * [1, 0.2, -0.5])
    wanted /= np.sqrt(1 + np.sum(wanted**2, axis=-1, keepdims=True) / ASTRAY**2)
    np.testing.assert_allclose(added[clock], wanted, atol=1e-5)


def test_a_seed_and_a_variant_are_the_same_bits_and_another_is_not():
    motion = broken(60.0, (slice(None), 0.8, 1.8))
    ours = way(2).complete(motion).positions
    assert np.array_equal(ours, way(2).complete(motion).positions)
    for other in (way(1), way(2, seed=8)):
        assert np.abs(ours - other.complete(motion).positions).max() > 0.01


def test_long_gaps_do_not_lead_astray():
    motion = broken(60.0, (slice(None), 0.5, 2.7))
    base = Auto().complete(motion).positions
    far = np.linalg.norm(way(sway=50).complete(motion).positions - base, axis=-1)
    assert 0.3 < far.max() < ASTRAY + 0.01


def test_at_the_start_the_base_stays_and_the_report_says_why():
    motion = broken(60.0, (slice(None), 0, 0.5))
    filled, gaps = way().fill(motion)
    assert np.array_equal(filled.positions, Auto().complete(motion).positions)
    assert "follower" not in gaps.method
    fixed = mm.repair(as_points(Take(motion, None, None, Units(1.0, "y", ""), "npz", "x.npz")), method="trajevae")
    assert {row.why for row in fixed.report.fills} == {"nothing is known before it, extrapolated"}


def test_without_a_pose_before_it_a_gap_keeps_the_base_s_fill():
    """No frame before the second gap has all joints: the arm's gap at the start is longer than the base will fill."""
    motion = broken(60.0, (ARM, 0, 1.5), ([JOINT["right_hand"]], 1.0, 2.0))
    filled, gaps = way().fill(motion)
    hand = gaps.joint == JOINT["right_hand"]
    assert [gaps.reasons[row] for row in np.flatnonzero(hand)] == ["no whole pose comes before it"]
    base = Auto().complete(motion)
    assert np.array_equal(filled.observed, base.observed)
    assert np.array_equal(filled.positions[base.observed], base.positions[base.observed])


def test_what_the_base_leaves_at_the_end_is_left():
    motion = broken(60.0, (ARM, 1.2, 9), ([JOINT["head"]], 1.5, 2.5))
    filled, gaps = way().fill(motion)
    assert not filled.observed[72:, ARM].any() and not gaps.method[np.isin(gaps.joint, ARM)].any()
    assert filled.observed[:, JOINT["head"]].all() and "follower" in gaps.method


def test_joints_that_are_never_seen_get_the_network_s_own_word():
    motion = broken(60.0, (ARM, 0, 9), (slice(None), 1.0, 1.7))
    (one, gaps), (two, _) = (way(variant).fill(motion) for variant in (1, 2))
    assert one.observed.all() and set(gaps.method) == {"follower"}
    assert np.abs(one.positions - two.positions)[:, ARM].max(axis=-1).any(axis=0).all()
    assert np.array_equal(one.positions[motion.observed], motion.positions[motion.observed])
    shoulder = one.positions[:, BODY.parents[ARM[0]], None]
    assert np.linalg.norm(one.positions[:, ARM] - shoulder, axis=-1).max() < 1.5
    steps = np.linalg.norm(np.diff(one.positions[1:, ARM], axis=0), axis=-1)
    assert steps.max() < 0.1


def test_short_gaps_have_one_filling():
    motion = broken(60.0, (ARM, 1.0, 1.05), ([JOINT["head"]], 0.5, 1.5))
    filled, gaps = way().fill(motion)
    short = np.isin(gaps.joint, ARM)
    assert set(gaps.method[~short]) == {"follower"} and "follower" not in gaps.method[short]
    assert {gaps.reasons[row] for row in np.flatnonzero(short)} == {"too short to go another way"}
    assert np.array_equal(filled.positions[:, ARM], Auto().complete(motion).positions[:, ARM])


def test_what_is_missing_is_not_read():
    motion = broken(60.0, (slice(None), 0.8, 1.4), (ARM, 1.6, 9), ([JOINT["head"]], 1.8, 2.4))
    nonsense = np.where(motion.observed[..., None], motion.positions, np.float32(77))
    ours, theirs = (way().complete(each) for each in (motion, replace(motion, positions=nonsense)))
    seen = ours.observed
    assert np.array_equal(seen, theirs.observed) and not seen.all()
    assert np.array_equal(ours.positions[seen], theirs.positions[seen])


def test_fingers_go_along_with_the_hand(take, alike):
    lost = {"gaps": [(100, 220)], "method": "trajevae", "seed": 1}
    fixed = mm.repair(as_points(take), **lost)
    alike()
    base = mm.repair(as_points(take), **lost)
    hand, finger = (take.skeleton.index(name) for name in ("LeftHand", "LeftHandIndex1"))
    bone, before = (each.motion.positions[:, finger] - each.motion.positions[:, hand] for each in (fixed, base))
    moved = np.linalg.norm(fixed.motion.positions - base.motion.positions, axis=-1)[:, hand].max()
    assert moved > 0.02 and np.linalg.norm(bone - before, axis=-1).max() < 0.2 * moved
    assert {row.method for row in fixed.report.fills} == {"trajevae"}


@pytest.mark.parametrize("points", [True, False], ids=["points", "rig"])
def test_without_a_person_all_is_left_to_the_fills(points):
    take = as_take(random_rig(3))
    take = as_points(take) if points else take
    fixed, plain = (mm.repair(take, gaps=[(10, 25)], method=method) for method in ("trajevae", "auto"))
    assert np.array_equal(fixed.motion.positions, plain.motion.positions)
    assert {row.why for row in fixed.report.fills} == {"the network found no person here"}
    assert "trajevae" not in {row.method for row in fixed.report.fills}


# --- channels, and the network that ships -----------------------------------------------------------------


@pytest.mark.parametrize("points", [True, False], ids=["points", "rig"])
@pytest.mark.parametrize(
    "lost", [{"gaps": [(100, 220)]}, {"lost": ["LeftArm,LeftForeArm,LeftHand:100:220"]}], ids=["body", "arm"]
)
def test_a_real_take_is_repaired_in_several_plausible_ways(take, alike, points, lost):
    take = as_points(take) if points else take
    made = [mm.repair(take, **lost, method="trajevae", seed=7, variant=variant) for variant in (1, 2, 3)]
    again = mm.repair(take, **lost, method="trajevae", seed=7, variant=3)
    assert np.array_equal(again.motion.positions, made[2].motion.positions)
    alike()
    base = mm.repair(take, **lost, method="trajevae")
    places = np.stack([each.motion.positions for each in made]).astype(float)
    apart = np.linalg.norm(places[[0, 1, 2]] - places[[1, 2, 0]], axis=-1)
    assert apart[:, 100:220].max(axis=(1, 2)).min() > 0.005 and apart.max() < 0.5
    assert not apart[:, :100].any() and not apart[:, 220:].any()
    for number, each in enumerate(made, 1):
        report = each.report
        assert (report.seed, report.variant) == (7, number) and f"variant {number} of seed 7" in str(report)
        assert "trajevae" in {row.method for row in report.fills}
        assert report.checks["changed"]["value"] == 0
        for check in ("seam_jump", "seam_kink", "unfilled"):
            assert report.checks[check]["ok"], (check, report.checks[check])
        ours, theirs = (
            1000 * np.linalg.norm(np.diff(one.motion.positions.astype(float), 2, axis=0), axis=-1)[[98, 99, 218, 219]]
            for one in (each, base)
        )
        assert (ours <= 1.1 * theirs + 0.2).all()
        if not points:
            assert report.checks["bone_length"]["value"] < 0.01
            outside = np.r_[0:100, 220 : len(take)]
            assert np.array_equal(each.rig.rotations[outside], take.rig.rotations[outside])
            assert np.array_equal(each.rig.translations[outside], take.rig.translations[outside])


def test_a_rig_without_toes_and_shoulders_is_filled_too(take):
    lacking = {f"{side}_{part}": "" for side in ("left", "right") for part in ("toe", "shoulder")}
    one, two = (
        mm.repair(take, gaps=[(100, 220)], method="trajevae", variant=variant, map=lacking) for variant in (1, 2)
    )
    assert np.abs(one.motion.positions - two.motion.positions)[100:220].max() > 0.01
    assert {"trajevae"} < {row.method for row in one.report.fills}


def test_a_rig_s_edges(take):
    lost = {"gaps": [(0, 90), (len(take) - 100, len(take))]}
    one, two = (mm.repair(take, **lost, method="trajevae", variant=variant) for variant in (1, 2))
    apart = np.linalg.norm(one.motion.positions - two.motion.positions, axis=-1)
    assert not apart[:-100].any() and apart[-100:].max() > 0.01
    assert one.report.checks["seam_jump"]["ok"]


def test_channels_that_are_never_trusted(take):
    take = take.distrust(np.isin(take.skeleton.names, ["LeftArm", "LeftForeArm"])[None].repeat(len(take), 0))
    one, two = (mm.repair(take, method="trajevae", variant=variant) for variant in (1, 2))
    hand = take.skeleton.index("LeftHand")
    assert one.motion.observed[:, hand].all()
    apart = np.linalg.norm(one.motion.positions - two.motion.positions, axis=-1)
    assert apart[:, hand].max() > 0.005
    assert np.array_equal(one.motion.positions[:, 0], take.motion.positions[:, 0])


def test_auto_never_takes_it():
    assert "trajevae" not in NETWORK_WINS and "trajevae" not in network_fill.installed()


# --- errors and the command line --------------------------------------------------------------------------


def test_what_cannot_be_asked_is_said(take, monkeypatch):
    for options, words in (
        ({"method": "auto", "variant": 2}, "2 variants are asked of auto.*Use the method trajevae"),
        ({"method": "trajevae", "variant": 0}, "0 variants of seed 0; expected 1 or more"),
        ({"method": "trajevae", "seed": -1}, "seed -1; expected"),
        ({"method": "trajevay"}, "Did you mean trajevae"),
    ):
        with pytest.raises(InputError, match=words):
            mm.repair(take, gaps=[(100, 220)], **options)
    varied_fill._generative.cache_clear()
    monkeypatch.setattr(varied_fill, "load_completer", load_completer)
    monkeypatch.setattr("motionmend.networks.checkpoints.folders", lambda: [])
    with pytest.raises(InputError, match="no network named 'trajevae' is installed"):
        filling.fill(take, "trajevae")


COMMAND = ["repair", "walk.bvh", "--gap", "100:220", "--method", "trajevae", "--seed", "7"]


def test_samples_are_written_into_a_folder(here, capsys):
    assert main([*COMMAND, "--samples", "3", "-o", "ways/"]) == 0
    said = capsys.readouterr().out
    assert "written: ways (3 takes)" in said and "report:  ways/walk.report.json" in said
    assert "checks of 3 variants, seed 7" in said and said.count("  0 samples  ") == 6
    assert {path.name for path in Path("ways").iterdir()} == {*(f"walk_{k}.bvh" for k in (1, 2, 3)), "walk.report.json"}
    told = json.loads(Path("ways/walk.report.json").read_text())
    assert [(each["variant"], each["seed"], each["output"]) for each in told["variants"]] == [
        (number, 7, f"ways/walk_{number}.bvh") for number in (1, 2, 3)
    ]
    written = [Path(f"ways/walk_{number}.bvh").read_bytes() for number in (1, 2, 3)]
    assert len(set(written)) == 3
    original = Path("walk.bvh").read_text().splitlines()
    for data in written:
        differ = [at for at, (ours, theirs) in enumerate(zip(data.decode().splitlines(), original)) if ours != theirs]
        first = len(original) - len(mm.load("walk.bvh"))
        assert first + 100 <= min(differ) and max(differ) < first + 220
    assert main([*COMMAND, "--samples", "2", "-o", "two"]) == 0 and main([*COMMAND, "-o", "one.bvh"]) == 0
    assert [Path(f"two/walk_{number}.bvh").read_bytes() for number in (1, 2)] == written[:2]
    assert Path("one.bvh").read_bytes() == written[0]
    assert json.loads(Path("one.bvh.report.json").read_text())["variant"] == 1
    capsys.readouterr()
    assert main([*COMMAND, "--samples", "3", "-o", "ways"]) == 1
    assert "the file exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--samples", "3", "--method", "auto", "-o", "out"], "3 variants are asked of auto"),
        (["--samples", "3", "--method", "xmae", "-o", "out"], "3 variants are asked of xmae"),
        (["--samples", "0", "-o", "out"], "0 variants"),
        (["--seed", "-1", "-o", "out"], "seed -1"),
        (["--samples", "2", "-o", "out.bvh"], "several variants need a folder"),
        (["--samples", "2", "-o", "out", "--picture", "out.png"], "--picture draws one repair"),
    ],
    ids=lambda each: " ".join(each) if isinstance(each, list) else "",
)
def test_what_is_wrong_is_said_in_one_line(here, capsys, options, words):
    before = sorted(here.iterdir())
    assert main([*COMMAND, *options]) == 1
    said = capsys.readouterr()
    assert said.out == "" and words in said.err and said.err.count("\n") == 1
    assert sorted(here.iterdir()) == before


def test_a_cloud_without_bodies_is_no_trouble_on_the_command_line(here, capsys):
    positions = np.cumsum(np.random.default_rng(0).normal(size=(60, 4, 3)), axis=0).astype(np.float32)
    cloud = Motion(positions, np.ones((60, 4), bool), 60.0, Skeleton.cloud(tuple("abcd")))
    mm.save(Take(cloud, None, None, Units(1.0, "y", ""), "npz", "cloud.npz"), "cloud.npz")
    assert main(["repair", "cloud.npz", "--gap", "20:40", "--method", "trajevae", "-o", "out.npz"]) == 0
    assert "the network found no person here" in capsys.readouterr().out
    assert map_rig(cloud.skeleton, positions).is_person is False
