"""ConvAE in the paper's size on one long motion, exported and in plain torch. Prints a table.

    python benchmarks/convae.py [--threads 2] [--repeats 5]

The weights are random, which does not matter to the time. A motion is given whole, in one pass: rows in, rows out, as
the paper measures it (0.3 ms a frame on a Quadro M6000, 0.58 s for its 1,927 frames); and beside it the whole way from
positions in the world and back. Of `repeats` runs in turn, the median.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import torch
from shared import head, medians, options, row

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


def main() -> None:
    told = options(__doc__, threads=2, repeats=5)
    torch.set_num_threads(told.threads)
    torch.manual_seed(0)
    network = ConvAE(ConvAEConfig(), len(BODY)).eval()
    with tempfile.TemporaryDirectory() as folder:
        export(network, Path(folder) / "convae", skeleton=BODY, windows=walking(240))
        exported, plain = load_completer(Path(folder) / "convae"), module_completer(network)
        size = sum(each.numel() for each in network.parameters())
        print(f"{size:,} parameters, {told.threads} threads, median of {told.repeats}; "
              f"{machine()}, torch {torch.__version__}\n")  # fmt: skip
        print(head("frames", "exported, s", "plain torch, s", "torch / exported", "exported, ms a frame",
                   "with the way from the world and back, s", left=0))  # fmt: skip
        for frames in FRAMES:
            positions, observed = walking(frames)
            inputs, _ = exported.space.encode(positions, observed)
            calls = {"graph": partial(exported.run, inputs), "torch": partial(plain.run, inputs),
                     "whole": partial(exported.windows, positions, observed)}  # fmt: skip
            graph, torch_, whole = medians(calls, told.repeats if frames <= PAPER else 2).values()
            print(row(f"{frames:,}", f"{graph:.3f}", f"{torch_:.3f}", f"{torch_ / graph:.2f}",
                      f"{1e3 * graph / frames:.3f}", f"{whole:.3f}"), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
