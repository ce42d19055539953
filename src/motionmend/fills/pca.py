"""The fill `pca`: the marker by the principal components of all markers' movement together.

Gløersen & Federolf 2016, "Predicting missing marker trajectories in human motion data using marker
intercorrelations", PLoS ONE 11(3), their second variant, which mends each marker by itself: positions from the
middle of the markers that are seen; each marker divided by its standard deviation and weighted by its distance to
the lost one, exp(-d² / 2s²), the lost one itself by 0.02; the components that carry 99 % of the singular values,
once of all columns (P) and once with the lost one's columns zero (Z); and the answer is X Z (Pᵀ Z)ᵀ Pᵀ for frames X
whose lost columns are zero. What it misses at the gap's ends is ramped through the gap.

The paper's standard deviations are each axis's and its s is 0.2 m. A marker has one here, and s is half the donors'
mean distance, so that a take that is turned, or a hand in place of a body, is mended alike.
"""

from __future__ import annotations

import numpy as np

from .donors import Chart
from .lessons import Lesson

Array = np.ndarray

DONORS = 30
OWN_WEIGHT = 0.02
REACH_SHARE = 0.5  # s, of the donors' mean distance
CARRIED = 0.99  # of the sum of singular values
STILL_SHARE = 1e-3  # of its distance: a donor that moves less than this against the middle is not scaled up


def pca_chart(one: Lesson) -> Chart:
    """Coordinates about what the components say."""
    middle = one.asked.mean(axis=1)
    known = np.concatenate([one.known, one.own[:, None]], axis=1) - one.known.mean(axis=1, keepdims=True)
    mean = known.mean(axis=0)
    spread = np.sqrt(np.mean((known - mean) ** 2, axis=(0, 2)))
    reach = REACH_SHARE * one.apart.mean()
    weights = np.append(np.exp(-(one.apart**2) / (2 * reach**2)), OWN_WEIGHT)
    scale = (weights / (spread + STILL_SHARE * np.append(one.apart, one.apart.mean())))[:, None]
    found = recovered(
        ((known - mean) * scale).reshape(len(known), -1),
        ((one.asked - middle[:, None] - mean[:-1]) * scale[:-1]).reshape(len(middle), -1),
    )
    return one.chart(found / scale[-1] + mean[-1] + middle)


def recovered(known: Array, asked: Array) -> Array:
    """The last three columns of `known (frames, columns)` for frames `asked (frames, columns - 3)` that lack them."""
    hidden = np.where(np.arange(known.shape[1]) < asked.shape[1], known, 0)
    values, whole = np.linalg.eigh(known.T @ known)
    singular = np.sqrt(np.maximum(values[::-1], 0))
    count = 1 + int(np.searchsorted(np.cumsum(singular), CARRIED * singular.sum()))
    count = max(1, min(count, len(known) - 1, asked.shape[1]))
    whole, lacking = whole[:, ::-1][:, :count], np.linalg.eigh(hidden.T @ hidden)[1][:, ::-1][:, :count]
    return asked @ lacking[: asked.shape[1]] @ (whole.T @ lacking).T @ whole[asked.shape[1] :].T
