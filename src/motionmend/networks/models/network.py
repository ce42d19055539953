"""What the training loop, the export and the benchmark ask of a network."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from torch import Tensor, nn

from ..windows import LONGEST

Array = np.ndarray


class Network(nn.Module):
    """A network over windows of joints. B = windows, T = frames of a window, J = joints.

    A network is its class attributes and four methods: `__init__(config, joints)`, `batch` (what training
    feeds it), `loss` (what training minimises) and `forward` (what is exported and run).
    """

    name: ClassVar[str]
    """As users say it: "xmae"."""
    space: str
    """How positions become the graph's inputs and come back: a name in `motionmend.networks.spaces.SPACES`."""
    fps: ClassVar[float]
    """Frames per second of its windows."""
    frames: ClassVar[int]
    """T, of the windows it is trained on."""
    protocol: ClassVar[str]
    """The benchmark whose quick form validates it: a name in `motionmend.benchmark.PROTOCOLS`, or "".

    Where it is "" or is for windows of another rate, training validates by the loss on held-out windows.
    """
    generative: ClassVar[bool] = False
    """Whether `forward` takes `noise` (B, noise_size) too, and answers differently for each."""
    noise_size: int = 0
    any_length: ClassVar[bool] = False
    """Whether `forward` takes windows of other lengths than T too; the exported graph does then."""
    longest: ClassVar[float] = LONGEST
    """Share of a window that a gap of the whole body may take; longer ones are crossed coarsely first."""
    Config: ClassVar[type]
    """A frozen dataclass with defaults: sizes, and options of its augmentation and corruption."""
    axes: ClassVar[dict[str, dict[int, str]]] = {}
    """Axes of its inputs, besides the first, that have another length in each call: input → axis → name."""
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {"": {}}
    """Small configurations that the contract suite tries: a name, and fields of its Config."""
    DEFAULTS: ClassVar[dict[str, Any]] = {}
    """Training options in which it differs from the loop's defaults: {"batch": 128, "lr": 3e-4}."""
    LASTING: ClassVar[tuple[str, ...]] = ()
    """Fields of its Config that are numbers of steps and end with the training, unless they are given or 0."""

    def __init__(self, config: Any, joints: int):
        super().__init__()
        self.config = config
        self.joints = joints

    def measure(self, positions: Array, observed: Array) -> None:
        """Take from windows `(B, T, J, 3)`, `(B, T, J)` of the training takes what it must know of all of them.

        Called once, before training; what it finds goes into buffers. Most networks need nothing.
        """

    def batch(self, positions: Array, observed: Array, rng: np.random.Generator, step: int) -> dict[str, Array]:
        """Augment and corrupt windows into what `loss` takes. NumPy only, no loop over samples.

        It runs in a thread beside the training step: read `self.config`, never the parameters.

        Parameters
        ----------
        positions : `(B, T, J, 3)` float32, metres, Y up; NaN where unobserved.
        observed : `(B, T, J)` bool.
        rng : the only source of chance, so that a step's samples follow from seed and step alone.
        step : how many steps were taken before this one, for a curriculum.

        Returns named arrays, each with B rows: float32, bool or int64.
        """
        raise NotImplementedError

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """Named losses `(B,)`, one value a row. "loss" is minimised, as the mean over all rows of all processes.

        step : how many steps were taken before this one, for losses that change over training.
        """
        raise NotImplementedError

    def forward(self, **inputs: Tensor) -> Tensor:
        """The graph that is exported: inputs as its space names them, to what its space decodes."""
        raise NotImplementedError
