"""What the house network says of itself, and how fast it says it.

    python benchmarks/house_network.py --corpus cmu30.corpus [--split validation] [--network mend] [--limit 200]

Bodies, legs and arms are lost in the middle of windows of 96 frames, for 0.3 to 2 s. Printed: for each length how well
the feet that it says stand do (by `constraints/contacts.py` on the truth); and by decile of the error that the network
expects, its median and the true one. Then seconds: one window and 64 at once, beside the same matrix products alone, in
the same run.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from shared import best, head, options, python, row

from motionmend.benchmark.gaps import LOST, SHORT, starts
from motionmend.body.joints import BODY, JOINT
from motionmend.constraints.contacts import standing
from motionmend.corpora.corpus import Corpus
from motionmend.networks.checkpoints import load
from motionmend.networks.gap_space import FEET, BesideCurves
from motionmend.networks.loading import load_completer

Array = np.ndarray
SECONDS = (0.3, 0.5, 0.9, 1.5, 2.0)
PARTS = {"whole body": list(range(len(BODY)))} | {part: [JOINT[each] for each in lost] for part, lost in LOST.items()}


def answers(network, truth: Array, seen: Array) -> tuple[Array, Array, Array]:
    """Distance from the truth, expected error, and whether feet are said to stand: `(B, T, J)` twice, `(B, T, 4)`."""
    space = BesideCurves()
    inputs, known = space.encode(np.where(seen[..., None], truth, 0).astype(np.float32), seen)
    parts = range(0, len(truth), 16)
    output = np.concatenate([network.run({name: each[at : at + 16] for name, each in inputs.items()}) for at in parts])
    away = np.linalg.norm(space.decode(output, known) - truth, axis=-1)
    return away, space.expected(output), output[..., FEET] > 0


def calibration(network, truth: Array, observed: Array) -> None:
    expected, true = [], []
    print(head("feet, whole body", "F1", "precision", "recall", "frames in which they stand"))
    for seconds in SECONDS:
        for part, joints in PARTS.items():
            length = round(30 * seconds)
            middle = slice((SHORT - length) // 2, (SHORT - length) // 2 + length)
            hidden = np.zeros_like(observed)
            hidden[:, middle, joints] = True
            away, said, told = answers(network, truth, observed & ~hidden)
            asked = hidden & observed
            expected.append(said[asked])
            true.append(away[asked])
            if part == "whole body":
                stands, known = standing(truth, observed, 30.0)
                inside = known & asked.any(axis=2)[..., None]
                hits, found, there = (each[inside].sum() for each in (told & stands, told, stands))
                scores = 2 * hits / max(1, found + there), hits / max(1, found), hits / max(1, there)
                print(row(f"{seconds:g} s", *(f"{score:.2f}" for score in scores), f"{stands[inside].mean():.0%}"))
    told, truly = np.concatenate(expected), np.concatenate(true)
    print("\n" + head("decile of the expected error", "expected, mm", "true, mm", "true / expected"))
    for number, rows in enumerate(np.array_split(np.argsort(told), 10), 1):
        middles = [1000 * float(np.median(each[rows])) for each in (told, truly)]
        print(row(number, *(f"{each:.1f}" for each in middles), f"{middles[1] / middles[0]:.2f}"))


def speed(network, config: dict, truth: Array, observed: Array) -> None:
    """Windows through the network, and its matrix products by NumPy, which is all that they could be reduced to."""
    hidden = observed.copy()
    hidden[:, 33:63] = False
    space, width, frames = BesideCurves(), int(config["width"]), SHORT
    inside = int(config["wider"]) * width
    rng = np.random.default_rng(0)
    matrices = [rng.standard_normal(shape, np.float32) for shape in
                ((width, 3 * width), (width, width), (width, inside), (inside, width))]  # fmt: skip
    print("\n" + head("windows at once", "ms a window", "of them the curves", "products alone", "graph at"))
    for count in (1, 64):
        rows = np.arange(count) % len(truth)
        positions, seen = truth[rows], hidden[rows]
        inputs, _ = space.encode(positions, seen)
        x = {size: rng.standard_normal((count * frames, size), np.float32) for size in (width, inside)}
        head_size = int(config["head"])
        q = rng.standard_normal((count * width // head_size, frames, head_size), np.float32)
        took = best({
            "all": partial(network.windows, positions, seen), "graph": partial(network.run, inputs),
            "curves": partial(space.encode, positions, seen),
            "products": partial(multiply, int(config["depth"]), matrices, x, q),
        }, 5)  # fmt: skip
        each = {name: 1000 * seconds / count for name, seconds in took.items()}
        share = f"{each['products'] / each['graph']:.0%}"
        print(row(count, *(f"{each[name]:.2f}" for name in ("all", "curves", "products")), share))


def multiply(depth: int, matrices: list[Array], x: dict[int, Array], q: Array) -> None:
    for _ in range(depth):
        for matrix in matrices:
            x[len(matrix)] @ matrix
        q @ q.transpose(0, 2, 1) @ q


def main() -> None:
    asked = options(__doc__, corpus=str, split="validation", network="mend", limit=200)
    corpus, network = Corpus.open(asked.corpus), load_completer(asked.network)
    windows = starts(corpus, asked.split, asked.limit)
    truth, observed = corpus.windows(windows, SHORT)
    print(f"{len(windows)} windows of {corpus.name}, {asked.split}; {network.name}: {network.budget}; {python()}\n")
    calibration(network, truth, observed)
    speed(network, load(asked.network).config, truth, observed)


if __name__ == "__main__":
    main()
