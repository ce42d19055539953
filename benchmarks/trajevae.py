"""How fast samples are drawn: TrajeVAE, all frames at once, beside CVAE-RNN, frame after frame. Prints a table.

    python benchmarks/trajevae.py [--checkpoint trajevae] [--samples 50] [--repeats 5]

Both are exported and run on onnxruntime, from one pose and two given paths to 100 frames of 21 joints. "paper's"
networks have random weights, which does not matter to the time. They take turns; medians of `repeats` rounds count.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import torch
from shared import head, medians, options, row

from motionmend.benchmark.provenance import machine
from motionmend.body.joints import BODY, JOINT
from motionmend.body.standing import STANDING, UPRIGHT
from motionmend.networks.export import export
from motionmend.networks.generative import GenerativeCompleter
from motionmend.networks.loading import load_completer
from motionmend.networks.models.cvae_rnn import CVAERNN
from motionmend.networks.models.trajevae import TrajeVAE

GIVEN = [JOINT["left_hand"], JOINT["right_hand"]]


def main() -> None:
    told = options(__doc__, checkpoint="trajevae", samples=50, repeats=5)
    clock = np.arange(101)[:, None, None] / 50
    positions = (STANDING + UPRIGHT + 0.1 * np.sin(3 * clock) * np.array([1, 0, 1])).astype(np.float32)[None]
    given = np.zeros((1, 100, len(BODY)), bool)
    given[..., GIVEN] = True
    networks = {told.checkpoint: load_completer(told.checkpoint)}
    with tempfile.TemporaryDirectory() as folder:
        for name, kind in (("paper's TrajeVAE", TrajeVAE), ("paper's CVAE-RNN", CVAERNN)):
            torch.manual_seed(0)
            whole = np.repeat(positions, 2, axis=0), np.ones((2, 101, len(BODY)), bool)
            path = export(kind(kind.Config(), len(BODY)), Path(folder) / kind.name, skeleton=BODY, windows=whole)
            networks[name] = load_completer(path)
        calls = {}
        for name, network in networks.items():
            assert isinstance(network, GenerativeCompleter)
            calls[name] = partial(network.sample_windows, positions[:, 0], positions[:, 1:], given, told.samples, 0)
        times = medians(calls, told.repeats)
    slow = times["paper's CVAE-RNN"]
    print(f"{told.samples} samples of 100 frames, median of {told.repeats}; {machine()}\n")
    print(head("network", "seconds", "CVAE-RNN takes so many times as long"))
    for name, seconds in times.items():
        print(row(name, f"{seconds:.3f}", f"{slow / seconds:.1f}"))


if __name__ == "__main__":
    main()
