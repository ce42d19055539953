"""TrajeVAE: a first pose and the paths of some joints in, any number of motions out (Kania et al. 2021).

Section numbers are the paper's. B = windows, T = frames after the first, J = joints, C = coefficients over time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...body.joints import BODY, LEFT_RIGHT
from ...body.standing import STANDING
from ...errors import InputError
from ..spaces import ACROSS, FirstPelvis, mirrored, turned
from .network import Network

Array = np.ndarray

SIZES = {"paper": (512, 2), "medium": (256, 1), "small": (192, 1)}  # width, layers of a stack
LOG_VARIANCE = 12.0  # bound of its absolute value: beyond, exp of it is of no use to anyone
PACE = 0.02  # metres a frame, what a network that begins at rest answers with 1
SLOW = 32  # cosines over a window, up to 8 Hz, that answers are made of where they are not summed up
NEAR = 0.6  # metres along the bones: a joint follows one that is so much farther away e times less
AWAY = 25  # frames, from which on joints that went at PACE are not expected to have come farther


@dataclass(frozen=True)
class TrajeVAEConfig:
    """The first fields, up to `kl`, are the paper's and have its values; what follows `xavier` is ours, and off."""

    size: Literal["paper", "medium", "small"] = "paper"
    """Width and layers of a stack: 512 and 2, 256 and 1, 192 and 1."""
    heads: int = 4
    dropout: float = 0.1
    prior: Literal["learned", "standard"] = "learned"
    """`standard`: no encoder of poses; the code of the trajectories is drawn towards a standard normal distribution."""
    dct: bool = True
    """Latent vectors are coefficients of a cosine transform over time rather than of frames."""
    mask_future: bool = True
    """The encoder of poses does not see the joints that are given."""
    given: float = 0.15
    """Share of the joints whose trajectories training gives."""
    kl: float = 0.01
    """Weight of the divergence of posterior and prior."""
    xavier: bool = False
    """Attention begins as in the authors' code, by torch's MultiheadAttention, rather than as any linear layer."""
    patch: int = 1
    """Frames that make a token together."""
    coefficients: int = 0
    """Keep only so many of the slowest cosines; 0 for all."""
    standardised: bool = False
    """Bodies face one way, inputs are differences that vary by about 1, and an untrained network stands still."""
    direct: bool = False
    """The network says how far joints have come rather than how far they go in each frame: sums over time make small
    errors of every frame large ones of the last, which then are all that is learned."""
    climb: int = 0
    """Steps in which `kl` grows from nothing: a decoder that learns to do without latent vectors goes on without."""
    along: bool = False
    """Answers begin at the given trajectories, which they keep and which carry other joints along, near ones the most;
    the decoder sees them too."""
    hips: float = 0.0
    """Weight of the squared error of joints from the hips, besides that of joints in the world."""
    bones: float = 0.0
    """Weight of the squared error of joints from the joints that they hang from."""
    spans: float = 0.0
    """Share of the windows in which training gives trajectories for some frames only."""
    mirror: bool = False
    """Training exchanges left and right in half of the windows."""
    resize: float = 0.0
    """Training makes bodies larger or smaller by up to this share."""


class Layer(nn.Module):
    """Self-attention and an MLP as wide as the tokens `(B, N, width)`, each normalised after it is added."""

    def __init__(self, width: int, heads: int, dropout: float):
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.query_key_value, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.inward, self.outward = nn.Linear(width, width), nn.Linear(width, width)
        self.norm_attention, self.norm_mlp = nn.LayerNorm(width), nn.LayerNorm(width)
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Tensor) -> Tensor:
        query, key, value = self.query_key_value(x).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        met = F.scaled_dot_product_attention(query, key, value, dropout_p=self.dropout if self.training else 0.0)
        x = self.norm_attention(x + self.drop(self.out(met.transpose(1, 2).flatten(2))))
        return self.norm_mlp(x + self.drop(self.outward(self.drop(F.relu(self.inward(x))))))


