"""Training: a known optimum is reached, a kill costs nothing, and many processes see what one would."""

from __future__ import annotations

import json
import math
import os
import random
import re
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from motionmend.cli import main  # noqa: E402
from motionmend.cli_train import parsed  # noqa: E402
from motionmend.corpus import ClipInfo, Corpus, write_corpus  # noqa: E402
from motionmend.errors import InputError  # noqa: E402
from motionmend.motion import Motion, Skeleton  # noqa: E402
from motionmend.training import config, state  # noqa: E402
from motionmend.training.batches import Ahead, Batches, share  # noqa: E402
from motionmend.training.config import Settings, rate  # noqa: E402
from motionmend.training.logs import cut_back, span  # noqa: E402
from motionmend.training.loop import train  # noqa: E402
from toys import Line, LineConfig, no_export, no_scores, settings  # noqa: E402

HERE = Path(__file__).parent
CLOUD = Skeleton.cloud(["one", "two", "frame"])


def noisy_line(frames: int, seed: int) -> Motion:
    """The first joint follows the frame before linearly, but for noise; the last one's height is the frame's number."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(frames, 3, 3))
    rule = rng.normal(size=(6, 3))
    for frame in range(1, frames):
        positions[frame, 0] = 0.3 * positions[frame - 1, :2].ravel() @ rule + [1, -1, 2] + rng.normal(size=3) * 0.2
    positions[:, 2] = [[0, frame, 0] for frame in range(frames)]
    return Motion(positions.astype(np.float32), np.ones((frames, 3), bool), 30.0, CLOUD)


def line_corpus(path: Path, frames: int = 120, seed: int = 0, fps: float = 30.0) -> Path:
    motion = replace(noisy_line(frames, seed), fps=fps)
    clips = [(ClipInfo(split, split=split), motion) for split in ("train", "validation")]
    write_corpus(path, name=path.stem, fps=fps, skeleton=CLOUD, clips=clips)
    return path


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """As in the processes that are started here: the sums of several threads may differ in their last bits."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    return line_corpus(tmp_path_factory.mktemp("corpus") / "line.corpus")


def trained(folder: Path, corpus: Path, *, resume: bool = False, **options) -> dict[str, torch.Tensor]:
    """Train in this process; all tensors of the last checkpoint."""
    status = train(settings(corpus, **options), folder, resume=resume, validate=no_scores, export=no_export)
    assert status == 0
    return state.load(folder / "last.safetensors")[0]


def same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def logged(folder: Path) -> list[dict]:
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [row for row in rows if "loss" in row]


def process(folder: Path, corpus: Path, *launcher: str, **options) -> subprocess.Popen:
    """Training in a process of its own, or in several by a launcher."""
    pairs = [f"{key}={value!r}" for key, value in options.items()]
    return subprocess.Popen(
        [sys.executable, *launcher, str(HERE / "toys.py"), str(folder), str(corpus), *pairs],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=os.environ | {"PYTHONPATH": str(HERE), "ACCELERATE_USE_CPU": "true", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip


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


@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGTERM], ids=lambda stop: stop.name)
def test_a_run_that_was_stopped_ends_as_one_that_was_not(tmp_path, corpus, stop):
    network = {"dropout": 0.2, "nap": 0.002}
    often = {"checkpoint_every": 7, "validate_every": 50, "log_every": 10}
    options = {"steps": 300, "batch": 16, "network": network, **often}
    whole = trained(tmp_path / "whole", corpus, **options)
    folder, delay = tmp_path / "stopped", random.uniform(0, 0.5)
    child = process(folder, corpus, **options)
    while not (folder / "last.safetensors").exists():
        assert child.poll() is None, child.stdout.read()
        time.sleep(0.01)
    time.sleep(delay)
    child.send_signal(stop)
    said = child.communicate(timeout=60)[0]
    done = int(state.load(folder / "last.safetensors")[1]["done"])
    assert 0 < done < 300, f"stopped after {delay} s"
    if stop == signal.SIGTERM:
        assert child.returncode == 143
        assert "--resume" in said
    # What a kill in the middle of writing would have left.
    (folder / ".last.safetensors.part").write_bytes((folder / "last.safetensors").read_bytes()[:100])
    with (folder / "log.jsonl").open("a") as log:
        log.write('{"step": 290, "loss": 1e9}\n{"step": 29')
    assert same(whole, trained(folder, corpus, resume=True, **options))
    steps = [row["step"] for row in logged(folder)]
    assert steps == sorted(set(steps))
    expected = {row["step"]: row for row in logged(tmp_path / "whole")}
    # The mean that was interrupted is over fewer steps; all later lines are the same.
    for row in logged(folder):
        if row["step"] > done + 10:
            assert all(row[name] == expected[row["step"]][name] for name in ("loss", "lr", "norm"))
    assert state.load(folder / "best.safetensors")[1] == state.load(tmp_path / "whole/best.safetensors")[1]


