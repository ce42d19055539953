"""The main job: one take in, the same take out with its damage repaired and a report of what was done."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..body.mapping import map_rig, read_map
from ..constraints import feet
from ..constraints.checks import checks
from ..diagnosis.diagnosing import diagnose
from ..diagnosis.findings import Finding, told, undone
from ..errors import InputError
from ..fills.kinds import KINDS, point_kinds, rig_kinds
from ..fills.points import FILLS
from ..gaps import Gaps, longer
from ..memory.channels import unlike
from ..memory.sessions import content
from ..memory.storing import Memory
from ..motion import Array, Take
from ..progress import Stage, silent
from ..ranges import Lost, Range, mask_of, parse_frames
from .denoising import denoise as smoothed
from .filling import RECALL, fill
from .fragments import Fragment, fragments, joined, unlabelled
from .learning import Teacher
from .learning import learn as learned
from .report import Denoised, Filled, Report
from .varied_fill import GENERATIVE, must_vary


def repair(
    take: Take,
    *,
    gaps: Iterable[Range] = (),
    lost: Iterable[Lost] = (),
    find: bool | None = None,
    method: str = "auto",
    donors: Sequence[str] = (),
    max_gap: int | str | None = None,
    keep_longer: bool = False,
    denoise: str | None = None,
    cutoff: float = 6.0,
    plant_feet: bool = False,
    join: bool = False,
    seed: int = 0,
    variant: int = 1,
    learn: Memory | Teacher | Iterable[Teacher] = (),
    map: str | Path | dict[str, str] | None = None,
    stage: Stage = silent,
) -> Take:
    """Repair a take; everything that is not repaired stays bit for bit.

    Parameters
    ----------
    gaps : frames in which all joints are untrusted, as `(start, stop)` or "120:180" or "0.5s:0.8s".
    lost : joints or markers and frames, as `(names, start, stop)` or "LeftForeArm,LeftHand:300:360". In a take of
        channels these are the joints' own channels; what hangs on them moves with them.
    find : whether to repair what `diagnose` finds, missing samples among it; by default only if neither `gaps` nor
        `lost` is given. Without it, what these name is all that is repaired.
    method : "linear", "hermite", "eased", "cubic", "pattern", "bones", "rigid", "local", "regression", "pca",
        "average", "mend", "xmae" or "convae" (networks), "trajevae" (one plausible way of many), "recall" (as the take
        itself and others moved in similar stretches), or "auto", which is "recall" where there is something to `learn`
        from.
    donors : names that "pattern", "rigid" and the fills that learn may follow; by default they choose for themselves.
    max_gap : fill gaps up to so long (frames, or "0.5s"). Longer ones are left, and marked as missing in
        formats that can say so; with `keep_longer` they stay as the file has them.
    denoise : "savgol", "butterworth", or a network such as "xmae": smooth the whole take afterwards. cutoff : of
        "butterworth", Hz.
    plant_feet : hold feet still where they stand inside repaired frames.
    join : give lost markers the samples of tracks without a label that go on where they were lost, first of all; see
        `fragments.fragments`. The tracks stay as they are.
    seed, variant : of "trajevae", from 0 on and from 1 on: which of the ways. The same two give the same bits.
    learn : takes that teach "recall" besides this one: paths, patterns, folders, Takes, or what `learn` returns.
    map : overrides of the rig's mapping: BODY name → name in the file, or a TOML file of such lines.
    stage : called with what is done next, for progress.

    Returns
    -------
    The repaired take. Its `report` says what was found, filled, left and checked.

    Raises
    ------
    InputError : for names or ranges the take does not have, for `join` in a take of channels, for variants of a method
        that has one answer, and if nothing in the take can be trusted.
    """
    must_vary(method, variant, seed)
    memory = _memory(learn, stage)
    if memory is not None:
        if method not in ("auto", RECALL):
            hint = f"say {RECALL!r}, or leave learn out"
            raise InputError(f"method {method!r} learns from no other takes", hint=hint)
        method = RECALL
    asked = mask_of(take, gaps, lost)
    overrides = map if isinstance(map, dict) or map is None else read_map(map)
    findings, whole, wrong = (), take, asked | ~take.trusted
    only_asked = asked.any() and not find
    put_right, calibration = np.zeros((2, *asked.shape), bool)
    if find or (find is None and not only_asked):
        stage("looking for damage")
        found = diagnose(take)
        findings = found.findings
        for finding in findings:
            if finding.is_undone:
                whole = undone(whole, finding)
                put_right[finding.start : finding.stop, list(finding.indices)] = True
            elif finding.cause == "t-pose":
                calibration[finding.start : finding.stop] = True
        wrong = wrong | found.untrusted
    joins = _joins(whole.distrust(wrong | calibration)) if join else []
    whole = joined(whole, joins) if joins else whole
    for one in joins:
        wrong[one.start : one.stop, one.marker] = False
        put_right[one.start : one.stop, one.marker] = True
    # A calibration pose stays in the file, but says nothing of the motion that follows it.
    calibration &= ~wrong
    damaged = whole.distrust(wrong | calibration)
    if not damaged.trusted.any():
        found = "no sample of this take can be trusted: there is nothing to repair it from"
        raise InputError(found, where=take.source)

    too_long = np.zeros_like(wrong)
    if max_gap is not None:
        limit = parse_frames(max_gap, take.fps) if isinstance(max_gap, str) else max_gap
        too_long = wrong & longer(~wrong, limit)

    nameless = _open_ends(damaged) & wrong & ~asked

    mapping = map_rig(take.skeleton, take.motion.positions, overrides)
    legs = feet.legs(mapping.joints) if mapping.is_person else []
    notes = take.notes
    if memory is not None and (mute := unlike(memory.sessions, damaged)):
        whole_memory = sum(len(session.takes) for session in memory.sessions)
        notes += (f"{mute} of {whole_memory} takes to learn from have other joints or markers, and teach nothing here",)
    stage("filling gaps")
    teaching = (memory.sessions if memory else (), content(take)) if method == RECALL else ((), "")
    filled, done = fill(damaged, method, donors, legs, mapping, seed, variant, *teaching)
    filled = _put_back(filled, whole if keep_longer else damaged, too_long)
    filled = _put_back(filled, whole, nameless)
    not_named = wrong & ~asked if only_asked else np.zeros_like(wrong)
    filled = _put_back(filled, whole, calibration | not_named)
    kept = too_long | not_named | nameless
    changed = wrong & filled.trusted & ~kept
    if plant_feet and changed.any():
        stage("planting feet")
        filled, _ = feet.plant_feet(filled, changed, legs)
    mended = changed | put_right
    checked, denoised = {}, None
    if mended.any():
        stage("checking")
        checked = checks(take, filled, mended, feet.soles(legs)).as_dict()
    if denoise:
        stage("denoising")
        rough, filled = filled, smoothed(filled, denoise, cutoff=cutoff, mapping=mapping)
        denoised = Denoised.of(denoise, rough.motion, filled.motion, mapping)
    report = Report(
        source=Path(take.source).name,
        format=take.format,
        frames=len(take),
        fps=take.fps,
        units=take.units.why,
        samples=int(take.trusted.size),
        repaired=int(mended.sum()),
        findings=[told(finding) for finding in findings],
        fills=_undone(take, findings) + _joined(take, joins) + _rows(damaged, done, changed, method),
        left=_rows(damaged, done, wrong & ~mended & ~kept, method)
        + _rows(damaged, done, too_long & ~not_named & ~nameless, method, f"longer than {max_gap}")
        + _rows(damaged, done, nameless & ~not_named, method, "a track without a label is not continued")
        + _rows(damaged, done, not_named, method, "missing, but not named"),
        checks=checked,
        notes=notes,
        denoised=denoised,
        seed=seed if method in GENERATIVE else None,
        variant=variant if method in GENERATIVE else None,
    )
    return replace(filled, report=report)


def _joins(take: Take) -> list[Fragment]:
    """The fragments that continue lost markers, in a take of points."""
    if take.rig is not None:
        found = "tracks without a label were to be joined in a take of channels, which has none"
        raise InputError(found, where=take.source, hint="leave --join out")
    return fragments(take.motion)


def _open_ends(take: Take) -> Array:
    """`(frames, joints)` bool: where a track of points without a label has not begun yet, or has ended."""
    ends = np.zeros(take.trusted.shape, bool)
    if take.rig is None and (loose := unlabelled(take.skeleton.names)).any():
        seen = take.trusted[:, loose]
        begun, goes_on = (np.logical_or.accumulate(each, axis=0) for each in (seen, seen[::-1]))
        ends[:, loose] = ~(begun & goes_on[::-1])
    return ends


def _memory(learn: Memory | Teacher | Iterable[Teacher], stage: Stage) -> Memory | None:
    if isinstance(learn, Memory):
        return learn
    teachers = [learn] if isinstance(learn, str | os.PathLike | Take) else [*learn]
    return learned(teachers, stage=stage) if teachers else None


def _put_back(filled: Take, source: Take, kept: Array) -> Take:
    """`filled` with the samples in `kept` as `source` has them, its trust included."""
    if not kept.any():
        return filled
    if filled.rig is None or source.rig is None:
        motion = replace(
            filled.motion,
            positions=np.where(kept[..., None], source.motion.positions, filled.motion.positions),
            observed=np.where(kept, source.motion.observed, filled.motion.observed),
        )
        return filled.with_motion(motion)
    rig = replace(
        filled.rig,
        rotations=np.where(kept[..., None], source.rig.rotations, filled.rig.rotations),
        translations=np.where(kept[..., None], source.rig.translations, filled.rig.translations),
        trusted=np.where(kept, source.rig.trusted, filled.rig.trusted),
    )
    return filled.with_rig(rig)


def _rows(take: Take, gaps: Gaps, wanted: Array, asked: str, because: str = "") -> list[Filled]:
    """The report's lines: the gaps that lie in `wanted`, those of the same frames and fate together."""
    if not wanted.any():
        return []  # most takes leave nothing, and telling the kinds of many gaps takes time
    kinds = rig_kinds(take.rig, gaps) if take.rig else point_kinds(take.motion, gaps)
    names = take.skeleton.names
    together: dict[tuple[int, int, str, str, tuple[str, ...]], list[int]] = {}
    for row, kind in enumerate(kinds):
        joint, first = int(gaps.joint[row]), int(gaps.start[row])
        inside = np.flatnonzero(wanted[first : gaps.stop[row], joint])
        if not len(inside):
            continue
        start, stop = first + int(inside[0]), first + int(inside[-1]) + 1
        method = "" if because else str(gaps.method[row])
        why = because or _why(gaps, row, method, asked, KINDS[kind])
        donors = tuple(names[donor] for donor in gaps.donors.get(row, ())) if method else ()
        together.setdefault((start, stop, method, why, donors), []).append(row)
    found = []
    for (start, stop, method, why, donors), rows in sorted(together.items()):
        joints = tuple(names[joint] for joint in gaps.joint[rows])
        off = [1000 * gaps.expected[row] for row in rows if method and row in gaps.expected]
        expected = float(np.median(off)) if off else None
        found.append(Filled(joints, start, stop, (stop - start) / take.fps, method, why, donors, expected))
    return found


