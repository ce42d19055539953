"""Locally weighted linear regression (Cleveland 1979; Atkeson, Moore & Schaal 1997) in its dual form.

What comes out are weights of the neighbours, so the same ones serve positions, rotation vectors, or what a network
left over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray

WIDTH = 1.5  # metres of weighted distance beyond the nearest's, of the Gaussian
RIDGE = 0.01  # square metres
MEAN = 1.0  # of the neighbours' mean: as good as free


def weights(across: Array, heights: Array, own: tuple[Array, Array], distance: Array) -> tuple[Array, Regression]:
    """The neighbours' weights `(near,)`, which add up to 1, and what `believed` wants to know.

    With D the neighbours' descriptors, q the gap's, w Gaussian weights, normalised, of the distances beyond the
    nearest's, X = √w (D - w·D) and a = (X Xᵀ + λ)⁻¹ X (q - w·D): e = w + √w a - w Σ √w a. Σ e y is then the value at q
    of the plane through the neighbours' y by weighted ridge regression.
    """
    kernel = np.exp(-0.5 * ((distance - distance.min()) / WIDTH) ** 2)
    kernel /= kernel.sum()
    root = np.sqrt(kernel)
    features = np.concatenate([np.real(across), np.imag(across), heights], axis=1)
    asked = np.concatenate([np.real(own[0]), np.imag(own[0]), own[1]])
    middle = kernel @ features
    spread = root[:, None] * (features - middle)
    gram = spread @ spread.T
    gram[np.diag_indices_from(gram)] += RIDGE
    inverse = np.linalg.inv(gram)
    lean = root * (inverse @ (spread @ (asked - middle)))
    return kernel + lean - kernel * lean.sum(), Regression(kernel, inverse)


@dataclass(frozen=True, eq=False)
class Regression:
    """kernel `(near,)` : Gaussian weights. inverse `(near, near)` : of the ridge regression's Gram matrix."""

    kernel: Array
    inverse: Array


def believed(regression: Regression, values: Array, blocks: Array) -> float:
    """How much of an answer to believe, from 0 to 1: what would have been best for the neighbours themselves.

    Each stretch of neighbours is predicted from all others, and what they have in common with it by least squares, with
    the kernel's weights, is the share. Leaving out a block B of a ridge regression changes its residuals to
    (G⁻¹_BB)⁻¹ (G⁻¹ y)_B (Hastie, Tibshirani & Friedman 2009, section 7.10, for blocks).

    values : `(near, numbers)` to be regressed. blocks : `(near,)` which stretch each neighbour belongs to.
    """
    root = np.sqrt(regression.kernel)
    # The mean is left out with the block too: √w is an eigenvector of G, and here has an eigenvalue of its own.
    inverse = regression.inverse - np.outer(root, root) * (1 / RIDGE - 1 / (RIDGE + MEAN))
    truth = root[:, None] * values
    solved = inverse @ truth
    predicted = truth.copy()
    for block in np.unique(blocks):
        rows = np.flatnonzero(blocks == block)
        predicted[rows] -= np.linalg.solve(inverse[np.ix_(rows, rows)], solved[rows])
    power = float(np.sum(predicted**2))
    return float(np.clip(np.sum(predicted * truth) / power, 0.0, 1.0)) if power > 0 else 0.0
