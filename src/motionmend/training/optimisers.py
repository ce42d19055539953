"""Muon for the matrices inside a network's blocks, AdamW for everything else, as one optimiser."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from .config import Settings

MOMENTUM, DECAY = 0.95, 0.05
# The quintic Newton-Schulz iteration of Jordan et al. 2024, as `torch.optim.Muon` has it.
COEFFICIENTS, ITERATIONS, LEAST = (3.4445, -4.775, 2.0315), 5, 1e-7
# An answer sums as many features as the network is wide, and AdamW moves all their weights alike, so at the full rate
# a single step would move bodies by decimetres. Networks so driven learn to drown their features in a constant.
ANSWER = 0.1
AS_ADAM = 0.2  # with this and the root of the longer side, a step is as large as AdamW's (Liu et al. 2025)


class Muon(torch.optim.Optimizer):
    """`torch.optim.Muon` with `match_rms_adamw`, in a precision of one's choice.

    Torch's own multiplies in bf16 whatever the machine; where that is emulated a step takes six times as long.
    """

    def __init__(self, parameters: list[nn.Parameter], lr: float, dtype: torch.dtype):
        super().__init__(parameters, {"lr": lr})
        self.dtype = dtype

    @torch.no_grad()
    def step(self) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                known = self.state[parameter]
                if not known:
                    known["momentum_buffer"] = torch.zeros_like(parameter.grad)
                moment = known["momentum_buffer"].lerp_(parameter.grad, 1 - MOMENTUM)
                ahead = orthogonal(parameter.grad.lerp(moment, MOMENTUM).to(self.dtype))
                parameter.mul_(1 - group["lr"] * DECAY)
                parameter.add_(ahead, alpha=-group["lr"] * AS_ADAM * max(parameter.shape) ** 0.5)


def orthogonal(matrix: Tensor) -> Tensor:
    """A matrix `(A, B)` with its singular values brought near to 1, within about a third."""
    a, b, c = COEFFICIENTS
    tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if tall else matrix
    x = x / x.norm().clamp(min=LEAST)
    for _ in range(ITERATIONS):
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.T if tall else x


class MuonAndAdam:
    """Muon on the matrices of `network.blocks`, AdamW on the rest, at one learning rate but for the answer.

    Muon makes a matrix's step orthogonal, so that no direction in it is learned sooner than others. Learning rates are
    set in `param_groups`, where a group's `share` tells what part of the rate it is to get.
    """

    def __init__(self, network: nn.Module, *, lr: float, dtype: torch.dtype = torch.float32, **adam: Any):
        inside = [each for name, each in network.named_parameters() if is_block_matrix(name, each)]
        others = [(name, each) for name, each in network.named_parameters() if not is_block_matrix(name, each)]
        groups = [
            {"params": [each for name, each in others if name.startswith("answer.") == last], "share": share}
            for last, share in ((False, 1.0), (True, ANSWER))
        ]
        groups = [each for each in groups if each["params"]]
        self.parts: tuple[torch.optim.Optimizer, ...] = (torch.optim.AdamW(groups, lr, **adam),) if groups else ()
        if inside:
            self.parts = (Muon(inside, lr, dtype), *self.parts)
        self.defaults: dict[str, Any] = {"fused": False}
        self.state = _State(self.parts)

    @property
    def param_groups(self) -> list[dict[str, Any]]:
        return [group for part in self.parts for group in part.param_groups]

    def step(self) -> None:
        for part in self.parts:
            part.step()

    def zero_grad(self) -> None:
        for part in self.parts:
            part.zero_grad(set_to_none=True)


class _State:
    """The state of whichever optimiser a parameter belongs to."""

    def __init__(self, parts: tuple[torch.optim.Optimizer, ...]):
        self.owner = {id(each): part for part in parts for group in part.param_groups for each in group["params"]}

    def __getitem__(self, parameter: Tensor) -> dict[str, Any]:
        return self.owner[id(parameter)].state[parameter]

    def get(self, parameter: Tensor, default: Any = None) -> Any:
        return self.owner[id(parameter)].state.get(parameter, default)


def is_block_matrix(name: str, parameter: Tensor) -> bool:
    """Whether Muon is for it: a matrix that multiplies features inside a block, no table, gain or convolution."""
    return name.startswith("blocks.") and name.endswith(".weight") and parameter.ndim == 2


Optimiser = torch.optim.Optimizer | MuonAndAdam


def optimiser_of(network: nn.Module, settings: Settings, device: torch.device) -> Optimiser:
    """The optimiser that the settings name, for all parameters of a network."""
    common = {"lr": settings.lr, "betas": settings.betas, "weight_decay": settings.weight_decay}
    if settings.optimiser == "muon":
        return MuonAndAdam(network, dtype=torch.bfloat16 if settings.precision == "bf16" else torch.float32, **common)
    return torch.optim.AdamW(network.parameters(), fused=device.type == "cuda", **common)


def set_rate(optimiser: Optimiser, lr: float) -> None:
    """The learning rate of the steps to come."""
    for group in optimiser.param_groups:
        group["lr"] = lr * group.get("share", 1.0)