def stack(config: TrajeVAEConfig) -> nn.Sequential:
    width, depth = SIZES[config.size]
    return nn.Sequential(*(Layer(width, config.heads, config.dropout) for _ in range(depth)), nn.LayerNorm(width))


def mlp(inward: int, width: int) -> nn.Sequential:
    """Appendix B's, for poses and trajectories."""
    parts = (nn.Linear(inward, width), nn.Linear(width, width))
    return nn.Sequential(*(layer for part in parts for layer in (part, nn.LayerNorm(width), nn.LeakyReLU(0.1))))


def bottleneck(inward: int, width: int, outward: int) -> nn.Sequential:
    """Appendix B's, around the decoder."""
    return nn.Sequential(
        nn.Linear(inward, width), nn.LayerNorm(width), nn.LeakyReLU(0.1), nn.Linear(width, outward)
    )  # fmt: skip


class Gaussian(nn.Module):
    """The unshared end of an encoder: a third stack, and heads for mean and logarithm of the variance."""

    def __init__(self, config: TrajeVAEConfig):
        super().__init__()
        width = SIZES[config.size][0]
        self.stack, self.mean, self.log_variance = stack(config), nn.Linear(width, width), nn.Linear(width, width)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x = self.stack(x)
        with torch.autocast(x.device.type, enabled=False):
            return self.mean(x.float()), self.log_variance(x.float()).clamp(-LOG_VARIANCE, LOG_VARIANCE)


