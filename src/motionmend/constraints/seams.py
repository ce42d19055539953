"""No pop: what a fill misses at the two seams of a gap dies away inside the gap, for points and for channels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..fills.curves import least_jerk
from ..motion import Motion, Rig
from ..rotations import from_rotvec, inverse, multiply, to_rotvec

Array = np.ndarray

FADE = 0.12  # seconds over which a residual at a seam dies away


def keep_observed(before: Motion, after: Motion) -> Motion:
    """`after` with every sample that `before` observed back, bit for bit."""
    positions = np.where(before.observed[..., None], before.positions, after.positions)
    return replace(after, positions=positions, observed=before.observed | after.observed)


def meet_seams(
    filled: Array, before: Array, known: Array, fps: float, fade: float = FADE, own: bool = False
) -> Array:
    """Fade the misfit of a fill at both seams of every gap out, inside the gap: no pop in position or velocity.

    Parameters
    ----------
    filled : `(frames, joints, 3)` a method's answer. Outside the gaps it may hold the method's own version of
        the known samples (a network's), which then tells the misfit exactly; where it repeats `before` or is
        NaN, the misfit is judged from the samples on both sides of the seam.
    before : `(frames, joints, 3)`; known : `(frames, joints)` bool, where `before` is to be trusted.
    fade : seconds; less in gaps that are shorter.
    own : `filled` holds the method's own version wherever it is a number, also where that repeats `before`.

    Returns
    -------
    `(frames, joints, 3)` float64: `before` where known, elsewhere `filled` plus minimum-jerk fades (Flash & Hogan
    1985) from the misfit of position and velocity at each seam to nothing. NaN stays NaN.
    """
    return _met(filled.astype(float), before.astype(float), known, fps, fade, lambda base, x: x - base, np.add, own)


def meet_rig_seams(filled: Rig, before: Rig, fps: float, fade: float = FADE) -> Rig:
    """The same for the channels of a rig where `before` does not trust them.

    Turns: the misfit is a rotation vector. Shifts: where the rig has position channels.
    """
    known = before.trusted

    def misfit(base: Array, x: Array) -> Array:
        return to_rotvec(multiply(inverse(base), x))

    def moved(q: Array, by: Array) -> Array:
        return multiply(q, from_rotvec(by))

    rotations = _met(filled.rotations, before.rotations, known, fps, fade, misfit, moved)
    translations = np.where(known[..., None], before.translations, filled.translations)
    for joint in np.flatnonzero(before.moves):
        one = slice(joint, joint + 1)
        translations[:, one] = meet_seams(
            translations[:, one], before.translations[:, one], known[:, one], fps, fade
        )  # fmt: skip
    return replace(filled, rotations=rotations, translations=translations)


def _met(
    filled: Array, before: Array, known: Array, fps: float, fade: float,
    misfit: Callable[[Array, Array], Array], moved: Callable[[Array, Array], Array], own: bool = False,
) -> Array:  # fmt: skip
    most = max(2, round(fade * fps))
    out = np.where(known[..., None], before, filled)
    for joint in np.flatnonzero(known.any(axis=0) & ~known.all(axis=0)):  # one at a time: it all fits in memory
        some = (slice(None), slice(joint, joint + 1))
        change = _fades(filled[some], before[some], known[some], most, misfit, own)
        change += _fades(filled[::-1][some], before[::-1][some], known[::-1][some], most, misfit, own)[::-1]
        touched = ~known[some] & np.any(change != 0, axis=-1)
        out[some][touched] = moved(filled[some][touched], change[touched])
    return out


def _fades(filled: Array, before: Array, known: Array, most: int, misfit: Callable, own: bool) -> Array:
    """The corrections `(frames, joints, 3)` that die away from each gap's first seam."""
    frames, joints = known.shape
    clock = np.arange(frames)[:, None]
    last = np.maximum.accumulate(np.where(known, clock, -1), axis=0)
    following = np.minimum.accumulate(np.where(known, clock, frames)[::-1], axis=0)[::-1]
    offset, slope = np.zeros((2, frames, joints, 3))
    seam, joint = np.nonzero(known[:-1] & ~known[1:])
    offset[seam, joint], slope[seam, joint] = _misfits(filled, before, known, seam, joint, misfit, own)

    frame, joint = np.nonzero(~known & (last >= 0))
    seam = last[frame, joint]
    span = np.minimum(most, following[frame, joint] - seam)
    u = np.minimum((frame - seam) / span, 1.0)[:, None]
    # Quintic Hermite from (value, slope) to rest, without acceleration at both ends.
    still = 1 - least_jerk(u)
    going = u * (1 - u) ** 3 * (1 + 3 * u)
    change = np.zeros((frames, joints, 3))
    change[frame, joint] = still * offset[seam, joint] + going * span[:, None] * slope[seam, joint]
    return np.nan_to_num(change)


def _misfits(
    filled: Array, before: Array, known: Array, seam: Array, joint: Array, misfit: Callable, always_own: bool
) -> tuple[Array, Array]:
    """How far the fill is from the last known sample, and that misfit's change a frame: `(gaps, 3)` each."""
    frames = len(known)

    def at(values: Array, shift: int) -> Array:
        here = np.clip(seam + shift, 0, frames - 1)
        taken = values[here, joint]
        return np.where((here == seam + shift)[:, None], taken, np.nan)

    def have(shift: int, wanted: bool) -> Array:
        here = np.clip(seam + shift, 0, frames - 1)
        return (here == seam + shift) & (known[here, joint] == wanted)

    base = at(before, 0)
    # The method's own word on the known samples, where it has one.
    first = misfit(at(filled, 0), base)
    second = misfit(at(filled, -1), at(before, -1))
    own = np.isfinite(first).all(axis=-1) & (always_own | np.any(at(filled, 0) != base, axis=-1))
    slope = np.where((have(-1, True) & np.isfinite(second).all(axis=-1))[:, None], first - second, 0.0)

    # Otherwise: straight through the seam with the mean velocity of both sides. Exact for any parabola.
    whole = np.where(known[..., None], before, filled)
    y = {shift: misfit(base, at(whole, shift)) for shift in (-2, -1, 1, 2, 3)}
    y = {shift: np.where(have(shift, shift < 0)[:, None], each, np.nan) for shift, each in y.items()}
    inward, outward = -y[-1], y[2] - y[1]
    behind = np.isfinite(inward)
    ahead = np.isfinite(outward)
    inward, outward = np.where(behind, inward, outward), np.where(ahead, outward, inward)
    bends = [y[-2] - 2 * y[-1], y[3] - 2 * y[2] + y[1]]
    counts = sum(np.isfinite(bend).astype(int) for bend in bends)
    bend = sum(np.nan_to_num(bend) for bend in bends) / np.maximum(counts, 1)
    judged = np.nan_to_num((inward + outward) / 2 - y[1])
    drift = np.where(behind & ahead, inward - outward + 2 * bend, 0.0)
    return np.where(own[:, None], first, judged), np.where(own[:, None], slope, drift)
