"""Whether the debt was paid: every check has a number, and a limit that the take itself sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..metrics import positional
from ..motion import Take
from .bones import reference_lengths

Array = np.ndarray

# A check passes up to a multiple of the take's own 99th percentile, or a floor that nobody sees.
SEAM_SLACK, SEAM_FLOOR = 3.0, 1.0  # mm, mm per frame
BONE_SLACK, BONE_FLOOR = 1.5, 1.0  # mm
SKATE_SLACK, SKATE_FLOOR = 3.0, 150.0  # mm/s


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
    jumps, kinks = positional.steps(points)
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
    departure = np.abs(positional.bone_lengths(points, take.skeleton.parents) - reference_lengths(known)) * 1000
    ours, usual = (departure[mask & np.isfinite(departure)] for mask in (touched, ~touched))
    own = float(np.percentile(usual, 99)) if len(usual) else None
    if not len(ours):
        return Check(None, "mm", True, "no bones were filled" if take.skeleton.has_bones else "no bones", own=own)
    worst = float(ours.max())
    ok = worst <= max(BONE_SLACK * (own or 0.0), BONE_FLOOR)
    return Check(worst, "mm", ok, f"{worst:.3g} mm off the usual length at worst", float(np.median(ours)), own)


def _feet_check(points: Array, affected: Array, fps: float) -> Check:
    contact = positional.stances(points, fps)
    value, own = (positional.foot_skate(points, contact & mask, fps) for mask in (affected, ~affected))
    if not np.isfinite(value):
        return Check(None, "mm/s", True, "no foot stands in what was filled", own=own if np.isfinite(own) else None)
    ok = value <= max(SKATE_SLACK * np.nan_to_num(own), SKATE_FLOOR)
    text = f"standing feet move at {value:.3g} mm/s" + (f" ({own:.3g} elsewhere)" if np.isfinite(own) else "")
    return Check(value, "mm/s", bool(ok), text, own=own if np.isfinite(own) else None)


def _unfilled(take: Take) -> Check:
    count = int(np.sum(~take.trusted))
    return Check(count, "samples", count == 0, f"{count} samples still not trusted")