class TrajeVAE(Network):
    """17,955,391 parameters with 21 joints in the paper's size."""

    name = "trajevae"
    space = "first_pelvis"
    fps = 50.0
    frames = 101
    protocol = "trajevae"
    generative = True
    Config = TrajeVAEConfig
    TRIALS: ClassVar[dict[str, dict[str, Any]]] = {
        "": {"size": "small", "patch": 4, "coefficients": 20, "standardised": True, "direct": True, "along": True,
             "spans": 0.5, "mirror": True, "resize": 0.1},
    }  # fmt: skip
    DEFAULTS: ClassVar[dict[str, Any]] = {
        "batch": 64, "lr": 1e-4, "betas": (0.9, 0.99), "steps": 240_000, "schedule": "step", "clip": 0.0, "warmup": 0.0,
    }  # fmt: skip

    cosines: Tensor
    positions: Tensor
    slow: Tensor
    standing: Tensor
    away: Tensor
    near: Tensor

    def __init__(self, config: TrajeVAEConfig, joints: int):
        super().__init__(config, joints)
        for wanted, what in ((config.standardised, "standardise"), (config.along, "carry along"),
                             (config.bones, "measure bones of"), (config.mirror, "mirror")):  # fmt: skip
            if wanted:
                only_bodies(what, joints)
        width, later = SIZES[config.size][0], self.frames - 1
        if later % config.patch:
            raise InputError(f"patches of {config.patch} frames", expected=f"a divisor of {later}")
        tokens = later // config.patch
        kept = min(config.coefficients or tokens, tokens) if config.dct else tokens
        self.noise_size = kept * width
        self.pose_mlp = mlp(3 * joints, width // 2)
        self.frame_mlp = mlp((7 if config.standardised else 3) * joints * config.patch, width // 2)
        self.over_time, self.over_coefficients = stack(config), stack(config)
        self.prior = Gaussian(config)
        self.posterior = Gaussian(config) if config.prior == "learned" else None
        self.joined = bottleneck(width * (5 if config.along else 3) // 2, width, width)
        self.decoder = stack(config)
        self.offsets = bottleneck(width, width, 3 * joints * config.patch)
        self.drop = nn.Dropout(config.dropout)
        for layer in (each for each in self.modules() if isinstance(each, Layer) and config.xavier):
            nn.init.xavier_uniform_(layer.query_key_value.weight)
            nn.init.zeros_(layer.query_key_value.bias)
            nn.init.zeros_(layer.out.bias)
        self.register_buffer("cosines", dct(tokens)[:kept] if config.dct else torch.eye(tokens), persistent=False)
        self.register_buffer("positions", sines(tokens, width), persistent=False)
        self.register_buffer("slow", dct(later)[:SLOW], persistent=False)
        away = (torch.arange(later) + 1).clamp(max=AWAY).float()[:, None, None]
        self.register_buffer("away", away, persistent=False)
        if config.along:
            self.register_buffer("near", torch.exp(-bone_paths() / NEAR), persistent=False)
        if config.standardised:
            self.register_buffer("standing", torch.tensor(STANDING), persistent=False)
            with torch.no_grad():  # an untrained network stands still
                for parameter in self.offsets[-1].parameters():
                    parameter *= 1e-3

    # Training

    def batch(self, positions: Array, observed: Array, rng: np.random.Generator, step: int) -> dict[str, Array]:
        return path_batch(self.config, positions, observed, rng)

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """Equations 2 to 4. Squared metres, summed over given and missing joints."""
        pose, given, wanted = batch["pose"], batch["given"], batch["wanted"]
        way = self._facing(pose)
        pose, paths, future = (_turned(each, way) for each in (pose, batch["trajectories"], batch["future"]))
        code = self._code(pose)
        seen = self._seen(paths, given, pose, code)
        prior = self._latent(seen, self.prior)
        if self.posterior is None:
            drawn, divergence = prior, kl(prior, tuple(torch.zeros_like(each) for each in prior))
        else:
            shown = wanted & ~given if self.config.mask_future else wanted
            drawn = self._latent(self._seen(future, shown, pose, code), self.posterior)
            divergence = kl(drawn, prior)
        answer = self._decoded(_sample(drawn, torch.randn_like(drawn[0])), paths, given, pose, code, seen)
        error = self._error(answer - future, wanted)
        divergence = divergence.sum((1, 2))
        weight = self.config.kl * min(1.0, step / max(self.config.climb, 1) if self.config.climb else 1.0)
        return {"loss": error + weight * divergence, "error": error, "kl": divergence}

    def _error(self, missed: Tensor, wanted: Tensor) -> Tensor:
        """`(B,)` squared metres that answers `missed (B, T, J, 3)` where they are `wanted`, from other joints too."""
        error = ((missed**2).sum(-1) * wanted).sum((1, 2))
        parents = torch.tensor([max(0, parent) for parent in BODY.parents]) if self.config.bones else None
        for weight, others in ((self.config.hips, slice(0, 1)), (self.config.bones, parents)):
            if weight:
                both = wanted & wanted[:, :, others]
                error = error + weight * (((missed - missed[:, :, others]) ** 2).sum(-1) * both).sum((1, 2))
        return error

    # The network

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, pose: Tensor, trajectories: Tensor, given: Tensor, noise: Tensor
    ) -> Tensor:
        way = self._facing(pose)
        pose, paths = _turned(pose, way), _turned(trajectories, way)
        code = self._code(pose)
        seen = self._seen(paths, given, pose, code)
        prior = self._latent(seen, self.prior)
        z = _sample(prior, noise.unflatten(1, (-1, prior[0].shape[-1])))
        answer = self._decoded(z, paths, given, pose, code, seen)
        return _turned(answer, way, back=True)

    def _facing(self, pose: Tensor) -> tuple[Tensor, Tensor] | None:
        """Cosine and sine `(B,)` of the angle from +X to the body's left in the first pose `(B, J, 3)`."""
        if not self.config.standardised:
            return None
        left, right = (list(side) for side in zip(*(pair for pair in LEFT_RIGHT if pair[0] in ACROSS)))
        there = _there(pose)
        both = there[:, left] & there[:, right]
        across = ((pose[:, left] - pose[:, right]) * both[..., None]).sum(1)
        length = (across[:, 0] ** 2 + across[:, 2] ** 2).sqrt()
        seen = length > 1e-3
        length = torch.where(seen, length, 1.0)
        return torch.where(seen, across[:, 0] / length, 1.0), torch.where(seen, across[:, 2] / length, 0.0)

    def _code(self, pose: Tensor) -> Tensor:
        """The first pose's code `(B, width / 2)`, which encoders and decoder share."""
        if self.config.standardised:
            pose = 8 * (pose - self.standing) * _there(pose)[..., None]
        with torch.autocast(pose.device.type, enabled=False):  # coordinates need more than bf16's eight bits
            return self.pose_mlp(pose.flatten(1))

    def _seen(self, paths: Tensor, given: Tensor, pose: Tensor, code: Tensor) -> Tensor:
        """What encoders see, `(B, T / patch, width)`, in paths `(B, T, J, 3)` where they are given `(B, T, J)`."""
        shown = given[..., None].to(paths.dtype)
        told = paths * shown
        if self.config.standardised:
            gone = (paths - pose[:, None]) * shown
            told = torch.cat([3 * gone, _paces(paths, shown, pose) / PACE, shown], dim=-1)
        with torch.autocast(paths.device.type, enabled=False):
            tokens = self.frame_mlp(told.unflatten(1, (-1, self.config.patch)).flatten(2))
        x = torch.cat([tokens, code[:, None].expand(-1, tokens.shape[1], -1)], dim=-1)
        return self.over_time(self.drop(x + self.positions))

    def _latent(self, seen: Tensor, end: Gaussian) -> tuple[Tensor, Tensor]:
        """Mean and logarithm of the variance, `(B, C, width)` each."""
        return end(self.over_coefficients(self.cosines @ seen))

    def _decoded(self, z: Tensor, paths: Tensor, given: Tensor, pose: Tensor, code: Tensor, seen: Tensor) -> Tensor:
        """The poses `(B, T, J, 3)` that follow the first (equation 1)."""
        x = self.cosines.T @ z
        parts = [x, code[:, None].expand(-1, x.shape[1], -1), *([seen] if self.config.along else [])]
        x = self.joined(torch.cat(parts, dim=-1))
        x = self.decoder(self.drop(x + self.positions))
        with torch.autocast(x.device.type, enabled=False):
            gone = self._gone(self.offsets(x.float()).reshape(-1, self.frames - 1, self.joints, 3))
            if not self.config.along:
                return pose[:, None] + gone
            shown = given[..., None].to(paths.dtype)
            pull = (self.near @ shown).clamp(min=1e-6)  # of a joint by those that are given
            carried = self.near @ _paces(paths, shown, pose) / pull
            return torch.where(given[..., None], paths, pose[:, None] + carried.cumsum(1) + gone)

    def _gone(self, offsets: Tensor) -> Tensor:
        """How far from the first pose joints are, from the answers of the last layer, `(B, T, J, 3)`."""
        offsets = offsets * PACE if self.config.standardised else offsets
        if not self.config.direct:
            return offsets.cumsum(1)
        smooth = self.slow.T @ (self.slow @ offsets.flatten(2))
        return smooth.unflatten(-1, (self.joints, 3)) * self.away


def _paces(paths: Tensor, shown: Tensor, pose: Tensor) -> Tensor:
    """How far joints went since the frame before, where they are shown in both; since the `pose` in the first."""
    both = shown[:, 1:] * shown[:, :-1]
    first = (paths[:, :1] - pose[:, None]) * shown[:, :1]
    return torch.cat([first, (paths[:, 1:] - paths[:, :-1]) * both], dim=1)


def bone_paths() -> Tensor:
    """Metres from joint to joint along the bones of a standing body, `(J, J)`."""
    paths = torch.full((len(BODY), len(BODY)), torch.inf).fill_diagonal_(0)
    for joint, parent in enumerate(BODY.parents):
        if parent >= 0:
            length = float(np.linalg.norm(STANDING[joint] - STANDING[parent]))
            paths[joint, parent] = paths[parent, joint] = length
    for between in range(len(BODY)):
        paths = torch.minimum(paths, paths[:, between, None] + paths[between])
    return paths


def only_bodies(what: str, joints: int) -> None:
    if joints != len(BODY):
        raise InputError(f"{joints} joints to {what}", expected=f"the {len(BODY)} joints of BODY")


def path_batch(config: Any, positions: Array, observed: Array, rng: np.random.Generator) -> dict[str, Array]:
    """What networks of this paper train on: FirstPelvis's inputs with some of the paths given, and the whole future.

    config : has `given`, `spans`, `mirror` and `resize`, as TrajeVAEConfig explains them.
    positions, observed, rng : as `Network.batch`'s.

    Returns `pose`, `trajectories` and `given`, also `future (B, T, J, 3)`, 0 where unobserved, and where it counts,
    `wanted (B, T, J)`.
    """
    rows, frames, joints = observed.shape
    truth = np.where(observed[..., None], positions, np.float32(0))
    if config.resize:
        truth *= rng.uniform(1 - config.resize, 1 + config.resize, (rows, 1, 1, 1)).astype(np.float32)
    if config.mirror:
        truth, observed = mirrored(truth, observed, rng.random(rows) < 0.5)
    truth = turned(truth, rng.uniform(-np.pi, np.pi, rows))
    given = observed & (rng.random((rows, 1, joints)) < config.given)
    if config.spans:
        first, last = np.sort(rng.integers(1, frames, (2, rows, 1, 1)), axis=0)
        clock = np.arange(frames)[:, None]
        given &= ((clock >= first) & (clock <= last)) | (rng.random((rows, 1, 1)) >= config.spans)
    given[:, 0] = observed[:, 0]
    space = FirstPelvis()
    inputs, _ = space.encode(truth, given)
    whole, _ = space.encode(truth, observed)
    # A joint that is unobserved in the first pose has nothing that offsets could be added to.
    return {**inputs, "future": whole["trajectories"], "wanted": whole["given"] & observed[:, :1]}


def dct(count: int) -> Tensor:
    """The orthonormal cosine transform (DCT-II) over `count` frames, a row for each coefficient, slowest first."""
    moments = torch.arange(count, dtype=torch.float64) + 0.5
    cosines = (torch.arange(count)[:, None] * moments * (math.pi / count)).cos() * (2 / count) ** 0.5
    cosines[0] /= 2**0.5
    return cosines.float()


def sines(count: int, width: int) -> Tensor:
    """The codes `(count, width)` of positions (Vaswani et al. 2017): sines and cosines in turn."""
    angles = torch.arange(count)[:, None] * 10_000 ** -(torch.arange(0, width, 2) / width)
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(1)


def kl(q: tuple[Tensor, ...], p: tuple[Tensor, ...]) -> Tensor:
    """The divergence KL(q ‖ p) of normal distributions, each a mean and the logarithm of its variance."""
    mean, log_variance = q
    other, log_other = p
    ratio = log_variance - log_other
    return 0.5 * (ratio.exp() + (mean - other) ** 2 * (-log_other).exp() - 1 - ratio)


def _sample(normal: tuple[Tensor, Tensor], noise: Tensor) -> Tensor:
    mean, log_variance = normal
    return mean + (log_variance / 2).exp() * noise


def _there(pose: Tensor) -> Tensor:
    """`(B, J)`: unobserved joints are 0 in the first pose, and so is the hips, which that does not change."""
    return (pose != 0).any(-1)


def _turned(positions: Tensor, way: tuple[Tensor, Tensor] | None, back: bool = False) -> Tensor:
    """`positions (B, …, 3)` turned about the vertical so that the body's left is +X, or back to where it was."""
    if way is None:
        return positions
    cosine, sine = (each.view(-1, *[1] * (positions.dim() - 2)) for each in way)
    sine = -sine if back else sine
    x, y, z = positions.unbind(-1)
    return torch.stack([x * cosine + z * sine, y, z * cosine - x * sine], dim=-1)
