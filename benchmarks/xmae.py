"""XMAE's speed beside the same network written with PyTorch's own layers, and beside the machine's peak. Markdown.

    python benchmarks/xmae.py [--checkpoint xmae] [--batch 64] [--train-batch 8] [--threads 2] [--seed 1]

1. The paper's network (random weights: speed does not depend on them) and a checkpoint, exported and run as `repair`
   runs them, `NetworkCompleter.windows` on onnxruntime; windows of 60 frames and 21 joints. Beside them torch,
   evaluation mode, with the same weights: nn.TransformerEncoder on all tokens with src_key_padding_mask ("all
   tokens") or on the observed ones, padded ("observed"), and nn.TransformerDecoder (pre-norm). All answers must agree
   within a millimetre. Operations are those that the architecture cannot do without: 2mnk for each linear layer and
   attention product over the tokens that are observed, and over all 1,260 queries. The peak is that of float32
   matrix products of 1536 x 1536 by torch.
2. A training step, forward, backward and Adam, at the paper's options, beside the same two in torch; and with fewer
   tokens `asked` for, whose queries do not attend to each other.

Everything is measured in turns, and of each the best round counts, so that what else runs on the machine hurts all
alike. `--threads` are onnxruntime's, torch's and NumPy's.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import shared
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionmend.body.joints import BODY, LIMBS
from motionmend.networks import checkpoints
from motionmend.networks.completers import TOKENS, NetworkCompleter
from motionmend.networks.export import export, halved
from motionmend.networks.loading import load_completer
from motionmend.networks.models.xmae import SIZES, XMAE, Attention, XMAEConfig

TASKS = ("0.5 s of the body", "one arm", "90 % of all")
PEAK = 1536
OURS = "paper's options"
AGREE = 1e-3  # metres
PAPER = 6  # ms for 60 frames on an RTX 2080 Ti


class Naive(nn.Module):
    """The same network, with the same weights, as one writes it with PyTorch's own layers."""

    def __init__(self, network: XMAE):
        super().__init__()
        self.ours = network
        wide, narrow = SIZES[network.config.size]
        options = {"dropout": 0.0, "batch_first": True, "norm_first": True}
        encoder = nn.TransformerEncoderLayer(wide, max(1, wide // network.config.head), 4 * wide, **options)
        decoder = nn.TransformerDecoderLayer(narrow, max(1, narrow // network.config.head), 4 * narrow, **options)
        self.encoder = nn.TransformerEncoder(encoder, len(network.encoder), network.encoded, enable_nested_tensor=False)
        self.decoder = nn.TransformerDecoder(decoder, len(network.decoder), network.decoded)
        for layer, block in zip(self.encoder.layers, network.encoder):
            norms = (block.norm_own, block.norm_mlp)
            layer.self_attn = _attention(block.own)
            layer.norm1, layer.norm2, layer.linear1, layer.linear2 = *norms, block.mlp[0], block.mlp[2]
        for layer, block in zip(self.decoder.layers, network.decoder):
            assert block.norm_cross is not None and block.cross is not None, "these layers have cross-attention"
            norms = (block.norm_own, block.norm_cross, block.norm_mlp)
            layer.self_attn, layer.multihead_attn = _attention(block.own), _attention(block.cross)
            layer.norm1, layer.norm2, layer.norm3, layer.linear1, layer.linear2 = *norms, block.mlp[0], block.mlp[2]

    def forward(self, tokens: Tensor, index: Tensor, there: Tensor, curve: Tensor | None = None) -> Tensor:
        ours, away = self.ours, ~there
        x = ours.embed(tokens) + F.embedding(index // ours.joints, ours.time_code)
        x = self.encoder(x + F.embedding(index % ours.joints, ours.joint_code), src_key_padding_mask=away)
        queries = ours.mask_token + (ours.time_query[:, None] + ours.joint_query).flatten(0, 1)
        queries = queries.expand(len(tokens), -1, -1)
        if ours.begin is not None and curve is not None:
            queries = queries + ours.begin(curve.flatten(1, 2))
        return ours.head(self.decoder(queries, x, memory_key_padding_mask=away))


def _attention(ours: Attention) -> nn.MultiheadAttention:
    width, source = ours.query.in_features, ours.key_value.in_features
    theirs = nn.MultiheadAttention(width, ours.heads, kdim=source, vdim=source, batch_first=True)
    parts = [ours.query.weight, *ours.key_value.weight.chunk(2)]
    with torch.no_grad():
        if theirs.in_proj_weight is not None:
            theirs.in_proj_weight.copy_(torch.cat(parts))
        else:
            for name, part in zip("qkv", parts):
                getattr(theirs, f"{name}_proj_weight").copy_(part)
        theirs.in_proj_bias.copy_(torch.cat([ours.query.bias, ours.key_value.bias]))
    theirs.out_proj.load_state_dict(ours.out.state_dict())
    return theirs


def unpacked(inputs: dict[str, Tensor], count: int) -> dict[str, Tensor]:
    """Tokens `(B, N, 3)` in their places among all `count`, as a network takes them that does not leave any out."""
    rows, most = inputs["there"].shape
    place = torch.where(inputs["there"], inputs["index"], count)
    there = torch.zeros(rows, count + 1, dtype=torch.bool).scatter(1, place, True)[:, :count]
    tokens = torch.zeros(rows, count + 1, 3).scatter(1, place[..., None].expand(rows, most, 3), inputs["tokens"])
    return {**inputs, "tokens": tokens[:, :count], "there": there, "index": torch.arange(count).expand(rows, count)}


def operations(network: XMAE, seen: np.ndarray) -> float:
    """Floating-point operations for windows of `seen (B,)` tokens; all first queries are alike without curves."""
    (wide, narrow), queries, seen = SIZES[network.config.size], network.frames * network.joints, seen.astype(float)
    encoder = len(network.encoder) * (24 * seen * wide**2 + 4 * seen**2 * wide)
    encoder += 2 * seen * wide * network.embed.in_features
    own = 8 * queries * narrow**2 + 4 * queries**2 * narrow
    cross = 4 * queries * narrow**2 + 4 * seen * wide * narrow + 4 * queries * seen * narrow
    decoder = len(network.decoder) * (own + cross + 16 * queries * narrow**2) + 6 * queries * narrow
    total = float((encoder + decoder).sum())
    if network.begin is None:
        return total - own * (len(seen) - 1)
    return total + 2 * queries * network.begin.in_features * narrow * len(seen)


def peak() -> Callable[[], object]:
    left, right, out = (torch.randn(PEAK, PEAK) for _ in range(3))
    return lambda: [torch.mm(left, right, out=out) for _ in range(4)]


PEAK_OPERATIONS = 4 * 2 * PEAK**3


def damaged(task: str, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Windows of something like a body, and what of them is seen."""
    positions = rng.normal(0, 0.3, (count, 60, len(BODY), 3)).astype(np.float32) + np.array([0, 1, 0], np.float32)
    observed = np.ones(positions.shape[:3], bool)
    if task == TASKS[0]:
        observed[:, 15:45] = False
    elif task == TASKS[1]:
        observed[:, :, list(LIMBS["left_arm"])] = False
    else:
        observed = rng.random(observed.shape) > 0.9
    return positions, observed


def running(name: str, network: XMAE, completer: NetworkCompleter, options: argparse.Namespace) -> None:
    naive, rng = Naive(network).eval(), np.random.default_rng(options.seed)
    for task in TASKS:
        positions, observed = damaged(task, options.batch, rng)
        rows = max(1, TOKENS // observed[0].size)  # at once, for torch as for ours
        few = min(2 * rows, options.batch)  # for torch, to save time: a window takes as long among any number

        def torch_way(packed: bool, positions=positions[:few], observed=observed[:few]) -> np.ndarray:
            def run(inputs: dict[str, np.ndarray]) -> np.ndarray:
                tensors = {key: torch.from_numpy(np.ascontiguousarray(each)) for key, each in inputs.items()}
                tensors = tensors if packed else unpacked(tensors, observed[0].size)
                with torch.inference_mode():
                    return naive(**tensors).numpy().reshape(-1, *observed.shape[1:], 3)

            return completer(completer.description, run).windows(positions, observed)

        ways = {
            "ours": lambda p=positions, o=observed: completer.windows(p, o),
            "one": lambda p=positions[:1], o=observed[:1]: completer.windows(p, o),
            "observed": lambda: torch_way(True),
            "peak": peak(),
        }  # fmt: skip
        if network.begin is None:  # a token is a joint, and may as well be told to be missing
            ways["all"] = lambda: torch_way(False)
        answer = ways["ours"]()
        for way in {"observed", "all"} & ways.keys():
            difference = np.abs(answer[:few] - ways[way]()).max()
            if not difference < AGREE:
                raise SystemExit(f"{name}, {task}: answers differ by {difference:g} m from torch, {way} tokens")
        took = shared.best(ways, options.rounds)
        tokens = completer.space.encode(positions, observed)[0]["there"].sum(axis=1)
        parts = range(0, options.batch, rows)
        rate = sum(operations(network, tokens[start : start + rows]) for start in parts) / took["ours"] / 1e9
        most = PEAK_OPERATIONS / took["peak"] / 1e9
        ours, seen = 1000 * took["ours"] / options.batch, 1000 * took["observed"] / few
        whole = f"{1000 * took['all'] / few:.1f} ({1000 * took['all'] / few / ours:.2f} x)" if "all" in took else "–"
        print(
            f"| {name} | {task} | {1000 * took['one']:.1f} | {ours:.1f} | {seen:.1f} ({seen / ours:.2f} x) | "
            f"{whole} | {rate:.1f} | {most:.1f} | {rate / most:.0%} |", flush=True,
        )  # fmt: skip


def training(options: argparse.Namespace) -> None:
    rng = np.random.default_rng(options.seed)
    positions, _ = damaged("", options.train_batch, rng)
    observed = np.ones(positions.shape[:3], bool)

    def batch_of(**fields) -> tuple[XMAE, dict[str, Tensor]]:
        network = XMAE(XMAEConfig(**fields), len(BODY)).train()
        arrays = network.batch(positions, observed, np.random.default_rng(options.seed), 0)
        return network, {name: torch.from_numpy(np.ascontiguousarray(each)) for name, each in arrays.items()}

    def step(network: nn.Module, losses: Callable[[], Tensor]) -> Callable[[], Tensor]:
        adam = torch.optim.Adam(network.parameters(), lr=1e-6)

        def take() -> Tensor:
            loss = losses().mean()
            loss.backward()
            adam.step()
            adam.zero_grad()
            return loss.detach()

        return take

    def ours(**fields) -> Callable[[], Tensor]:
        network, batch = batch_of(**fields)
        return step(network, lambda: network.loss(batch, 0)["loss"])

    def theirs(packed: bool) -> Callable[[], Tensor]:
        network, batch = batch_of()
        naive = Naive(network).train()
        inputs = {name: batch[name] for name in ("tokens", "index", "there")}
        inputs = inputs if packed else unpacked(inputs, observed[0].size)

        def losses() -> Tensor:
            error = (naive(**inputs) - batch["target"]).abs().mean(dim=-1) * batch["weight"]
            return error.sum(dim=1) / batch["weight"].sum(dim=1).clamp(min=1)

        return step(naive, losses)

    def alike(make: Callable[[], Callable[[], Tensor]]) -> Callable[[], Tensor]:
        torch.manual_seed(options.seed)
        return make()

    ways = {
        OURS: alike(ours), "torch, observed tokens": alike(lambda: theirs(True)),
        "torch, all tokens": alike(lambda: theirs(False)),
        "asked=160, queries apart": alike(lambda: ours(asked=160, query_attention=False)),
    }  # fmt: skip
    first = [float(ways[name]()) for name in list(ways)[:3]]
    if np.ptp(first) > 1e-4 * first[0]:
        raise SystemExit(f"losses differ: {first}")
    took = shared.best({**ways, "peak": peak()}, options.rounds)
    network, batch = batch_of()
    seen = torch.zeros(len(observed), observed[0].size).scatter(1, batch["index"], batch["there"].float())
    # Backward has two products for each one of forward.
    rate = 3 * operations(network, (seen.numpy() > 0).sum(axis=1)) / took[OURS]
    most = PEAK_OPERATIONS / took.pop("peak")
    print(f"\nTraining at {OURS}: {rate / 1e9:.1f} GFLOP/s, {rate / most:.0%} of the peak of {most / 1e9:.1f}\n")
    print(f"| training step, batch {options.train_batch} | ms | time beside ours |\n|---|---|---|")
    for name, seconds in took.items():
        print(f"| {name} | {1000 * seconds:.0f} | {seconds / took[OURS]:.2f} x |")


def main() -> None:
    line = shared.parser(__doc__, checkpoint="xmae", batch=64, train_batch=8, threads=2, rounds=3, seed=1)
    line.add_argument("--only", choices=("running", "training"))
    options = line.parse_args()
    torch.set_num_threads(options.threads)
    if hasattr(os, "sched_setaffinity"):  # onnxruntime takes a thread for each core that it may use
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.threads])
    torch.manual_seed(options.seed)
    print(f"{platform.machine()} {model_name()}, {options.threads} threads, seed {options.seed}, "
          f"torch {torch.__version__}, onnxruntime {onnxruntime.__version__}, best of {options.rounds}\n")  # fmt: skip
    if options.only != "training":
        print(f"ms a window, {options.batch} windows at once, 60 frames of {len(BODY)} joints; one window alone "
              f"beside the paper's {PAPER} ms on an RTX 2080 Ti\n\n"
              "| network | lost | one alone | ours | torch, observed tokens | torch, all tokens "
              "| GFLOP/s | peak | share |\n|---|---|---|---|---|---|---|---|---|")  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            network = halved(XMAE(XMAEConfig(), len(BODY)))
            real = damaged(TASKS[0], 2, np.random.default_rng(options.seed))
            where = export(network, Path(folder) / "paper", skeleton=BODY, windows=real)
            assert isinstance(network, XMAE)
            running("paper's", network, load_completer(where), options)
        if options.checkpoint:
            completer = load_completer(options.checkpoint)
            stored = checkpoints.load_network(checkpoints.find(options.checkpoint))
            if not isinstance(stored, XMAE):
                raise SystemExit(f"{options.checkpoint} is no XMAE")
            running(completer.name, stored.eval(), completer, options)
    if options.only != "running":
        training(options)


def model_name() -> str:
    """The processor's, where the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())


if __name__ == "__main__":
    main()
