"""CVAE-RNN, the recurrent baseline of TrajeVAE's paper (Kania et al. 2021, appendix B; after Yuan and Kitani 2020).

B = windows, T = frames after the first, J = joints.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn
from torch._higher_order_ops.scan import scan
from torch.func import functional_call
from torch.utils._pytree import tree_map

from .network import Network
from .trajevae import kl, only_bodies, path_batch

Array = np.ndarray


@dataclass(frozen=True)
class CVAERNNConfig:
    """The paper's sizes."""

    hidden: int = 128
    """Features of recurrent states and codes."""
    wide: tuple[int, ...] = (300, 200)
    """Widths of the MLPs."""
    latent: int = 256
    given: float = 0.15
    """Share of the joints whose trajectories training gives."""
    kl: float = 0.01
    """Weight of the divergence of the posterior from the standard normal distribution."""
    spans: float = 0.0
    """Share of the windows in which training gives trajectories for some frames only."""
    mirror: bool = False
    """Training exchanges left and right in half of the windows."""
    resize: float = 0.0
    """Training makes bodies larger or smaller by up to this share."""


class CVAERNN(Network):
    """810,099 parameters with 21 joints in the paper's size. One latent vector says all of a motion."""

    name = "cvae-rnn"
    space = "first_pelvis"
    fps = 50.0
    frames = 101
    protocol = "trajevae"
    generative = True
    Config = CVAERNNConfig
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {"": {"hidden": 16, "wide": (24,), "latent": 16}}
    DEFAULTS: ClassVar[dict[str, Any]] = {
        "batch": 64, "lr": 1e-4, "betas": (0.9, 0.99), "steps": 240_000, "schedule": "step", "clip": 0.0, "warmup": 0.0,
    }  # fmt: skip

    def __init__(self, config: CVAERNNConfig, joints: int):
        super().__init__(config, joints)
        if config.mirror:
            only_bodies("mirror", joints)
        hidden, pose = config.hidden, 3 * joints
        self.noise_size = config.latent
        self.paths = nn.GRU(pose, hidden // 2, bidirectional=True, batch_first=True)
        self.future = nn.GRU(pose, hidden // 2, bidirectional=True, batch_first=True)
        self.met = tanh_mlp(2 * hidden, *config.wide, hidden)
        self.mean, self.log_variance = nn.Linear(hidden, config.latent), nn.Linear(hidden, config.latent)
        self.begin = tanh_mlp(hidden, *config.wide, hidden)
        self.step = Step(2 * pose + config.latent + hidden, hidden, *config.wide, pose)

    def batch(self, positions: Array, observed: Array, rng: np.random.Generator, step: int) -> dict[str, Array]:
        return path_batch(self.config, positions, observed, rng)

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """Equations 2 to 4 with a standard normal prior. Squared metres, summed over given and missing joints."""
        given, future, wanted = batch["given"], batch["future"], batch["wanted"]
        with torch.autocast(future.device.type, enabled=False):  # coordinates need more than bf16's eight bits
            paths = (batch["trajectories"] * given[..., None]).flatten(2)
            shown = (future * (wanted & ~given)[..., None]).flatten(2)
            code = read(self.paths, paths)
            met = self.met(torch.cat([code, read(self.future, shown)], dim=-1))
            mean, log_variance = self.mean(met), self.log_variance(met)
            z = mean + (log_variance / 2).exp() * torch.randn_like(mean)
            missed = self._decoded(z, code, paths, batch["pose"]) - future
        error = ((missed**2).sum(-1) * wanted).sum((1, 2))
        divergence = kl((mean, log_variance), (torch.zeros_like(mean), torch.zeros_like(mean))).sum(1)
        return {"loss": error + self.config.kl * divergence, "error": error, "kl": divergence}

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, pose: Tensor, trajectories: Tensor, given: Tensor, noise: Tensor
    ) -> Tensor:
        paths = (trajectories * given[..., None]).flatten(2)
        return self._decoded(noise, read(self.paths, paths), paths, pose)

    def _decoded(self, z: Tensor, code: Tensor, paths: Tensor, pose: Tensor) -> Tensor:
        """The poses `(B, T, J, 3)` that follow, each made from the one before."""
        step = fixed(self.step)

        def following(carry: tuple[Tensor, Tensor], path: Tensor) -> tuple[tuple[Tensor, Tensor], Tensor]:
            state, last = carry
            state, answer = step(torch.cat([code, z, last, path], dim=-1), state)
            return (state, answer), answer.clone()

        return over_time(following, (self.begin(code), pose.flatten(1)), paths).unflatten(-1, (self.joints, 3))


class Step(nn.Module):
    """One step of the decoder: from what it is told and its state, the next state and a pose."""

    def __init__(self, told: int, hidden: int, *widths: int):
        super().__init__()
        self.cell = nn.GRUCell(told, hidden)
        self.mlp, self.pose = tanh_mlp(hidden, *widths[:-1]), nn.Linear((hidden, *widths)[-2], widths[-1])

    def forward(self, told: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        state = self.cell(told, state)
        return state, self.pose(self.mlp(state))


def read(gru: nn.GRU, x: Tensor) -> Tensor:
    """The mean over time, `(B, 2 · hidden)`, of a bidirectional GRU's states in `x (B, T, …)`."""
    if not torch.compiler.is_exporting():
        return gru(x)[0].mean(1)
    begin = x.new_zeros(x.shape[0], gru.hidden_size)
    ways = []
    for way, frames in (("l0", x), ("l0_reverse", x.flip(1))):
        weights = [getattr(gru, f"{name}_{way}").detach() for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")]

        def step(state: Tensor, frame: Tensor, weights: list[Tensor] = weights) -> tuple[Tensor, Tensor]:
            state = torch.gru_cell(frame, state, *weights)
            return state, state.clone()

        ways.append(over_time(step, begin, frames).mean(1))
    return torch.cat(ways, dim=-1)


def over_time(step: Callable[..., tuple[Any, Tensor]], begin: Any, x: Tensor) -> Tensor:
    """What `step` makes of each frame of `x (B, T, …)` and of what it carried over from the frame before.

    A graph gets one node with a body for it: unrolled, it takes minutes to export.
    """
    if torch.compiler.is_exporting():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch warns of what it does itself to trace a step
            return scan(step, tree_map(torch.detach, begin), x.detach(), dim=1)[1]
    made = []
    for frame in x.unbind(1):
        begin, out = step(begin, frame)
        made.append(out)
    return torch.stack(made, dim=1)


def fixed(module: nn.Module) -> Callable[..., Any]:
    """The module; in an export, with weights that want no gradient, which would be traced through the scan as well."""
    if not torch.compiler.is_exporting():
        return module
    weights = {name: each.detach() for name, each in module.named_parameters()}
    return lambda *arguments: functional_call(module, weights, arguments)


def tanh_mlp(*widths: int) -> nn.Sequential:
    return nn.Sequential(*(layer for pair in pairwise(widths) for layer in (nn.Linear(*pair), nn.Tanh())))
