"""What runs a network: named arrays to an array, by an ONNX graph on onnxruntime or by a torch module in training."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .models.network import Network

Array = np.ndarray

Run = Callable[[dict[str, Array]], Array]


class Graph:
    """A Run by onnxruntime. The session starts when it is first needed, with one thread a core."""

    def __init__(self, path: Path):
        self.path = path

    @cached_property
    def session(self):
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0
        options.use_deterministic_compute = True
        options.log_severity_level = 3  # errors
        return onnxruntime.InferenceSession(str(self.path), options, providers=["CPUExecutionProvider"])

    def __call__(self, inputs: dict[str, Array]) -> Array:
        wanted = {each.name: inputs[each.name] for each in self.session.get_inputs()}
        return np.asarray(self.session.run(None, wanted)[0])


class Module:
    """A Run by a torch module on the device where it is, in evaluation mode and without gradients."""

    def __init__(self, module: Network):
        self.module = module

    def __call__(self, inputs: dict[str, Array]) -> Array:
        import torch

        device, training = next(self.module.parameters()).device, self.module.training
        self.module.eval()
        with torch.inference_mode():
            tensors = {name: torch.from_numpy(np.ascontiguousarray(each)).to(device) for name, each in inputs.items()}
            output = self.module(**tensors).float().cpu().numpy()
        self.module.train(training)
        return output
