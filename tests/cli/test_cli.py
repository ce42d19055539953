"""The commands as people type them: what they print, what they write, and how they end."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import motionmend as mm
from motionmend.cli.main import main
from walks import WALK

EXAMPLES = Path(mm.__file__).parent / "examples"


def test_inspect_says_what_is_in_it(here, capsys):
    assert main(["inspect", "walk.bvh"]) == 0
    said = capsys.readouterr().out
    for words in ("359 frames at 120 fps", "31 joints", "CMU", "left_forearm    ← LeftForeArm", "guessed"):
        assert words in said
    assert main(["inspect", "walk.bvh", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["mapping"]["left_hand"] == "LeftHand"
    assert facts["units"].startswith("asf")


def test_units_can_be_set(here, capsys):
    assert main(["inspect", "walk.bvh", "--unit", "m", "--up", "z", "--fps", "60"]) == 0
    said = capsys.readouterr().out
    assert "m (as you said), z up (as you said)" in said
    assert "at 60 fps" in said


def test_a_map_overrides(here, capsys):
    Path("rig.toml").write_text('left_hand = "LThumb"\n')
    assert main(["inspect", "walk.bvh", "--map", "rig.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mapping"]["left_hand"] == "LThumb"
    Path("rig.toml").write_text('left_hand = "LThum"\n')
    assert main(["inspect", "walk.bvh", "--map", "rig.toml"]) == 1
    assert "LThumb" in capsys.readouterr().err


def test_damage_then_repair_then_compare(here, capsys):
    damage = ["--gap", "120:150", "--lost", "LeftArm,LeftForeArm:200:230", "--seed", "1"]
    assert main(["damage", "walk.bvh", "-o", "broken.bvh", *damage]) == 0
    assert main(["repair", "broken.bvh", "-o", "fixed.bvh", "--picture", "fixed.png"]) == 0
    said = capsys.readouterr().out
    assert "120:150" in said
    assert "rest untouched" in said
    assert Path("fixed.png").read_bytes().startswith(b"\x89PNG")
    report = json.loads(Path("fixed.bvh.report.json").read_text())
    assert report["output"] == "fixed.bvh"
    assert report["checks"]["changed"]["value"] == 0
    errors = []
    for name in ("broken.bvh", "fixed.bvh"):
        assert main(["compare", "walk.bvh", name, "--frames", "120:150", "--json"]) == 0
        errors.append(json.loads(capsys.readouterr().out)["mpjpe"])
    assert errors[1] < 0.25 * errors[0]


def test_the_same_seed_plants_the_same_damage(here):
    for name in ("a.bvh", "b.bvh"):
        assert main(["damage", "walk.bvh", "-o", name, "--dropout", "0.1", "--noise", "5mm", "--seed", "4"]) == 0
    assert Path("a.bvh").read_bytes() == Path("b.bvh").read_bytes() != Path("walk.bvh").read_bytes()


def test_named_ranges_and_a_named_report(here):
    options = ["--gap", "0.5s:0.8s", "--lost", "LeftForeArm,LeftHand:200:230", "--method", "hermite"]
    assert main(["repair", "walk.bvh", "-o", "fixed.bvh", *options, "--report", "said.json"]) == 0
    fills = json.loads(Path("said.json").read_text())["fills"]
    told = [(fill["start"], fill["stop"], fill["method"]) for fill in fills]
    assert told == [(60, 96, "hermite"), (200, 230, "hermite")]
    assert not Path("fixed.bvh.report.json").exists()


def test_one_bad_file_does_not_stop_the_rest(here, capsys):
    shutil.copy("walk.bvh", "again.bvh")
    Path("bad.bvh").write_bytes(Path("walk.bvh").read_bytes()[:5000])
    assert main(["repair", "walk.bvh", "bad.bvh", "again.bvh", "-o", "repaired/"]) == 1
    assert sorted(path.name for path in Path("repaired").glob("*.bvh")) == ["again.bvh", "walk.bvh"]
    complaint = capsys.readouterr().err
    assert "bad.bvh" in complaint
    assert "1 of 3 files failed" in complaint
    assert "Traceback" not in complaint


def test_nothing_is_overwritten(here, capsys):
    Path("fixed.bvh").write_text("precious")
    assert main(["repair", "walk.bvh", "-o", "fixed.bvh"]) == 1
    assert "--force" in capsys.readouterr().err
    assert Path("fixed.bvh").read_text() == "precious"
    assert main(["repair", "walk.bvh", "-o", "fixed.bvh", "--force"]) == 0
    assert main(["repair", "walk.bvh", "-o", "walk.bvh", "--force"]) == 1
    assert Path("walk.bvh").read_bytes() == WALK.read_bytes()
    assert [path for path in here.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(
    "command",
    [
        ["inspect", "nowhere.bvh"],
        ["inspect", "."],
        ["inspect", "walk.fbx"],
        ["inspect"],
        ["repair", "walk.bvh", "-o", "out.xyz"],
        ["repair", "walk.bvh", "-o", "out.bvh", "--gap", "a:b"],
        ["repair", "walk.bvh", "-o", "out.bvh", "--lost", "Nobody:1:2"],
        ["repair", "walk.bvh", "-o", "nowhere/out.bvh"],
        ["damage", "walk.bvh", "-o", "out.bvh", "--noise", "5 inches"],
        ["compare", "walk.bvh", "walk.bvh", "--frames", "900:"],
        ["convert", "walk.bvh", "-o", "out.amc"],
        ["inspect", "walk.bvh", "--unit", "furlong"],
    ],
    ids=" ".join,
)
def test_what_is_wrong_is_said_in_one_line(here, capsys, command):
    Path("walk.fbx").write_text("x")
    before = sorted(here.iterdir())
    assert main(command) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("motionmend: ")
    assert said.err.count("\n") == 1
    assert sorted(here.iterdir()) == before


def test_a_terminal_without_arrows_and_a_reader_that_leaves(here):
    command = [sys.executable, "-m", "motionmend", "inspect", "walk.bvh"]
    plain = {**os.environ, "PYTHONIOENCODING": "ascii"}
    ran = subprocess.run(command, capture_output=True, text=True, env=plain)
    assert ran.returncode == 0
    assert "left_hand       ? LeftHand" in ran.stdout
    left = subprocess.run(f"{' '.join(command)} --json | head -1", shell=True, capture_output=True, text=True)
    assert (left.stdout, left.stderr) == ("{\n", "")


def test_a_wrong_command_line_ends_with_2(here):
    ran = subprocess.run([sys.executable, "-m", "motionmend", "repair", "walk.bvh"], capture_output=True, text=True)
    assert ran.returncode == 2
    assert "output" in ran.stderr


@pytest.mark.parametrize("suffix", ["c3d", "trc", "csv", "npz"])
def test_every_format_is_repaired_end_to_end(here, capsys, suffix):
    """The walk's joints as markers, with a hole planted and a point that freezes."""
    assert main(["convert", "walk.bvh", "-o", f"walk.{suffix}"]) == 0
    damage = ["--lost", "LeftHand,LeftForeArm:100:130", "--held", "RightFoot:200:230", "--jump", "Head:300:302"]
    assert main(["damage", f"walk.{suffix}", "-o", f"broken.{suffix}", *damage, "--seed", "2"]) == 0
    assert main(["repair", f"broken.{suffix}", "-o", f"fixed.{suffix}"]) == 0
    capsys.readouterr()
    assert main(["compare", f"walk.{suffix}", f"fixed.{suffix}", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["missing"] == [0, 0]
    assert result["mpjpe"] < 1.0
    assert result["worst"]["mm"] < 60
    assert result["differing_samples"] <= 30 * 2 + 30 + 2 + 60


def test_convert_to_glb(here):
    assert main(["convert", "walk.bvh", "-o", "walk.glb"]) == 0
    assert Path("walk.glb").read_bytes().startswith(b"glTF")


def test_amc_is_repaired_into_bvh(here, cmu):
    assert main(["repair", str(cmu / "16" / "16_35.amc"), "-o", "out/", "--gap", "60:80"]) == 0
    fixed, source = mm.load("out/16_35.bvh"), mm.load(cmu / "16" / "16_35.amc")
    assert abs(fixed.motion.positions[:60] - source.motion.positions[:60]).max() < 1e-4


def test_the_demo_ends_with_a_take_a_report_and_a_picture(here, capsys):
    assert main(["demo", "-o", "demo"]) == 0
    said = capsys.readouterr().out
    names = {path.name for path in Path("demo").iterdir()}
    assert names == {
        "walk.bvh", "broken.bvh", "fixed.bvh", "fixed.bvh.report.json", "fixed.png",
        "step.bvh", "step_broken.bvh", "step_fixed.bvh", "step_spline.bvh", "step.png",
    }  # fmt: skip
    by_network, by_spline = (int(each) for each in re.findall(r"(\d+) mm from the truth", said))
    assert by_network < 0.6 * by_spline
    assert "128:170" in said
    # The commands it prints do what it says it did.
    lines = [line.removeprefix("$ motionmend ").split("   (")[0] for line in said.splitlines() if line.startswith("$")]
    shutil.rmtree("demo")
    Path("demo").mkdir()
    shutil.copy("walk.bvh", "demo/walk.bvh")
    shutil.copy(EXAMPLES / "step.bvh", "demo/step.bvh")
    for line in lines:
        assert main(line.split()) == 0, line
