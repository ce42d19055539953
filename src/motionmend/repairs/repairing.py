"""The main job: one take in, the same take out with its damage repaired and a report of what was done."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..body.mapping import Mapping, map_rig, read_map
from ..constraints import feet
from ..constraints.bones import keep_lengths, reference_lengths
from ..constraints.checks import checks
from ..diagnosis.diagnosing import diagnose
from ..diagnosis.findings import Finding, told, undone
from ..errors import InputError, nearest_names
from ..fills.auto import rig_methods
from ..fills.channels import fill_rig
from ..fills.curves import CURVES
from ..fills.kinds import KINDS, point_kinds, rig_kinds
from ..fills.points import FILLS, DonorFill, Fill
from ..gaps import Gaps, covered, longer
from ..metrics.positional import bone_lengths
from ..motion import Array, Motion, Take
from ..progress import Stage, silent
from ..ranges import Lost, Range, mask_of, parse_frames
from ..rigs.fitting import fit
from . import network_fill
from .chooser import NETWORK_WINS, Chooser, network_reason, network_rows
from .denoising import denoise as smoothed
from .report import Denoised, Filled, Report
from .varied_fill import GENERATIVE, must_vary, varied

KEEP_SECONDS = 0.2  # gaps of points longer than this keep the lengths of bones
STEADY_METRES = 0.002  # bones that vary more than this have no length to keep


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
    seed: int = 0,
    variant: int = 1,
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
    method : "linear", "hermite", "eased", "cubic", "pattern", "bones", "rigid", "xmae" or "convae" (networks),
        "trajevae" (one plausible way of many), or "auto".
    donors : names that "pattern" and "rigid" may follow; by default they choose for themselves.
    max_gap : fill gaps up to so long (frames, or "0.5s"). Longer ones are left, and marked as missing in
        formats that can say so; with `keep_longer` they stay as the file has them.
    denoise : "savgol", "butterworth", or a network such as "xmae": smooth the whole take afterwards. cutoff : of
        "butterworth", Hz.
    plant_feet : hold feet still where they stand inside repaired frames.
    seed, variant : of "trajevae", from 0 on and from 1 on: which of the ways. The same two give the same bits.
    map : overrides of the rig's mapping: BODY name → name in the file, or a TOML file of such lines.
    stage : called with what is done next, for progress.

    Returns
    -------
    The repaired take. Its `report` says what was found, filled, left and checked.

    Raises
    ------
    InputError : for names or ranges the take does not have, for variants of a method that has one answer, and if
        nothing in the take can be trusted.
    """
    must_vary(method, variant, seed)
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

    mapping = map_rig(take.skeleton, take.motion.positions, overrides)
    legs = feet.legs(mapping.joints) if mapping.is_person else []
    stage("filling gaps")
    filled, done = fill(damaged, method, donors, legs, mapping, seed, variant)
    filled = _put_back(filled, whole if keep_longer else damaged, too_long)
    not_named = wrong & ~asked if only_asked else np.zeros_like(wrong)
    filled = _put_back(filled, whole, calibration | not_named)
    changed = wrong & filled.trusted & ~too_long & ~not_named
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
        fills=_undone(take, findings) + _rows(damaged, done, changed, method),
        left=_rows(damaged, done, wrong & ~mended & ~too_long & ~not_named, method)
        + _rows(damaged, done, too_long & ~not_named, method, f"longer than {max_gap}")
        + _rows(damaged, done, not_named, method, "missing, but not named"),
        checks=checked,
        notes=take.notes,
        denoised=denoised,
        seed=seed if method in GENERATIVE else None,
        variant=variant if method in GENERATIVE else None,
    )
    return replace(filled, report=report)


