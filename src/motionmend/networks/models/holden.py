"""The motion manifold of Holden et al. 2016, as Kaufmann et al. 2020 compare with it: one convolution over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..rows import ROWS
from .over_rows import OverRows, RowsConfig


@dataclass(frozen=True)
class HoldenConfig(RowsConfig):
    curriculum: int = 0
    """Steps over which gaps grow; 0, as in the comparison, for gaps of always one length."""
    error: Literal["l1", "l2", "rms"] = "l2"
    """As RowsConfig has it; L2 in that paper."""
    features: int = 256
    width: int = 25
    """Frames that the convolutions see."""
    dropout: float = 0.25
    """Share of the inputs of each convolution that training leaves out."""


class Holden(OverRows):
    """Convolution, max-pooling by two, unpooling, convolution (Holden et al. 2016, section 5)."""

    name = "holden"
    Config = HoldenConfig
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {"": {"features": 8, "width": 5}}
    DEFAULTS: ClassVar[dict[str, Any]] = OverRows.DEFAULTS | {"lr": 1e-5, "steps": 2_450}

    def __init__(self, config: HoldenConfig, joints: int):
        super().__init__(config, joints)
        reach = config.width // 2
        self.inward = nn.Conv1d(ROWS, config.features, config.width, padding=reach)
        self.outward = nn.Conv1d(config.features, ROWS, config.width, padding=reach)
        self.drop = nn.Dropout(config.dropout)

    def answer(self, rows: Tensor, known: Tensor, leeway: Tensor) -> Tensor:
        del leeway
        there = known.to(rows.dtype).repeat_interleave(3, dim=2)
        x = (self.normalised(rows) * there).transpose(1, 2)  # (B, R, T)
        found = F.pad(F.relu(self.inward(self.drop(x))), (0, 1))
        pooled = F.max_pool2d(found[:, :, None], (1, 2))[:, :, 0]
        # Each value goes to one of the two frames that it was taken from, at random; in use, half to both.
        first = torch.rand_like(pooled).round() if self.training else torch.full_like(pooled, 0.5)
        pairs = torch.stack([pooled * first, pooled * (1 - first)], dim=-1)
        # Neither rounding up nor a slice: both would bind the exported graph to some lengths.
        spread = pairs.flatten(2).index_select(2, torch.arange(x.shape[2], device=x.device))
        return self.outward(self.drop(spread)).transpose(1, 2).float()