def test_two_processes_give_the_losses_of_one(tmp_path, corpus):
    options = {"steps": 40, "log_every": 1}
    launcher = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
    child = process(tmp_path / "two", corpus, *launcher, **options)
    one = trained(tmp_path / "one", corpus, **options)
    said = child.communicate(timeout=100)[0]
    assert child.returncode == 0, said
    assert "2 processes" in said
    two = state.load(tmp_path / "two" / "last.safetensors")[0]
    alone, shared = logged(tmp_path / "one"), logged(tmp_path / "two")
    # 64 rows: sums of frame numbers and of coins are exact in float32, so the samples were the same.
    assert [(row["which"], row["chance"]) for row in alone] == [(row["which"], row["chance"]) for row in shared]
    assert np.allclose([row["loss"] for row in alone], [row["loss"] for row in shared], rtol=1e-5)
    assert all(torch.allclose(one[name], two[name], rtol=1e-4, atol=1e-6) for name in one)


def test_processes_that_cannot_share_equally_are_refused():
    assert [share(64, rank, 4) for rank in range(4)] == [(0, 16), (16, 32), (32, 48), (48, 64)]
    with pytest.raises(InputError, match="3 processes"):
        share(64, 0, 3)


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


# Settings


def test_flags_win_over_the_file_and_the_file_over_the_networks_defaults(tmp_path):
    file = tmp_path / "some.toml"
    file.write_text("lr = 1\nbatch = 7\n[network]\ndropout = 0.25\n")
    said = ["train", "toys:Line", "--corpus", "a.corpus", "b.corpus", "-o", str(tmp_path / "run")]
    plain = parsed(said)
    assert (plain.batch, plain.lr, plain.steps) == (64, 0.02, Settings(name="x").steps)
    assert plain.network == LineConfig(sizes=(3,))
    assert plain.corpus == ("a.corpus", "b.corpus")
    by_file = parsed([*said, "--config", str(file)])
    assert (by_file.batch, by_file.lr, by_file.network.dropout) == (7, 1.0, 0.25)
    by_flag = parsed([*said, "--config", str(file), "--batch", "9", "--network.dropout", "0.5"])
    assert (by_flag.batch, by_flag.lr, by_flag.network) == (9, 1.0, LineConfig(dropout=0.5, sizes=(3,)))


def test_resume_goes_on_with_the_settings_of_the_run(tmp_path, corpus):
    trained(tmp_path / "run", corpus, steps=5, batch=32, betas=(0.8, 0.9), network={"sizes": [4, 5]})
    found = parsed(["train", "toys:Line", "-o", str(tmp_path / "run"), "--resume"])
    assert (found.steps, found.batch, found.betas, found.network.sizes) == (5, 32, (0.8, 0.9), (4, 5))
    assert found.corpus == (str(corpus),)


