"""How well planted damage is found, and how often good samples are accused. Prints Markdown tables.

    python benchmarks/diagnosis.py --data DIR [--split validation]

DIR holds `cmu.csv` (one row a trial: file, fps, split) and the folder `cmu`; `reactidle` and `bandai-namco-2`
beside it are measured for false alarms too.
"""

from __future__ import annotations

import argparse
import os
import platform
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from shared import cmu_trials, other_packs, parser

import motionmend.io as io
from motionmend.damage.planting import Truth, mirrored_pairs, plant_and_tell
from motionmend.diagnosis.diagnosing import diagnose
from motionmend.diagnosis.findings import CERTAIN, Diagnosis
from motionmend.motion import Motion, Skeleton, Take
from motionmend.rotations import IDENTITY

Array = np.ndarray

# Causes by which a planted one may rightly be called: a file of channels cannot say "lost", it repeats values.
ALSO = {
    "lost": {"lost", "held", "gap"},
    "held": {"held", "gap", "dropout"},
    "gap": {"gap"},
    "dropout": {"dropout", "held", "lost"},
    "jump": {"jump"},
    "displaced": {"displaced"},
    "swap": {"swap"},
    "noise": {"noise"},
    "t-pose": {"t-pose"},
}


@dataclass(frozen=True)
class Case:
    """One kind of damage at one length and strength. seconds : its length; 0 is one frame."""

    cause: str
    seconds: float = 0.0
    size: float = 0.0
    turn: float = 0.0  # degrees, the size where the take stores channels
    said: str = ""


CASES = (
    *(Case("gap", seconds) for seconds in (0.1, 0.5)),
    *(Case("lost", seconds) for seconds in (0.1, 0.5)),
    *(Case("held", seconds) for seconds in (0.05, 0.1, 0.5)),
    *(Case("dropout", size=share, said=f"{share:.0%}") for share in (0.02, 0.1)),
    *(Case("jump", seconds, 0.001 * mm, turn) for seconds in (0.0, 0.025) for mm, turn in ((30, 10), (100, 30))),
    *(Case("displaced", seconds, 0.001 * mm, turn) for seconds in (0.2, 0.5) for mm, turn in ((50, 15), (150, 45))),
    *(Case("swap", seconds) for seconds in (0.1, 0.5)),
    *(Case("noise", size=0.001 * mm, said=f"{mm} mm") for mm in (2, 5)),
    Case("t-pose"),
)


@dataclass
class Score:
    planted: int = 0
    found: int = 0
    flagged: int = 0
    right: int = 0
    samples: int = 0
    samples_found: int = 0
    samples_flagged: int = 0
    samples_right: int = 0
    edges: int = 0
    edges_left: int = 0

    def shares(self) -> list[str]:
        """How many were planted, and per cent: found, right, samples found, samples right."""
        parts = (
            (self.found, self.planted), (self.right, self.flagged), (self.samples_found, self.samples),
            (self.samples_right, self.samples_flagged),
        )  # fmt: skip
        return [str(self.planted), *(share(*each) for each in parts)]

    def row(self) -> str:
        return " | ".join([*self.shares(), share(self.edges_left, self.edges)])


def share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f}" if whole else "–"


def as_points(take: Take) -> Take:
    """The joints' positions as a cloud of markers without bones or channels."""
    motion = Motion(
        take.motion.positions, np.ones_like(take.motion.observed), take.fps, Skeleton.cloud(take.skeleton.names)
    )
    return Take(motion, None, None, take.units, "npz", take.source)


def lively(take: Take) -> Array:
    """Indices of the joints that move by more than rounding in this take."""
    if take.rig is None:
        moves = np.ptp(take.motion.positions, axis=0).max(axis=-1) > 0.02
    else:
        moves = np.ptp(take.rig.rotations, axis=0).max(axis=-1) > 0.02
    return np.flatnonzero(moves)


