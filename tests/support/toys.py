"""A network whose optimum is known in closed form, for the tests of training; and a script that trains it.

`python toys.py FOLDER CORPUS [key=value …]` trains in its own process, or in several. Where the environment says
TOYS_STOP=137:SIGKILL it sends itself that signal in the middle of step 137: a test that waits for a clock hangs on it.
"""

from __future__ import annotations

import ast
import os
import signal
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from motionmend.corpora.corpus import ClipInfo
from motionmend.corpora.writing import write_corpus
from motionmend.motion import Motion, Skeleton
from motionmend.networks.models.network import Network


@dataclass(frozen=True)
class LineConfig:
    dropout: float = 0.0
    bad_at: int = -1
    """The step whose loss is not a number."""
    hole_at: int = -1
    """The step whose batch has NaN."""
    sizes: tuple[int, ...] = (1, 2)
    """Nothing; there to be written and read."""


class Line(Network):
    """The first joint in the next frame as a linear function of all joints in this one, by least squares."""

    name = "line"
    space = "floor_mean"
    fps = 30.0
    frames = 2
    protocol = ""
    Config = LineConfig
    DEFAULTS = {"batch": 64, "lr": 0.02, "network": {"sizes": (3,)}}  # noqa: RUF012

    def __init__(self, config, joints):
        super().__init__(config, joints)
        self.line = nn.Linear(3 * joints, 3)
        self.drop = nn.Dropout(config.dropout)

    def batch(self, positions, observed, rng, step):
        given = positions[:, 0].reshape(len(positions), -1)
        # The last joint's y is the number of the frame: which samples came is told exactly.
        rows = {"given": given, "wanted": positions[:, 1, 0]}
        if step == self.config.hole_at:
            rows["wanted"] = rows["wanted"] * np.float32(np.nan)
        return rows | {"which": positions[:, 0, -1, 1], "chance": rng.random(len(given)) < 0.5}

    def loss(self, batch, step):
        if os.environ.get("TOYS_STOP", "").split(":")[0] == str(step):
            os.kill(os.getpid(), signal.Signals[os.environ["TOYS_STOP"].split(":")[1]])
        # Scaled so that the frame's number, up to hundreds, does not spoil the conditioning.
        given = torch.cat([batch["given"][:, :-3], 0 * batch["given"][:, -3:]], 1)
        error = (self.line(self.drop(given)) - batch["wanted"]).square().mean(1)
        if step == self.config.bad_at:
            error = error / 0
        return {"loss": error, "which": batch["which"], "chance": batch["chance"].float()}


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


def no_scores(network, corpus, settings, picture):
    return {"height": float(network.line.bias.detach().square().sum())}


def no_export(network, folder, corpora, spent, scores):
    return folder


def settings(corpus, **options):
    from motionmend.training.config import settle

    # Exact sums are what the tests go by, whatever this machine is faster at.
    known = {"corpus": [str(corpus)], "checkpoint_minutes": 0, "precision": "fp32"}
    return settle("toys:Line", Line, known | options)


def trained(folder: Path, corpus: Path, *, resume: bool = False, **options) -> dict[str, torch.Tensor]:
    """Train in this process; all tensors of the last checkpoint."""
    from motionmend.training import state
    from motionmend.training.loop import train

    status = train(settings(corpus, **options), folder, resume=resume, validate=no_scores, export=no_export)
    assert status == 0
    return state.load(folder / "last.safetensors")[0]


if __name__ == "__main__":
    from motionmend.cli.common import complain
    from motionmend.errors import InputError
    from motionmend.training.loop import train
    from motionmend.training.runs import leave

    folder, corpus, *pairs = sys.argv[1:]
    options = {key: ast.literal_eval(value) for key, value in (pair.split("=", 1) for pair in pairs)}
    resume = options.pop("resume", False)
    try:
        status = train(settings(corpus, **options), Path(folder), resume=resume, validate=no_scores, export=no_export)
    except InputError as error:
        status = complain(error)
    leave(status)
    sys.exit(status)
