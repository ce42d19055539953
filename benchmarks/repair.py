"""Repairs from file to file beside an independent fill: how far off, and what else of the file changed. Markdown.

    python benchmarks/repair.py --data DIR [--split test] [--seed 1]

DIR holds `cmu.csv` (one row a trial: file, fps, split) and the folder `cmu`. From every trial of the split a stretch of
0.1 to 0.9 s is taken out, of the whole body, an arm or a leg: the channels are overwritten with nonsense and
written to a BVH file (AMC trials are first converted), the file is read and repaired with the stretch named, and
the result written and read again. Errors are mean distances of the joints that hang on the lost channels, in the
lost frames. Beside them: SciPy's CubicHermiteSpline and a straight line on the joints' positions.
"""

from __future__ import annotations

import platform
import tempfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from shared import cmu_trials, options

import motionmend as mm
from motionmend.body.joints import LIMBS
from motionmend.body.mapping import map_rig
from motionmend.constraints.checks import affected_by

SECONDS = (0.1, 0.3, 0.5, 0.7, 0.9)
KINDS = ["body", "arm", "leg"]
MARGIN = 0.15  # seconds of good motion on both sides
VELOCITY_FRAMES = 4


def parts(take: mm.Take) -> dict[str, list[list[int]]]:
    """What is lost: kind → choices of joints."""
    joints = map_rig(take.skeleton, take.motion.positions).joints
    found: dict[str, list[list[int]]] = {"body": [list(range(len(take.skeleton)))], "arm": [], "leg": []}
    for name, limb in LIMBS.items():
        lost = {joints[each] for each in limb if joints[each] >= 0}
        for joint, parent in enumerate(take.skeleton.parents):
            if parent in lost:
                lost.add(joint)
        found[name.split("_")[-1]].append(sorted(lost))
    return found


def spoil(take: mm.Take, mask: np.ndarray, rng: np.random.Generator) -> mm.Take:
    turns = rng.normal(size=(*mask.shape, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    shifts = take.rig.translations.copy()
    shifts[:, 0] += np.where(mask[:, :1], rng.normal(size=(len(take), 3)), 0)
    turning = mask & np.array([bool(order) for order in take.rig.orders])
    return take.with_rig(
        replace(take.rig, rotations=np.where(turning[..., None], turns, take.rig.rotations), translations=shifts)
    )


def by_scipy(points: np.ndarray, start: int, stop: int) -> np.ndarray:
    points = points.astype(float)
    enter = np.diff(points[start - VELOCITY_FRAMES : start], axis=0).mean(axis=0)
    leave = np.diff(points[stop : stop + VELOCITY_FRAMES], axis=0).mean(axis=0)
    spline = CubicHermiteSpline([start - 1, stop], points[[start - 1, stop]], [enter, leave])
    return spline(np.arange(start, stop))


def by_line(points: np.ndarray, start: int, stop: int) -> np.ndarray:
    share = (np.arange(start, stop) - start + 1)[:, None, None] / (stop - start + 1)
    return points[start - 1] * (1 - share) + points[stop] * share


def changed_lines(before: Path, after: Path) -> set[int]:
    old, new = before.read_bytes().splitlines(keepends=True), after.read_bytes().splitlines(keepends=True)
    assert len(old) == len(new)
    first = next(number for number, line in enumerate(old) if line.strip().lower().startswith(b"frame time")) + 1
    return {number - first for number, (a, b) in enumerate(zip(old, new)) if a != b}


def main() -> None:
    told = options(__doc__, data=Path, split="test", seed=1)
    rng = np.random.default_rng(told.seed)
    errors: dict[tuple[str, float], list[list[float]]] = defaultdict(list)
    worst_written, outside, files = 0.0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        good, bad, fixed_path = (Path(folder) / f"{name}.bvh" for name in ("good", "bad", "fixed"))
        for path, fps in cmu_trials(told.data, told.split):
            take = mm.load(path, fps=fps)
            if path.suffix == ".amc":
                mm.save(take, good, force=True)
            else:
                good.write_bytes(path.read_bytes())
            take = mm.load(good, fps=fps)
            files += 1
            margin = round(MARGIN * fps)
            for seconds in SECONDS:
                length = round(seconds * fps)
                if len(take) < length + 2 * margin + 2:
                    continue
                for kind, choices in parts(take).items():
                    start = int(rng.integers(margin + 1, len(take) - length - margin))
                    stop, lost = start + length, choices[rng.integers(len(choices))]
                    mask = np.zeros(take.trusted.shape, bool)
                    mask[start:stop, lost] = True
                    mm.save(spoil(take, mask, rng), bad, force=True)
                    broken = mm.load(bad, fps=fps, unit=take.units.why.split()[0], up=take.units.up)
                    names = [take.skeleton.names[joint] for joint in lost]
                    fixed = mm.repair(broken, lost=[(names, start, stop)], method="hermite")
                    chosen = mm.repair(broken, lost=[(names, start, stop)], method="auto")
                    mm.save(fixed, fixed_path, force=True)
                    again = mm.load(fixed_path, fps=fps, unit=take.units.why.split()[0], up=take.units.up)

                    hit = affected_by(take, mask)[start:stop]
                    truth = take.motion.positions
                    guesses = {
                        "line": by_line(truth, start, stop),
                        "SciPy Hermite": by_scipy(truth, start, stop),
                        "hermite": fixed.motion.positions[start:stop],
                        "hermite, file": again.motion.positions[start:stop],
                        "auto": chosen.motion.positions[start:stop],
                    }
                    apart = {
                        name: 1000 * np.linalg.norm(guess - truth[start:stop], axis=-1)[hit].mean()
                        for name, guess in guesses.items()
                    }
                    errors[kind, seconds].append(list(apart.values()))
                    worst_written = max(worst_written, abs(apart["hermite, file"] - apart["hermite"]))
                    outside += len(changed_lines(bad, fixed_path) - set(range(start, stop)))
                    outside += len(changed_lines(good, fixed_path) - set(range(start, stop)))

    head = ("lost", "seconds", "takes", "line", "SciPy Hermite", "hermite", "its file", "auto", "hermite / SciPy")
    print("| " + " | ".join(head) + " |")
    print("|---|---|---|---|---|---|---|---|---|")
    for (kind, seconds), rows in sorted(errors.items(), key=lambda item: (KINDS.index(item[0][0]), item[0])):
        mean = np.mean(rows, axis=0)
        cells = " | ".join(f"{value:.2f}" for value in mean)
        print(f"| {kind} | {seconds} | {len(rows)} | {cells} | {mean[2] / mean[1]:.3f} |")
    print(
        f"\nMean error in mm. CMU {told.split} split, {files} takes, seed {told.seed}; "
        f"{platform.machine()}, Python {platform.python_version()}, motionmend {mm.__version__}.\n"
        f"Lines of the files that changed outside the repaired frames: {outside}. "
        f"Largest difference between a gap's error in memory and in its written file: {worst_written:.5f} mm."
    )


if __name__ == "__main__":
    main()