def damaged(take: Take, case: Case, rng: np.random.Generator) -> tuple[Take, Truth] | None:
    """One piece of damage at a random place, away from the ends; None where the take is too short for it."""
    frames = max(1, round(case.seconds * take.fps))
    margin = round(0.1 * take.fps) + 2
    if len(take) < frames + 2 * margin + 1:
        return None
    start = int(rng.integers(margin, len(take) - margin - frames))
    stretch = (start, start + frames)
    joints = lively(take)
    if case.cause == "lost":  # a limb: two or three joints that follow one another
        first = int(rng.integers(0, len(joints) - 2))
        which = joints[first : first + 3].tolist()
    elif case.cause == "swap":
        pairs = [pair for pair in mirrored_pairs(take.skeleton.names) if set(pair) <= set(joints.tolist())]
        if not pairs:
            return None
        first = int(rng.integers(0, max(1, len(pairs) - 2)))
        which = [joint for pair in pairs[first : first + 3] for joint in pair]
    else:
        which = [int(rng.choice(joints))]
    size = case.size if take.rig is None else np.radians(case.turn)
    seed = int(rng.integers(2**31))
    some = [(which, *stretch)]
    match case.cause:
        case "gap":
            return plant_and_tell(take, gaps=[stretch], seed=seed)
        case "lost":
            return plant_and_tell(take, lost=some, seed=seed)
        case "held":
            return plant_and_tell(take, held=some, seed=seed)
        case "jump":
            return plant_and_tell(take, jump=some, size=size, seed=seed)
        case "displaced":
            return plant_and_tell(take, displaced=some, size=size, seed=seed)
        case "swap":
            return plant_and_tell(take, swap=some, seed=seed)
        case "dropout":
            return plant_and_tell(take, dropout=case.size, seed=seed)
        case "noise":
            return plant_and_tell(take, noise=case.size, seed=seed)
    return None


def with_rest_pose(take: Take) -> Take:
    """The take with the rig's rest pose as its first frame, as converters put it there."""
    assert take.rig is not None
    rotations = take.rig.rotations.copy()
    rotations[0] = IDENTITY
    return take.with_rig(replace(take.rig, rotations=rotations))


def really_changed(before: Take, after: Take, mask: Array) -> Array:
    """Where `mask` is True and the numbers differ: to hold a joint that rests damages nothing."""
    if before.rig is None or after.rig is None:
        differ = ~np.isclose(before.motion.positions, after.motion.positions, rtol=0, atol=1e-5).all(axis=-1)
        return mask & differ
    turned = 1 - np.abs(np.sum(before.rig.rotations * after.rig.rotations, axis=-1)) > 1e-12
    shifted = np.abs(before.rig.translations - after.rig.translations).max(axis=-1) > 1e-7
    return mask & (turned | shifted)


def painted(diagnosis: Diagnosis, causes: set[str], shape: tuple[int, ...]) -> Array:
    mask = np.zeros(shape, bool)
    for finding in diagnosis.findings:
        if finding.cause in causes and finding.certainty >= 0.5:
            mask[finding.start : finding.stop, list(finding.indices)] = True
    return mask


def accused(diagnosis: Diagnosis) -> Array:
    """`(frames, joints)` bool: what a repair would fill, exchange or move back."""
    mask = diagnosis.untrusted.copy()
    for finding in diagnosis.findings:
        if finding.is_undone:
            mask[finding.start : finding.stop, list(finding.indices)] = True
    return mask


def overlap(a: tuple[int, int], b: tuple[int, int]) -> float:
    both = min(a[1], b[1]) - max(a[0], b[0])
    return max(0, both) / (a[1] - a[0] + b[1] - b[0] - max(0, both))


def add(score: Score, take: Take, clean: Diagnosis, case: Case, broken: Take, truth: Truth) -> None:
    changed = really_changed(take, broken, truth.masks.get(case.cause, truth.mask))
    if not changed.any():
        return
    seen = diagnose(broken)
    causes = ALSO[case.cause]
    score.planted += 1
    at = np.flatnonzero(changed.any(axis=1))
    where = (int(at[0]), int(at[-1]) + 1)
    hit = [f for f in seen.findings if f.cause in causes and changed[f.start : f.stop, list(f.indices)].any()]
    score.found += any(overlap(where, (f.start, f.stop)) >= 0.5 for f in hit)
    known = {(f.cause, f.start, f.stop, joint) for f in clean.findings for joint in f.indices}
    fresh = [
        f
        for f in seen.findings
        if f.cause in causes
        and f.certainty >= CERTAIN
        and any((f.cause, f.start, f.stop, joint) not in known for joint in f.indices)
    ]
    score.flagged += len(fresh)
    score.right += sum(bool(changed[f.start : f.stop, list(f.indices)].any()) for f in fresh)
    if case.cause == "noise":  # told, never replaced
        return
    if case.cause == "swap":
        flagged = painted(seen, causes, changed.shape) & ~painted(clean, causes, changed.shape)
    else:
        flagged = accused(seen) & ~accused(clean)
    score.samples += int(changed.sum())
    score.samples_found += int((changed & (flagged | clean.untrusted)).sum())
    score.samples_flagged += int(flagged.sum())
    score.samples_right += int((flagged & truth.mask).sum())
    if case.cause != "dropout":
        add_edges(score, changed, flagged | clean.untrusted)