def fill(
    take: Take,
    method: str,
    donors: Sequence[str] = (),
    legs: Sequence[feet.Leg] = (),
    mapping: Mapping | None = None,
    seed: int = 0,
    variant: int = 1,
) -> tuple[Take, Gaps]:
    """The take with its untrusted samples filled, and its gaps with the method of each.

    legs : joints of whole legs (`feet.legs`), to be aimed at their joints' paths where one was lost alone.
    mapping : for the network, which joint is which. seed, variant : of a generative network's way.
    """
    if method not in (names := ["auto", *NETWORK_WINS, *GENERATIVE, *FILLS]):
        raise InputError(f"no method is named {method!r}", hint=nearest_names(method, names))
    for name in donors:
        take.skeleton.index(name)
    if donors and take.rig is not None:
        found = "donors were named for a take of channels, whose joints follow their parents"
        raise InputError(found, where=take.source, hint="leave --donors out")
    seen = np.where(take.motion.observed[..., None], take.motion.positions, np.nan)
    mapping = mapping or map_rig(take.skeleton, seen)
    networks = _networks(method, mapping, seed, variant)
    if take.rig is None:
        motion, gaps = _completer(method, donors, mapping, networks).fill(take.motion)
        return take.with_motion(_bones_kept(take.motion, motion, gaps)), gaps
    chosen = rig_methods if method not in FILLS else method
    rig, gaps = fill_rig(take.rig, take.fps, chosen)
    filled = _feet_on_their_paths(take, take.with_rig(rig), method, legs)
    if method in GENERATIVE:
        filled, gaps = _by_network(take, filled, gaps, "auto", mapping, _networks("auto", mapping))
    return _by_network(take, filled, gaps, method, mapping, networks)


def _networks(method: str, mapping: Mapping, seed: int = 0, variant: int = 1) -> dict[str, network_fill.NetworkFill]:
    """By name the network that is asked for, or all those that `auto` may take."""
    if method in FILLS:
        return {}
    if method in GENERATIVE:
        found = {method: varied(method, seed, variant)}
    else:
        found = network_fill.installed() if method == "auto" else {method: network_fill.required(method)}
    return {name: replace(network, mapping=mapping) for name, network in found.items()}


def _completer(
    method: str, donors: Sequence[str], mapping: Mapping, networks: dict[str, network_fill.NetworkFill]
) -> Fill:
    if method == "auto":
        improve = {name: network.improve for name, network in networks.items()}
        return Chooser(tuple(donors), mapping, improve)
    if method in networks:
        base = _networks("auto", mapping) if method in GENERATIVE else {}
        return replace(networks[method], base=_completer("auto", donors, mapping, base))
    chosen = FILLS[method]
    return replace(chosen, donors=tuple(donors)) if isinstance(chosen, DonorFill) else chosen


def _by_network(
    take: Take, filled: Take, gaps: Gaps, method: str, mapping: Mapping, networks: dict[str, network_fill.NetworkFill]
) -> tuple[Take, Gaps]:
    """A take of channels with those gaps by the network that were asked of it, or that are better left to it."""
    if not networks or take.rig is None:
        return filled, gaps
    if not mapping.is_person:
        nobody = {} if method == "auto" else dict.fromkeys(range(len(gaps)), network_fill.NOBODY)
        return filled, replace(gaps, reasons=gaps.reasons | nobody)
    kinds, chosen = rig_kinds(take.rig, gaps), dict.fromkeys(range(len(gaps)), method)
    if method == "auto":
        chosen = network_rows(gaps, kinds, take.trusted, take.fps, mapping, networks)
    method_of, reasons = gaps.method.copy(), dict(gaps.reasons)
    for name in dict.fromkeys(chosen.values()):
        rows = np.array([row for row, other in chosen.items() if other == name])
        wanted = covered(gaps.pick(rows), take.trusted.shape)
        filled, decided = networks[name].fill_take(take, filled, wanted)
        done = np.zeros(len(gaps), bool)
        for row in rows.tolist():
            done[row] = decided[gaps.start[row] : gaps.stop[row], gaps.joint[row]].all()
            if done[row] and method == "auto":
                reasons[row] = network_reason(name, kinds[row], float(gaps.length[row] / take.fps))
        if method == name:
            reasons = {row: why for row, why in reasons.items() if not done[row]}
            reasons |= networks[name].reasons(gaps, done, take.fps, "no joint that the network knows hangs on it")
        method_of[done] = name
    return filled, replace(gaps, method=method_of, reasons=reasons)


