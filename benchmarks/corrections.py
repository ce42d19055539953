"""How well displaced joints are found and put right, and how often good samples are accused. Prints Markdown tables.

    python benchmarks/corrections.py --data DIR [--split validation]

Every take's joints are points here, with bones and without channels, as joint centres are exported. DIR is that of
`diagnosis.py`, of which this is the sequel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import diagnosis
import numpy as np
from diagnosis import accused, asked, overlap
from shared import cmu_trials, other_packs

import motionmend.io as io
from motionmend.body.mapping import Mapping, map_rig
from motionmend.damage.planting import mirrored_pairs, plant
from motionmend.diagnosis.diagnosing import diagnose
from motionmend.diagnosis.findings import CERTAIN, Diagnosis
from motionmend.motion import Motion, Skeleton, Take
from motionmend.repairs.repairing import repair

Array = np.ndarray

LONGEST = 0.45  # share of a take that is damaged at most
RAMP = 0.1  # seconds


@dataclass(frozen=True)
class Case:
    """Damage of one kind.

    what : "limb" (an arm, a leg or a hand, drawn anew each time, with all that hangs on it), "joint" or "swap".
    where : "inside", "ramped", or "end": it begins with the take, or ends with it. mm : the offset's length, or
    the shortest and the longest. noise : metres an axis, on all samples.
    """

    what: str
    where: str
    seconds: float
    mm: tuple[int, int] = (0, 0)
    noise: float = 0.0

    def __str__(self) -> str:
        what = {"limb": "limb", "joint": "one joint", "swap": "swap of a limb"}[self.what]
        where = {"inside": "", "ramped": ", grows and fades", "end": ", to an end of the take"}[self.where]
        noise = f", {1000 * self.noise:g} mm noise" if self.noise else ""
        low, high = self.mm
        size = "–" if not high else f"{low} mm" if low == high else f"{low}–{high} mm"
        return f"| {what}{where}{noise} | {self.seconds:g} s | {size} "


SIZES = ((50, 50), (100, 100), (200, 200), (500, 1000))
CASES = (
    *(Case("limb", "inside", seconds, mm) for seconds in (0.3, 0.9, 3.0) for mm in SIZES),
    *(Case("limb", "ramped", seconds, mm) for seconds in (0.3, 0.9, 3.0) for mm in SIZES),
    *(Case("limb", "end", seconds, mm) for seconds in (0.3, 0.9, 3.0) for mm in SIZES),
    *(Case("joint", "inside", seconds, mm) for seconds in (0.3, 0.9, 3.0) for mm in SIZES[:3]),
    *(Case("swap", "end", seconds) for seconds in (0.3, 0.9)),
    *(Case("limb", "inside", 0.9, mm, noise) for noise in (0.002, 0.005) for mm in SIZES[1:3]),
)


@dataclass
class Score(diagnosis.Score):
    """before, after : sums of the planted pieces' mean errors, mm."""

    before: float = 0.0
    after: float = 0.0

    def row(self) -> str:
        errors = [f"{total / max(self.planted, 1):.0f}" for total in (self.before, self.after)]
        return " | ".join([*self.shares(), *errors])


def as_points(take: Take, cloud: bool = False) -> Take:
    """The joints' positions, without channels; as a cloud, without bones too, which names must then tell."""
    skeleton = Skeleton.cloud(take.skeleton.names) if cloud else take.skeleton
    motion = Motion(take.motion.positions, np.ones_like(take.motion.observed), take.fps, skeleton)
    return Take(motion, None, None, take.units, "npz", take.source)


def below(parents: tuple[int, ...], top: int) -> list[int]:
    joints = [top]
    for joint, parent in enumerate(parents):
        if parent in joints:
            joints.append(joint)
    return joints


def damaged(take: Take, mapping: Mapping, parents: tuple[int, ...], case: Case, rng: np.random.Generator):
    """The take with one piece of damage, and `(frames, joints)` bool where it is; None where it cannot be had."""
    frames, count = len(take), max(1, round(case.seconds * take.fps))
    margin = round(0.1 * take.fps) + 2
    if count > LONGEST * frames or frames < count + 2 * margin + 1:
        return None
    start = int(rng.integers(margin, frames - margin - count))
    if case.where == "end":
        start = int(rng.choice([0, frames - count]))
    stop = start + count
    found = mapping.found
    tops = {
        "limb": ("left_upper_arm", "right_upper_arm", "left_thigh", "right_thigh", "left_hand", "right_hand"),
        "joint": tuple(name for name in found if name not in ("hips", "spine", "chest", "neck")),
        "swap": ("left_upper_arm", "left_forearm", "left_thigh", "left_shin"),
    }[case.what]
    top = found.get(str(rng.choice(tops)))
    offset, size = rng.normal(size=3), rng.uniform(*case.mm) / 1000
    if top is None:
        return None
    which = [top] if case.what == "joint" else below(parents, top)
    mask = np.zeros(take.trusted.shape, bool)
    noisy = plant(take, noise=case.noise, seed=int(rng.integers(2**31))) if case.noise else take
    if case.what == "swap":
        twins = {joint: twin for pair in mirrored_pairs(take.skeleton.names) for joint, twin in (pair, pair[::-1])}
        if not all(joint in twins for joint in which):
            return None
        mask[start:stop, [*which, *(twins[joint] for joint in which)]] = True
        return plant(noisy, swap=[(which, start, stop)]), mask
    weights = np.zeros(frames)
    weights[start:stop] = 1.0
    if case.where == "ramped":
        ramp = RAMP * take.fps
        weights[start:stop] = np.minimum(1, np.minimum(np.arange(1, count + 1), np.arange(count, 0, -1)) / ramp)
    positions = noisy.motion.positions.copy()
    moved = weights[:, None, None] * (size * offset / np.linalg.norm(offset))
    positions[:, which] += moved.astype(np.float32)
    mask[start:stop, which] = True
    return noisy.with_motion(replace(noisy.motion, positions=positions)), mask