def add_edges(score: Score, changed: Array, flagged: Array) -> None:
    """Of the joints whose damage was found: how often its first or last sample is still trusted."""
    for joint in np.flatnonzero(changed.any(axis=0)):
        damaged = flagged[changed[:, joint], joint]
        if damaged.mean() >= 0.5:
            score.edges += 2
            score.edges_left += int(not damaged[0]) + int(not damaged[-1])


def add_first_frame(score: Score, clean: Diagnosis, broken: Take) -> None:
    if any(f.cause == "t-pose" for f in clean.findings):  # has one already
        return
    seen = diagnose(broken)
    told = [f for f in seen.findings if f.cause == "t-pose"]
    score.planted += 1
    score.found += bool(told)
    score.flagged += len(told)
    score.right += sum(f.stop == 1 for f in told)


def both_kinds(path: Path, fps: float | None = None) -> tuple[tuple[str, Take], ...]:
    take = io.load(path, fps=fps)
    return ("channels", take), ("points", as_points(take))


def print_found(files: list[tuple[Path, float]], seed: int) -> None:
    scores = {kind: [Score() for _ in CASES] for kind in ("channels", "points")}
    rng = np.random.default_rng(seed)
    for path, fps in files:
        kinds = both_kinds(path, fps)
        rest = with_rest_pose(kinds[0][1])
        for (kind, take), posed in zip(kinds, (rest, as_points(rest))):
            clean = diagnose(take)
            for case, score in zip(CASES, scores[kind]):
                if case.cause == "t-pose":
                    add_first_frame(score, clean, posed)
                elif planted := damaged(take, case, rng):
                    add(score, take, clean, case, *planted)
    for kind, unit in (("channels", "°"), ("points", "mm")):
        print(f"\n### Planted in {kind}\n")
        print("| cause | length | size | planted | found % | right % ", end="")
        print("| samples found % | samples right % | edges left % |")
        print("|---|---|---|--:|--:|--:|--:|--:|--:|")
        for case, score in zip(CASES, scores[kind]):
            length = f"{case.seconds:g} s" if case.seconds else "1 frame" if case.cause in ("jump", "t-pose") else "–"
            strength = case.turn if kind == "channels" else 1000 * case.size
            size = case.said or (f"{strength:g} {unit}" if case.turn else "–")
            print(f"| {case.cause} | {length} | {size} | {score.row()} |")


def print_false_alarms(name: str, files: list[tuple[Path, float | None]]) -> None:
    flagged, samples, takes = {"channels": 0, "points": 0}, {"channels": 0, "points": 0}, 0
    for path, fps in files:
        takes += 1
        for kind, take in both_kinds(path, fps):
            flagged[kind] += int(accused(diagnose(take)).sum())
            samples[kind] += take.trusted.size
    shares = [f"{100 * flagged[kind] / samples[kind]:.4f}" for kind in flagged]
    print(f"| {name} | {takes} | {samples['points']:,} | {' | '.join(shares)} |", flush=True)


def asked(
    doc: str | None, **switches: str
) -> tuple[argparse.Namespace, list[tuple[Path, float | None]]]:
    """The command line, with `switches` by name and what their help says, and the takes of its split; says which."""
    line = parser(doc, data=Path, split="validation", every=1, seed=1)
    line.add_argument("--csv", type=Path, help="the table of trials (default: DIR/cmu.csv)")
    for name, told in switches.items():
        line.add_argument(f"--{name}", action="store_true", help=told)
    options = line.parse_args()
    files = list(cmu_trials(options.data, options.split, table=options.csv))[:: options.every]
    print(f"Seed {options.seed}, CMU {options.split} ({len(files)} takes); NumPy {np.__version__}, ", end="")
    print(f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores.")
    return options, files


def main() -> None:
    options, files = asked(__doc__, quick="leave out the false alarms on all other takes")
    print_found(files, options.seed)
    print("\n### False alarms: samples of takes as published that would be replaced\n")
    print("| takes | number | samples | channels % | points % |\n|---|--:|--:|--:|--:|")
    print_false_alarms(f"CMU {options.split}", list(files))
    if not options.quick:
        print_false_alarms("CMU train", list(cmu_trials(options.data, "train", table=options.csv)))
        for pack, found in other_packs(options.data):
            print_false_alarms(pack, found)


if __name__ == "__main__":
    main()
