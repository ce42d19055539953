"""Low-pass filters and networks that rewrite: what changes samples that are trusted, and only when asked to.

The filters are zero-phase: nothing is delayed. They filter each run of observed samples by itself and never look
across a gap. Turns are filtered as quaternions of one hemisphere, and normalised: within a filter's window a
joint turns little, so this is the tangent space to second order, and a steady spin comes back as it was,
because filtering a sinusoid changes only its height.

A network answers with its own version of a person's joints. The channels of a rig are then posed to meet it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from .. import rotations
from ..body.mapping import Mapping, map_rig
from ..errors import InputError, nearest_names
from ..gaps import Gaps
from ..motion import Motion, Rig, Take
from ..networks import checkpoints
from ..networks.completers import NetworkCompleter
from ..networks.loading import load_completer
from ..rigs.fitting import fit

Array = np.ndarray
Moving = TypeVar("Moving", Motion, Take)

CUTOFF_HZ = 6.0  # of gait and most everyday movement (Winter 2009); running and throwing want 10 to 20
WINDOW_SECONDS = 0.15
SAVGOL_ORDER = 3


FILTERS = ("butterworth", "savgol")
FILLS_ONLY = "poses_off_curves"  # spaces of networks whose answer for what they see is what they see
STILL = 1e-7  # channels that vary less are constant by intent


def denoise(
    moving: Moving,
    method: str | NetworkCompleter = "butterworth",
    *,
    cutoff: float = CUTOFF_HZ,
    window: float = WINDOW_SECONDS,
    mapping: Mapping | None = None,
) -> Moving:
    """A Motion or Take whose observed samples are smoothed; what is not observed stays as it is.

    Parameters
    ----------
    method : "butterworth" or "savgol"; or a network, the name of one that is installed ("xmae") or a checkpoint's
        folder. A network rewrites the joints that it knows, and leaves all others as they are.
    cutoff : Hz, where "butterworth" passes 1/sqrt 2 of the amplitude.
    window : seconds, the length of "savgol"'s window.
    mapping : for a network, which joint is which; `mapping.map_rig`'s answer otherwise.

    Raises
    ------
    InputError : for an unknown method, a cutoff that is not between 0 and half the rate, a window not above 0;
        where a network is not installed, cannot denoise, or finds no person in the take.
    """
    if method == "butterworth":
        smooth = _butterworth(moving.fps, cutoff)
    elif method == "savgol":
        smooth = _savgol(moving.fps, window)
    else:
        return _by_network(moving, load_denoiser(method) if isinstance(method, str) else method, mapping)
    if isinstance(moving, Motion):
        return _smooth_motion(moving, smooth)
    if moving.rig is None:
        return moving.with_motion(_smooth_motion(moving.motion, smooth))
    return moving.with_rig(_smooth_rig(moving.rig, smooth))


# Filters ----------------------------------------------------------------------------------------------------


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


# Networks ---------------------------------------------------------------------------------------------------


def load_denoiser(name_or_path: str) -> NetworkCompleter:
    """The network of this name or folder, or NAME-denoise if that is installed: the same network with weights that
    learned to rewrite. InputError if there is none."""
    known = checkpoints.names()
    if f"{name_or_path}-denoise" in known:
        return load_completer(f"{name_or_path}-denoise")
    if name_or_path not in known and not Path(name_or_path).exists():
        found = f"unknown way to denoise {name_or_path!r}"
        hint = nearest_names(name_or_path, (*FILTERS, *known))
        if name_or_path == "xmae":
            found = "no network named 'xmae' is installed"
            hint = f"put its folder where ${checkpoints.PATH_VARIABLE} says, or use butterworth, which needs none"
        raise InputError(found, hint=hint)
    return load_completer(name_or_path)


def _by_network(moving: Moving, network: NetworkCompleter, mapping: Mapping | None) -> Moving:
    if network.description.space.startswith(FILLS_ONLY):
        raise InputError(
            f"{network.name} was trained to fill, and leaves whatever it sees as it is: it cannot denoise",
            hint="use butterworth or savgol, or train one with --network.curves on --network.damage takes",
        )
    if isinstance(moving, Motion):
        return _rewritten(moving, network, mapping)[0]
    motion, changed = _rewritten(moving.motion, network, mapping)
    if moving.rig is None:
        return moving.with_motion(motion)
    # A joint that never turns is constant by intent, and `fit` cannot see that where all frames may change.
    turns = rotations.continuous(moving.rig.rotations)
    turning = np.ptp(np.where(moving.rig.trusted[..., None], turns, turns[:1]), axis=0).max(axis=-1) > STILL
    moves = moving.rig.moves | (np.array(moving.skeleton.parents) < 0)
    where = moving.rig.trusted & changed.any(axis=0) & (turning | moves)
    return fit(moving, np.where(changed[..., None], motion.positions, np.nan), where)


def _rewritten(motion: Motion, network: NetworkCompleter, mapping: Mapping | None) -> tuple[Motion, Array]:
    """The motion with the network's word for what is observed, and `(frames, joints)` where it has one.

    It sees every second frame of a take of twice its rate. So it is asked twice, from frame 0 and from frame 1 on, and
    the answers' mean is taken: no sample goes unused.
    """
    seen = np.where(motion.observed[..., None], motion.positions, np.float32(np.nan))
    mapping = mapping or map_rig(motion.skeleton, seen)
    total, count = np.zeros(seen.shape), np.zeros((len(seen), 1, 1))
    known = np.zeros(len(motion.skeleton), bool)
    for first in range(min(max(1, round(motion.fps / network.fps)), len(motion))):
        rest = replace(motion, positions=seen[first:], observed=motion.observed[first:])
        answer = network.predict(rest, mapping).positions
        total[first:] += answer
        count[first:] += 1
        known |= (rest.observed & (answer != rest.positions).any(axis=-1)).any(axis=0)
    mean, changed = (total / count).astype(np.float32), motion.observed & known
    return replace(motion, positions=np.where(changed[..., None], mean, motion.positions)), changed
