"""All that a run must keep to go on as if it had never stopped: weights, their moving average, Adam's moments."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from ..errors import InputError
from .optimisers import Optimiser


class Average:
    """An exponential moving average of a network's weights.

    After step n (from 0) it is `d * average + (1 - d) * weights` with d = min(decay, (1 + n) / (10 + n)), so
    that it is not tied to the first weights for long. Buffers are copied. A decay of 0 follows the weights.
    """

    def __init__(self, network: nn.Module, decay: float):
        self.decay = decay
        self.values = {name: value.detach().clone() for name, value in network.state_dict().items()}

    @torch.no_grad()
    def update(self, network: nn.Module, step: int) -> None:
        decay = min(self.decay, (1 + step) / (10 + step)) if self.decay else 0.0
        now = network.state_dict()
        for name, value in now.items():
            if value.is_floating_point():
                self.values[name].lerp_(value, 1 - decay)
            else:
                self.values[name].copy_(value)


def gather(network: nn.Module, optimiser: Optimiser, average: Average) -> dict[str, Tensor]:
    """Every tensor of a run by name: `network.…`, `ema.…`, `adam.MOMENT.…`."""
    tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
    tensors |= {f"ema.{name}": value for name, value in average.values.items()}
    for name, parameter in network.named_parameters():
        tensors |= {f"adam.{moment}.{name}": value for moment, value in optimiser.state.get(parameter, {}).items()}
    return tensors


def spread(tensors: Mapping[str, Tensor], network: nn.Module, optimiser: Optimiser, average: Average):
    """Put what `gather` collected back where it was."""

    def part(prefix: str) -> dict[str, Tensor]:
        return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}

    network.load_state_dict(part("network."))
    for name, value in part("ema.").items():
        average.values[name].copy_(value)
    moments = part("adam.")
    for name, parameter in network.named_parameters():
        found = {key.removesuffix(f".{name}"): value for key, value in moments.items() if key.split(".", 1)[1] == name}
        # Adam counts its steps in a tensor that stays on the CPU unless the optimiser is fused.
        fused = optimiser.defaults.get("fused")
        for moment, value in found.items():
            device = "cpu" if moment == "step" and not fused else parameter.device
            optimiser.state[parameter][moment] = value.to(device)


@contextmanager
def aside(path: Path) -> Iterator[Path]:
    """The name under which to write a file of a run, which gets its own name when it is whole.

    `io.write_whole` for what may be killed at any moment: the name is a fixed one, so a file that a kill left behind is
    overwritten by the next and never read.
    """
    part = path.with_name(f".{path.name}.part")
    yield part
    part.replace(path)


def save(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, object]) -> None:
    """Write a checkpoint so that at any moment there is a whole one: aside, to the disk, then renamed."""
    # Copies, because safetensors refuses tensors that share memory, as tied weights do.
    whole = torch.contiguous_format
    copies = {name: value.detach().cpu().clone(memory_format=whole) for name, value in tensors.items()}
    with aside(path) as part:
        save_file(copies, part, metadata={key: str(value) for key, value in metadata.items()})
        with part.open("rb+") as file:
            os.fsync(file.fileno())
    if os.name == "posix":  # elsewhere a folder cannot be opened
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)


def load(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata of a checkpoint. InputError where it is damaged."""
    try:
        with safe_open(path, "pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except SafetensorError as error:
        hint = "an earlier checkpoint beside it, if there is one, can take its name"
        raise InputError(f"the checkpoint is damaged: {error}", where=path, hint=hint) from None


def keep_copy(path: Path, step: int, keep: int) -> None:
    """Copy a checkpoint beside itself as `step-NNN.safetensors`, and keep only the newest few of those."""
    if not keep:
        return
    with aside(path.with_name(f"step-{step:09d}.safetensors")) as part:
        shutil.copyfile(path, part)
    for old in sorted(path.parent.glob("step-*.safetensors"))[:-keep]:
        old.unlink()