def test_settings_come_back_from_toml(tmp_path):
    given = settings("my corpora/a.corpus", betas=[0.1, 0.2], schedule="step", network={"dropout": 0.125})
    path = tmp_path / "config.toml"
    path.write_text(config.write(given))
    assert config.settle("toys:Line", Line, config.read(path, "toys:Line")) == given


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        ("stepz = 3", r"some\.toml: there is no option 'stepz'.*steps"),
        ("[network]\ndropuot = 0.1", r"there is no option 'dropuot'.*dropout"),
        ('lr = "high"', "lr is 'high'.*float"),
        ("steps = 2.5", "steps is 2.5.*int"),
        ("compile = 1", "compile is 1.*bool"),
        ("betas = [0.9]", "betas has 1 values"),
        ('schedule = "cosin"', "schedule is 'cosin'.*cosine, constant, step"),
        ('name = "xmae"', "these settings are for 'xmae'"),
        ("network = 3", "network is not a table"),
        ("steps = ", "not TOML"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path, toml, said):
    file = tmp_path / "some.toml"
    file.write_text(toml)
    with pytest.raises(InputError, match=said):
        parsed(["train", "toys:Line", "-o", "x", "--config", str(file)])


@pytest.mark.parametrize(
    "options", [{"steps": 0}, {"lr": 0.0}, {"warmup": 1.0}, {"ema": -0.1}, {"stride": 0}], ids=str
)
def test_numbers_that_cannot_be_meant_are_refused(tmp_path, corpus, options):
    with pytest.raises(InputError, match=next(iter(options))):
        trained(tmp_path / "run", corpus, **options)
    assert not (tmp_path / "run").exists()


def test_data_that_does_not_fit_is_refused_before_a_folder_is_made(tmp_path, corpus):
    with pytest.raises(InputError, match=r"60 frames a second.*--fps 30"):
        trained(tmp_path / "run", line_corpus(tmp_path / "fast.corpus", fps=60.0))
    with pytest.raises(InputError, match="no such corpus"):
        trained(tmp_path / "run", tmp_path / "absent.corpus")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [("nobody", "no network is named"), ("toys:Lime", "no 'Lime'"), ("nothing:Line", "no module 'nothing'"),
     ("json:loads", "not a network"), ("--steps", "the network")],
)  # fmt: skip
def test_a_network_that_is_not_there_is_named(capsys, name, said):
    assert main(["train", name, "-o", "x"]) == 1
    assert said in capsys.readouterr().err


def test_help_is_light_without_a_network_and_whole_with_one(capsys):
    code = (
        "import sys\nfrom motionmend.cli import main\n"
        "try:\n  main(['train', '--help'])\nfinally:\n  print('torch' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "--checkpoint-minutes" in ran.stdout
    assert ran.stdout.splitlines()[-1] == "False"
    with pytest.raises(SystemExit, match="0"):
        main(["train", "toys:Line", "--help"])
    said = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    assert "--network.dropout FLOAT" in said
    assert "--batch INT Windows a step, over all processes. (default: 64)" in said


def test_every_option_says_what_it_does(capsys):
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    said = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    for field in fields(Settings):
        if field.name not in ("name", "network"):
            flag = "--" + field.name.replace("_", "-")
            assert re.search(rf" {flag} [^-]*[A-Z][a-z]", said), flag


# Schedules, averages, batches


def test_schedules_by_hand():
    base = Settings(name="x", steps=100, warmup=0.1, lr=1.0)
    cosine = [rate(base, step) for step in (0, 4, 9, 10, 55, 99)]
    assert np.allclose(cosine, [0.1, 0.5, 1.0, 1.0, 0.5, math.sin(math.pi / 180) ** 2])
    assert [rate(replace(base, schedule="constant"), step) for step in (0, 10, 99)] == [0.1, 1.0, 1.0]
    falls = replace(base, schedule="step", step_every=30, warmup=0.0)
    assert [rate(falls, step) for step in (0, 29, 30, 59, 60, 90)] == [1, 1, 1 / 4, 1 / 4, 1 / 16, 1 / 64]
    assert rate(replace(base, warmup=0.0), 0) == 1.0


def test_the_average_of_weights_against_a_slow_twin():
    network = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.BatchNorm1d(2))
    average = state.Average(network, 0.9)
    slow = {name: value.double().numpy().copy() for name, value in network.state_dict().items()}
    for step in range(200):
        with torch.no_grad():
            for parameter in network.parameters():
                parameter += torch.randn(parameter.shape)
            network[1].num_batches_tracked += 1
        average.update(network, step)
        decay = 0.9 if step >= 80 else (1 + step) / (10 + step)
        for name, value in network.state_dict().items():
            slow[name] = decay * slow[name] + (1 - decay) * value.double().numpy()
    slow["1.num_batches_tracked"] = np.float64(200)
    for name, value in average.values.items():
        assert np.allclose(value.numpy(), slow[name], rtol=1e-4, atol=1e-5), name


