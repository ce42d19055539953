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

from ...body.joints import BODY
from ...damage import corruption
from ...errors import InputError
from ..spaces import SPACES, mirrored, turned
from .network import Network

Array = np.ndarray

NEGLIGIBLE = 0.001  # metres: errors below it are as good as none
CODES = 0.02  # standard deviation of codes that begin without structure
SIZES = {"small": (128, 64), "default": (256, 128), "large": (512, 256)}  # widths of encoder and decoder, Table 1


@dataclass(frozen=True)
class XMAEConfig:
    """The first fields are the paper's and have its values. What follows is ours: of it, `structured` and `codes` are
    on, all else is off; `motionmend train xmae --paper holden` turns off these two as well."""

    size: Literal["small", "default", "large"] = "default"
    """Widths as in Table 1, or half or double of them."""
    decoder: Literal["cross", "mae", "bert"] = "cross"
    """`mae`: mask tokens among the encoded ones and no cross-attention; `bert`: that, and clean tokens in the loss."""
    encoder_depth: int = 6
    decoder_depth: int = 3
    head: int = 64
    """Features of an attention's head; more and smaller ones learn sooner whom to attend to."""
    masked: float = 0.85
    """Share of the tokens that training hides."""
    displaced: float = 0.05
    """Share of the tokens that training displaces."""
    radius: float = 1.0
    """Metres, the farthest that training displaces them."""
    clean: float = 0.05
    """Share of all tokens that are shown as they are and count in the loss with `bert`."""
    turn: bool = True
    """Training turns windows about the vertical at random, as in section 4.1; off for data without rotation."""
    structured: bool = True
    """Training begins with codes that are alike for near frames, and attention that looks near by them."""
    codes: Literal["own", "shared"] = "own"
    """`shared`: one set of codes for tokens and queries, and one projection of both to the decoder's width, which is
    equation 4 to the letter; `own`: the decoder has codes of its own, as wide as it is."""
    curves: Literal["", "on", "off", "smooth"] = ""
    """Tokens are whole poses, queries begin at curves through what is seen, and the answer is the difference from
    them: `on` for samples that may be wrong, `off` for those that are true and stay (spaces.PosesOffCurves), `smooth`
    for noisy ones (spaces.PosesSmoothCurves)."""
    damage: Literal["tokens", "takes", "gaps", "wrong"] = "tokens"
    """What training does to a window: the paper's uniform masks, `take_damage`, or its gaps alone, or what it
    does to samples that are there."""
    error: Literal["l1", "rms"] = "l1"
    """What training minimises of each window: the paper's L1, or the root of the mean squared error. From curves, L1
    stays where it begins: half of all differences are on either side of nothing."""
    mirror: bool = False
    """Training exchanges left and right in half of the windows."""
    resize: float = 0.0
    """Training makes bodies larger or smaller by up to this share."""
    query_attention: bool = True
    """Queries attend to each other, as in the paper. Without, each learns from the encoding alone, and its answer is
    the same whatever else is asked."""
    asked: int = 0
    """How many tokens of a window training asks for; 0 for all, as in the paper. Needs queries that do not attend to
    each other, or a decoder that has all tokens anyway: else training asks otherwise than use does."""


