"""ConvAE: gaps as holes in an image whose columns are poses, filled by a convolutional autoencoder.

Kaufmann et al. 2020; section numbers are the paper's. B = windows, T = frames, R = rows (`networks.rows`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..rows import GROUPS, ROWS
from .over_rows import OverRows, RowsConfig

CHANNELS = {"vgg": (32, 64, 128, 256, 256), "vanilla": (32, 64, 128, 256, 512)}
FEWEST_ROWS = 10  # the Vanilla AE does not halve fewer
SLOPE = 0.2  # of the leaky ReLU


@dataclass(frozen=True)
class ConvAEConfig(RowsConfig):
    """The paper's values; `begin`, `share` and `skips` are ours, and off."""

    kind: Literal["vgg", "vanilla"] = "vgg"
    """Two convolutions and a max-pooling a unit, or the Vanilla AE's one convolution with a stride."""
    channels: tuple[int, ...] = ()
    """Of the units; the paper's if empty."""
    begin: Literal["zeros", "curve"] = "zeros"
    """What stands in place of unknown rows: the paper's zeros; or a curve, which the network then leads away from,
    the farther the longer nothing is known (spaces.BodyRows)."""
    share: tuple[float, float] = (1.0, 1.0)
    """How much of an answer counts that leads away from a curve: of poses, and of the way and the turn. For validation
    to choose once the network is trained."""
    skips: bool = False
    """What a unit of the encoder is given is added to what its mirror gives: such a network learns in a hundred steps
    what without takes thousands."""


class ConvAE(OverRows):
    """4,703,425 parameters in the paper's size."""

    name = "convae"
    Config = ConvAEConfig
    share: Tensor
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {
        "": {"channels": (4, 6, 8, 8, 8)},
        "vanilla": {"kind": "vanilla", "channels": (4, 6, 8, 8, 8), "curriculum": 0},
        "curve": {"channels": (4, 6, 8, 8, 8), "begin": "curve", "skips": True, "damage": "takes",
                  "mirror": True, "error": "rms", "share": (0.8, 0.5)},
    }

    def __init__(self, config: ConvAEConfig, joints: int):
        super().__init__(config, joints)
        self.space = "body_rows" if config.begin == "curve" else "seen_rows"
        channels = config.channels or CHANNELS[config.kind]
        inward = (1 if config.begin == "zeros" else 2, *channels[:-1])
        outward = (1, *channels[:-1])  # mirrored: the last layer of a unit changes the channels
        strides, rows = [], ROWS
        for _ in channels:
            strides.append((2 if config.kind == "vgg" or rows >= FEWEST_ROWS else 1, 2))
            rows = -(-rows // strides[-1][0])
        down, up = (Down, Up) if config.kind == "vgg" else (VanillaDown, VanillaUp)
        self.down = nn.ModuleList(map(down, inward, channels, strides))
        self.up = nn.ModuleList(map(up, reversed(channels), reversed(outward), reversed(strides)))
        layers = [each for each in self.modules() if isinstance(each, nn.Conv2d | nn.ConvTranspose2d)]
        for layer in layers:
            if config.skips:
                _keep_variance(layer)
            else:
                nn.init.xavier_uniform_(layer.weight)
            assert layer.bias is not None
            nn.init.zeros_(layer.bias)
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        if config.begin == "curve":  # an untrained network answers with the curve
            nn.init.zeros_(layers[-1].weight)
        poses, way = config.share
        self.register_buffer("share", torch.tensor([poses] * (GROUPS - 1) + [way]), persistent=False)

    def answer(self, rows: Tensor, known: Tensor, leeway: Tensor) -> Tensor:
        rows, zeros = self.normalised(rows), self.config.begin == "zeros"
        there = known.to(rows.dtype).repeat_interleave(3, dim=2)
        shown = [rows * there] if zeros else [rows, there]
        image = torch.stack(shown, dim=1).transpose(2, 3)  # (B, channels, R, T)
        given = [image.contiguous(memory_format=torch.channels_last)]  # a fourth faster on CPUs
        for unit in self.down:
            given.append(unit(given[-1]))
        x = given.pop()
        while given:
            before = given.pop()
            x = _first(self.up[len(self.up) - 1 - len(given)](x), before)
            if self.config.skips and given:
                x = (x + before) * 0.5**0.5
        answer = x[:, 0].transpose(1, 2).float()
        return answer if zeros else rows + answer * (leeway * self.share).repeat_interleave(3, dim=2)


class Down(nn.Sequential):
    """A unit of the encoder, `(B, before, R, T)` to `(B, after, R / 2, T / 2)`, rounded up (section 3.2)."""

    def __init__(self, before: int, after: int, stride: tuple[int, int]):
        del stride
        super().__init__(
            nn.Conv2d(before, after, 3, padding=1), nn.LeakyReLU(SLOPE),
            nn.Conv2d(after, after, 3, padding=1), nn.LeakyReLU(SLOPE),
            Halve(),
        )  # fmt: skip


class Halve(nn.Module):
    """Max-pooling of two by two, rounded up by hand: its own rounding would bind the exported graph to some lengths."""

    def forward(self, x: Tensor) -> Tensor:
        return F.max_pool2d(F.pad(x, (0, 1, 0, 1), value=float("-inf")), 2)


class Up(nn.Sequential):
    """A unit of the decoder, `(B, before, R, T)` to `(B, after, 2 R, 2 T)`."""

    def __init__(self, before: int, after: int, stride: tuple[int, int]):
        super().__init__(
            *VanillaUp(before, before, stride), nn.Conv2d(before, after, 3, padding=1), *_unless_last(after)
        )  # fmt: skip


class VanillaDown(nn.Sequential):
    """A unit of the Vanilla AE's encoder."""

    def __init__(self, before: int, after: int, stride: tuple[int, int]):
        super().__init__(nn.Conv2d(before, after, 3, stride, padding=1), nn.LeakyReLU(SLOPE))


class VanillaUp(nn.Sequential):
    """A unit of the Vanilla AE's decoder."""

    def __init__(self, before: int, after: int, stride: tuple[int, int]):
        padding = (stride[0] - 1, stride[1] - 1)
        wider = nn.ConvTranspose2d(before, after, 3, stride, padding=1, output_padding=padding)
        super().__init__(wider, *_unless_last(after))


def _first(x: Tensor, like: Tensor) -> Tensor:
    """The first rows and frames of `x`, as many as `like` has. A slice would bind the graph to some lengths too."""
    return x[:, :, : like.shape[2]].index_select(3, torch.arange(like.shape[3], device=x.device))


def _keep_variance(layer: nn.Conv2d | nn.ConvTranspose2d) -> None:
    """He et al. 2015, so that nothing dies away in twenty layers. In strided deconvolutions a fourth of the weights
    meets each output."""
    if isinstance(layer, nn.Conv2d):
        nn.init.kaiming_normal_(layer.weight, a=SLOPE)
        return
    nn.init.kaiming_normal_(layer.weight, a=SLOPE, mode="fan_out")
    with torch.no_grad():
        layer.weight *= float(np.sqrt(np.prod(layer.stride)))


def _unless_last(channels: int) -> list[nn.Module]:
    """There is no activation at the very end, where one channel is left."""
    return [nn.LeakyReLU(SLOPE)] if channels > 1 else []
