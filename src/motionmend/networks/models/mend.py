"""The house network: poses as tokens, and what it says is the difference from a curve.

Every frame is a token, told where the `eased` curve has all joints (gap_space.BesideCurves). The answer is turned into
metres by an envelope that grows with a gap's length and is nothing at its ends, so an untrained network answers with
the curve, and a trained one leaves no seam. Beside the fill it says how far off it expects to be, a joint and a frame,
and whether feet stand; both are learned from what the fill sees without moving it.

B = windows, T = frames, J = BODY's joints, W = width, H = heads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...body.joints import BODY
from ...constraints.contacts import standing
from ...errors import InputError
from ..gap_draws import Shares, draw
from ..gap_space import ERRORS, FEET, INPUTS, OUTPUTS, BesideCurves, about_y, normalised
from ..spaces import mirrored
from .network import Network

Array = np.ndarray

STEP = 0.25  # metres of a joint's difference per unit of the answer
LEAST = 1e-6  # square metres under the root of a sample's error: 1 mm
ALWAYS = 0.03  # metres added to the curve's error that a window's is divided by: short gaps count for less
SHARE = 0.1  # of the envelope, added likewise: long gaps of who stands still would outweigh all that moves
SURE = 1e-3  # metres: errors that are smaller need not be foretold better
ASIDE = 0.1  # weight of what is said beside the fill


@dataclass(frozen=True)
class MendConfig:
    width: int = 192
    depth: int = 5
    head: int = 32
    """Features of an attention's head."""
    wider: int = 3
    """How much wider than the rest the inside of an MLP is."""
    near: int = 5
    """Frames that the convolution before attention sees."""
    aside: int = 128
    """Width of the layer from which expected errors and standing feet are told."""
    mirror: bool = True
    """Training exchanges left and right in half of the windows."""
    limbs: float = 0.3
    joints: float = 0.1
    ends: float = 0.1
    """Shares of training windows that lose a limb, a few joints, and all on one side of the gap."""
    longest: int = 72
    """Frames of the longest training gap: `longest` of a window."""


class Block(nn.Module):
    """Pre-norm attention over frames, with a look at the frames beside, and an MLP."""

    def __init__(self, config: MendConfig, frames: int):
        super().__init__()
        width = config.width
        self.heads = width // config.head
        self.norm, self.norm_mlp = nn.LayerNorm(width), nn.LayerNorm(width)
        self.near = nn.Conv1d(width, width, config.near, padding=config.near // 2, groups=width)
        nn.init.zeros_(self.near.weight)
        nn.init.zeros_(self.near.bias)  # pyright: ignore[reportArgumentType]
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.far = nn.Parameter(torch.zeros(self.heads, 2 * frames - 1))
        self.into, self.back = nn.Linear(width, config.wider * width), nn.Linear(config.wider * width, width)
        for last in (self.out, self.back):  # a block begins by changing nothing
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, x: Tensor, apart: Tensor) -> Tensor:
        """x : `(B, T, W)`. apart : `(T, T)` int64, which of `far` is for a query's and a key's frame."""
        h = self.norm(x)
        h = h + self.near(h.transpose(1, 2)).transpose(1, 2)
        q, k, v = self.qkv(h).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        scores = q @ k.transpose(-1, -2) * q.shape[-1] ** -0.5 + self.far[:, apart].to(q.dtype)
        # The sum of all that was added stays in float32: in bf16 what is large and common would drown the rest.
        x = x + self.out((scores.softmax(dim=-1).to(v.dtype) @ v).transpose(1, 2).flatten(2)).float()
        return x + self.back(F.gelu(self.into(self.norm_mlp(x)), approximate="tanh")).float()


