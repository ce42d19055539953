"""Find damage: which of a file's own numbers cannot be trusted, and why.

Points are judged as points. Channels are judged as channels, each joint's own turn (and shift, if it has
one) in its parent's frame, so that one bad shoulder does not accuse the whole arm; but one whose children make
up for it is left alone. No body and no names are needed, but for left/right swaps, which need names. Everything
scales with the frame rate and with what the same joint does in the rest of the take. `symptoms` judges numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..motion import Array, Take, runs
from . import compensation, symptoms
from .disagreement import disagreements
from .findings import CERTAIN, UNSURE, Diagnosis, Finding, undone, unswap
from .swaps import exchange_tracks, find_swaps
from .symptoms import FEW, Tear, Track

OFTEN = 20.0  # held stretches a minute, from which on they are how the take was made
LONG_STILL = 1.0  # seconds
TIP = 3  # joints that hang on one of a finger, a toe or a head, itself included
TIP_SPEED = float(np.radians(480))  # a second, which these reach
SMALL_SHIFT = 0.03  # metres, by which several points together may well have moved
# How rough at the seams, against before, a replacement may leave what hangs on the joint. A jump must show there;
# a held value is known by repeating to the last digit, and to have filled it must only do no harm.
ROUGHNESS = {"jump": 0.9, "displaced": 0.9, "held": 1.2}


def diagnose(take: Take) -> Diagnosis:
    """What is wrong with a take, and which of its numbers to replace.

    `untrusted` has the shape of `take.trusted` and, for a take of channels, speaks of each joint's own
    channels. Noise, a T-pose and a step that is not undone are told but never untrusted; a swap, or a stretch that
    is off by one known offset, is not either, because its values are good: see `undone`.
    """
    findings = list(_missing(take))
    untrusted = ~take.trusted
    if len(take) > FEW:
        tracks = list(_tracks(take))
        seen, bad = _judge(take, tracks)
        findings += seen
        untrusted = untrusted | bad
    return Diagnosis(tuple(sorted(findings, key=lambda f: (f.start, f.stop, f.cause))), untrusted)


def _tracks(take: Take) -> Iterator[Track]:
    """Every joint's turn and shift that ever change; untrusted entries are NaN."""
    tips = _tips(take)
    for joint in range(len(take.skeleton)):
        distrusted = ~take.trusted[:, joint]
        if take.rig is None:
            kinds = [(False, take.motion.positions[:, joint].astype(float))]
        else:
            kinds = [(True, 2 * take.rig.rotations[:, joint])] if take.rig.orders[joint] else []
            kinds += [(False, take.rig.translations[:, joint].copy())] if take.rig.moves[joint] else []
        for turns, values in kinds:
            values[distrusted] = np.nan
            least = 0.008
            if turns:
                values = symptoms.continuous_track(values)
                least = max(np.radians(4), TIP_SPEED / take.fps if tips[joint] else 0)
            track = Track(joint, turns, values, float(least))
            if track.is_lively:
                yield track


def _tips(take: Take) -> Array:
    """`(joints,)` bool: those on which next to nothing hangs, which turn fastest."""
    hanging = np.ones(len(take.skeleton), int)
    for joint, parent in reversed(list(enumerate(take.skeleton.parents))):
        if parent >= 0:
            hanging[parent] += hanging[joint]
    return hanging <= TIP


# Missing --------------------------------------------------------------------------------------------------


def _missing(take: Take) -> Iterator[Finding]:
    """Numbers that the file does not have: gaps, lost stretches and dropouts."""
    gone = ~take.trusted
    if not gone.any():
        return
    names, fps = take.skeleton.names, take.fps
    longest = max(FEW, round(0.05 * fps))
    gap = np.logical_and.reduce(gone, axis=1)
    for start, stop in runs(gap):
        yield _finding(take, "gap", range(len(names)), start, stop, 1.0, "no joint has numbers")
    stretches: dict[tuple[int, int], list[int]] = {}
    scattered = np.zeros_like(gone)
    for joint in np.flatnonzero(gone.any(axis=0)):
        for start, stop in runs(gone[:, joint] & ~gap):
            if stop - start > longest:
                stretches.setdefault((start, stop), []).append(int(joint))
            else:
                scattered[start:stop, joint] = True
    for (start, stop), joints in stretches.items():
        yield _finding(take, "lost", joints, start, stop, 1.0, "no numbers")
    yield from _dropout(take, scattered, 1.0, "without numbers")