def _feet_on_their_paths(before: Take, filled: Take, method: str, legs: Sequence[feet.Leg]) -> Take:
    """Where a leg alone was lost, pose it by the paths of its knee, ankle and toe rather than by its turns.

    A foot moves by the floor, not by the hips: on validation takes this is the better of the two by about a
    tenth for legs, and the worse one for arms and for whole bodies.
    """
    curve = FILLS[method if method in CURVES else "eased"]
    where, follow = np.zeros((2, *before.trusted.shape), bool)
    for thigh, shin, foot, toe in legs:
        turning = [thigh, shin, foot]
        # A leg that is lost for good has no paths, and its turns were not filled either.
        alone = ~before.trusted[:, turning].any(axis=1) & before.motion.observed[:, thigh]
        alone &= filled.trusted[:, turning].all(axis=1)
        where[:, turning] |= alone[:, None]
        follow[:, [shin, foot, max(toe, foot)]] |= alone[:, None]
    if not where.any():
        return filled
    paths = curve.complete(before.motion)
    targets = np.where((follow & paths.observed)[..., None], paths.positions, np.nan)
    return fit(filled, targets, where)


def _bones_kept(before: Motion, filled: Motion, gaps: Gaps) -> Motion:
    """Filled points back at their bones' lengths, for bones that have one, in gaps long enough for it to matter.

    On validation takes this lowers the error from about 0.2 s on, and raises it in shorter gaps.
    """
    if not before.skeleton.has_bones:
        return filled
    lengths = reference_lengths(before)
    points = np.where(before.observed[..., None], before.positions, np.nan)
    loose = np.abs(bone_lengths(points, before.skeleton.parents) - lengths) > STEADY_METRES
    lengths = np.where(loose.mean(axis=0) > 0.05, np.nan, lengths)
    long = covered(gaps.pick(gaps.length > KEEP_SECONDS * before.fps), before.observed.shape)
    return keep_lengths(filled, lengths, long & filled.observed)


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
    together: dict[tuple[int, int, str, str, tuple[str, ...]], list[str]] = {}
    for row, kind in enumerate(kinds):
        joint, first = int(gaps.joint[row]), int(gaps.start[row])
        inside = np.flatnonzero(wanted[first : gaps.stop[row], joint])
        if not len(inside):
            continue
        start, stop = first + int(inside[0]), first + int(inside[-1]) + 1
        method = "" if because else str(gaps.method[row])
        why = because or _why(gaps, row, method, asked, KINDS[kind])
        donors = tuple(names[donor] for donor in gaps.donors.get(row, ())) if method else ()
        together.setdefault((start, stop, method, why, donors), []).append(names[joint])
    return [
        Filled(tuple(joints), start, stop, (stop - start) / take.fps, method, why, donors)
        for (start, stop, method, why, donors), joints in sorted(together.items())
    ]


def _why(gaps: Gaps, row: int, method: str, asked: str, kind: str) -> str:
    if gaps.is_blank[row]:
        return "never seen" + (", as asked" if method else "")
    if gaps.is_edge[row]:
        side = "after" if gaps.before[row] else "before"
        how = ", carried by its donors" if row in gaps.donors else ", extrapolated" if method else ""
        return f"nothing is known {side} it{how}"
    if asked == "auto":
        return gaps.reasons.get(row, kind)
    if asked not in FILLS:
        return gaps.reasons.get(row, "as asked")
    return "as asked" if method == asked else f"no donors for {asked}"


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
