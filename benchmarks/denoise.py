"""Filters and a network on whole takes with Gaussian noise on every joint. Prints a Markdown table.

    python benchmarks/denoise.py --corpus cmu.corpus [--methods butterworth,savgol,xmae] [--takes 14] [--seed 0]

Takes of the validation split, spread evenly. Mean distance from the undamaged take in mm, and in brackets the mean
standard deviation of the bones' lengths over a take; a sigma of 0 tells what a method does to a take that is clean.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from shared import head, options, python, row

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
    asked = options(__doc__, corpus=Path, methods="butterworth,savgol,xmae", takes=14, seed=0)
    corpus = Corpus.open(asked.corpus)
    clips = [clip for clip in corpus.in_split("validation") if clip.stop - clip.start >= FRAMES]
    takes = [corpus.motion(clips[at]) for at in evenly(np.arange(len(clips)), asked.takes)]
    seconds = sum(len(take) / take.fps for take in takes)
    print(f"{len(takes)} takes of {corpus.name}, validation, {seconds:.0f} s, seed {asked.seed}; "
          f"{python()}\n")  # fmt: skip
    methods = ["as it is", *asked.methods.split(",")]
    print(head("sigma, mm", *methods, left=0))
    for sigma in SIGMAS:
        random, found = np.random.default_rng(asked.seed), []
        for take in takes:
            noise = sigma / 1000 * random.standard_normal(take.positions.shape, np.float32)
            noisy = replace(take, positions=take.positions + noise)
            found.append([told(noisy, take), *(told(denoise(noisy, method), take) for method in methods[1:])])
        cells = [f"{error:.1f} ({bones:.1f})" for error, bones in np.mean(found, axis=0)]
        print(row(sigma, *cells), flush=True)


if __name__ == "__main__":
    main()
