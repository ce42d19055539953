"""What training is given: settings from four places, and batches that follow from them; what it logs."""

from __future__ import annotations

import dataclasses
import math
import re
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from motionmend.cli.main import main  # noqa: E402
from motionmend.cli.train import parsed  # noqa: E402
from motionmend.corpora.corpus import Corpus  # noqa: E402
from motionmend.errors import InputError  # noqa: E402
from motionmend.networks.checkpoints import span  # noqa: E402
from motionmend.training import batches, config, state  # noqa: E402
from motionmend.training.batches import Ahead, Batches, share  # noqa: E402
from motionmend.training.config import Settings, rate  # noqa: E402
from motionmend.training.logs import cut_back  # noqa: E402
from toys import Line, LineConfig, line_corpus, settings, trained  # noqa: E402


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    return line_corpus(tmp_path_factory.mktemp("corpus") / "line.corpus")


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


def test_the_same_command_with_resume_is_understood_whatever_its_switches_were(tmp_path, corpus):
    said = ["train", "xmae", "-o", str(tmp_path / "run"), "--corpus", str(corpus), "--network.mirror", "--no-compile"]
    first = parsed(said)
    (tmp_path / "run").mkdir()
    values = {each.name: getattr(first, each.name) for each in dataclasses.fields(config.Settings)}
    (tmp_path / "run" / "config.toml").write_text(config.write(config.Settings(**values)))
    again = parsed([*said, "--resume"])
    assert again.resume and first.network.mirror and again.network.mirror and not again.compile


# The papers' own numbers, typed off the papers and the authors' code, not taken from the package.
XMAE = {"batch": 128, "lr": 3e-4, "betas": (0.9, 0.999), "schedule": "cosine", "clip": 0, "ema": 0}
CONVAE = {"batch": 80, "lr": 1e-3, "betas": (0.9, 0.999), "schedule": "constant", "warmup": 0, "clip": 0, "ema": 0}
TRAJEVAE = {"batch": 64, "lr": 1e-4, "betas": (0.9, 0.99), "schedule": "step", "step_every": 80_000, "warmup": 0,
            "clip": 0, "ema": 0, "steps": 240_000}  # fmt: skip
PAPERS = [
    ("xmae", "h36m", XMAE | {"steps": 60_000}, {"codes": "shared", "structured": False, "masked": 0.85, "asked": 0}),
    ("xmae", "holden", XMAE | {"steps": 100_000}, {"codes": "shared", "structured": False, "displaced": 0.05}),
    ("xmae", "cmu", XMAE | {"steps": 100_000}, {"codes": "shared", "structured": False, "query_attention": True}),
    ("xmae", "amass", XMAE | {"steps": 240_000}, {"codes": "shared", "structured": False, "curves": ""}),
    *((name, data, TRAJEVAE, {}) for name in ("cvae-rnn", "infilling") for data in ("h36m", "cmu")),
    *(("trajevae", data, TRAJEVAE, {"xavier": True, "dropout": 0.1, "kl": 0.01}) for data in ("h36m", "cmu")),
    ("convae", "holden", CONVAE | {"steps": 58_704}, {"curriculum": 58_704, "error": "l1", "begin": "zeros"}),
    ("convae --network.curriculum 0", "holden", CONVAE | {"steps": 29_204}, {"curriculum": 0, "gap": 60}),
    ("convae --network.kind vanilla", "cmu", CONVAE | {"steps": 18_521}, {"curriculum": 0, "gap": 60}),
    ("holden", "holden", CONVAE | {"steps": 20_285, "lr": 1e-5}, {"curriculum": 0, "error": "l2", "dropout": 0.25}),
    ("holden", "amass", CONVAE | {"steps": 20_285, "lr": 1e-5}, {"features": 256, "width": 25}),
]


@pytest.mark.parametrize(("name", "data", "wanted", "network"), PAPERS)
def test_a_papers_own_training_is_one_word(tmp_path, name, data, wanted, network):
    found = parsed(["train", *name.split(), "--paper", data, "--corpus", "a.corpus", "-o", str(tmp_path / "run")])
    assert {key: getattr(found, key) for key in wanted} == wanted
    assert {key: getattr(found.network, key) for key in network} == network


@pytest.mark.parametrize(("data", "climb"), [("h36m", 1_200), ("holden", 2_200), ("amass", 5_000)])
def test_xmaes_rate_climbs_for_so_many_steps(tmp_path, data, climb):
    found = parsed(["train", "xmae", "--paper", data, "--corpus", "a.corpus", "-o", str(tmp_path / "run")])
    assert rate(found, climb - 2) < rate(found, climb - 1) == found.lr == rate(found, climb) > rate(found, climb + 100)


def test_flags_and_files_win_over_a_paper(tmp_path):
    file = tmp_path / "some.toml"
    file.write_text("batch = 7\n[network]\ncurriculum = 0\n")
    said = ["train", "convae", "--paper", "holden", "--corpus", "a.corpus", "-o", str(tmp_path / "run"), "--lr", "0.1"]
    by_file = parsed([*said, "--config", str(file)])
    assert (by_file.lr, by_file.batch, by_file.steps, by_file.network.curriculum) == (0.1, 7, 29_204, 0)