def _dropout(take: Take, scattered: Array, certainty: float, what: str) -> Iterator[Finding]:
    """All scattered samples as one finding: thousands of lines help nobody."""
    if scattered.any():
        at = np.flatnonzero(scattered.any(axis=1))
        joints = np.flatnonzero(scattered.any(axis=0))
        detail = f"{scattered.sum()} samples ({100 * scattered.mean():.2g} %) {what}"
        yield _finding(take, "dropout", joints, at[0], at[-1] + 1, certainty, detail)


def _finding(
    take: Take, cause: str, joints: Iterable[int], start: int, stop: int, certainty: float, detail: str
) -> Finding:
    indices = tuple(int(joint) for joint in joints)
    names = tuple(take.skeleton.names[joint] for joint in indices)
    return Finding(cause, names, int(start), int(stop), round(float(certainty), 2), detail, indices)


# There, but wrong -----------------------------------------------------------------------------------------


def _judge(take: Take, tracks: list[Track]) -> tuple[list[Finding], Array]:
    """Findings in the numbers that are there, and the mask of those to replace."""
    bad = np.zeros(take.trusted.shape, bool)
    findings: list[Finding] = []
    if not tracks:
        return findings, bad
    everyone = range(len(take.skeleton))
    copied = np.stack([symptoms.copies(track.values) for track in tracks], axis=1)
    still = np.logical_and.reduce(copied, axis=1)
    doubled = np.zeros(len(take), bool)
    for start, stop in symptoms.doubled_stretches(still):
        doubled[start:stop] = True
        detail = f"{100 * still[start:stop].mean():.0f} % of the frames repeat the one before: made from a lower rate"
        findings.append(_finding(take, "held", everyone, start, stop, 0.3, detail))
    if not doubled.any():
        if first := symptoms.calibration_frames(tracks, take.fps):
            detail = f"a pose that the take leaves at once in frame {first}; it is left as it is"
            findings.append(_finding(take, "t-pose", everyone, 0, first, 0.9, detail))
            copied[: first + 1] = False
            for track in tracks:
                track.values[:first] = np.nan
        findings += _noise(take, tracks)
    findings += _held(take, tracks, copied, doubled, bad)
    mended = undisputed = take
    for start, stop, certainty, joints in find_swaps(tracks, take.skeleton.names, take.fps):
        detail = "left and right have each other's values; they can be exchanged back without loss"
        if take.rig is not None and len(joints) <= 2 and _tips(take)[joints].all():
            certainty = min(certainty, UNSURE)  # nothing mixes up two toes and leaves their feet
        swap = _finding(take, "swap", joints, start, stop, certainty, detail)
        findings.append(swap)
        exchange_tracks(tracks, swap.indices, start, stop)
        mended = unswap(mended, swap)
        undisputed = undone(undisputed, swap) if swap.is_undone else undisputed
    accused = bad | _painted(findings, bad.shape)
    for track in tracks:
        track.values[accused[:, track.joint]] = np.nan
    findings += _torn(take, tracks)
    findings = list(_borne_out(mended, findings))
    if take.rig is None:
        findings = _with_disagreements(undisputed, findings, bad)
    return findings, bad | _painted(findings, bad.shape)


def _painted(findings: list[Finding], shape: tuple[int, ...]) -> Array:
    """`(frames, joints)` bool: what the stretches that can be replaced cover."""
    mask = np.zeros(shape, bool)
    for finding in findings:
        if _replaceable(finding):
            mask[finding.start : finding.stop, list(finding.indices)] = True
    return mask


