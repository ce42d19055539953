"""The fill `regression`: where the marker is, as seen from the body, by where the others of that frame are.

Kernel ridge regression (Saunders, Gammerman & Vovk 1998) of the marker's place on its donors' places, both seen from
the donors' body. The kernel is a line and a bell, k(x, y) = x·y / v + exp(-|x - y|² / 2v), with v the mean of |x|²:
the line is the global linear regression of Tits, Tilmanne & Dutoit 2018, which finds any linear relation and goes on
beyond what was seen, the bell weights frames of like poses, as their GRNN does.
"""

from __future__ import annotations

import numpy as np

from .donors import Chart
from .lessons import Lesson, view

Array = np.ndarray

DONORS = 12
PENALTY = 1e-3  # variance of what no donor explains, where the kernel's is 1 or 2
STILL_SHARE = 1e-4  # of the donors' breadth: what moves less than this as seen from the body is noise


def regressed(one: Lesson, bell: float = 1.0, penalty: float = PENALTY) -> Chart | None:
    """Coordinates about what the regression says; None if `lessons.view` is.

    bell : its height; 0 for a linear ridge regression.
    """
    seen = view(one)
    if seen is None:
        return None
    # Donors that keep their distance badly count less: what they do has less to do with the marker.
    scale = np.sqrt(seen.weights / seen.weights.max())[:, None]
    x, asked = ((each * scale).reshape(len(each), -1) for each in (seen.known, seen.asked))
    middle, level = x.mean(axis=0), seen.own.mean(axis=0)
    x, asked = x - middle, asked - middle
    breadth = np.sum(seen.weights[:, None] * seen.known**2) / len(x)
    v = np.sum(x**2) / len(x) + STILL_SHARE**2 * breadth

    def kernel(others: Array) -> Array:
        products = others @ x.T
        if not bell:
            return products / v
        apart = np.sum(others**2, axis=1)[:, None] + np.sum(x**2, axis=1) - 2 * products
        return products / v + bell * np.exp(-0.5 * np.maximum(apart, 0) / v)

    weights = np.linalg.solve(kernel(x) + penalty * np.eye(len(x)), seen.own - level)
    return one.chart(seen.outward(kernel(asked) @ weights + level), seen.turn)
