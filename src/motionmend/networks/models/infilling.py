"""ConvAE in TrajeVAE's place: a first pose and the paths of some joints in, one answer for all the others out.

The row "Motion Infilling" of Kania et al. 2021, who trained Kaufmann et al. 2020 so. B = windows, T = frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from .convae import ConvAE, ConvAEConfig

Array = np.ndarray


@dataclass(frozen=True)
class InfillingConfig(ConvAEConfig):
    """ConvAE's options; `damage`, `gap` and `curriculum` do nothing here."""

    given: float = 0.15
    """Share of the joints whose paths training gives, as TrajeVAE's."""


class Infilling(ConvAE):
    """ConvAE's parameters. Its windows are TrajeVAE's: 1 + 100 frames at 50 fps."""

    name = "infilling"
    fps = 50.0
    frames = 101
    protocol = "trajevae"
    Config = InfillingConfig
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {"": {"channels": (4, 6, 8, 8, 8)}}
    config: InfillingConfig

    def _hidden(self, truth: Array, observed: Array, rng: np.random.Generator, step: int) -> Array:
        """All but the first frame of the joints whose paths are not given, the same ones in every frame."""
        windows, frames, joints = observed.shape
        hidden = np.tile(rng.random((windows, 1, joints)) >= self.config.given, (1, frames, 1))
        hidden[:, 0] = False
        return hidden
