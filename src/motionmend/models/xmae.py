"""XMAE: a masked autoencoder whose decoder meets what was seen in cross-attention alone (Björkstrand et al. 2023).

Section numbers are the paper's. B = windows, T = frames, J = joints, N = observed tokens of the fullest window,
Q = tokens that are asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .. import damage
from ..spaces import SPACES, mirrored, turned
from .network import Network

Array = np.ndarray

HEAD = 64  # Table 1
SIZES = {"small": (128, 64), "default": (256, 128), "large": (512, 256)}  # widths of encoder and decoder, Table 1


@dataclass(frozen=True)
class XMAEConfig:
    """The first fields are the paper's and have its values; `curves` and what follows are ours, and off."""

    size: Literal["small", "default", "large"] = "default"
    """Widths as in Table 1, or half or double of them."""
    decoder: Literal["cross", "mae", "bert"] = "cross"
    """`mae`: mask tokens among the encoded ones and no cross-attention; `bert`: that, and clean tokens in the loss."""
    encoder_depth: int = 6
    decoder_depth: int = 3
    masked: float = 0.85
    """Share of the tokens that training hides."""
    displaced: float = 0.05
    """Share of the tokens that training displaces."""
    radius: float = 1.0
    """Metres, the farthest that training displaces them."""
    clean: float = 0.05
    """Share of all tokens that are shown as they are and count in the loss with `bert`."""
    curves: Literal["", "on", "off"] = ""
    """Queries begin at Hermite curves through what is seen, and the answer is the difference from them: `on` for
    samples that may be wrong, `off` for those that are true and are not to be changed (spaces.TokensOffCurves)."""
    damage: Literal["tokens", "takes", "gaps"] = "tokens"
    """What training does to a window: the paper's uniform masks, `damage.take_damage`, or its gaps alone."""
    delta: float = 0.0
    """Metres from which on the loss is L1, and below which it is quadratic (Huber 1964); 0 for L1 throughout. From
    curves, L1 alone stays where it begins: half of all differences are on either side of nothing."""
    mirror: bool = False
    """Training exchanges left and right in half of the windows."""
    resize: float = 0.0
    """Training makes bodies larger or smaller by up to this share."""
    asked: int = 0
    """How many tokens of a window training asks for, hidden and displaced ones first; 0 for all, as in the paper."""
    shown: int = 0
    """How many of a window's observed tokens training shows the encoder, drawn at random; 0 for all."""