@pytest.mark.parametrize("batch", [64, 48, 7])
def test_batches_are_a_pure_function_of_seed_and_step(corpus, batch):
    opened = Corpus.open(corpus)

    def batches(seed: int = 0) -> Batches:
        return Batches(Line(LineConfig(), 3), [opened], batch=batch, stride=1, seed=seed)

    blocks = math.gcd(batch, 64)
    first = batches()
    later = first.make(5)
    assert all(len(each) == batch for each in later.values())
    again = batches()
    for part in (again.make(5), glued([again.make(5, block, block + 1) for block in range(blocks)])):
        assert all(np.array_equal(part[name], later[name]) for name in later)
    assert not np.array_equal(first.make(6)["which"], later["which"])
    assert not np.array_equal(batches(1).make(5)["which"], later["which"])


def glued(parts: list[dict]) -> dict:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_batches_look_only_at_the_training_split_and_weigh_corpora_by_hours(tmp_path):
    paths = [line_corpus(tmp_path / "long.corpus", 300), line_corpus(tmp_path / "short.corpus", 100, seed=1)]
    corpora = [Corpus.open(path) for path in paths]
    # A stride gives the long one fewer windows a frame only if windows were counted rather than hours.
    batches = Batches(Line(LineConfig(), 3), corpora, batch=64, stride=7, seed=0)
    which, starts = batches.choose(np.random.default_rng(0).random((2, 5000)))
    assert abs((which == 0).mean() - 0.75) < 0.03
    for number, corpus in enumerate(corpora):
        mine = starts[which == number]
        assert set(mine) == set(corpus.starts("train", 2, 7))
        positions, _ = batches.windows(np.full(5, number), mine[:5])
        assert np.array_equal(positions, corpus.windows(mine[:5], 2)[0])


def test_ahead_gives_what_was_made_in_order_and_raises_what_was_raised():
    def make(step: int) -> int:
        if step == 12:
            raise KeyError("twelve")
        return step * step

    with Ahead(make, 3, 100, depth=2) as ahead:
        assert [ahead.next() for _ in range(3, 12)] == [step * step for step in range(3, 12)]
        with pytest.raises(KeyError, match="twelve"):
            ahead.next()
    with Ahead(lambda step: step, 0, 10**9) as ahead:
        assert ahead.next() == 0
    assert not ahead._thread.is_alive()


def test_waiting_is_measured():
    with Ahead(lambda _: time.sleep(0.05), 0, 3) as slow:
        for _ in range(3):
            slow.next()
    assert slow.waited > 0.1
    with Ahead(lambda _: None, 0, 3) as quick:
        time.sleep(0.3)
        for _ in range(3):
            quick.next()
    assert quick.waited < 0.05


# Logs


def test_a_log_is_cut_back(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text('{"step": 1}\n{"step": 2}\nrubbish\n{"step": 3}\n{"step": 2')
    cut_back(log, 2)
    assert log.read_text() == '{"step": 1}\n{"step": 2}\n'


def test_times_in_words():
    words = ["5 s", "1 min 0 s", "1 min 5 s", "1 h 1 min", "1 d 1 h"]
    assert [span(seconds) for seconds in (5, 59.9, 65, 3661, 90061)] == words


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
    from motionmend.checkpoints import load

    checkpoint = load(run)
    assert checkpoint.budget["batch"] == 16
    assert checkpoint.budget["corpus"] == "a"
    assert checkpoint.budget["data sha256"] == Corpus.open(tmp_path / "a.corpus").sha256
    assert checkpoint.validation["loss"] > 0
    assert [path.name for path in sorted((run / "samples").iterdir())] == ["000000003.png", "000000006.png"]
    rows = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows if "validation" in row] == [3, 6]
