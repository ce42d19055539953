"""What formats share: names told apart, and of points (C3D, TRC) what counts as missing and what changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..motion import Motion

Array = np.ndarray

NOWHERE = 1e9  # in any file's units: no laboratory reaches that far, but a damaged number does


def unique(labels: Sequence[str], notes: list[str]) -> list[str]:
    """The labels, with the second of a kind called "label_2" and so on; a note says which."""
    taken, seen, told_apart = set(labels), set(), []
    counts: dict[str, int] = {}
    for label in labels:
        name = label
        while name in seen or (name != label and name in taken):
            counts[label] = counts.get(label, 1) + 1
            name = f"{label}_{counts[label]}"
        seen.add(name)
        told_apart.append(name)
    renamed = [name for name, label in zip(told_apart, labels) if name != label]
    if renamed:
        more = ", …" if len(renamed) > 8 else ""
        notes.append(f"names that occur twice are numbered here, and not in the file: {', '.join(renamed[:8])}{more}")
    return told_apart


def present(points: Array, measured: Array | bool, notes: list[str]) -> Array:
    """`(frames, points)` bool: which samples of `points (frames, points, 3)` in file units are there.

    Missing are those that `measured` says so of, coordinates that are not finite or beyond NOWHERE, and
    triples of exact zeros, which many programs write for what they did not see.
    """
    with np.errstate(invalid="ignore"):
        somewhere = (np.abs(points) < NOWHERE).all(-1) & measured
    zero = (points == 0).all(-1) & somewhere
    if zero.any():
        notes.append(f"{zero.mean():.1%} of the samples are exactly (0, 0, 0): read as missing")
    return somewhere & ~zero


def changes(before: Motion, after: Motion) -> tuple[Array, Array]:
    """`(frames, points)` bool masks: samples with a new position, and samples that lost their trust unfilled."""
    bits_before, bits_after = (np.ascontiguousarray(m.positions).view(np.uint32) for m in (before, after))
    moved = (bits_before != bits_after).any(-1)
    return after.observed & (moved | ~before.observed), before.observed & ~after.observed