class Attention(nn.Module):
    """Multi-head attention of `(B, Q, width)` to `(B, N, source)`."""

    def __init__(self, width: int, source: int):
        super().__init__()
        self.heads = max(1, width // HEAD)
        self.query, self.key_value = nn.Linear(width, width), nn.Linear(source, 2 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, source: Tensor, there: Tensor | None) -> Tensor:
        query = self.query(x).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        key, value = self.key_value(source).unflatten(-1, (2, self.heads, -1)).permute(2, 0, 3, 1, 4)
        met = F.scaled_dot_product_attention(query, key, value, attn_mask=there)
        return self.out(met.transpose(1, 2).flatten(2))


class Block(nn.Module):
    """A pre-norm Transformer block; with `source` it also attends to an encoding that is so wide (section 3)."""

    def __init__(self, width: int, source: int = 0):
        super().__init__()
        self.norm_own, self.own = nn.LayerNorm(width), Attention(width, width)
        self.norm_cross, self.cross = (nn.LayerNorm(width), Attention(width, source)) if source else (None, None)
        self.norm_mlp = nn.LayerNorm(width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.ReLU(), nn.Linear(4 * width, width))

    def among(self, x: Tensor, there: Tensor | None = None) -> Tensor:
        """The tokens after attending to each other, those that are `there`."""
        normed = self.norm_own(x)
        return x + self.own(normed, normed, there)

    def onward(self, x: Tensor, source: Tensor | None = None, there: Tensor | None = None) -> Tensor:
        """The tokens after attending to `source`, and the MLP."""
        if self.norm_cross is not None and self.cross is not None and source is not None:
            x = x + self.cross(self.norm_cross(x), source, there)
        return x + self.mlp(self.norm_mlp(x))


class Stack(nn.ModuleList):
    """Blocks, one after the other."""

    def __init__(self, depth: int, width: int, source: int = 0):
        super().__init__(Block(width, source) for _ in range(depth))

    def __iter__(self) -> Iterator[Block]:
        return cast(Iterator[Block], super().__iter__())


class XMAE(Network):
    """5,664,003 parameters with 21 joints in the paper's size."""

    name = "xmae"
    fps = 60.0
    frames = 60
    protocol = "xmae"
    Config = XMAEConfig
    axes: ClassVar[dict[str, dict[int, str]]] = {"tokens": {1: "shown"}, "index": {1: "shown"}, "there": {1: "shown"}}
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {
        "small": {"size": "small", "encoder_depth": 1, "decoder_depth": 5},
        "default": {"encoder_depth": 1},
        "large": {"size": "large", "encoder_depth": 1, "decoder_depth": 1},
        "mae": {"size": "small", "decoder": "mae", "encoder_depth": 1, "decoder_depth": 1},
        "bert": {"size": "small", "decoder": "bert", "encoder_depth": 1, "decoder_depth": 1, "displaced": 0.0},
        "curves": {"size": "small", "curves": "on", "damage": "takes", "mirror": True, "resize": 0.1,
                   "asked": 100, "shown": 100, "encoder_depth": 1},
    }  # fmt: skip
    DEFAULTS: ClassVar[dict[str, Any]] = {"batch": 128, "lr": 3e-4, "steps": 100_000}

    def __init__(self, config: XMAEConfig, joints: int):
        super().__init__(config, joints)
        self.space = f"tokens_{config.curves}_curves" if config.curves else "joint_tokens"
        wide, narrow = SIZES[config.size]
        crossing = config.decoder == "cross"
        self.embed = nn.Linear(3, wide)
        self.joint_code, self.time_code = _codes(joints, wide), _times(self.frames, wide)
        self.encoder = Stack(config.encoder_depth, wide)
        self.encoded = nn.LayerNorm(wide)
        self.narrowed = nn.Identity() if crossing else nn.Linear(wide, narrow)
        self.mask_token = _codes(narrow)
        self.joint_query, self.time_query = _codes(joints, narrow), _times(self.frames, narrow)
        self.begin = nn.Linear(8, narrow) if config.curves else None
        self.decoder = Stack(config.decoder_depth, narrow, wide if crossing else 0)
        self.decoded, self.head = nn.LayerNorm(narrow), nn.Linear(narrow, 3)
        if config.curves:  # an untrained network answers with the curve
            nn.init.zeros_(self.head.weight)
            nn.init.zeros_(self.head.bias)

    # Training

    def batch(self, positions: Array, observed: Array, rng: np.random.Generator, step: int) -> dict[str, Array]:
        c = self.config
        truth = np.where(observed[..., None], positions, np.float32(0))
        rows = len(truth)
        if c.resize:
            truth *= rng.uniform(1 - c.resize, 1 + c.resize, (rows, 1, 1, 1)).astype(np.float32)
        if c.mirror:
            truth, observed = mirrored(truth, observed, rng.random(rows) < 0.5)
        if c.damage != "tokens":
            damaged, hidden, moved = damage.take_damage(truth, observed, rng, gaps_only=c.damage == "gaps")
        else:
            hidden, moved = damage.token_masks(
                observed.shape, rng, masked=c.masked, displaced=c.displaced, observed=observed
            )
            damaged = damage.displace(truth, moved, damage.ball(observed.shape, c.radius, rng))
        seen = observed & ~hidden
        space = SPACES[self.space]()
        inputs, known = space.encode(damaged, seen)
        # After normalisation, as section 4.1 has it. Where the space turns bodies to face one way, it may be wrong.
        angles = rng.uniform(-np.pi, np.pi, rows)
        if c.curves:
            angles *= np.where(rng.random(rows) < 0.1, 1, 0.1)
            for part in (slice(0, 3), slice(3, 6)):
                inputs["curve"][..., part] = turned(inputs["curve"][..., part], angles)
        inputs["tokens"] = turned(inputs["tokens"], angles)
        wanted = (observed & hidden) | moved
        if c.decoder == "bert":
            wanted |= seen & (rng.random(observed.shape) < c.clean / max(1 - c.masked - c.displaced, c.clean))
        target = turned(truth - space.decode(np.zeros_like(truth), known), angles + known[1] if c.curves else angles)
        weight = (wanted + (0.3 * (seen & ~wanted) if c.damage == "takes" else 0)).astype(np.float32)
        inputs |= {"target": target.reshape(rows, -1, 3), "weight": weight.reshape(rows, -1)}
        if c.curves == "off":
            inputs["leeway"] = known[3].reshape(rows, -1)
        if c.shown:
            _show(inputs, c.shown, rng)
        if c.asked:
            # The same tokens are asked of all windows of a block: hidden and displaced ones first.
            keys = rng.random(weight.reshape(rows, -1).shape, np.float32) - wanted.reshape(rows, -1)
            asked = np.sort(np.argpartition(keys, c.asked, axis=1)[:, : c.asked], axis=1)
            inputs["asked"] = asked
            for name in {"weight", "leeway"} & inputs.keys():
                inputs[name] = np.take_along_axis(inputs[name], asked, axis=1)
            inputs["target"] = np.take_along_axis(inputs["target"], asked[..., None], axis=1)
        return inputs

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        answer = self._answer(
            batch["tokens"], batch["index"], batch["there"], batch.get("curve"), batch.get("asked")
        )  # fmt: skip
        answer = answer * batch["leeway"][..., None] if "leeway" in batch else answer
        weight = batch["weight"] / batch["weight"].sum(dim=1, keepdim=True).clamp(min=1)
        losses = {"loss": (self._apart(answer, batch["target"]) * weight).sum(dim=1)}
        if self.config.curves:  # what the curve alone would have
            losses["curve"] = (self._apart(torch.zeros_like(answer), batch["target"]) * weight).sum(dim=1)
        return losses

    def _apart(self, answer: Tensor, target: Tensor) -> Tensor:
        if self.config.delta:
            return F.huber_loss(answer, target, reduction="none", delta=self.config.delta).mean(dim=-1)
        return (answer - target).abs().mean(dim=-1)

    # The network

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, tokens: Tensor, index: Tensor, there: Tensor, curve: Tensor | None = None
    ) -> Tensor:
        return self._answer(tokens, index, there, curve, None).unflatten(1, (self.frames, self.joints))

    def _answer(
        self, tokens: Tensor, index: Tensor, there: Tensor, curve: Tensor | None, asked: Tensor | None
    ) -> Tensor:
        """`(B, Q, 3)`; all T · J tokens where none are `asked (B, Q)` for in particular."""
        mask = there[:, None, None, :]
        with torch.autocast(tokens.device.type, enabled=False):  # coordinates need more than bf16's eight bits
            frame, joint = index // self.joints, index % self.joints
            x = self.embed(tokens) + F.embedding(frame, self.time_code) + F.embedding(joint, self.joint_code)
        for block in self.encoder:
            x = block.onward(block.among(x, mask))
        x = self.encoded(x)
        queries = self.mask_token + _grid(self.time_query, self.joint_query)
        x = self._meet(x, there, queries, asked, curve) if self.config.decoder == "cross" else (
            self._mix(x, index, there, queries, asked)
        )  # fmt: skip
        with torch.autocast(tokens.device.type, enabled=False):
            return self.head(self.decoded(x.float()))

    def _meet(
        self, encoded: Tensor, there: Tensor, queries: Tensor, asked: Tensor | None, curve: Tensor | None
    ) -> Tensor:
        """Section 3.2: queries that know where they are and nothing else learn the rest from the encoding."""
        queries = F.embedding(asked, queries) if asked is not None else queries[None]
        if self.begin is not None and curve is not None:
            curve = curve.flatten(1, 2)
            curve = curve if asked is None else curve.gather(1, asked[..., None].expand(-1, -1, curve.shape[-1]))
            with torch.autocast(encoded.device.type, enabled=False):
                queries = queries + self.begin(curve)
        # Without curves all windows begin with the same queries, so those attend to each other once, not in each.
        for number, block in enumerate(self.decoder):
            queries = block.among(queries)
            if not number:
                queries = queries.expand(encoded.shape[0], -1, -1)
            queries = block.onward(queries, encoded, there[:, None, None, :])
        return queries

    def _mix(self, encoded: Tensor, index: Tensor, there: Tensor, queries: Tensor, asked: Tensor | None) -> Tensor:
        """He et al. 2022: encoded tokens in their places, mask tokens in all others, and self-attention."""
        rows, count = encoded.shape[0], queries.shape[0]
        codes = queries - self.mask_token
        seen = self.narrowed(encoded) + F.embedding(index, codes)
        place = torch.where(there, index, count)[..., None].expand_as(seen)  # what is not there goes to the end
        x = torch.cat([queries, queries[:1]])[None].expand(rows, -1, -1).to(seen.dtype)
        x = x.scatter(1, place, seen)[:, :count]
        for block in self.decoder:
            x = block.onward(block.among(x))
        return x if asked is None else x.gather(1, asked[..., None].expand(-1, -1, x.shape[-1]))


def _codes(*shape: int) -> nn.Parameter:
    return nn.Parameter(torch.randn(*shape) * 0.5)


def _times(frames: int, width: int) -> nn.Parameter:
    """Sines and cosines (Vaswani et al. 2017) to begin with: learned from there, near frames are alike at once."""
    rates = frames ** -torch.linspace(0, 1, width // 2)
    angles = torch.arange(frames)[:, None] * rates
    return nn.Parameter(0.5 * torch.cat([angles.sin(), angles.cos()], dim=1))


def _grid(times: Tensor, joints: Tensor) -> Tensor:
    """The sums of codes `(T, width)` and `(J, width)`, `(T · J, width)` in the order of tokens."""
    return (times[:, None] + joints).flatten(0, 1)


def _show(inputs: dict[str, Array], most: int, rng: np.random.Generator) -> None:
    """Leave a window at most so many of its tokens, drawn at random."""
    there = inputs["there"]
    if there.shape[1] > most:
        keys = rng.random(there.shape, np.float32) + ~there
        kept = np.argpartition(keys, most, axis=1)[:, :most]
        for name in ("tokens", "index", "there"):
            values = inputs[name]
            inputs[name] = np.take_along_axis(values, kept[..., None] if values.ndim == 3 else kept, axis=1)
