"""What every repair owes the take: good samples kept, no pop, bones of one length, feet that stand still.

And `checks`, which measures whether the debt was paid. Nothing here changes a sample outside the mask it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from . import metrics
from .curves import least_jerk
from .motion import Motion, Rig, Take
from .rotations import from_rotvec, inverse, multiply, normalised, to_rotvec

Array = np.ndarray

FADE = 0.12  # seconds over which a residual at a seam dies away
# A check passes up to a multiple of the take's own 99th percentile, or a floor that nobody sees.
SEAM_SLACK, SEAM_FLOOR = 3.0, 1.0  # mm, mm per frame
BONE_SLACK, BONE_FLOOR = 1.5, 1.0  # mm
SKATE_SLACK, SKATE_FLOOR = 3.0, 150.0  # mm/s


def keep_observed(before: Motion, after: Motion) -> Motion:
    """`after` with every sample that `before` observed back, bit for bit."""
    positions = np.where(before.observed[..., None], before.positions, after.positions)
    return replace(after, positions=positions, observed=before.observed | after.observed)


def meet_seams(filled: Array, before: Array, known: Array, fps: float, fade: float = FADE) -> Array:
    """Fade the misfit of a fill at both seams of every gap out, inside the gap: no pop in position or velocity.

    Parameters
    ----------
    filled : `(frames, joints, 3)` a method's answer. Outside the gaps it may hold the method's own version of
        the known samples (a network's), which then tells the misfit exactly; where it repeats `before` or is
        NaN, the misfit is judged from the samples on both sides of the seam.
    before : `(frames, joints, 3)`; known : `(frames, joints)` bool, where `before` is to be trusted.
    fade : seconds; less in gaps that are shorter.

    Returns
    -------
    `(frames, joints, 3)` float64: `before` where known, elsewhere `filled` plus minimum-jerk fades (Flash & Hogan
    1985) from the misfit of position and velocity at each seam to nothing. NaN stays NaN.
    """
    return _met(filled.astype(float), before.astype(float), known, fps, fade, lambda base, x: x - base, np.add)


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
    misfit: Callable[[Array, Array], Array], moved: Callable[[Array, Array], Array],
) -> Array:  # fmt: skip
    most = max(2, round(fade * fps))
    out = np.where(known[..., None], before, filled)
    for joint in np.flatnonzero(known.any(axis=0) & ~known.all(axis=0)):  # one at a time: it all fits in memory
        some = (slice(None), slice(joint, joint + 1))
        change = _fades(filled[some], before[some], known[some], most, misfit)
        change += _fades(filled[::-1][some], before[::-1][some], known[::-1][some], most, misfit)[::-1]
        touched = ~known[some] & np.any(change != 0, axis=-1)
        out[some][touched] = moved(filled[some][touched], change[touched])
    return out


def _fades(filled: Array, before: Array, known: Array, most: int, misfit: Callable) -> Array:
    """The corrections `(frames, joints, 3)` that die away from each gap's first seam."""
    frames, joints = known.shape
    clock = np.arange(frames)[:, None]
    last = np.maximum.accumulate(np.where(known, clock, -1), axis=0)
    following = np.minimum.accumulate(np.where(known, clock, frames)[::-1], axis=0)[::-1]
    offset, slope = np.zeros((2, frames, joints, 3))
    seam, joint = np.nonzero(known[:-1] & ~known[1:])
    offset[seam, joint], slope[seam, joint] = _misfits(filled, before, known, seam, joint, misfit)

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
    filled: Array, before: Array, known: Array, seam: Array, joint: Array, misfit: Callable
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
    own = np.isfinite(first).all(axis=-1) & np.any(at(filled, 0) != base, axis=-1)
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


def reference_lengths(motion: Motion) -> Array:
    """`(joints,)` metres: each bone's median length where both its ends are observed; NaN where they never are."""
    points = np.where(motion.observed[..., None], motion.positions, np.nan)
    bones = (column[np.isfinite(column)] for column in metrics.bone_lengths(points, motion.skeleton.parents).T)
    return np.array([np.median(bone) if len(bone) else np.nan for bone in bones])


def keep_lengths(motion: Motion, lengths: Array, filled: Array) -> Motion:
    """Give bones their length back by moving filled points only, from the root outward.

    A point stays in the direction it has from its parent's new place, so errors do not add up along a chain; one
    between two others that it must suit, of which the outer is not filled, goes to the nearest place that suits
    both, or as near as can be.

    lengths : `(joints,)` metres, NaN for bones to leave alone. filled : `(frames, joints)` bool.
    """
    skeleton = motion.skeleton
    points = motion.positions.astype(float)
    for joint, parent in enumerate(skeleton.parents):
        rows = np.flatnonzero(filled[:, joint])
        if parent < 0 or not np.isfinite(lengths[joint]) or not len(rows):
            continue
        along = points[rows, joint] - points[rows, parent]
        points[rows, joint] = points[rows, parent] + normalised(along) * lengths[joint]
        for child in skeleton.children[joint]:
            held = rows[~filled[rows, child] & motion.observed[rows, child]]
            if np.isfinite(lengths[child]) and len(held):
                ends = points[held, parent], motion.positions[held, joint], points[held, child]
                points[held, joint] = between_two(*ends, lengths[joint], lengths[child])
    positions = np.where(filled[..., None] & np.isfinite(points), points.astype(np.float32), motion.positions)
    return replace(motion, positions=positions)


def between_two(start: Array, middle: Array, end: Array, first: float, second: float) -> Array:
    """The place `(rows, 3)` nearest to `middle` at distance `first` from `start` and `second` from `end`."""
    axis = end - start
    distance = np.linalg.norm(axis, axis=-1, keepdims=True)
    apart = np.clip(distance, max(abs(first - second), 1e-9), first + second)
    axis = normalised(axis)
    along = (first**2 - second**2 + apart**2) / (2 * apart)
    aside = middle - start
    aside = normalised(aside - axis * np.sum(aside * axis, axis=-1, keepdims=True))
    return start + axis * along + aside * np.sqrt(np.maximum(first**2 - along**2, 0))


@dataclass(frozen=True)
class Check:
    """One number of the report, whether it is as it should be, and the take's own measure to judge it by."""

    value: float | None
    unit: str
    ok: bool
    text: str
    typical: float | None = None
    own: float | None = None


@dataclass(frozen=True)
class Checks:
    """What a repair is held to.

    changed : samples of the file that changed outside the mask; must be 0.
    seam_jump : mm, the step across a seam less what the velocity on both sides explains, the worst; `typical` is
        the median, `own` the 99th percentile of the same in samples that were never touched.
    seam_kink : mm per frame, the same for the change of velocity.
    bone_length : mm, the greatest departure of a filled bone from its median length.
    foot_skate : mm/s, of standing feet where filled; `own` where not.
    unfilled : samples that are still not trusted.
    """

    changed: Check
    seam_jump: Check
    seam_kink: Check
    bone_length: Check
    foot_skate: Check
    unfilled: Check

    @property
    def ok(self) -> bool:
        return all(check.ok for check in vars(self).values())

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """name → {value, unit, ok, text, typical, own}: plain numbers and None, ready for JSON."""
        return asdict(self)


def checks(before: Take, after: Take, filled: Array, feet: Sequence[int] = ()) -> Checks:
    """Measure a repair.

    filled : `(frames, joints)` bool, the file's own samples (channels, or points) that may have changed.
    feet : the indices of the joints that touch the floor (toes, or ankles), if the take has a body.
    """
    changed = int(np.sum(_differ(before, after) & ~filled))
    affected = affected_by(after, filled)
    points = np.where((after.motion.observed | affected)[..., None], after.motion.positions, np.nan).astype(float)
    jumps, kinks = metrics.steps(points)
    at_seam = np.zeros_like(affected)
    at_seam[1:] = affected[1:] != affected[:-1]
    # A step is the take's own where none of its four samples hangs on what was filled.
    clean = ~affected
    for shift in (-1, 1, 2):
        clean &= ~np.roll(affected, shift, axis=0)
    return Checks(
        Check(changed, "samples", changed == 0, f"{changed} samples changed outside the repair"),
        _seam_check(jumps, at_seam, clean, "mm", after.skeleton.names),
        _seam_check(kinks, at_seam, clean, "mm/frame", after.skeleton.names),
        _bone_check(after, points, affected),
        _feet_check(points[:, list(feet)], affected[:, list(feet)], after.fps),
        _unfilled(after),
    )


def _differ(before: Take, after: Take) -> Array:
    """`(frames, joints)` bool: whose own samples in the file are no longer the same."""
    pairs = [(before.motion.positions, after.motion.positions)]
    if before.rig is not None and after.rig is not None:
        pairs = [(before.rig.rotations, after.rig.rotations), (before.rig.translations, after.rig.translations)]
    other = np.zeros(before.trusted.shape, bool)
    for old, new in pairs:
        other |= np.any((old != new) & ~(np.isnan(old) & np.isnan(new)), axis=-1)
    return other


def affected_by(take: Take, filled: Array) -> Array:
    """`(frames, joints)` bool: the positions that hang on filled samples."""
    return filled if take.rig is None else ~replace(take.rig, trusted=~filled).observed()


def _seam_check(values: Array, at_seam: Array, clean: Array, unit: str, names: Sequence[str]) -> Check:
    at_seam = at_seam & np.isfinite(values)
    seams = values[at_seam]
    usual = values[clean & np.isfinite(values)]
    own = float(np.percentile(usual, 99)) if len(usual) else None
    if not len(seams):
        return Check(None, unit, True, "no seams", own=own)
    worst, typical = float(seams.max()), float(np.median(seams))
    ok = worst <= max(SEAM_SLACK * (own or 0.0), SEAM_FLOOR)
    frame, joint = np.unravel_index(np.argmax(np.where(at_seam, values, -1)), values.shape)
    text = f"{worst:.3g} {unit} at worst ({names[int(joint)]}, frame {frame}), {typical:.2g} typically"
    if own is not None:
        text += f"; the take's own 99 %: {own:.2g}"
    return Check(worst, unit, ok, text, typical, own)


def _bone_check(take: Take, points: Array, affected: Array) -> Check:
    parents = np.array(take.skeleton.parents)
    touched = (affected | affected[:, parents]) & (parents >= 0)
    known = replace(take.motion, observed=take.motion.observed & ~affected)
    departure = np.abs(metrics.bone_lengths(points, take.skeleton.parents) - reference_lengths(known)) * 1000
    ours, usual = (departure[mask & np.isfinite(departure)] for mask in (touched, ~touched))
    own = float(np.percentile(usual, 99)) if len(usual) else None
    if not len(ours):
        return Check(None, "mm", True, "no bones were filled" if take.skeleton.has_bones else "no bones", own=own)
    worst = float(ours.max())
    ok = worst <= max(BONE_SLACK * (own or 0.0), BONE_FLOOR)
    return Check(worst, "mm", ok, f"{worst:.3g} mm off the usual length at worst", float(np.median(ours)), own)


def _feet_check(points: Array, affected: Array, fps: float) -> Check:
    contact = metrics.stances(points, fps)
    value, own = (metrics.foot_skate(points, contact & mask, fps) for mask in (affected, ~affected))
    if not np.isfinite(value):
        return Check(None, "mm/s", True, "no foot stands in what was filled", own=own if np.isfinite(own) else None)
    ok = value <= max(SKATE_SLACK * np.nan_to_num(own), SKATE_FLOOR)
    text = f"standing feet move at {value:.3g} mm/s" + (f" ({own:.3g} elsewhere)" if np.isfinite(own) else "")
    return Check(value, "mm/s", bool(ok), text, own=own if np.isfinite(own) else None)


def _unfilled(take: Take) -> Check:
    count = int(np.sum(~take.trusted))
    return Check(count, "samples", count == 0, f"{count} samples still not trusted")
