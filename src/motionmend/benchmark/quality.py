"""What an error in millimetres does not show: seams, jitter, feet that skate, bones that stretch.

Measured where a method was at work, and for the undamaged motion too (the row "truth"), because people jerk, skate
and stretch a little themselves, and more so in the joints that marker systems compute.
"""

from __future__ import annotations

import numpy as np

from ..metrics import positional
from ..motion import Skeleton

Array = np.ndarray

UNITS = {
    "seam jump": "mm",
    "seam kink": "mm/frame",
    "jitter": "m/s³",
    "foot skate": "mm/s",
    "bone-length change": "mm",
}
FEET = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("foot", "toe"))
JERK_FRAMES = 3  # a third difference reaches this far beyond a changed frame


def contacts(truth: Array, fps: float, skeleton: Skeleton) -> Array:
    """`(B, T, feet)` bool: when each of FEET stands in `truth (B, T, J, 3)`."""
    return positional.stances(truth[:, :, _feet(skeleton)], fps)


def _feet(skeleton: Skeleton) -> list[int]:
    return [joint for joint, name in enumerate(skeleton.names) if name in FEET]


def measure(
    truth: Array, guess: Array, touched: Array, fps: float, skeleton: Skeleton, standing: Array | None = None
) -> dict[str, tuple[float, int]]:
    """Each metric of UNITS that applies, with its weight (how many samples it is the mean of).

    Parameters
    ----------
    truth, guess : `(B, T, J, 3)` metres, NaN for joints that the capture never saw.
    touched : `(B, T, J)` bool, what was damaged: where the method was at work.
    standing : `contacts` of the truth, which take longest, where the caller has them already.

    "seam jump" and "seam kink" are `positional.steps` at both ends of the touched stretches; "jitter" is that of the
    touched samples and across their seams; "foot skate" the speed of touched feet while the true ones stand;
    "bone-length change" the greatest departure in a window from its true median, averaged over windows.
    """
    found = {}
    at = positional.seams(touched)
    for name, values in zip(("seam jump", "seam kink"), positional.steps(guess)):
        found[name] = _mean(values[at & np.isfinite(values)])

    around = _widened(touched, JERK_FRAMES)
    jerked = np.where(around[..., None], guess, np.nan)
    found["jitter"] = positional.jitter(jerked, fps), int(touched.sum())

    feet = _feet(skeleton)
    contact = contacts(truth, fps, skeleton) if standing is None else standing
    contact = contact & _widened(touched[:, :, feet], 1)
    paired = int((contact[:, 1:] & contact[:, :-1]).sum())
    found["foot skate"] = positional.foot_skate(guess[:, :, feet], contact, fps), paired

    parents = np.asarray(skeleton.parents)
    bones = touched | (touched[:, :, parents] & (parents >= 0))
    change = np.where(bones, positional.bone_length_changes(truth, guess, skeleton.parents), np.nan)
    greatest = np.nan_to_num(change, nan=-1.0).max(axis=(1, 2), initial=-1.0)
    found["bone-length change"] = _mean(greatest[greatest >= 0])
    return {name: (value, weight) for name, (value, weight) in found.items() if weight}


def _mean(values: Array) -> tuple[float, int]:
    return (float(values.mean()) if len(values) else float("nan")), len(values)


def _widened(mask: Array, frames: int) -> Array:
    """`(B, T, J)` True within so many frames of a True one."""
    wide = mask.copy()
    for shift in range(1, frames + 1):
        wide[:, shift:] |= mask[:, :-shift]
        wide[:, :-shift] |= mask[:, shift:]
    return wide
