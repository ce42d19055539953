"""Training: a known optimum is reached, a kill costs nothing, and many processes see what one would."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from motionmend.cli.main import main  # noqa: E402
from motionmend.cli.train import parsed  # noqa: E402
from motionmend.corpora.corpus import ClipInfo, Corpus  # noqa: E402
from motionmend.corpora.writing import write_corpus  # noqa: E402
from motionmend.errors import InputError  # noqa: E402
from motionmend.motion import Motion, Skeleton  # noqa: E402
from motionmend.training import config, logs, state  # noqa: E402
from motionmend.training.config import Settings  # noqa: E402
from motionmend.training.logs import Journal  # noqa: E402
from motionmend.training.loop import train  # noqa: E402
from toys import Line, line_corpus, no_scores, settings, trained  # noqa: E402

SUPPORT = Path(__file__).parents[1] / "support"


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    return line_corpus(tmp_path_factory.mktemp("corpus") / "line.corpus")


def same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def logged(folder: Path) -> list[dict]:
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [row for row in rows if "loss" in row]


@contextmanager
def process(folder: Path, corpus: Path, *launcher: str, stop: str = "", **options) -> Iterator[subprocess.Popen]:
    """Training in a process of its own, or in several by a launcher; gone afterwards, whatever happened.

    stop : when it is to send itself which signal, as `toys` reads it.
    """
    pairs = [f"{key}={value!r}" for key, value in options.items()]
    own = {"PYTHONPATH": str(SUPPORT), "CUDA_VISIBLE_DEVICES": "", "OMP_NUM_THREADS": "1", "TOYS_STOP": stop}
    child = subprocess.Popen(
        [sys.executable, *launcher, str(SUPPORT / "toys.py"), str(folder), str(corpus), *pairs],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | own, start_new_session=True,
    )  # fmt: skip
    with child:
        try:
            yield child
        finally:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)


# The optimum, and what stopping does to it


def test_reaches_the_least_squares_optimum(tmp_path, corpus):
    # 119 is odd, so a batch is one block, and as large as the data.
    tensors = trained(tmp_path / "run", corpus, steps=1000, batch=119, lr=0.1, ema=0.0, clip=0.0, log_every=500)
    opened = Corpus.open(corpus)
    positions, _ = opened.windows(opened.starts("train", 2, 1), 2)
    given = np.column_stack([positions[:, 0, :2].reshape(-1, 6), np.ones(len(positions))]).astype(float)
    best, *_ = np.linalg.lstsq(given, positions[:, 1, 0].astype(float), rcond=None)
    found = np.column_stack([tensors["network.line.weight"][:, :6], tensors["network.line.bias"]]).T
    assert np.abs(best).max() > 0.5
    assert np.allclose(found, best, atol=5e-3)


@pytest.mark.parametrize(("stop", "last"), [("137:SIGKILL", 133), ("211:SIGTERM", 212)])
def test_a_run_that_was_stopped_ends_as_one_that_was_not(tmp_path, corpus, stop, last):
    often = {"checkpoint_every": 7, "validate_every": 50, "log_every": 10}
    options = {"steps": 300, "batch": 16, "network": {"dropout": 0.2}, **often}
    whole = trained(tmp_path / "whole", corpus, **options)
    expected = {row["step"]: row for row in logged(tmp_path / "whole")}
    folder = tmp_path / "stopped"
    with process(folder, corpus, stop=stop, **options) as child:
        said = child.communicate()[0]
    # Killed, it has its last checkpoint; asked to end, it ends its step and saves.
    assert int(state.load(folder / "last.safetensors")[1]["done"]) == last
    if stop.endswith("SIGTERM"):
        assert child.returncode == 143
        assert "--resume" in said
    else:
        assert child.returncode == -signal.SIGKILL
    # What a kill in the middle of writing would have left.
    (folder / ".last.safetensors.part").write_bytes((folder / "last.safetensors").read_bytes()[:100])
    with (folder / "log.jsonl").open("a") as log:
        log.write('{"step": 290, "loss": 1e9}\n{"step": 29')
    assert same(whole, trained(folder, corpus, resume=True, **options))
    rows = {row["step"]: row for row in logged(folder)}
    assert list(rows) == sorted(rows) and len(rows) == len(logged(folder))
    # The mean that was interrupted is over fewer steps; all later lines are the same.
    later = [step for step in rows if step > last + 10]
    assert later[-1] == 300 and later == [step for step in expected if step > last + 10]
    for step in later:
        assert all(rows[step][name] == expected[step][name] for name in ("loss", "lr", "norm"))
    assert state.load(folder / "best.safetensors")[1] == state.load(tmp_path / "whole/best.safetensors")[1]


def test_validations_and_checkpoints_change_no_weight(tmp_path, corpus):
    options = {"steps": 30, "network": {"dropout": 0.2}, "log_every": 100}
    seldom = trained(tmp_path / "seldom", corpus, validate_every=0, checkpoint_every=0, **options)
    assert same(seldom, trained(tmp_path / "often", corpus, validate_every=1, checkpoint_every=1, **options))


def test_two_processes_give_the_losses_of_one(tmp_path, corpus):
    options = {"steps": 40, "log_every": 1}
    launcher = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
    with process(tmp_path / "two", corpus, *launcher, **options) as child:
        one = trained(tmp_path / "one", corpus, **options)
        said = child.communicate()[0]
    assert child.returncode == 0, said
    assert "2 processes" in said
    two = state.load(tmp_path / "two" / "last.safetensors")[0]
    alone, shared = logged(tmp_path / "one"), logged(tmp_path / "two")
    # 64 rows: sums of frame numbers and of coins are exact in float32, so the samples were the same.
    assert [(row["which"], row["chance"]) for row in alone] == [(row["which"], row["chance"]) for row in shared]
    assert np.allclose([row["loss"] for row in alone], [row["loss"] for row in shared], rtol=1e-5)
    assert all(torch.allclose(one[name], two[name], rtol=1e-4, atol=1e-6) for name in one)


def test_worker_processes_make_the_samples_that_a_thread_makes(tmp_path, corpus):
    alone = trained(tmp_path / "thread", corpus, steps=12)
    assert same(alone, trained(tmp_path / "process", corpus, steps=12, workers=1))


def test_a_loss_that_is_no_number_stops_the_run_and_loses_nothing(tmp_path, corpus):
    folder = tmp_path / "run"
    with pytest.raises(InputError, match=r"loss is (nan|inf) in step 31"):
        trained(folder, corpus, steps=40, checkpoint_every=0, network={"bad_at": 30})
    tensors, metadata = state.load(folder / "last.safetensors")
    assert metadata["done"] == "30"
    assert all(torch.isfinite(each).all() for each in tensors.values())
    good = trained(tmp_path / "good", corpus, steps=30, schedule="constant", warmup=0.0)
    with pytest.raises(InputError):
        trained(tmp_path / "bad", corpus, steps=40, schedule="constant", warmup=0.0, network={"bad_at": 30})
    assert same(good, state.load(tmp_path / "bad" / "last.safetensors")[0])


def test_what_a_network_gets_wrong_is_named(tmp_path, corpus, monkeypatch):
    with pytest.raises(InputError, match=r"toys:Line: 'wanted' of the batch of step 4 has NaN"):
        trained(tmp_path / "hole", corpus, steps=5, network={"hole_at": 3})
    assert state.load(tmp_path / "hole" / "last.safetensors")[1]["done"] == "3"
    monkeypatch.setattr(Line, "loss", lambda *given: {"error": given[1]["which"]})
    with pytest.raises(InputError, match=r'its losses are error; expected one named "loss"'):
        trained(tmp_path / "nameless", corpus, steps=5)


def test_bf16_and_copies_of_checkpoints(tmp_path, corpus):
    full = trained(tmp_path / "fp32", corpus, steps=20, precision="fp32")
    half = trained(tmp_path / "bf16", corpus, steps=20, precision="bf16", checkpoint_every=5, keep=2)
    assert all(each.dtype == torch.float32 for each in half.values())
    assert 0 < (full["network.line.weight"] - half["network.line.weight"]).abs().max() < 0.05
    kept = sorted(each.name for each in (tmp_path / "bf16").glob("step-*"))
    assert kept == ["step-000000015.safetensors", "step-000000020.safetensors"]
    assert not list(tmp_path.glob("*/.*"))


# Resuming


def test_a_folder_in_use_is_left_alone(tmp_path, corpus):
    folder = tmp_path / "run"
    trained(folder, corpus, steps=5)
    before = (folder / "last.safetensors").read_bytes()
    with pytest.raises(InputError, match=r"a run is there already.*--resume"):
        trained(folder, corpus, steps=5)
    assert (folder / "last.safetensors").read_bytes() == before
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "a.txt").write_text("dear")
    for resume in (False, True):
        with pytest.raises(InputError, match="this is not a run"):
            trained(tmp_path / "letters", corpus, steps=5, resume=resume)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"batch": 32}, "batch is 32 and was 64"),
        ({"seed": 1}, "seed is 1 and was 0"),
        ({"network": {"dropout": 0.5}}, r"network.dropout is 0.5 and was 0.0"),
        ({"steps": 50}, "steps is 50 and was 10"),  # a longer cosine would have had other learning rates so far
        ({"steps": 9}, "steps is 9 and was 10"),
    ],
)
def test_a_run_is_not_gone_on_with_otherwise(tmp_path, corpus, options, named):
    trained(tmp_path / "run", corpus, steps=10)
    with pytest.raises(InputError, match=named):
        trained(tmp_path / "run", corpus, resume=True, **{"steps": 10, **options})


def test_a_run_is_gone_on_with_as_it_was_begun_whatever_its_config_says_now(tmp_path, corpus):
    trained(tmp_path / "run", corpus, steps=10, schedule="constant")
    file = tmp_path / "run" / "config.toml"
    file.write_text(file.read_text().replace("lr = 0.02", "lr = 0.01"))
    changed = parsed(["train", "toys:Line", "-o", str(tmp_path / "run"), "--resume"])
    assert changed.lr == 0.01
    with pytest.raises(InputError, match=r"lr is 0.01 and was 0.02"):
        trained(tmp_path / "run", corpus, steps=10, schedule="constant", resume=True, lr=changed.lr)


def test_a_run_that_never_came_to_a_checkpoint_is_begun_anew(tmp_path, corpus):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.toml").write_text(config.write(settings(corpus, batch=3)))
    with pytest.raises(InputError, match=r"a run is there already.*--resume"):
        trained(folder, corpus, steps=5)
    anew = trained(folder, corpus, steps=5, resume=True)
    assert same(anew, trained(tmp_path / "other", corpus, steps=5))
    assert config.read(folder / "config.toml", "toys:Line")["precision"] in ("fp32", "bf16")


def test_a_run_is_not_gone_on_with_on_other_data(tmp_path, corpus):
    trained(tmp_path / "run", corpus, steps=10)
    other = line_corpus(tmp_path / "line.corpus", seed=1)
    with pytest.raises(InputError, match="the data is line"):
        trained(tmp_path / "run", other, steps=10, resume=True)


def test_a_constant_schedule_can_be_prolonged(tmp_path, corpus):
    same_so_far = {"schedule": "constant", "warmup": 0.0}
    long = trained(tmp_path / "long", corpus, steps=30, **same_so_far)
    trained(tmp_path / "grown", corpus, steps=10, **same_so_far)
    grown = trained(tmp_path / "grown", corpus, steps=30, resume=True, checkpoint_every=3, **same_so_far)
    assert same(long, grown)
    assert config.read(tmp_path / "grown" / "config.toml", "toys:Line")["steps"] == 30


def test_a_finished_run_is_exported_again(tmp_path, corpus):
    done = trained(tmp_path / "run", corpus, steps=10)
    log = (tmp_path / "run" / "log.jsonl").read_bytes()
    exports = []

    def export(network, folder, corpora, spent, scores):
        exports.append((folder, spent["steps"], scores, network.line.weight.detach()))

    chosen = parsed(["train", "toys:Line", "-o", str(tmp_path / "run"), "--resume"])
    again = Settings(**{field.name: getattr(chosen, field.name) for field in fields(Settings)})
    assert train(again, tmp_path / "run", resume=True, validate=no_scores, export=export) == 0
    [(folder, steps, scores, weight)] = exports
    assert (folder, steps, list(scores)) == (tmp_path / "run" / "export", 10, ["height"])
    assert torch.equal(weight, done["ema.line.weight"])
    assert (tmp_path / "run" / "log.jsonl").read_bytes() == log


def test_a_damaged_checkpoint_is_named(tmp_path, corpus):
    trained(tmp_path / "run", corpus, steps=5)
    path = tmp_path / "run" / "last.safetensors"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(InputError, match=r"last\.safetensors: the checkpoint is damaged"):
        trained(tmp_path / "run", corpus, steps=5, resume=True)
    (tmp_path / "run" / "best.safetensors").rename(path)
    with pytest.raises(InputError, match=r"last\.safetensors: this is not a run's last checkpoint"):
        trained(tmp_path / "run", corpus, steps=5, resume=True)


def test_the_time_left_counts_what_validations_take(tmp_path, monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(logs.time, "perf_counter", lambda: now[0])
    journal = Journal(tmp_path, first=0, steps=1000, every=10)
    now[0] = 60.0  # to compile
    for done in range(1, 112):
        journal.step(done, {"loss": 1.0}, 1e-3, 0.0)
        now[0] += 1.0
        if done % 10 == 0:
            now[0] += 10.0
            journal.pause(10.0)
    journal.close()
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("step 111/1,000") and "1 steps/s" in line
    assert line.endswith("29 min 38 s left")  # 889 steps of 1 s each, and 10 s after every tenth


# All of it


def test_the_command_trains_validates_draws_and_exports(tmp_path, capfd):
    rng = np.random.default_rng(0)
    places = np.cumsum(0.01 * rng.normal(size=(80, 3, 3)), axis=0).astype(np.float32)
    motion = Motion(places, np.ones((80, 3), bool), 30.0, Skeleton(("hips", "spine", "chest"), (-1, 0, 1)))
    clips = [(ClipInfo(split, split=split, licence="CC0-1.0"), motion) for split in ("train", "validation")]
    write_corpus(tmp_path / "a.corpus", name="a", fps=30.0, skeleton=motion.skeleton, licence="CC0-1.0", clips=clips)
    run = tmp_path / "run"
    said = ["train", "tiny:Tiny", "--corpus", str(tmp_path / "a.corpus"), "-o", str(run), "--steps", "6"]
    assert main([*said, "--validate-every", "3"]) == 0
    told = capfd.readouterr().err
    assert "validation by loss" in told
    assert f"are in {run}/export" in told
    from motionmend.networks.checkpoints import load

    checkpoint = load(run)
    assert checkpoint.budget["batch"] == 16
    assert checkpoint.budget["corpus"] == "a"
    assert checkpoint.budget["data sha256"] == Corpus.open(tmp_path / "a.corpus").sha256
    assert checkpoint.validation["loss"] > 0
    assert [path.name for path in sorted((run / "samples").iterdir())] == ["000000003.png", "000000006.png"]
    rows = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows if "validation" in row] == [3, 6]


# What a run begins with


def test_a_network_is_shown_training_windows_once_before_it_trains(tmp_path, corpus, monkeypatch):
    shown = []
    monkeypatch.setattr(Line, "measure", lambda *of: shown.append(of[1]), raising=False)
    trained(tmp_path / "run", corpus, steps=3)
    trained(tmp_path / "run", corpus, steps=3, resume=True)
    opened = Corpus.open(corpus)
    frames = {float(window[0, -1, 1]) for window in opened.windows(opened.starts("train", 2, 1, pad=True), 2)[0]}
    assert len(shown) == 1 and {float(window[0, -1, 1]) for window in shown[0]} <= frames


def test_training_can_begin_with_the_weights_of_a_checkpoint(tmp_path):
    pytest.importorskip("onnx")
    from motionmend.body.joints import BODY
    from motionmend.networks.export import export, halved
    from motionmend.training import runs
    from tiny import Tiny, TinyConfig
    from walks import walk

    torch.manual_seed(1)
    source, positions = Tiny(TinyConfig(), 21), walk(30.0).positions[None, :16].repeat(2, axis=0)
    export(source, tmp_path / "start", skeleton=BODY, windows=(positions, np.ones((2, 16, 21), bool)))
    chosen = Settings(name="tiny:Tiny", start=str(tmp_path / "start"))
    torch.manual_seed(2)
    network = Tiny(TinyConfig(), 21)
    runs.begin(network, chosen, [])
    assert same(network.state_dict(), halved(source).state_dict())
    with pytest.raises(InputError, match=r"not weights of this tiny.*hidden 8"):
        runs.begin(Tiny(TinyConfig(hidden=4), 21), chosen, [])
    with pytest.raises(InputError, match="no network or checkpoint is named"):
        runs.begin(network, Settings(name="tiny:Tiny", start="nowhere"), [])