class Mend(Network):
    """1.8 million parameters."""

    name = "mend"
    space = BesideCurves.name
    fps = 30.0
    frames = 96
    longest = 0.75
    protocol = "gaps"
    Config = MendConfig
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {"": {"width": 64, "depth": 2, "aside": 32}}
    DEFAULTS: ClassVar[dict[str, Any]] = {
        "batch": 64, "steps": 15_000, "optimiser": "muon", "lr": 2e-3, "betas": (0.9, 0.98), "weight_decay": 0.01,
        "warmup": 300, "schedule": "trapezoid", "ema": 0.995, "anywhere": True,
    }  # fmt: skip

    def __init__(self, config: MendConfig, joints: int):
        super().__init__(config, joints)
        if joints != len(BODY):
            raise InputError(f"curves for {joints} joints", expected=f"the {len(BODY)} joints of BODY")
        width = config.width
        self.begin = nn.Linear(INPUTS, width)
        self.place = nn.Parameter(0.02 * torch.randn(self.frames, width))
        self.blocks = nn.ModuleList(Block(config, self.frames) for _ in range(config.depth))
        self.norm, self.answer = nn.LayerNorm(width), nn.Linear(width, 3 * joints)
        self.aside = nn.Sequential(nn.Linear(width, config.aside), nn.GELU(), nn.Linear(config.aside, joints + 4))
        for last in (self.answer, self.aside[-1]):
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
        chain = torch.eye(joints)  # (J, J): row j has its own joint and all those above it
        for joint, parent in enumerate(BODY.parents):
            if parent >= 0:
                chain[joint] += chain[parent]
        self.register_buffer("chain", STEP * chain, persistent=False)

    # Training

    def batch(self, positions: Array, observed: Array, rng: np.random.Generator, step: int) -> dict[str, Array]:
        c = self.config
        truth = np.where(observed[..., None], positions, np.float32(0))
        if c.mirror:
            truth, observed = mirrored(truth, observed, rng.random(len(truth)) < 0.5)
        shares = Shares(limbs=c.limbs, joints=c.joints, ends=c.ends, longest=c.longest)
        asked, hidden = draw(observed, rng, shares)
        inputs, (curve, *_) = BesideCurves().encode(truth, observed & ~hidden)
        cosine, sine, _ = normalised(curve)[1]
        beside = np.where(asked[..., None], about_y(truth - curve, cosine, sine), np.float32(0))
        stands, known = standing(truth, observed, self.fps)
        feet = np.where(known, stands, np.float32(-1))
        return {**inputs, "beside": beside, "asked": asked, "feet": feet.astype(np.float32)}

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        said = self(frames=batch["frames"], envelope=batch["envelope"])
        asked, beside = batch["asked"].float(), batch["beside"]
        count = asked.sum(dim=(1, 2)).clamp(min=1)
        off = said[..., : ERRORS.start].unflatten(-1, (self.joints, 3)) - beside
        world = (off.square().sum(-1) + LEAST).sqrt()
        # Seen hips are where they are, so that a limb's error is the same from them as in the world.
        hips = off[:, :, :1] * asked[:, :, :1, None]
        rooted = ((off - hips).square().sum(-1) + LEAST).sqrt()
        curve = ((beside.square().sum(-1) * asked).sum(dim=(1, 2)) / count).sqrt()
        mean = [(each * asked).sum(dim=(1, 2)) / count for each in (world, rooted)]
        room = (batch["envelope"] * asked).sum(dim=(1, 2)) / count
        fill = (mean[0] + mean[1]) / (curve + ALWAYS + SHARE * room)
        # Whose logarithm is foretold in the mean of absolute errors has its median foretold.
        true = world.detach().clamp(min=SURE).log()
        foretold = ((said[..., ERRORS] - true).abs() * asked).sum(dim=(1, 2)) / count
        feet, known = batch["feet"].clamp(min=0), (batch["feet"] >= 0).float()
        hits = F.binary_cross_entropy_with_logits(said[..., FEET], feet, reduction="none")
        standing = (hits * known).sum(dim=(1, 2)) / known.sum(dim=(1, 2)).clamp(min=1)
        loss = fill + ASIDE * (foretold + standing)
        straight = (beside.norm(dim=-1) * asked).sum(dim=(1, 2)) / count
        told = {
            "fill": fill,
            "foretold": foretold,
            "standing": standing,
            "mm": 1000 * mean[0],
            "curve": 1000 * straight,
        }
        return {"loss": loss, **{name: each.detach() for name, each in told.items()}}

    # The network

    def forward(self, frames: Tensor, envelope: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        device = frames.device.type
        with torch.autocast(device, enabled=False):  # coordinates need more than bf16's eight bits
            x = self.begin(frames) + self.place
        clock = torch.arange(self.frames, device=x.device)
        apart = clock[:, None] - clock + self.frames - 1
        for block in self.blocks:
            x = block(x, apart)
        with torch.autocast(device, enabled=False):
            h = self.norm(x.float())
            # Joints that are seen lead nobody astray: what hangs on them is said from where they are.
            own = self.answer(h).unflatten(-1, (self.joints, 3)) * (envelope > 0)[..., None]
            beside = (self.chain @ own) * envelope[..., None]
            aside = self.aside(h.detach())
            errors = aside[..., : self.joints] + (0.3 * envelope + SURE).log()
            return torch.cat([beside.flatten(-2), errors, aside[..., self.joints :]], dim=-1)


assert FEET.stop == OUTPUTS
