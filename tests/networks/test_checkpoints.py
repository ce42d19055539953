"""A checkpoint is found by its name, is what was exported or refused, and is written whole or not at all."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

import torch

import motionmend as mm
from motionmend.body.joints import BODY
from motionmend.cli.main import main
from motionmend.errors import InputError
from motionmend.networks import checkpoints
from motionmend.networks.card import write_card
from motionmend.networks.export import export
from tiny import Tiny

BUDGET = {
    "steps": 1200, "batch": 16, "seconds": 5400.0, "machine": "2 cores", "seed": 3, "commit": "abc",
    "corpus": "made.corpus", "data sha256": "0123", "licence": "CC-BY-NC-4.0", "credit": "Nobody: \"made\" up",
}  # fmt: skip
VALIDATION = {"MPJPE, root-relative, 0.5 s, mm": 41.25, "MPJPE, global, 0.5 s, mm": 55.0}


def windows(count=3):
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(count, Tiny.frames, len(BODY), 3)).astype(np.float32)
    return positions, rng.random(positions.shape[:3]) > 0.3


def fresh(seed=0):
    torch.manual_seed(seed)
    return Tiny(Tiny.Config(), len(BODY))


@pytest.fixture(scope="session")
def exported(tmp_path_factory) -> Path:
    target = tmp_path_factory.mktemp("checkpoints") / "walker"
    return export(fresh(), target, skeleton=BODY, windows=windows(), budget=BUDGET, validation=VALIDATION)


@pytest.fixture
def shelf(exported, tmp_path, monkeypatch) -> Path:
    """A folder of checkpoints that is looked in, and nothing else that is installed."""
    for folder in ("here/walker", "here/runner", "data/motionmend/models/sleeper"):
        shutil.copytree(exported, tmp_path / folder)
    monkeypatch.setenv("MOTIONMEND_MODELS", str(tmp_path / "here"))
    monkeypatch.setattr(checkpoints, "_data_folder", lambda: tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    return tmp_path


# Names


def test_names_are_looked_up_in_order(shelf, exported, monkeypatch):
    assert {"walker", "runner", "sleeper"} <= set(checkpoints.names())
    assert checkpoints.find("sleeper") == shelf / "data" / "motionmend" / "models" / "sleeper"
    assert checkpoints.find("walker") == shelf / "here" / "walker"
    monkeypatch.setenv("MOTIONMEND_MODELS", f"{exported.parent}:{shelf / 'here'}".replace(":", checkpoints.os.pathsep))
    assert checkpoints.find("walker") == exported and checkpoints.find("runner") == shelf / "here" / "runner"
    assert [path.name for path in checkpoints.installed()] == sorted(checkpoints.names())


def test_a_path_is_a_checkpoint_or_a_run_that_exported_one(shelf, exported):
    assert checkpoints.find(exported) == exported
    shutil.copytree(exported, shelf / "runs" / "long" / "export")
    assert checkpoints.find("runs/long") == Path("runs/long/export")
    assert checkpoints.load("runs/long").name == "long"
    assert mm.load_completer(shelf / "runs" / "long").name == "long"


def test_a_folder_of_runs_can_be_searched_by_the_names_of_the_runs(shelf, exported, monkeypatch, capsys):
    shutil.copytree(exported, shelf / "runs" / "long" / "export")
    (shelf / "runs" / "linked").symlink_to(exported)
    (shelf / "runs" / ".half.part").mkdir()
    monkeypatch.setenv("MOTIONMEND_MODELS", str(shelf / "runs"))
    assert {"long", "linked"} <= set(checkpoints.names()) and ".half.part" not in checkpoints.names()
    assert checkpoints.find("long") == shelf / "runs" / "long" / "export"
    assert mm.load_completer("linked").name == "linked"
    (shelf / "runs" / "long" / "export" / "model.onnx").write_bytes(b"")
    assert main(["models"]) == 1
    told = capsys.readouterr()
    assert "linked" in told.out and "model.onnx: the file is not the one that was exported" in told.err


def test_what_is_no_checkpoint_is_named(shelf, monkeypatch):
    there = "convae, mend, runner, sleeper, trajevae, walker, xmae, xmae-denoise"
    listed = rf"no network or checkpoint is named 'walkr'.*Installed: {there}; did you mean walker"
    with pytest.raises(InputError, match=listed):
        checkpoints.find("walkr")
    with pytest.raises(InputError, match=r"here: this folder holds no config\.json"):
        checkpoints.find("here")
    with pytest.raises(InputError, match="expected the checkpoint's folder"):
        checkpoints.find("here/walker/model.onnx")
    monkeypatch.setattr(checkpoints, "folders", list)
    with pytest.raises(InputError, match="No network is installed"):
        checkpoints.find("walker")


# Damage


@pytest.mark.parametrize("name", ["model.onnx", "model.safetensors", "README.md"])
@pytest.mark.parametrize("harm", ["changed", "cut", "lost"])
def test_a_damaged_file_is_named(shelf, name, harm):
    file = shelf / "here" / "walker" / name
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    if harm == "lost":
        file.unlink()
    else:
        file.write_bytes(content if harm == "changed" else file.read_bytes()[:-7])
    with pytest.raises(InputError, match=rf"{name}: (the file is not the one|the checkpoint lacks)"):
        mm.load_completer("walker")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda text: text[: len(text) // 2], "damaged, or no checkpoint's"),
        (lambda _: "[1]", "damaged, or no checkpoint's"),
        (lambda _: "\x00\xff", "damaged, or no checkpoint's"),
        (lambda text: text.replace('"version": 1', '"version": 2'), "version 2; expected version 1"),
        (lambda text: text.replace('"frames": 16', '"frames": "many"'), "damaged"),
        (lambda text: text.replace('"parents"', '"ancestors"'), "damaged"),
        (lambda text: text.replace('"sha256"', '"md5"'), "damaged"),
        (lambda text: text.replace('"floor_mean"', '"hyperspace"'), "its space 'hyperspace' is not known"),
    ],
    ids=range(8),
)
def test_a_damaged_config_is_named(shelf, spoil, message):
    config = shelf / "here" / "walker" / "config.json"
    config.write_text(spoil(config.read_text("utf-8")), "latin-1", errors="replace")
    with pytest.raises(InputError, match=rf"config\.json: {message}"):
        mm.load_completer("walker")


def test_weights_of_other_code_are_refused(shelf):
    config = shelf / "here" / "walker" / "config.json"
    for old, new in (('"hidden": 8', '"hidden": 9'), ('"hidden"', '"width"')):
        whole = config.read_text("utf-8")
        config.write_text(whole.replace(old, new), "utf-8")
        with pytest.raises(InputError, match="does not fit these weights"):
            checkpoints.load_network("walker")
        config.write_text(whole, "utf-8")
    assert isinstance(checkpoints.load_network("walker"), Tiny)


# Writing


def test_an_existing_folder_is_replaced_only_by_force(exported, tmp_path):
    target = tmp_path / "mine"
    target.mkdir()
    (target / "diary.txt").write_text("precious")
    with pytest.raises(InputError, match=r"mine: the folder exists.*--force"):
        export(fresh(), target, skeleton=BODY, windows=windows())
    assert (target / "diary.txt").read_text() == "precious"
    export(fresh(1), target, skeleton=BODY, windows=windows(), force=True)
    assert sorted(each.name for each in target.iterdir()) == sorted(each.name for each in exported.iterdir())
    assert [each.name for each in tmp_path.iterdir()] == ["mine"]


class TwoFaced(Tiny):
    """Answers a centimetre higher once it is exported."""

    name = "two-faced"

    def forward(self, positions, observed):
        return super().forward(positions, observed) + (0.01 if torch.compiler.is_exporting() else 0.0)


def test_a_graph_that_answers_otherwise_is_not_written(tmp_path):
    network = TwoFaced(Tiny.Config(), len(BODY))
    with pytest.raises(InputError, match=r"differs from the network's by 0\.01 m"):
        export(network, tmp_path / "two-faced", skeleton=BODY, windows=windows())
    assert list(tmp_path.iterdir()) == []


def test_weights_beyond_half_precision_are_refused(tmp_path):
    network = fresh()
    with torch.no_grad():
        network.inward.bias[2] = 1e5
    with pytest.raises(InputError, match=r"inward\.bias holds numbers that half precision does not"):
        export(network, tmp_path / "large", skeleton=BODY, windows=windows())
    assert list(tmp_path.iterdir()) == []


def test_export_leaves_the_network_as_it_is(tmp_path):
    network = fresh().train()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    export(network, tmp_path / "mine", skeleton=BODY, windows=windows(1))
    assert network.training
    assert all(torch.equal(before[name], value) for name, value in network.state_dict().items())


def test_the_config_tells_what_it_is(exported):
    config = json.loads((exported / "config.json").read_text("utf-8"))
    assert config["network"] == "tiny:Tiny" and config["space"] == "floor_mean" and config["fps"] == 30
    assert config["budget"] == BUDGET and config["validation"] == VALIDATION
    assert config["inputs"] == {"positions": ["batch", "frames", 21, 3], "observed": ["batch", "frames", 21]}
    checkpoint = checkpoints.load(exported)
    assert checkpoint.description.skeleton == BODY and checkpoint.config == {
        "hidden": 8, "kernel": 5, "masked": 0.3, "turned": True,
    }  # fmt: skip
    assert checkpoint.summary == "1,200 steps of 16 windows in 1 h 30 min on 2 cores (made.corpus)"
    further = replace(checkpoint, budget=BUDGET | {"began with": "first: 10 steps"})
    assert further.summary == checkpoint.summary + " from first: 10 steps"


def test_the_card_tells_data_licence_budget_and_results(exported):
    card = (exported / "README.md").read_text("utf-8")
    _, front, body = card.split("---\n", 2)
    keys = dict(line.split(": ", 1) for line in front.splitlines())
    assert json.loads(keys["license_name"]) == "CC-BY-NC-4.0" and json.loads(keys["datasets"]) == ["made.corpus"]
    row = "| MPJPE, root-relative, 0.5 s, mm | 41.25 |"
    for told in ('Nobody: "made" up', "CC-BY-NC-4.0", "steps: 1,200", row, "made.corpus"):
        assert told in body
    assert 'mm.load_completer("walker")' in body


def test_the_card_of_a_run_goes_by_its_name_and_says_what_was_chosen_how(tmp_path):
    (tmp_path / "run").mkdir()
    spent = {**BUDGET, "steps": 200, "steps of the run": 300, "seconds": 162, "validated by": "protocol xmae; in mm"}
    spent["beside"] = {"hermite": {"MPJPE, root-relative, 0.5 s, mm": 30.5}}
    folder = tmp_path / "run" / "export"
    export(fresh(), folder, skeleton=BODY, windows=windows(), budget=spent, validation=VALIDATION)
    card = (folder / "README.md").read_text("utf-8")
    assert "# run\n" in card and 'mm.load_completer("run")' in card
    assert "- steps: 200, the best by validation of a run of 300\n" in card
    assert "- time: 2 min 42 s, all of the run\n" in card
    assert "By protocol xmae; in mm.\n\n| validation | this network | hermite |" in card
    assert "| MPJPE, root-relative, 0.5 s, mm | 41.25 | 30.5 |" in card and "beside" not in card
    summary = checkpoints.load(tmp_path / "run").summary
    assert summary.startswith("200 steps (the best of 300) of 16 windows in 2 min 42 s on ")


def test_a_card_says_what_it_was_not_told():
    facts = {
        "network": "pkg:Net", "fps": 30.0, "frames": 15, "skeleton": {"names": ["a"]}, "config": {}, "budget": {},
        "validation": {}, "parity": 0.0, "parameters": 10, "generative": True,
    }  # fmt: skip
    facts["budget"] = {"licence": ""}
    card = write_card(facts, "pkg:Net")
    assert "# pkg:Net" in card and "Licence of the data: not told" in card and "It was not validated." in card
    assert "completer.sample(" in card


@pytest.mark.parametrize(
    ("platform", "variable", "value", "expected"),
    [
        ("linux", "XDG_DATA_HOME", "", ".local/share"),
        ("linux", "XDG_DATA_HOME", "/mine", "/mine"),
        ("darwin", "XDG_DATA_HOME", "/mine", "Library/Application Support"),
        ("win32", "LOCALAPPDATA", "/app", "/app"),
    ],
)
def test_a_users_folder_is_where_the_system_keeps_data(platform, variable, value, expected, monkeypatch):
    monkeypatch.setattr(checkpoints.sys, "platform", platform)
    monkeypatch.setenv(variable, value)
    assert checkpoints.folders()[-2] == Path.home() / expected / "motionmend" / "models"
