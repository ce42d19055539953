"""Two networks small enough for tests: one that fills windows, and one that is asked for many answers.

`Tiny` trains to a known optimum: on windows in which every joint stands still, the mean of its observed samples, which
a fresh one gives already but for its small correction, is the whole answer, so its loss can reach 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from motionmend.networks.models.network import Network
from motionmend.networks.spaces import SPACES, turned


@dataclass(frozen=True)
class TinyConfig:
    hidden: int = 8
    kernel: int = 5
    masked: float = 0.3
    """Share of observed samples that training hides."""
    turned: bool = True
    """Turn each window about the vertical by a random angle."""


class Tiny(Network):
    """Each joint's mean over the window, and a correction by two convolutions over time. Any number of frames."""

    name = "tiny"
    space = "floor_mean"
    fps = 30.0
    frames = 16
    any_length = True
    protocol = "xmae"
    Config = TinyConfig
    DEFAULTS = {"batch": 16, "lr": 1e-2}  # noqa: RUF012

    def __init__(self, config: TinyConfig, joints: int):
        super().__init__(config, joints)
        self.inward = nn.Conv1d(4 * joints, config.hidden, config.kernel, padding=config.kernel // 2)
        self.outward = nn.Conv1d(config.hidden, 3 * joints, config.kernel, padding=config.kernel // 2)

    def batch(self, positions, observed, rng, step):
        positions = np.where(observed[..., None], positions, 0).astype(np.float32)
        if self.config.turned:
            positions = turned(positions, rng.uniform(0, 2 * np.pi, len(positions)))
        kept = observed & (rng.random(observed.shape) >= self.config.masked)
        space = SPACES[self.space]()
        inputs, known = space.encode(positions, kept)
        origin = space.decode(np.zeros_like(positions), known)
        return {**inputs, "target": positions - origin, "wanted": observed & ~kept}

    def loss(self, batch, step):
        error = (self(positions=batch["positions"], observed=batch["observed"]) - batch["target"]).abs().mean(-1)
        wanted = batch["wanted"].to(error.dtype)
        return {"loss": (error * wanted).sum((1, 2)) / wanted.sum((1, 2)).clamp(min=1)}

    def forward(self, positions: Tensor, observed: Tensor) -> Tensor:
        windows, frames, joints, _ = positions.shape
        seen = observed.unsqueeze(-1).to(positions.dtype)
        mean = (positions * seen).sum(1, keepdim=True) / seen.sum(1, keepdim=True).clamp(min=1)
        rows = torch.cat([(positions - mean) * seen, seen], -1).reshape(windows, frames, 4 * joints)
        correction = self.outward(torch.relu(self.inward(rows.transpose(1, 2)))).transpose(1, 2)
        return mean + 0.1 * correction.reshape(windows, frames, joints, 3)


@dataclass(frozen=True)
class TinyDreamConfig:
    hidden: int = 16
    kept: float = 0.2
    """Share of joints whose paths training gives."""


class TinyDream(Network):
    """From the first pose, any given paths and noise: where the joints are in the frames that follow."""

    name = "tiny-dream"
    space = "first_pelvis"
    fps = 25.0
    frames = 9
    protocol = "trajevae"
    generative = True
    noise_size = 4
    Config = TinyDreamConfig
    DEFAULTS = {"batch": 16, "lr": 1e-2}  # noqa: RUF012

    def __init__(self, config: TinyDreamConfig, joints: int):
        super().__init__(config, joints)
        later = self.frames - 1
        self.inward = nn.Linear(3 * joints + 4 * joints * later + self.noise_size, config.hidden)
        self.outward = nn.Linear(config.hidden, 3 * joints * later)

    def batch(self, positions, observed, rng, step):
        kept = observed & (rng.random((len(positions), 1, observed.shape[2])) < self.config.kept)
        kept[:, 0] = observed[:, 0]
        space = SPACES[self.space]()
        inputs, _ = space.encode(positions, kept)
        truth, _ = space.encode(positions, observed)
        noise = rng.standard_normal((len(positions), self.noise_size)).astype(np.float32)
        return {**inputs, "noise": noise, "target": truth["trajectories"], "wanted": truth["given"]}

    def loss(self, batch, step):
        inputs = {name: batch[name] for name in ("pose", "trajectories", "given", "noise")}
        error = (self(**inputs) - batch["target"]).abs().mean(-1)
        wanted = batch["wanted"].to(error.dtype)
        return {"loss": (error * wanted).sum((1, 2)) / wanted.sum((1, 2)).clamp(min=1)}

    def forward(self, pose: Tensor, trajectories: Tensor, given: Tensor, noise: Tensor) -> Tensor:
        known = given.unsqueeze(-1).to(trajectories.dtype)
        parts = (pose, trajectories * known, known, noise)
        row = torch.cat([part.flatten(1) for part in parts], -1)
        moved = self.outward(torch.tanh(self.inward(row))).reshape(trajectories.shape)
        return trajectories * known + (pose.unsqueeze(1) + 0.1 * moved) * (1 - known)
