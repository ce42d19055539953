"""`learn` and `repair --learn` on the command line, with sessions as they are on disks: bad files among good ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import motionmend as mm
from motionmend.cli.main import main
from strollers import as_point_take, as_points, as_rig_take, stroll


@pytest.fixture
def session(tmp_path, monkeypatch):
    """A folder with three walks of one rig, a file that is none, markers of something else, and an empty folder."""
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2, 3):
        mm.save(as_rig_take(stroll(seed, 6.0)), f"s{seed}.bvh")
    (tmp_path / "junk.bvh").write_text("nothing")
    others = as_points(stroll(4, 3.0))
    skeleton = mm.Skeleton.cloud([f"m{marker}" for marker in range(9)])
    mm.save(as_point_take(mm.Motion(others.positions, others.observed, others.fps, skeleton)), "others.npz")
    (tmp_path / "empty").mkdir()
    return tmp_path


def reported(name):
    return json.loads(Path(f"{name}.report.json").read_text(encoding="utf-8"))


def test_a_session_teaches_and_what_is_bad_in_it_is_named_and_skipped(session, capsys):
    asked = ["repair", "s1.bvh", "-o", "fixed.bvh", "--gap", "150:180"]
    assert main([*asked, "--learn", "s2.bvh", "s3.bvh", "junk.bvh", "others.npz", "empty", "x*.c3d", "gone.bvh"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4
    bad = "junk.bvh", "empty", "x*.c3d", "gone.bvh"
    assert all(any(word in line for line in lines) for word in bad)
    facts = reported("fixed.bvh")
    assert {fill["method"] for fill in facts["fills"]} == {"recall"}
    assert "s2.bvh" in facts["fills"][0]["why"] and "s3.bvh" in facts["fills"][0]["why"]
    assert "1 of 3 takes to learn from have other joints" in " ".join(facts["notes"])
    # The damaged take itself, under its own or another name, is no other take; nor does the order matter.
    (session / "copy.bvh").write_bytes((session / "s1.bvh").read_bytes())
    assert main([*asked[:2], "-o", "again.bvh", *asked[4:], "--learn", "others.npz", "copy.bvh", "s*.bvh"]) == 0
    assert (session / "again.bvh").read_bytes() == (session / "fixed.bvh").read_bytes()


def test_a_saved_memory_says_what_it_holds_and_does_the_same(session, capsys):
    assert main(["learn", "s2.bvh", "s3.bvh", "-o", "session.memory"]) == 0
    said = capsys.readouterr().out
    assert "2 takes, 12 s, 9 joints, channels: s2.bvh, s3.bvh" in said and "written: session.memory" in said
    for learn, output in ((["session.memory"], "one.bvh"), (["s3.bvh", "s2.bvh"], "other.bvh")):
        assert main(["repair", "s1.bvh", "-o", output, "--gap", "150:180", "--learn", *learn]) == 0
    assert (session / "one.bvh").read_bytes() == (session / "other.bvh").read_bytes()
    assert main(["learn", "s2.bvh", "-o", "session.memory"]) == 1
    assert main(["learn", ".", "-o", "all.memory"]) == 1  # junk.bvh is named, the rest is learned
    assert "junk.bvh" in capsys.readouterr().err and len(mm.Memory.open("all.memory").sessions) == 2


def test_takes_of_a_batch_teach_each_other_unless_told_not_to(session, capsys):
    asked = ["s1.bvh", "junk.bvh", "s2.bvh", "--gap", "150:180", "--method", "recall"]
    assert main(["repair", *asked, "-o", "together"]) == 1  # junk.bvh
    assert capsys.readouterr().err.count("junk.bvh:1") == 1
    assert main(["repair", "s1.bvh", "s2.bvh", *asked[3:], "--learn", "none", "-o", "alone"]) == 0
    together, alone = (reported(f"{folder}/s1.bvh")["fills"][0]["why"] for folder in ("together", "alone"))
    assert "s2.bvh" in together and "s2.bvh" not in alone
    assert main(["repair", "s2.bvh", "s1.bvh", *asked[3:], "-o", "turned"]) == 0
    for name in ("s1.bvh", "s2.bvh"):
        assert (session / "turned" / name).read_bytes() == (session / "together" / name).read_bytes()


def test_units_axes_and_rates_of_those_that_teach_are_brought_to_one(session):
    truth = as_points(stroll(1, 6.0))
    mm.save(as_point_take(truth), "points.npz")
    other = as_points(stroll(2, 6.0, fps=100.0), 100.0)
    turned = np.stack([other.positions[..., 0], -other.positions[..., 2], other.positions[..., 1]], axis=-1)  # z up
    np.savez("mm.npz", positions=1000 * turned, fps=100.0, names=np.array(other.skeleton.names), unit="mm", up="z")
    mm.save(as_point_take(other), "metres.npz")
    fixed = [mm.repair(mm.load("points.npz"), gaps=[(150, 180)], learn=[path]) for path in ("mm.npz", "metres.npz")]
    np.testing.assert_allclose(fixed[0].motion.positions, fixed[1].motion.positions, atol=1e-4)
    assert "mm.npz" in fixed[0].report.fills[0].why


def test_methods_that_do_not_learn_refuse(session, capsys):
    assert main(["repair", "s1.bvh", "-o", "fixed.bvh", "--learn", "s2.bvh", "--method", "eased"]) == 1
    assert "does not learn" in capsys.readouterr().err
    with pytest.raises(mm.InputError, match="learns from no other takes"):
        mm.repair(mm.load("s1.bvh"), learn=["s2.bvh"], method="hermite")
