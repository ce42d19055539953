"""LaFAN1's measures of motion in rotations: L2P, L2Q and NPSS, as its public evaluation takes them.

Harvey et al. 2020 (Robust Motion In-betweening), its LaFAN1 benchmark, and Gopalakrishnan et al. 2019 for NPSS.
Windows W, missing frames T, joints J; world positions and world quaternions of the missing frames only. No units.
"""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def l2p(truth: Array, guess: Array, std: Array) -> Array:
    """`(W,)` for world positions `(W, T, J, 3)`: mean over time of the L2 distance of all joints' coordinates together.

    std : `(J, 3)` of the training set's positions, by which every coordinate is divided; the mean that normalising
    takes away as well cancels in the difference. All in one unit, which one does not matter. The paper's number is the
    mean over windows.
    """
    return _over_time((guess.astype(float) - truth) / std)


def l2q(truth: Array, guess: Array) -> Array:
    """`(W,)` for world quaternions `(W, T, J, 4)`: mean over time of the L2 distance of all joints' numbers together.

    Signs matter: q and -q are one rotation and lie 2 apart. Both motions must run on without a flip from the same last
    known frame, as `rotations.continuous` makes them. The paper's number is the mean over windows.
    """
    return _over_time(guess.astype(float) - truth)


def _over_time(error: Array) -> Array:
    return np.sqrt(np.sum(error**2, axis=(-2, -1))).mean(axis=-1)


def npss(truth: Array, guess: Array) -> float:
    """Normalised power spectrum similarity of sequences `(W, T, D)`: 0 for alike, more for unlike.

    For each window and dimension the earth mover's distance between the two power spectra, each divided by its sum and
    summed up along the frequencies; then the mean of these, weighted by the truth's power.
    """
    distance, power = npss_terms(truth, guess)
    return npss_mean(distance, power)


def npss_terms(truth: Array, guess: Array) -> tuple[Array, Array]:
    """`(W, D)` earth mover's distances and their weights, for windows that come in blocks: see `npss`.

    The power is the square of the Fourier coefficients' REAL part over all T frequencies, as LaFAN1's evaluation has
    it; the 2019 paper has the squared magnitude. A sequence without any power counts as spread over no frequency.
    """
    (one, power), (other, _) = (_spectrum(sequence) for sequence in (truth, guess))
    return np.abs(np.cumsum(other, axis=1) - np.cumsum(one, axis=1)).sum(axis=1), power


def npss_mean(distance: Array, power: Array) -> float:
    """The weighted mean of `npss_terms`; NaN where the truth has no power at all."""
    total = power.sum()
    return float((distance * power).sum() / total) if total > 0 else float("nan")


def _spectrum(sequence: Array) -> tuple[Array, Array]:
    """The normalised power `(W, T, D)` of sequences, and its sums `(W, D)`."""
    power = np.fft.fft(sequence.astype(float), axis=1).real ** 2
    total = power.sum(axis=1)
    return np.divide(power, total[:, None], out=np.zeros_like(power), where=total[:, None] > 0), total
