"""What networks over rows share: the rows' spread, what training hides, and how the answer is told.

B = windows, T = frames, R = rows (`networks.rows`); section numbers are those of Kaufmann et al. 2020.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor

from ...body.joints import BODY
from ...damage import corruption
from ...errors import InputError
from ..rows import ROWS
from ..spaces import SPACES, SeenRows, mirrored
from .network import Network

Array = np.ndarray

EPOCHS = 200  # of the paper's training, over which its curriculum is laid
NEGLIGIBLE = 0.001  # metres: errors below it are as good as none
TRAVELLED = 10  # frames: an error in a row of travel is one in all frames that follow
LEAST_SPREAD = 0.002  # of a row, metres and radians: the root's rows are always 0


@dataclass(frozen=True)
class RowsConfig:
    """What training hides and minimises (section 3.3): the paper's values; `damage` and what follows are ours."""

    curriculum: int = 7_000
    """Steps over which gaps grow and more joints are lost, the paper's 200 epochs: those of the training unless given;
    0 for gaps of always one length."""
    gap: int = 60
    """Frames, the length of all training gaps where there is no curriculum."""
    damage: Literal["paper", "takes"] = "paper"
    """What training hides: as the paper, or the gaps of `corruption.take_damage`."""
    mirror: bool = False
    """Training exchanges left and right in half of the windows."""
    error: Literal["l1", "l2", "rms"] = "l1"
    """What training minimises: the paper's L1 of all normalised rows, or L2; or of each window the root of the mean
    squared error of what is hidden, in metres."""


class OverRows(Network):
    """A network that answers with normalised rows to rows that are known in part; any number of frames."""

    space = "seen_rows"
    fps = 60.0
    frames = 240
    any_length = True
    protocol = "convae"
    axes: ClassVar[dict[str, dict[int, str]]] = {name: {1: "frames"} for name in ("rows", "known", "leeway")}
    DEFAULTS: ClassVar[dict[str, Any]] = {
        "batch": 80, "lr": 1e-3, "steps": 7_000, "schedule": "constant", "stride": 120,
    }  # fmt: skip
    LASTING: ClassVar[tuple[str, ...]] = ("curriculum",)
    mean: Tensor
    spread: Tensor

    def __init__(self, config: RowsConfig, joints: int):
        super().__init__(config, joints)
        if joints != len(BODY):
            raise InputError(f"rows of {joints} joints", expected=f"the {len(BODY)} joints of BODY")
        self.register_buffer("mean", torch.zeros(ROWS))
        self.register_buffer("spread", torch.ones(ROWS))

    def measure(self, positions: Array, observed: Array) -> None:
        rows = SPACES[self.space]().encode(positions, observed)[0]["rows"].reshape(-1, ROWS)
        self.mean.copy_(torch.from_numpy(rows.mean(axis=0)))
        self.spread.copy_(torch.from_numpy(np.maximum(rows.std(axis=0), LEAST_SPREAD)))

    def batch(self, positions: Array, observed: Array, rng: np.random.Generator, step: int) -> dict[str, Array]:
        space = SPACES[self.space]()
        truth = np.where(observed[..., None], positions, np.float32(0))
        if self.config.mirror:
            truth, observed = mirrored(truth, observed, rng.random(len(truth)) < 0.5)
        whole, _ = SeenRows().encode(truth, observed)  # where nothing is known, nothing counts
        inputs, _ = space.encode(truth, observed & ~self._hidden(truth, observed, rng, step))
        wanted = whole["known"] & ~inputs["known"] if self.config.error == "rms" else whole["known"]
        return {**inputs, "target": whole["rows"], "weight": wanted.astype(np.float32)}

    def _hidden(self, truth: Array, observed: Array, rng: np.random.Generator, step: int) -> Array:
        """`(B, T, J)` bool: what this step's damage takes away."""
        c, (windows, frames, _) = self.config, observed.shape
        if c.damage == "takes":
            return corruption.take_damage(truth, observed, rng, only="gaps")[1]
        if not c.curriculum:
            gaps = corruption.curriculum_gaps(windows, frames, c.gap, rng, 0)
            return np.broadcast_to(gaps[..., None], observed.shape)
        epoch = min(EPOCHS * step // c.curriculum, EPOCHS - 1)
        return corruption.convae_damage(observed.shape, epoch, EPOCHS, rng, never=())

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        answer = self.answer(batch["rows"], batch["known"], batch["leeway"])
        missed = answer - self.normalised(batch["target"])
        weight = batch["weight"].repeat_interleave(3, dim=2)
        share = weight / weight.sum((1, 2), keepdim=True).clamp(min=1)
        if self.config.error != "rms":
            missed = missed.abs() if self.config.error == "l1" else missed**2
            return {"loss": (missed * share).sum((1, 2))}
        scale = self.spread.clone()
        scale[-3:] *= TRAVELLED
        return {"loss": ((missed * scale) ** 2 * share).sum((1, 2)).add(NEGLIGIBLE**2).sqrt()}

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, rows: Tensor, known: Tensor, leeway: Tensor
    ) -> Tensor:
        return self.answer(rows, known, leeway) * self.spread + self.mean

    def normalised(self, rows: Tensor) -> Tensor:
        return (rows - self.mean) / self.spread

    def answer(self, rows: Tensor, known: Tensor, leeway: Tensor) -> Tensor:
        """Normalised rows `(B, T, R)`; the arguments are the space's."""
        raise NotImplementedError
