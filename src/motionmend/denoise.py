"""Low-pass filters: the only methods here that change what is trusted, and only when asked to.

Both are zero-phase: nothing is delayed. They filter each run of observed samples by itself and never look
across a gap. Turns are filtered as quaternions of one hemisphere, and normalised: within a filter's window a
joint turns little, so this is the tangent space to second order, and a steady spin comes back as it was,
because filtering a sinusoid changes only its height.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from . import rotations
from .errors import InputError, nearest_names
from .gaps import Gaps
from .motion import Motion, Rig, Take

Array = np.ndarray
Moving = TypeVar("Moving", Motion, Take)

CUTOFF_HZ = 6.0  # of gait and most everyday movement (Winter 2009); running and throwing want 10 to 20
WINDOW_SECONDS = 0.15
SAVGOL_ORDER = 3


def denoise(
    moving: Moving, method: str = "butterworth", *, cutoff: float = CUTOFF_HZ, window: float = WINDOW_SECONDS
) -> Moving:
    """A Motion or Take whose observed samples are smoothed; what is not observed stays as it is.

    Parameters
    ----------
    method : "butterworth" or "savgol".
    cutoff : Hz, where "butterworth" passes 1/sqrt 2 of the amplitude.
    window : seconds, the length of "savgol"'s window.

    Raises
    ------
    InputError : for an unknown method, a cutoff that is not between 0 and half the rate, a window not above 0.
    """
    if method == "butterworth":
        smooth = _butterworth(moving.fps, cutoff)
    elif method == "savgol":
        smooth = _savgol(moving.fps, window)
    else:
        raise InputError(f"unknown way to denoise {method!r}", hint=nearest_names(method, ("butterworth", "savgol")))
    if isinstance(moving, Motion):
        return _smooth_motion(moving, smooth)
    if moving.rig is None:
        return moving.with_motion(_smooth_motion(moving.motion, smooth))
    return moving.with_rig(_smooth_rig(moving.rig, smooth))


Smooth = Callable[[Array], Array]


def _butterworth(fps: float, cutoff: float) -> Smooth:
    """Fourth order, zero lag: a second-order filter run forwards and backwards.

    Twice through would lower the cutoff; it is raised beforehand by (sqrt 2 - 1)^(-1/4) in the warped
    frequency (Robertson and Dowling 2003).
    """
    from scipy.signal import butter, sosfiltfilt

    if not 0 < cutoff < fps / 2:
        raise InputError(
            f"a cutoff of {cutoff:g} Hz", expected=f"between 0 and half of the rate, {fps / 2:g} Hz",
            hint="6 Hz suits walking, 10 to 20 Hz fast movement",
        )  # fmt: skip
    warped = np.tan(np.pi * cutoff / fps) / (np.sqrt(2) - 1) ** 0.25
    filter = butter(2, 2 / np.pi * np.arctan(warped), output="sos")
    pad = int(np.ceil(2 * fps / cutoff))

    def smooth(samples: Array) -> Array:
        return np.asarray(sosfiltfilt(filter, samples, axis=0, padlen=min(pad, len(samples) - 1)))

    return smooth


def _savgol(fps: float, window: float) -> Smooth:
    """The middle of the least-squares cubic over a sliding window (Savitzky and Golay 1964); at a run's ends, of
    the cubic over its first or last window."""
    from scipy.signal import savgol_filter

    if not (np.isfinite(window) and window > 0):
        raise InputError(f"a window of {window:g} s", expected="a time above 0")
    width = max(2 * int(window * fps / 2 + 1e-6) + 1, SAVGOL_ORDER + 2)

    def smooth(samples: Array) -> Array:
        fitting = min(width, len(samples) - 1 + len(samples) % 2)  # the largest odd number of frames there are
        if fitting <= SAVGOL_ORDER:
            return samples
        return np.asarray(savgol_filter(samples, fitting, SAVGOL_ORDER, axis=0))

    return smooth


def _smooth_motion(motion: Motion, smooth: Smooth) -> Motion:
    positions = motion.positions.copy()
    for frames, joints in _runs(motion.observed):
        positions[frames, joints] = smooth(positions[frames, joints].astype(np.float64))
    return replace(motion, positions=positions)


def _smooth_rig(rig: Rig, smooth: Smooth) -> Rig:
    turns, shifts = rig.rotations.copy(), rig.translations.copy()
    turning = np.array([bool(order) for order in rig.orders])
    moving = (np.array(rig.skeleton.parents) < 0) | rig.moves
    for frames, joints in _runs(rig.trusted):
        shifting = joints[moving[joints]]
        shifts[frames, shifting] = smooth(shifts[frames, shifting])
        turned = joints[turning[joints]]
        turns[frames, turned] = rotations.normalised(smooth(rotations.continuous(turns[frames, turned])))
    return replace(rig, rotations=turns, translations=shifts)


def _runs(observed: Array) -> list[tuple[slice, Array]]:
    """The runs of observed samples that are long enough to filter: frames, and the joints `(n,)` that share them."""
    runs = Gaps.of(~observed)
    runs = runs.pick(runs.length > 1)
    order = np.lexsort((runs.joint, runs.stop, runs.start))
    spans = np.stack([runs.start, runs.stop], axis=1)[order]
    cuts = np.flatnonzero(np.any(np.diff(spans, axis=0), axis=1)) + 1
    return [
        (slice(*span), joints)
        for span, joints in zip(spans[[0, *cuts]].tolist(), np.split(runs.joint[order], cuts))
    ] if len(runs) else []  # fmt: skip