def add(score: Score, take: Take, clean: Diagnosis, case: Case, broken: Take, mask: Array) -> None:
    seen = diagnose(broken)
    causes = {"swap"} if case.what == "swap" else {"displaced", "jump"}
    at = np.flatnonzero(mask.any(axis=1))
    where = (int(at[0]), int(at[-1]) + 1)
    sure = [f for f in seen.findings if f.certainty >= CERTAIN and f.cause in ("displaced", "jump", "swap", "held")]
    known = {(f.cause, f.start, f.stop) for f in clean.findings}
    fresh = [f for f in sure if (f.cause, f.start, f.stop) not in known]
    hit = [f for f in fresh if mask[f.start : f.stop, list(f.indices)].any()]
    score.planted += 1
    score.found += any(f.cause in causes and overlap(where, (f.start, f.stop)) >= 0.5 for f in hit)
    score.flagged += len(fresh)
    score.right += len(hit)
    flagged = accused(seen) & ~accused(clean)
    score.samples += int(mask.sum())
    score.samples_found += int((mask & flagged).sum())
    score.samples_flagged += int(flagged.sum())
    score.samples_right += int((flagged & mask).sum())
    mended = repair(broken, find=True)
    for name, one in (("before", broken), ("after", mended)):
        off = np.linalg.norm(one.motion.positions - take.motion.positions, axis=-1)
        setattr(score, name, getattr(score, name) + 1000 * float(off[mask].mean()))


def print_found(files: list[tuple[Path, float]], seed: int, cloud: bool) -> None:
    scores = [Score() for _ in CASES]
    rng = np.random.default_rng(seed)
    for path, fps in files:
        loaded = io.load(path, fps=fps)
        mapping = map_rig(loaded.skeleton, loaded.motion.positions)
        take = as_points(loaded, cloud)
        clean = diagnose(take)
        for case, score in zip(CASES, scores):
            # Few takes are long enough for the longest: these bear several, one after the other.
            for _ in range(min(4, max(1, int(LONGEST * len(take) / take.fps / case.seconds)))):
                if planted := damaged(take, mapping, loaded.skeleton.parents, case, rng):
                    add(score, take, clean, case, *planted)
                if case.seconds < 3:
                    break
    print("\n| damage | length | offset | planted | found % | right % ", end="")
    print("| samples found % | samples right % | error before, mm | after, mm |")
    print("|---|---|---|--:|--:|--:|--:|--:|--:|--:|")
    for case, score in zip(CASES, scores):
        print(f"{case}| {score.row()} |")


def print_false_alarms(name: str, files: Sequence[tuple[Path, float | None]]) -> None:
    flagged, samples = {False: 0, True: 0}, 0
    for path, fps in files:
        loaded = io.load(path, fps=fps)
        samples += loaded.trusted.size
        for cloud in flagged:
            flagged[cloud] += int(accused(diagnose(as_points(loaded, cloud))).sum())
    shares = " | ".join(f"{100 * count / max(samples, 1):.4f}" for count in flagged.values())
    print(f"| {name} | {len(files)} | {samples:,} | {shares} |", flush=True)


def main() -> None:
    options, files = asked(
        __doc__, cloud="leave the bones out of the takes; names tell them", quick="leave out the false alarms"
    )
    print_found(files, options.seed, options.cloud)
    if options.quick:
        return
    print("\n### False alarms: samples of takes as published that would be changed\n")
    print("| takes | number | samples | joints with bones % | points without % |\n|---|--:|--:|--:|--:|")
    print_false_alarms(f"CMU {options.split}", [*files])
    print_false_alarms("CMU train, every 5th", list(cmu_trials(options.data, "train", table=options.csv))[::5])
    for name, found in other_packs(options.data):
        step = 20 if len(found) > 200 else 1
        print_false_alarms(f"{name}, every {step}th" if step > 1 else name, found[::step])


if __name__ == "__main__":
    main()