class Attention(nn.Module):
    """Multi-head attention of `(B, Q, width)` to `(B, N, source)`."""

    def __init__(self, width: int, source: int, head: int):
        super().__init__()
        self.heads = max(1, width // head)
        self.query, self.key_value = nn.Linear(width, width), nn.Linear(source, 2 * width)
        self.out = nn.Linear(width, width)

    @torch.no_grad()
    def look_near(self, shared: int) -> None:
        """Begin by attending to tokens with codes like one's own, in every head to another degree.

        Of near frames, of the same joint, or both. Attention that must find this out by itself takes many thousands of
        steps (mimetic initialisation, Trockman and Kolter 2023).
        """
        size, half = self.query.out_features // self.heads, shared // 2
        keys = self.key_value.weight[: self.query.out_features]
        for head in range(self.heads):
            rows = slice(head * size, (head + 1) * size)
            mix = torch.zeros(size, shared)
            times, joints = mix[: size // 2, :half], mix[size // 2 :, half:]
            for part, strength in ((times, (2, 1, 3, 0)[head % 4]), (joints, (0, 2, 2, 1)[head % 4])):
                part.copy_(nn.init.orthogonal_(torch.empty_like(part)) * strength)
            for weight in (self.query.weight, keys):
                weight[rows] *= 0.3
                weight[rows, :shared] += mix

    def forward(self, x: Tensor, source: Tensor, there: Tensor | None) -> Tensor:
        query = self.query(x).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        key, value = self.key_value(source).unflatten(-1, (2, self.heads, -1)).permute(2, 0, 3, 1, 4)
        met = F.scaled_dot_product_attention(query, key, value, attn_mask=there)
        return self.out(met.transpose(1, 2).flatten(2))


class Block(nn.Module):
    """A pre-norm Transformer block; with `source` it also attends to an encoding that is so wide (section 3).

    own : whether its tokens attend to each other.
    """

    def __init__(self, width: int, head: int, source: int = 0, own: bool = True):
        super().__init__()
        self.norm_own, self.own = (nn.LayerNorm(width), Attention(width, width, head)) if own else (None, None)
        self.norm_cross, self.cross = (nn.LayerNorm(width), Attention(width, source, head)) if source else (None, None)
        self.norm_mlp = nn.LayerNorm(width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.ReLU(), nn.Linear(4 * width, width))

    def among(self, x: Tensor, there: Tensor | None = None) -> Tensor:
        """The tokens after attending to each other, those that are `there`."""
        if self.norm_own is None or self.own is None:
            return x
        normed = self.norm_own(x)
        return x + self.own(normed, normed, there)

    def onward(self, x: Tensor, source: Tensor | None = None, there: Tensor | None = None) -> Tensor:
        """The tokens after attending to `source`, and the MLP."""
        if self.norm_cross is not None and self.cross is not None and source is not None:
            x = x + self.cross(self.norm_cross(x), source, there)
        return x + self.mlp(self.norm_mlp(x))


class Stack(nn.ModuleList):
    """Blocks, one after the other."""

    def __init__(self, depth: int, width: int, head: int, source: int = 0, own: bool = True):
        super().__init__(Block(width, head, source, own) for _ in range(depth))

    def __iter__(self) -> Iterator[Block]:
        return cast(Iterator[Block], super().__iter__())


class XMAE(Network):
    """5,664,003 parameters with 21 joints in the paper's size, 5,588,355 with shared codes."""

    name = "xmae"
    fps = 60.0
    frames = 60
    protocol = "xmae"
    Config = XMAEConfig
    axes: ClassVar[dict[str, dict[int, str]]] = {
        "tokens": {1: "shown"}, "index": {1: "shown"}, "there": {1: "shown"}, "asked": {1: "asked"},
    }  # fmt: skip
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {
        "small": {"size": "small", "encoder_depth": 1, "decoder_depth": 5},
        "default": {"encoder_depth": 1},
        "large": {"size": "large", "encoder_depth": 1, "decoder_depth": 1},
        "mae": {"size": "small", "decoder": "mae", "encoder_depth": 1, "decoder_depth": 1},
        "bert": {"size": "small", "decoder": "bert", "encoder_depth": 1, "decoder_depth": 1, "displaced": 0.0},
        "curves": {"size": "small", "curves": "on", "damage": "takes", "mirror": True, "resize": 0.1,
                   "query_attention": False, "asked": 100, "head": 16, "encoder_depth": 1},
        "off": {"size": "small", "curves": "off", "damage": "gaps", "query_attention": False, "asked": 100, "head": 16,
                "encoder_depth": 1, "decoder_depth": 1},
        "smooth": {"size": "small", "curves": "smooth", "damage": "wrong", "query_attention": False, "asked": 100,
                   "head": 16, "encoder_depth": 1, "decoder_depth": 1},
        "letter": {"size": "small", "codes": "shared", "structured": False, "encoder_depth": 1, "decoder_depth": 1},
    }  # fmt: skip
    DEFAULTS: ClassVar[dict[str, Any]] = {"batch": 128, "lr": 3e-4, "steps": 100_000}

    def __init__(self, config: XMAEConfig, joints: int):
        super().__init__(config, joints)
        self.space = f"poses_{config.curves}_curves" if config.curves else "joint_tokens"
        # Who was asked for some tokens in training is asked in use for those that count.
        self.space += "_asked" if config.curves == "off" and config.asked else ""
        if config.curves and joints != len(BODY):
            raise InputError(f"curves for {joints} joints", expected=f"the {len(BODY)} joints of BODY")
        wide, narrow = SIZES[config.size]
        crossing, shared = config.decoder == "cross", config.codes == "shared"
        queried = wide if shared else narrow
        self.embed = nn.Linear(10 * joints if config.curves else 3, wide)
        self.joint_code = self._codes(joints, wide, narrow, times=False)
        self.time_code = self._codes(self.frames, wide, narrow, times=True)
        self.encoder = Stack(config.encoder_depth, wide, config.head)
        self.encoded = nn.LayerNorm(wide)
        self.narrowed = nn.Identity() if crossing and not shared else nn.Linear(wide, narrow)
        self.mask_token = nn.Parameter(torch.randn(queried) * CODES)
        self.joint_query = None if shared else self._codes(joints, narrow, narrow, times=False)
        self.time_query = None if shared else self._codes(self.frames, narrow, narrow, times=True)
        self.begin = nn.Linear(14, narrow) if config.curves else None
        met = (narrow if shared else wide) if crossing else 0
        self.decoder = Stack(config.decoder_depth, narrow, config.head, met, config.query_attention or not crossing)
        self.decoded, self.head = nn.LayerNorm(narrow), nn.Linear(narrow, 3)
        if config.structured:
            for stack in (self.encoder,) if shared else (self.encoder, self.decoder):
                for block in stack:
                    for attention in (block.own, block.cross):
                        if attention is not None:
                            attention.look_near(narrow)
        if config.structured and not config.curves:
            with torch.no_grad():  # codes are not to drown in coordinates
                self.embed.weight[:narrow] *= 0.2
        if config.curves:  # an untrained network answers with the curve
            nn.init.zeros_(self.head.weight)
            nn.init.zeros_(self.head.bias)

    def _codes(self, count: int, width: int, shared: int, times: bool) -> nn.Parameter:
        """What tells `count` frames or joints apart, learned from here, `(count, width)`."""
        if self.config.structured:
            return nn.Parameter(_apart(count, width, shared, times))
        return nn.Parameter(torch.randn(count, width) * CODES)

    # Training

    def batch(self, positions: Array, observed: Array, rng: np.random.Generator, step: int) -> dict[str, Array]:
        c = self.config
        if c.asked and c.query_attention and c.decoder == "cross":
            raise InputError(f"{c.asked} tokens asked of queries that attend to each other, of which use asks all",
                             hint="say --network.no-query-attention, or --network.asked 0")  # fmt: skip
        truth = np.where(observed[..., None], positions, np.float32(0))
        rows = len(truth)
        if c.resize:
            truth *= rng.uniform(1 - c.resize, 1 + c.resize, (rows, 1, 1, 1)).astype(np.float32)
        if c.mirror:
            truth, observed = mirrored(truth, observed, rng.random(rows) < 0.5)
        if c.damage != "tokens":
            damaged, hidden, moved = corruption.take_damage(truth, observed, rng, only=c.damage.replace("takes", ""))
        else:
            hidden, moved = corruption.token_masks(
                observed.shape, rng, masked=c.masked, displaced=c.displaced, observed=observed
            )
            damaged = corruption.displace(truth, moved, corruption.ball(observed.shape, c.radius, rng))
        seen = observed & ~hidden
        space = SPACES[self.space]()
        inputs, known = space.encode(damaged, seen)
        # After normalisation, as section 4.1 has it; from curves, the space has turned the bodies to face one way.
        angles = rng.uniform(-np.pi, np.pi, rows) * c.turn
        if c.curves:
            angles = known[1]
        else:
            inputs["tokens"] = turned(inputs["tokens"], angles)
        wanted = (observed & hidden) | moved
        if c.decoder == "bert":
            wanted |= seen & (rng.random(observed.shape) < c.clean / max(1 - c.masked - c.displaced, c.clean))
        target = turned(truth - space.decode(np.zeros_like(truth), known), angles)
        weight = (wanted + (0.3 * (seen & ~wanted) if c.damage in ("takes", "wrong") else 0)).astype(np.float32)
        inputs |= {"target": target.reshape(rows, -1, 3), "weight": weight.reshape(rows, -1)}
        if c.curves == "off":
            inputs["leeway"] = known[3].reshape(rows, -1)
        tokens = observed[0].size
        if not c.curves:
            _filled_up(inputs, tokens - round(c.masked * tokens) if c.damage == "tokens" else tokens)
        if c.asked:
            # By chance, whatever is wrong with them: who is asked must not tell. Where only what is hidden counts, that
            # is asked first, for everybody sees what it is.
            keys = rng.random((rows, tokens), np.float32) - (hidden.reshape(rows, -1) if c.damage == "gaps" else 0)
            asked = np.sort(np.argpartition(keys, c.asked, axis=1)[:, : c.asked], axis=1)
            inputs["asked"] = asked
            for name in {"weight", "leeway"} & inputs.keys():
                inputs[name] = np.take_along_axis(inputs[name], asked, axis=1)
            inputs["target"] = np.take_along_axis(inputs["target"], asked[..., None], axis=1)
        return inputs

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        # Attention without a mask is faster, and nearly always all tokens are there.
        there = None if bool(batch["there"].all()) else batch["there"]
        answer = self._answer(batch["tokens"], batch["index"], there, batch.get("curve"), batch.get("asked"))
        answer = answer * batch["leeway"][..., None] if "leeway" in batch else answer
        weight = batch["weight"] / batch["weight"].sum(dim=1, keepdim=True).clamp(min=1)
        missed = answer - batch["target"]
        if self.config.error == "l1":
            return {"loss": (missed.abs().mean(dim=-1) * weight).sum(dim=1)}
        return {"loss": ((missed**2).sum(dim=-1) * weight).sum(dim=1).add(NEGLIGIBLE**2).sqrt()}

    # The network

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, tokens: Tensor, index: Tensor, there: Tensor, curve: Tensor | None = None, asked: Tensor | None = None
    ) -> Tensor:
        """`(B, T, J, 3)`; 0 where a network that was trained on `asked (B, Q)` tokens is not asked (-1: for none)."""
        if asked is None or not self.config.asked:
            return self._answer(tokens, index, there, curve, None).unflatten(1, (self.frames, self.joints))
        some, count = asked >= 0, self.frames * self.joints
        answer = self._answer(tokens, index, there, curve, asked.clamp(min=0), some)
        place = torch.where(some, asked, count)[..., None].expand_as(answer)  # who is not asked goes to the end
        whole = answer.new_zeros(answer.shape[0], count + 1, 3).scatter(1, place, answer)
        return whole[:, :count].unflatten(1, (self.frames, self.joints))

    def _answer(
        self, tokens: Tensor, index: Tensor, there: Tensor | None, curve: Tensor | None, asked: Tensor | None,
        some: Tensor | None = None,
    ) -> Tensor:  # fmt: skip
        """`(B, Q, 3)`; all T · J tokens where none are `asked (B, Q)` for in particular.

        there `(B, N)`, some `(B, Q)` : which tokens are shown, and asked, at all; None where all are.
        """
        mask = None if there is None else there[:, None, None, :]
        with torch.autocast(tokens.device.type, enabled=False):  # coordinates need more than bf16's eight bits
            frame, joint = index // self.joints, index % self.joints
            x = self.embed(tokens) + F.embedding(frame, self.time_code) + F.embedding(joint, self.joint_code)
            start = None if self.begin is None or curve is None else self.begin(curve.flatten(1, 2))
        for block in self.encoder:
            x = block.onward(block.among(x, mask))
        x = self.encoded(x)
        if self.config.decoder == "cross":
            x = self._meet(x, mask, start, asked, None if some is None else some[:, None, None, :])
        else:
            x = self._mix(x, index, there, start, asked)
        with torch.autocast(tokens.device.type, enabled=False):
            return self.head(self.decoded(x.float()))

    def _codes_of_queries(self) -> Tensor:
        """`(T · J, width)`, of the decoder's width, or of the encoder's where codes are shared."""
        times, joints = self.time_query, self.joint_query
        return _grid(self.time_code if times is None else times, self.joint_code if joints is None else joints)

    def _meet(
        self, encoded: Tensor, mask: Tensor | None, start: Tensor | None, asked: Tensor | None, some: Tensor | None
    ) -> Tensor:
        """Section 3.2: queries that know where they are and nothing else learn the rest from the encoding."""
        queries = self.mask_token + self._codes_of_queries()
        if self.config.codes == "shared":
            queries, encoded = self.narrowed(queries), self.narrowed(encoded)
        queries = F.embedding(asked, queries) if asked is not None else queries[None]
        if start is not None:
            queries = queries + _picked(start, asked)
        # Without curves all windows begin with the same queries, so those attend to each other once, not in each.
        for number, block in enumerate(self.decoder):
            queries = block.among(queries, some)
            if not number:
                queries = queries.expand(encoded.shape[0], -1, -1)
            queries = block.onward(queries, encoded, mask)
        return queries

    def _mix(
        self, encoded: Tensor, index: Tensor, there: Tensor | None, start: Tensor | None, asked: Tensor | None
    ) -> Tensor:
        """He et al. 2022: encoded tokens in their places, mask tokens in all others, and self-attention.

        From curves every place also knows its curve, as every query does in `_meet`.
        """
        codes = self._codes_of_queries()
        queries = self.mask_token + codes
        if self.config.codes == "shared":
            seen = self.narrowed(encoded + F.embedding(index, codes))
            queries = self.narrowed(queries)
        else:
            seen = self.narrowed(encoded) + F.embedding(index, codes)
        rows, count = encoded.shape[0], queries.shape[0]
        place = index if there is None else torch.where(there, index, count)  # what is not there goes to the end
        x = torch.cat([queries, queries[:1]])[None].expand(rows, -1, -1).to(seen.dtype)
        x = x.scatter(1, place[..., None].expand_as(seen), seen)[:, :count]
        x = x if start is None else x + start
        for block in self.decoder:
            x = block.onward(block.among(x))
        return _picked(x, asked)


def _picked(x: Tensor, asked: Tensor | None) -> Tensor:
    """Of `x (B, T · J, width)` the tokens that are asked for."""
    return x if asked is None else x.gather(1, asked[..., None].expand(-1, -1, x.shape[-1]))


def _apart(count: int, width: int, shared: int, times: bool) -> Tensor:
    """Codes of frames in the first half of the `shared` features, as sines and cosines (Vaswani et al. 2017), so that
    near ones are alike; of joints at random in the second half."""
    half, codes = shared // 2, torch.zeros(count, width)
    if times:
        angles = torch.arange(count)[:, None] * count ** -torch.linspace(0, 1, half // 2)
        codes[:, :half] = torch.cat([angles.sin(), angles.cos()], dim=1)
    else:
        codes[:, half:shared] = torch.randn(count, half) / 2**0.5
    return codes


def _grid(times: Tensor, joints: Tensor) -> Tensor:
    """The sums of codes `(T, width)` and `(J, width)`, `(T · J, width)` in the order of tokens."""
    return (times[:, None] + joints).flatten(0, 1)


def _filled_up(inputs: dict[str, Array], count: int) -> None:
    """Fill up with tokens that are not there, so that all blocks of a batch have the same shape."""
    for name in ("tokens", "index", "there"):
        missing = count - inputs[name].shape[1]
        inputs[name] = np.pad(inputs[name], [(0, 0), (0, max(0, missing))] + [(0, 0)] * (inputs[name].ndim - 2))
