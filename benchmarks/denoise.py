"""Filters and a network on whole takes with Gaussian noise on every joint. Prints a Markdown table.

    python benchmarks/denoise.py --corpus cmu.corpus [--methods butterworth,savgol,xmae] [--takes 14] [--seed 0]

Takes of the validation split, spread evenly. Mean distance from the undamaged take in mm, and in brackets the mean
standard deviation of the bones' lengths over a take; a sigma of 0 tells what a method does to a take that is clean.
"""

from __future__ import annotations

import argparse
import platform
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionmend.benchmark.results import evenly
from motionmend.corpora.corpus import Corpus
from motionmend.metrics.positional import bone_lengths
from motionmend.motion import Motion
from motionmend.repairs.denoising import denoise

SIGMAS = (0, 2, 5, 10, 20, 50)  # mm, along each axis
FRAMES = 180  # at least


def told(noisy: Motion, clean: Motion) -> tuple[float, float]:
    """The mean error and the mean sigma of bones, both in mm."""
    points = np.where(clean.observed[..., None], noisy.positions, np.nan)
    lengths = bone_lengths(points, clean.skeleton.parents)
    spread = np.nanstd(lengths[:, np.isfinite(lengths).any(axis=0)], axis=0)
    error = np.linalg.norm(noisy.positions - clean.positions, axis=-1)[clean.observed]
    return 1000 * float(error.mean()), 1000 * float(spread.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--corpus", type=Path, required=True)
    parser.add_argument("--methods", default="butterworth,savgol,xmae")
    parser.add_argument("--takes", type=int, default=14)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    corpus = Corpus.open(options.corpus)
    clips = [clip for clip in corpus.in_split("validation") if clip.stop - clip.start >= FRAMES]
    takes = [corpus.motion(clips[at]) for at in evenly(np.arange(len(clips)), options.takes)]
    seconds = sum(len(take) / take.fps for take in takes)
    print(f"{len(takes)} takes of {corpus.name}, validation, {seconds:.0f} s, seed {options.seed}; "
          f"Python {platform.python_version()}, NumPy {np.__version__}\n")  # fmt: skip
    methods = ["as it is", *options.methods.split(",")]
    print("| sigma, mm | " + " | ".join(methods) + " |\n|---:|" + "---:|" * len(methods))
    for sigma in SIGMAS:
        random, found = np.random.default_rng(options.seed), []
        for take in takes:
            noise = sigma / 1000 * random.standard_normal(take.positions.shape, np.float32)
            noisy = replace(take, positions=take.positions + noise)
            found.append([told(noisy, take), *(told(denoise(noisy, method), take) for method in methods[1:])])
        cells = [f"{error:.1f} ({bones:.1f})" for error, bones in np.mean(found, axis=0)]
        print(f"| {sigma} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