def _why(gaps: Gaps, row: int, method: str, asked: str, kind: str) -> str:
    if gaps.is_blank[row]:
        return "never seen" + (", as asked" if method else "")
    if method == RECALL or (asked == RECALL and row in gaps.reasons):
        return gaps.reasons[row]
    if gaps.is_edge[row]:
        side = "after" if gaps.before[row] else "before"
        how = ", carried by its donors" if row in gaps.donors else ", extrapolated" if method else ""
        return f"nothing is known {side} it{how}"
    if asked == "auto":
        return gaps.reasons.get(row, kind)
    if asked not in FILLS:
        return gaps.reasons.get(row, "as asked")
    return gaps.reasons.get(row, "as asked" if method == asked else f"no donors for {asked}")


def _joined(take: Take, joins: Iterable[Fragment]) -> list[Filled]:
    """The report's lines of tracks without a label that were joined to markers."""
    names, rows = take.skeleton.names, []
    for one in joins:
        seconds, track = (one.stop - one.start) / take.fps, names[one.track]
        why = f"{track} goes on there and keeps its distances, {1000 * one.metres:.0f} mm from where it is expected"
        rows.append(Filled((names[one.marker],), one.start, one.stop, seconds, "join", why, (track,)))
    return rows


def _undone(take: Take, findings: Iterable[Finding]) -> list[Filled]:
    """The report's lines of swaps and offsets that were undone."""
    whys = {"swap": "left and right exchanged back", "shift": "moved back to where all bones fit"}
    rows = []
    for found in findings:
        if found.is_undone:
            method, seconds = "shift" if found.shift else "swap", (found.stop - found.start) / take.fps
            why = f"{whys[method]}, nothing interpolated"
            rows.append(Filled(found.joints, found.start, found.stop, seconds, method, why))
    return rows
