"""A row of the tables: a method as functions on whole batches of windows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..motion import Skeleton

if TYPE_CHECKING:
    pass


Array = np.ndarray

Windows = Callable[[Array, Array, float, Skeleton], Array]
Samples = Callable[[Array, Array, Array, int, int], Array]
CONSTRAINED = "+constraints"  # what is added to the name of a method whose samples are mended as `animate` does


@dataclass(frozen=True)
class Method:
    """A row of the tables.

    Windows are `positions (B, T, J, 3)` float32 metres and `observed (B, T, J)` bool; where `observed` is False
    the numbers mean nothing, and may be NaN.

    fill : `(positions, observed, fps, skeleton) -> positions`, observed samples bit for bit, NaN where it could
        not fill; None for what cannot fill.
    restore : `(positions, observed, fps, skeleton) -> positions`, may rewrite every sample (filters, networks;
        "none" rewrites nothing).
    sample : `(pose (B, J, 3), trajectories (B, T, J, 3), given (B, T, J), count K, seed) -> (B, K, T, J, 3)`;
        for K = 1 the one best guess, whatever the seed.
    most : how many samples may be asked of it in a column, where more would take hours; None for any number.
    about : what it is, for the table's footnote. budget : what a network was trained with.
    """

    name: str
    fill: Windows | None = None
    restore: Windows | None = None
    sample: Samples | None = None
    about: str = ""
    budget: str = ""
    most: int | None = None

    def can_sample(self, count: int) -> bool:
        """Whether it can be asked for so many samples, those of all windows of a column together."""
        return self.sample is not None and (self.most is None or count <= self.most)