def _replaceable(finding: Finding) -> bool:
    return finding.cause in ROUGHNESS and finding.certainty >= CERTAIN and finding.shift is None


def _held(take: Take, tracks: list[Track], copied: Array, doubled: Array, bad: Array) -> list[Finding]:
    """Frozen tracks, single repeated samples and, where everything froze at once, gaps; marks these two in `bad`.

    What the take does again and again is how it was made: flat keys, a slower sensor. It is told, not replaced.
    """
    frozen = np.zeros(copied.shape, np.float32)  # with what certainty
    every = []
    for number, track in enumerate(tracks):
        for start, stop, certainty in symptoms.held_runs(track.values, take.fps):
            if doubled[start:stop].any():
                continue
            every.append((track.joint, start, stop, certainty))
            frozen[start:stop, number] = certainty
    lively = copied.mean(axis=0) < 0.5
    whole = np.logical_and.reduce(copied[:, lively], axis=1) & (lively.sum() > 1) & ~doubled
    often = OFTEN * len(take) / take.fps / 60
    most = UNSURE if _is_habit(every, often) else 1.0
    stills = []
    for start, stop in runs(whole):
        certainties = frozen[start:stop, lively].max(axis=0)
        # A take that ends, or begins, with a still may be meant so, and so may a long one that few leave at a leap.
        needed = 0.3 if stop - start <= LONG_STILL * take.fps else 0.6
        if (certainties > 0).mean() > 0.3:
            stills.append((start, stop, (certainties >= CERTAIN).mean() > needed))
    rare = sum(sure for _, _, sure in stills) <= max(3, often)
    findings = []
    for start, stop, sure in stills:
        certainty = 0.95 if sure and rare and most == 1 else UNSURE
        bad[start:stop] |= certainty >= CERTAIN
        detail = f"every joint repeats frame {start - 1}"
        findings.append(_finding(take, "gap", range(len(take.skeleton)), start, stop, certainty, detail))
    scattered = np.zeros_like(bad)
    stretches: dict[tuple[int, int], list[tuple[int, float]]] = {}
    for joint, start, stop, certainty in every:
        if whole[start:stop].all():
            continue
        if stop - start < FEW:
            scattered[start:stop, joint] = True
            bad[start:stop, joint] |= min(most, certainty) >= CERTAIN
        else:
            stretches.setdefault((start, stop), []).append((joint, min(most, certainty)))
    for (start, stop), which in stretches.items():
        joints, certainties = zip(*which)
        if max(certainties) >= CERTAIN:
            # Another joint that was frozen in just these frames was frozen with them, though it hardly moved then.
            edges = copied[[start - 1, min(stop, len(copied) - 1)]].any(axis=0)
            alike = np.asarray(copied[start:stop].all(axis=0) & ~edges)
            joints += tuple(track.joint for track, same in zip(tracks, alike) if same)
        detail = f"the value of frame {start - 1} is repeated"
        findings.append(_finding(take, "held", sorted(set(joints)), start, stop, max(certainties), detail))
    return [*findings, *_dropout(take, scattered, min(most, 0.9), "repeat the one before, while the joint moves")]


def _is_habit(every: list[tuple[int, int, int, float]], often: float) -> bool:
    """Whether more stretches than `often` are held, and more than single samples: such is no damage."""
    sure = [(start, stop) for _, start, stop, certainty in every if certainty >= CERTAIN]
    stretches = {(start, stop) for start, stop in sure if stop - start >= FEW}
    return len(stretches) > max(5, often, sum(stop - start < FEW for start, stop in sure))


