"""Locally weighted linear regression (Cleveland 1979; Atkeson, Moore & Schaal 1997) in its dual form.

What comes out are weights of the neighbours, so the same ones serve positions, rotation vectors, or what a network
left over.
"""

from __future__ import annotations

import numpy as np

Array = np.ndarray

WIDTH = 1.5  # metres of weighted distance beyond the nearest's, of the Gaussian
RIDGE = 0.01  # square metres


def weights(across: Array, heights: Array, own: tuple[Array, Array], distance: Array) -> Array:
    """The neighbours' weights `(near,)`, which add up to 1.

    With D the neighbours' descriptors, q the gap's, w Gaussian weights, normalised, of the distances beyond the
    nearest's, X = √w (D - w·D) and a = (X Xᵀ + λ)⁻¹ X (q - w·D): e = w + √w a - w Σ √w a. Σ e y is then the value at q of
    the plane through the neighbours' y by weighted ridge regression.
    """
    kernel = np.exp(-0.5 * ((distance - distance.min()) / WIDTH) ** 2)
    kernel /= kernel.sum()
    root = np.sqrt(kernel)
    features = np.concatenate([across.real, across.imag, heights], axis=1)
    asked = np.concatenate([own[0].real, own[0].imag, own[1]])
    middle = kernel @ features
    spread = root[:, None] * (features - middle)
    gram = spread @ spread.T
    gram[np.diag_indices_from(gram)] += RIDGE
    lean = root * np.linalg.solve(gram, spread @ (asked - middle))
    return kernel + lean - kernel * lean.sum()
