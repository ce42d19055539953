"""Does a network of XMAE's size ever wait for its samples? Steps a second, and the share of them spent waiting.

    python benchmarks/throughput.py --corpus cmu60.corpus [--batch 128] [--steps 30] [--workers 0] [--precision bf16]

Trains a stand-in made of PyTorch's own Transformer layers (encoder 256 wide and 6 deep on the 15 % of tokens that are
shown, decoder 128 wide and 3 deep on all 60 x 21) with the real loop, on windows turned, masked and displaced as XMAE's
are, and reads the loop's own log. The first few steps are left out: the first sample cannot be there before it is
made. Also printed: how long the making of one batch takes by itself, so that it can be set against a faster
network's step. Rows are samples. The target is a share of waiting below 3 %.
"""

from __future__ import annotations

import json
import platform
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from shared import parser
from torch import Tensor, nn

from motionmend.corpora.corpus import Corpus
from motionmend.damage import corruption
from motionmend.networks.models.network import Network
from motionmend.training.batches import Batches
from motionmend.training.config import settle
from motionmend.training.loop import train


@dataclass(frozen=True)
class Sizes:
    width: int = 256
    depth: int = 6
    decoder: int = 128
    decoder_depth: int = 3


class StandIn(Network):
    """As large as XMAE, and fed as it is; not it."""

    name, space, protocol, fps, frames = "stand-in", "floor_mean", "", 60.0, 60
    Config = Sizes

    def __init__(self, config: Sizes, joints: int):
        super().__init__(config, joints)
        self.tokens = self.frames * joints
        self.inward, self.outward = nn.Linear(3, config.width), nn.Linear(config.decoder, 3)
        self.where = nn.Parameter(0.02 * torch.randn(self.tokens, config.width))
        self.queries = nn.Parameter(0.02 * torch.randn(self.tokens, config.decoder))
        self.narrow = nn.Linear(config.width, config.decoder)
        kinds = {"dropout": 0.0, "batch_first": True, "norm_first": True}
        encoder = nn.TransformerEncoderLayer(config.width, config.width // 64, 4 * config.width, **kinds)
        decoder = nn.TransformerDecoderLayer(config.decoder, config.decoder // 64, 4 * config.decoder, **kinds)
        self.encoder = nn.TransformerEncoder(encoder, config.depth, enable_nested_tensor=False)
        self.decoder = nn.TransformerDecoder(decoder, config.decoder_depth)

    def batch(self, positions, observed, rng, step):
        positions = np.where(observed[..., None], positions, np.float32(0))
        masked, displaced = corruption.token_masks(observed.shape, rng, observed=observed)
        given = corruption.displace(positions, displaced, corruption.ball((int(displaced.sum()),), 1.0, rng))
        shown = observed & ~masked
        mean = (given * shown[..., None]).sum((1, 2)) / np.maximum(shown.sum((1, 2)), 1)[:, None]
        mean = mean.astype(np.float32) * np.float32([1, 0, 1])
        angle = rng.uniform(0, 2 * np.pi, len(positions)).astype(np.float32)
        cos, sin, one, zero = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
        turn = np.array([[cos, zero, -sin], [zero, one, zero], [sin, zero, cos]]).transpose(2, 0, 1)[:, None]
        given, wanted = ((each - mean[:, None, None]) @ turn for each in (given, positions))
        return {"given": given, "wanted": wanted, "shown": shown, "judged": (masked | displaced) & observed}

    def loss(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        keep = self.tokens - round(0.85 * self.tokens)
        chosen = batch["shown"].flatten(1).float().topk(keep).indices
        rows = batch["given"].flatten(1, 2).gather(1, chosen[..., None].expand(-1, -1, 3))
        memory = self.narrow(self.encoder(self.inward(rows) + self.where[chosen]))
        answer = self.outward(self.decoder(self.queries.expand(len(rows), -1, -1), memory))
        judged = batch["judged"].flatten(1)
        error = (answer - batch["wanted"].flatten(1, 2)).abs().mean(-1)
        return {"loss": (error * judged).sum(1) / judged.sum(1).clamp(min=1)}


def main() -> None:
    line = parser(__doc__, batch=128, steps=30, precision="auto", workers=0)
    line.add_argument("--corpus", required=True, nargs="+")
    options = line.parse_args()
    sys.modules.setdefault("throughput", sys.modules["__main__"])  # under which the loop finds the class
    settings = settle("throughput:StandIn", StandIn, vars(options), {"log_every": 5, "checkpoint_minutes": 0.0})

    corpora = [Corpus.open(path) for path in options.corpus]
    batches = Batches(StandIn(Sizes(), len(corpora[0].skeleton)), corpora, batch=options.batch, stride=1, seed=0)
    batches.make(0)
    began, cpu = time.perf_counter(), time.thread_time()
    for step in range(1, 6):
        batches.make(step)
    alone, busy = (time.perf_counter() - began) / 5, (time.thread_time() - cpu) / 5

    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        train(settings, run, validate=lambda *_: {"loss": 0.0}, export=lambda *_: run)
        rows = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    rows = [row for row in rows if "rate" in row][1:]
    rate = len(rows) / sum(1 / row["rate"] for row in rows)
    waiting = sum(row["waiting"] / row["rate"] for row in rows) / sum(1 / row["rate"] for row in rows)
    device = torch.cuda.get_device_name() if torch.cuda.is_available() else f"{platform.machine()} CPU"
    print(f"{device}, torch {torch.__version__}, {torch.get_num_threads()} threads, batch {options.batch}")
    print(f"{rate:.3g} steps/s, {rate * options.batch:.3g} rows/s; waiting {waiting:.2%} of the time")
    print(
        f"making a batch by itself: {1000 * alone:.1f} ms ({1000 * busy:.1f} ms of one core), "
        f"{alone * rate:.2%} of a step, {options.batch / alone:.3g} rows/s"
    )


if __name__ == "__main__":
    main()