def _torn(take: Take, tracks: list[Track]) -> Iterator[Finding]:
    """Jumps, displaced stretches and steps, those of several joints in the same frames as one."""
    found: dict[tuple[str, int, int, bool], list[tuple[Track, Tear]]] = {}
    for track in tracks:
        for tear in symptoms.tears(track, take.fps):
            key = tear.cause, tear.start, tear.stop, tear.certainty >= CERTAIN
            found.setdefault(key, []).append((track, tear))
    words = {"jump": "out and back by {}", "displaced": "off by about {}", "step": "a step of {} that is not undone"}
    for (cause, start, stop, _), which in found.items():
        joints = sorted({track.joint for track, _ in which})
        certainty = max(tear.certainty for _, tear in which)
        if take.rig is None and len(which) > FEW and np.median([tear.size for _, tear in which]) < SMALL_SHIFT:
            certainty = min(certainty, UNSURE)  # no marker's damage: a hand, or the whole body, may have moved so
        track, tear = which[0]
        detail = words[cause].format(track.describe(tear.size))
        yield _finding(take, "jump" if cause == "step" else cause, joints, start, stop, certainty, detail)


def _noise(take: Take, tracks: list[Track]) -> Iterator[Finding]:
    """A level, told and never mended unasked."""
    for turns, least, unit in ((False, 0.0015, 1000.0), (True, np.radians(0.75), np.degrees(1.0))):
        levels = {track.joint: symptoms.noise_level(track.values) for track in tracks if track.turns == turns}
        noisy = [joint for joint, level in levels.items() if level > least]
        if noisy:
            level = np.median([levels[joint] for joint in noisy]) * unit
            detail = f"about {level:.1f} {'°' if turns else 'mm'} an axis, from frame to frame"
            yield _finding(take, "noise", sorted(noisy), 0, len(take), 0.8, detail)


# What hangs below -----------------------------------------------------------------------------------------


def _borne_out(take: Take, findings: list[Finding]) -> Iterator[Finding]:
    """The findings; what the world does not bear out is only told.

    Solvers let hips jump and legs jump back by as much: nothing shows, and hips mended alone would throw the feet.
    """
    limits = {(joint, f.start, f.stop): ROUGHNESS[f.cause] for f in findings if _replaceable(f) for joint in f.indices}
    if take.rig is None:
        excused = compensation.excused_points(take.motion, limits)
    else:
        excused = compensation.excused(take.rig, take.fps, limits)
    for found in findings:
        where = found.start, found.stop
        harmless = [joint for joint in found.indices if _replaceable(found) and (joint, *where) in excused]
        guilty = [joint for joint in found.indices if joint not in harmless]
        if guilty:
            yield _finding(take, found.cause, guilty, *where, found.certainty, found.detail)
        if harmless:
            why = f"{found.detail}, but the movement would be no smoother without it"
            yield _finding(take, found.cause, harmless, *where, 0.4, why)


# Against the other joints ---------------------------------------------------------------------------------


def _with_disagreements(take: Take, findings: list[Finding], bad: Array) -> list[Finding]:
    """The findings, and those of joints that disagree with the others, which know more of displaced stretches."""
    known = bad | _painted([finding for finding in findings if finding.cause != "displaced"], bad.shape)
    for seen in disagreements(replace(take.motion, observed=take.motion.observed & ~known)):
        new = replace(_finding(take, *seen.found), shift=seen.shift)
        same = [old for old in findings if _is_same(old, new)]
        if new.certainty < CERTAIN and same:
            continue  # told already, or certain by its seams
        findings = [old for old in findings if old not in same]
        for old in same:
            others = [joint for joint in old.indices if joint not in new.indices]
            if others and old.cause == "displaced":
                findings.append(_finding(take, old.cause, others, old.start, old.stop, old.certainty, old.detail))
        findings.append(new)
    return findings


def _is_same(old: Finding, new: Finding) -> bool:
    """Whether two findings speak of the same joints' places at the same time; a sure jump is one for itself."""
    sure = old.certainty >= CERTAIN
    if old.cause != "displaced" and (sure or old.cause not in ("jump", "swap")):
        return False
    both = min(old.stop, new.stop + FEW) - max(old.start, new.start - FEW)
    least = 0.5 * (old.stop - old.start) if sure else 0.0
    return both > least and not set(old.indices).isdisjoint(new.indices)
