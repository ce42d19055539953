"""TrajeVAE's measures of many samples for one window, and the two that its paper left out.

Kania et al. 2021, section 4, after Yuan and Kitani 2020 (DLow). All but the last two work on poses of which the root
is put at the origin in every frame and then dropped, the other joints FLATTENED to one vector: for 20 joints these
numbers are about 4 times a mean error per joint. Metres in; metres out but for the last two, in cm and %.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .positional import bone_lengths, distances

Array = np.ndarray

REACH = 0.5  # start poses that lie nearer to each other than this, as flattened vectors in metres, are one group
MEMBERS = 64  # of a group, compared at a time
NAMES = ("APD", "ADE", "FDE", "MMADE", "MMFDE")


def flattened(positions: Array, root: int = 0) -> Array:
    """Poses `(..., joints, 3)` as vectors `(..., (joints - 1) * 3)` float64: less the root, without the root."""
    others = np.arange(positions.shape[-2]) != root
    centred = positions[..., others, :] - positions[..., root, None, :].astype(float)
    return centred.reshape(*positions.shape[:-2], -1)


def apd(samples: Array) -> float:
    """Average pairwise distance: mean L2 between all pairs of `samples (K, T, D)`, each flattened; 0 for one."""
    count = len(samples)
    if count < 2:
        return 0.0
    flat = samples.reshape(count, -1)
    flat = flat - flat.mean(axis=0)
    apart = _distances(flat, flat)
    return float(apart[np.triu_indices(count, 1)].mean())


def displacements(samples: Array, truths: Array) -> tuple[Array, Array]:
    """ADE and FDE, `(G,)` each, of the best of `samples (K, T, D)` for each of `truths (G, T, D)`.

    ADE : mean over time of the L2 distance of the flattened pose, of the sample where that mean is least.
    FDE : that distance in the last frame, of the sample where it is least, which may be another one.
    """
    ade, fde = np.empty((2, len(truths)))
    by_time = samples.swapaxes(0, 1)  # (T, K, D)
    for first in range(0, len(truths), MEMBERS):
        block = slice(first, first + MEMBERS)
        apart = _distances(by_time, truths[block].astype(float).swapaxes(0, 1))  # (T, K, G)
        ade[block] = apart.mean(axis=0).min(axis=0)
        fde[block] = apart[-1].min(axis=0)
    return ade, fde


def _distances(a: Array, b: Array) -> Array:
    """L2 between all rows of `a (..., A, D)` and `b (..., B, D)`, by |a|² + |b|² - 2ab: no A x B x D array."""
    square = _squares(a)[..., :, None] + _squares(b)[..., None, :]
    return np.sqrt(np.maximum(square - 2 * a @ b.swapaxes(-1, -2), 0))


def _squares(a: Array) -> Array:
    return np.einsum("...d,...d->...", a, a)


def control_error(samples: Array, truth: Array, given: Array) -> float:
    """Mean distance in cm of given trajectories from where the samples put those joints, in the world.

    samples : `(..., T, J, 3)` metres; truth `(T, J, 3)`; given `(T, J)` bool. Over all samples, not the best one: a
    person who draws a path gets one sample. NaN where nothing is given.
    """
    errors = distances(truth, samples)[..., given]
    return float(errors.mean() * 100) if errors.size else float("nan")


def bone_stretch(samples: Array, pose: Array, parents: Sequence[int]) -> tuple[float, float]:
    """Mean and worst relative change in % of the bones' lengths against those of the start pose.

    samples : `(..., T, J, 3)` metres; pose `(J, 3)`. Over all samples, frames and bones; shorter counts as longer
    does. NaN without bones.
    """
    lengths = bone_lengths(pose[None], parents)[0]
    bones = lengths > 0
    if not bones.any():
        return float("nan"), float("nan")
    change = np.abs(bone_lengths(samples, parents)[..., bones] / lengths[bones] - 1) * 100
    return float(change.mean()), float(change.max())


class SampleScores:
    """The five measures over a test set whose samples come window by window or in blocks.

    truths : `(W, 1 + T, J, 3)` metres, finite: each window's start pose and its T frames to come. All windows of the
        test set, whether or not they will be scored: they are the groups for MMADE and MMFDE.
    root : the joint that is put at the origin.

    Keeps one copy of `truths` and five numbers a window; works on one window's samples and on 64 members of its group
    at a time. A group is every window whose start pose, flattened as above, is less than REACH away, with the window
    itself. MMADE and MMFDE take the least over the samples for each member by itself, then the group's mean.
    """

    def __init__(self, truths: Array, root: int = 0):
        flat = flattened(truths, root).astype(truths.dtype)
        self._starts, self._futures, self._root = flat[:, 0].astype(float), flat[:, 1:], root
        self.values = {name: np.full(len(truths), np.nan) for name in NAMES}

    def add(self, windows: Sequence[int] | Array, samples: Array) -> None:
        """Score `samples (B, K, T, J, 3)` of the windows with these `(B,)` numbers."""
        for window, some in zip(windows, samples, strict=True):
            flat = flattened(some, self._root)
            if flat.shape[1:] != self._futures.shape[1:]:
                raise ValueError(f"samples {samples.shape} do not suit futures {self._futures.shape}")
            members = self.group(int(window))
            ade, fde = displacements(flat, self._futures[members])
            own = members == window
            scores = apd(flat), ade[own][0], fde[own][0], ade.mean(), fde.mean()
            for name, score in zip(NAMES, scores):
                self.values[name][window] = score

    def group(self, window: int) -> Array:
        """The numbers of the windows that start as this one does, itself among them."""
        return np.flatnonzero(np.linalg.norm(self._starts - self._starts[window], axis=-1) < REACH)

    def means(self) -> dict[str, float]:
        """Each measure's mean over the windows scored so far; NaN before the first."""
        scored = np.isfinite(self.values["APD"])
        return {
            name: float(values[scored].mean()) if scored.any() else float("nan")
            for name, values in self.values.items()
        }
