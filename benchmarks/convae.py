"""ConvAE in the paper's size on one long motion, exported and in plain torch. Prints a table.

    python benchmarks/convae.py [--threads 2] [--repeats 5]

The weights are random, which does not matter to the time. A motion is given whole, in one pass: rows in, rows out, as
the paper measures it (0.3 ms a frame on a Quadro M6000, 0.58 s for its 1,927 frames); and beside it the whole way from
positions in the world and back. Of `repeats` runs in turn, the median.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch

from motionmend.benchmark.provenance import machine
from motionmend.body.joints import BODY
from motionmend.body.standing import STANDING, UPRIGHT
from motionmend.networks.export import export
from motionmend.networks.loading import load_completer, module_completer
from motionmend.networks.models.convae import ConvAE, ConvAEConfig

FRAMES = (240, 480, 960, 1927, 4800, 9600, 24000)
PAPER = 1927


def walking(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """A body that sways and goes forwards, every other 75 frames of it missing: `(1, frames, 21, 3)` and observed."""
    clock = np.arange(frames)[:, None, None] / 60
    sway = 0.1 * np.sin(6 * clock + np.arange(21)[None, :, None])
    positions = (STANDING + UPRIGHT + sway + clock * np.array([0, 0, 1.2])).astype(np.float32)[None]
    observed = np.broadcast_to((np.arange(frames) // 75 % 2 == 0)[None, :, None], positions.shape[:3]).copy()
    return positions, observed


def medians(calls: list[Callable[[], object]], repeats: int) -> list[float]:
    """Seconds of each call; they take turns, so that whatever else the machine does meets all of them."""
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats + 1):
        for call, spent in zip(calls, times):
            began = time.perf_counter()
            call()
            spent.append(time.perf_counter() - began)
    return [float(np.median(spent[1:])) for spent in times]  # the first warms up


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    network = ConvAE(ConvAEConfig(), len(BODY)).eval()
    with tempfile.TemporaryDirectory() as folder:
        export(network, Path(folder) / "convae", skeleton=BODY, windows=walking(240))
        exported, plain = load_completer(Path(folder) / "convae"), module_completer(network)
        size = sum(each.numel() for each in network.parameters())
        print(f"{size:,} parameters, {options.threads} threads, median of {options.repeats}; "
              f"{machine()}, torch {torch.__version__}\n")  # fmt: skip
        print("| frames | exported, s | plain torch, s | torch / exported | exported, ms a frame | with the way from "
              "the world and back, s |")  # fmt: skip
        print("|---:|---:|---:|---:|---:|---:|")
        for frames in FRAMES:
            positions, observed = walking(frames)
            inputs, _ = exported.space.encode(positions, observed)
            calls = [partial(exported.run, inputs), partial(plain.run, inputs),
                     partial(exported.windows, positions, observed)]  # fmt: skip
            graph, torch_, whole = medians(calls, options.repeats if frames <= PAPER else 2)
            print(f"| {frames:,} | {graph:.3f} | {torch_:.3f} | {torch_ / graph:.2f} | {1e3 * graph / frames:.3f} | "
                  f"{whole:.3f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