def test_steps_alone_scale_the_curriculum(tmp_path):
    file = tmp_path / "some.toml"
    file.write_text("steps = 300\n")
    said = ["train", "convae", "--corpus", "a.corpus", "-o", str(tmp_path / "run")]
    for words, steps, curriculum in (
        ([], 7_000, 7_000), (["--steps", "500"], 500, 500), (["--paper", "holden", "--steps", "900"], 900, 900),
        (["--config", str(file)], 300, 300), (["--config", str(file), "--steps", "400"], 400, 400),
        (["--steps", "500", "--network.curriculum", "80"], 500, 80),
        (["--steps", "500", "--network.curriculum", "0"], 500, 0),
    ):  # fmt: skip
        found = parsed([*said, *words])
        assert (found.steps, found.network.curriculum) == (steps, curriculum)
    assert parsed(["train", "holden", *said[2:], "--steps", "500"]).network.curriculum == 0


def test_a_network_without_a_paper_is_told_so(tmp_path, capsys):
    assert main(["train", "toys:Line", "--paper", "cmu", "--corpus", "a.corpus", "-o", str(tmp_path / "run")]) == 1
    assert "no paper says how to train toys:Line" in capsys.readouterr().err


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
        ('schedule = "cosin"', "schedule is 'cosin'.*cosine, constant, step, trapezoid"),
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


def test_a_file_of_options_that_is_not_there_is_named(tmp_path):
    for path, said in ((tmp_path / "no.toml", "no.toml: cannot be read: No such file"), (tmp_path, "a directory")):
        with pytest.raises(InputError, match=said):
            parsed(["train", "toys:Line", "-o", "x", "--config", str(path)])


@pytest.mark.parametrize(
    "options",
    [{"steps": 0}, {"lr": 0.0}, {"lr": math.inf}, {"betas": [1.5, 0.9]}, {"warmup": -1}, {"ema": -0.1}, {"stride": 0}],
    ids=str,
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
     ("toys.py:Line", "Say toys:Line"),
     ("json:loads", "not a network"), ("--steps", "the network")],
)  # fmt: skip
def test_a_network_that_is_not_there_is_named(capsys, name, said):
    assert main(["train", name, "-o", "x"]) == 1
    assert said in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_named(tmp_path, corpus, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(InputError, match=r"run: the run's folder cannot be written: Permission denied"):
        trained(tmp_path / "run", corpus, steps=1)


def test_an_unknown_protocol_is_an_error_before_a_folder_is_made(tmp_path, corpus, monkeypatch):
    monkeypatch.setattr(Line, "protocol", "xmaee")
    with pytest.raises(InputError, match="xmaee"):
        trained(tmp_path / "run", corpus, steps=1)
    assert not (tmp_path / "run").exists()


def test_help_is_light_without_a_network_and_whole_with_one(capsys):
    code = (
        "import sys\nfrom motionmend.cli.main import main\n"
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
    trapezoid = replace(base, schedule="trapezoid")
    assert np.allclose([rate(trapezoid, step) for step in (0, 10, 79, 80, 90, 99)], [0.1, 1, 1, 1, 0.5, 0.05])
    longer = replace(trapezoid, steps=200, warmup=0.05)
    assert config.changes(trapezoid, longer, 80) == [] and config.changes(trapezoid, longer, 90) != []
    falls = replace(base, schedule="step", step_every=30, warmup=0.0)
    assert [rate(falls, step) for step in (0, 29, 30, 59, 60, 90)] == [1, 1, 1 / 4, 1 / 4, 1 / 16, 1 / 64]
    assert rate(replace(base, warmup=0.0), 0) == 1.0
    in_steps = replace(base, warmup=10.0, schedule="trapezoid")
    assert [rate(in_steps, step) for step in (0, 4, 9, 10)] == [0.1, 0.5, 1.0, 1.0]
    assert config.changes(in_steps, replace(in_steps, steps=500), 80) == []  # prolonged, and no more to say


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


def test_processes_that_cannot_share_equally_are_refused():
    assert [share(64, rank, 4) for rank in range(4)] == [(0, 16), (16, 32), (32, 48), (48, 64)]
    with pytest.raises(InputError, match="3 processes"):
        share(64, 0, 3)


@pytest.mark.parametrize("batch", [64, 48, 7])
def test_batches_are_a_pure_function_of_seed_and_step(corpus, batch):
    opened = Corpus.open(corpus)

    def batches(seed: int = 0) -> Batches:
        return Batches(Line(LineConfig(), 3), [opened], batch=batch, stride=1, seed=seed)

    blocks = math.gcd(batch, 8)
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


def test_waiting_is_measured(monkeypatch):
    """Only the asker's waiting counts, each time from when it asked until it got; the clock is moved by hand."""
    clock = {"now": 0.0}
    monkeypatch.setattr(batches.time, "perf_counter", lambda: clock["now"])

    with Ahead(lambda step: step, 0, 3) as ahead:
        get = ahead._queue.get

        def after_a_while():
            clock["now"] += 0.25
            return get()

        ahead._queue.get = after_a_while
        for step in range(3):
            assert ahead.next() == step
            clock["now"] += 100  # the asker's own work
    assert ahead.waited == 0.75


# Logs


def test_a_log_is_cut_back(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text('{"step": 1}\n{"step": 2}\nrubbish\n{"step": 3}\n{"step": 2')
    cut_back(log, 2)
    assert log.read_text() == '{"step": 1}\n{"step": 2}\n'


def test_times_in_words():
    words = ["5 s", "1 min 0 s", "1 min 5 s", "1 h 1 min", "1 d 1 h"]
    assert [span(seconds) for seconds in (5, 59.9, 65, 3661, 90061)] == words
