"""Every fill on real markers that are hidden, and on markers made on bodies. Prints Markdown tables, mean errors in mm.

    python benchmarks/markers.py --data DIR [--people s06 s07] [--subjects 06 16] [--seed 0] [--every 1] [--per-take 4]
    python benchmarks/markers.py --data DIR --speed
    python benchmarks/markers.py --data DIR --fragments

DIR holds `markers` (UI-PRMD, TRC, one folder a person), `cmu`, `free-motion` and `free-motion.csv`. In each take one
marker is hidden, or three or six that are near each other, five anywhere, or half of all (those nearest to one), so
many times for each length; every method mends the same holes. No take of UI-PRMD is long enough for five seconds.
"Moving" are the holes in which the hidden markers move by 0.2 m/s or more on average. Markers are made as in
`fills.py`, two on each bone, with drift and jitter. "auto before" is `auto` without the fills that learn. `--speed`
prints instead the CPU seconds of each method for 60 markers, 60 s at 120 Hz, with 200 gaps of 0.1 to 1.5 s.
`--fragments` prints how many pieces of lost markers, left as tracks without a label, `repair --join` would join rightly
and wrongly: of one, three or eight markers that are near each other, lost at overlapping times, and of a lost marker's
nearest neighbour that nobody has labelled at all, and of tracks that run beside a lost marker, where every join is
wrong.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shared
from fills import takes, with_markers

import motionmend.io as io
from motionmend.fills import auto
from motionmend.fills.auto import Auto
from motionmend.fills.points import FILLS
from motionmend.motion import Motion, Skeleton
from motionmend.repairs.fragments import fragments

Array = np.ndarray
Trial = tuple[Motion, Array, int, int]  # the whole take, which markers are hidden, and from where to where

METHODS = ("linear", "eased", "pattern", "rigid", "local", "regression", "pca", "average", "before", "auto")
LOST = {"one": 1, "three near": 3, "five anywhere": 5, "six near": 6, "half": 0}
BEFORE = {0: ((np.inf, "eased"),), 1: ((np.inf, "pattern"),), 3: ((np.inf, "rigid"),)}
MOVING = 0.2  # m/s
LOW = ("crawl", "falling_down", "lying", "roll")  # in the names of takes near the floor
CONTEXT = 10  # frames, at least, beside a hole


@dataclass(frozen=True)
class Before(Auto):
    """`auto` without the fills that learn: for marker clouds the table and the trials that it had."""

    def complete(self, motion: Motion) -> Motion:
        tables = auto.WINNERS, auto.TRIED
        auto.WINNERS, auto.TRIED = {**tables[0], "markers": BEFORE, "many markers": BEFORE}, {}
        try:
            return super().complete(motion)
        finally:
            auto.WINNERS, auto.TRIED = tables


def fill(name: str):
    return {"auto": Auto(), "before": Before()}.get(name) or FILLS[name]


def real(data: Path, people: list[str], every: int) -> list[Motion]:
    """UI-PRMD's takes of these people."""
    paths = [path for who in people for path in sorted((data / "markers").rglob(f"{who}/*.trc"))]
    return [io.load(path).motion for path in paths[::every]]


def made(data: Path, subjects: list[str], every: int, seed: int) -> list[Motion]:
    """Markers made on CMU's takes of these subjects."""
    random = np.random.default_rng(seed)
    return [with_markers(rig, fps, 2, random)[0] for _, rig, fps in takes(data / "cmu", subjects)[::every]]


def crawling(data: Path, seed: int) -> list[Motion]:
    """Markers made on the free pack's takes that crawl, lie down and get up, or fall."""
    random, found = np.random.default_rng(seed), []
    with (data / "free-motion.csv").open(newline="") as file:
        takes = [(data / "free-motion" / row["file"], float(row["fps"])) for row in csv.DictReader(file)]
    for path, fps in takes:
        if any(word in path.stem.lower() for word in LOW) and path.is_file():
            take = io.load(path, fps=fps)
            assert take.rig is not None
            found.append(with_markers(take.rig, fps, 2, random)[0])
    return found


def near(motion: Motion, marker: int, number: int) -> Array:
    """The `number` markers that are on average nearest to one, itself among them."""
    points = np.where(motion.observed[..., None], motion.positions, np.nan)
    apart = np.linalg.norm(points - points[:, marker : marker + 1], axis=-1)
    there = np.isfinite(apart)
    mean = np.where(there, apart, 0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    return np.argsort(np.where(there.any(axis=0), mean, np.inf), kind="stable")[:number]


def trials(motions: list[Motion], lost: str, seconds: float, seed: int, per_take: int) -> Iterator[Trial]:
    random = np.random.default_rng([seed, round(1000 * seconds), *lost.encode()])
    for motion in motions:
        length, markers = round(seconds * motion.fps), len(motion.skeleton)
        for _ in range(per_take):
            first, anywhere = int(random.integers(markers)), random.permutation(markers)
            start = int(random.integers(CONTEXT, max(CONTEXT + 1, len(motion) - length - CONTEXT)))
            if start + length + CONTEXT > len(motion):
                continue
            number = LOST[lost] or markers // 2
            gone = anywhere[:number] if "anywhere" in lost else near(motion, first, number)
            if motion.observed[start - 1 : start + length + 1, gone].all():
                yield motion, gone, start, start + length


def errors(trial: Trial, methods: tuple[str, ...]) -> tuple[list[float], bool]:
    """Each method's mean error on one hole, mm, and whether its markers move."""
    motion, gone, start, stop = trial
    observed = motion.observed.copy()
    observed[start:stop, gone] = False
    seen = np.where(observed[..., None], motion.positions, np.float32("nan"))
    broken = replace(motion, positions=seen, observed=observed)
    truth, found = motion.positions[start - 1 : stop][:, gone], []
    for name in methods:
        filled = fill(name).complete(broken).positions[start:stop][:, gone]
        found.append(1e3 * float(np.linalg.norm(filled - truth[1:], axis=-1).mean()))
    speed = np.linalg.norm(np.diff(truth.astype(float), axis=0), axis=-1).mean() * motion.fps
    return found, bool(speed >= MOVING)


def table(title: str, motions: list[Motion], seconds: tuple[float, ...], options, methods=METHODS) -> None:
    """Prints the mean errors, of all holes and of those that move."""
    columns, means, moving = [], [], []
    for lost in LOST:
        for each in seconds:
            tried = [errors(trial, methods) for trial in trials(motions, lost, each, options.seed, options.per_take)]
            columns.append((f"{lost}, {each:g} s", len(tried), sum(moves for _, moves in tried)))
            means.append(np.mean([found for found, _ in tried], axis=0) if tried else np.full(len(methods), np.nan))
            fast = [found for found, moves in tried if moves]
            moving.append(np.mean(fast, axis=0) if fast else np.full(len(methods), np.nan))
    for what, numbers, count in ((title, means, 1), (f"{title}, moving", moving, 2)):
        print(f"\n**{what}**, mean error in mm\n")
        print(shared.head("method", *(column[0] for column in columns)))
        for row, name in enumerate(methods):
            told = "auto before" if name == "before" else name
            print(shared.row(told, *(f"{column[row]:.1f}" for column in numbers)))
        print(shared.row("holes", *(column[count] for column in columns)), flush=True)


def pieces(
    motion: Motion, lost: Array, nameless: bool, off: float, random: np.random.Generator
) -> tuple[Motion, set]:
    """The take with `lost` markers gone for a while and pieces of them without a label; which piece is whose.

    nameless : the pieces are those of the nearest neighbour of the first, which is never labelled. off : metres by
        which a piece runs beside its marker, in a direction of its own.
    """
    frames, markers = motion.observed.shape
    observed, tracks, truth = motion.observed.copy(), [], set()
    for marker in lost[:1] if nameless else lost:
        start = int(random.integers(5, max(6, frames - 40)))
        stop = min(frames - 5, start + int(random.integers(15, 150)))
        observed[start:stop, marker] = False
        owner = lost[1] if nameless else marker
        first = int(random.integers(start, max(start + 1, stop - 3)))
        last = min(stop, first + int(random.integers(4, 80)))
        if last - first > 2 and motion.observed[first:last, owner].all():
            truth.add((markers + len(tracks), int(marker), first, last))
            tracks.append((owner, first, last))
    if nameless:
        observed[:, lost[1]] = False
    seen = [np.where(observed[..., None], motion.positions, np.float32("nan"))]
    for owner, first, last in tracks:
        track = np.full((frames, 1, 3), np.nan, np.float32)
        aside = random.normal(size=3)
        track[first:last, 0] = motion.positions[first:last, owner] + off * aside / np.linalg.norm(aside)
        seen.append(track)
    positions = np.concatenate(seen, axis=1)
    names = [*motion.skeleton.names, *(f"*{number}" for number in range(len(tracks)))]
    return Motion(positions, np.isfinite(positions).all(axis=-1), motion.fps, Skeleton.cloud(names)), truth


def joins(sets: dict[str, list[Motion]], seed: int, per_take: int) -> None:
    print(shared.head("markers", "lost", "pieces", "joined rightly", "wrongly", left=2))
    for name, motions in sets.items():
        ways = [("one", 1, 0.0), ("three near", 3, 0.0), ("eight near", 8, 0.0), ("another's piece", 2, 0.0)]
        for what, number, off in [*ways, *((f"{1000 * off:.0f} mm beside", 1, off) for off in (0.01, 0.015, 0.03))]:
            random, there, right, wrong = np.random.default_rng(seed), 0, 0, 0
            for motion in motions * per_take:
                lost = near(motion, int(random.integers(len(motion.skeleton))), number)
                broken, truth = pieces(motion, lost, number == 2, off, random)
                found = {(one.track, one.marker, one.start, one.stop) for one in fragments(broken)}
                rightly = set() if number == 2 or off else found & truth
                there, right, wrong = there + len(truth), right + len(rightly), wrong + len(found - rightly)
            print(shared.row(name, what, there, right, wrong), flush=True)


def speed(data: Path, subjects: list[str], seed: int) -> None:
    random = np.random.default_rng(seed)
    rig, fps = max(((rig, fps) for _, rig, fps in takes(data / "cmu", subjects)), key=lambda take: len(take[0].trusted))
    motion, _ = with_markers(rig, fps, 4, random)
    frames = np.abs((np.arange(7200) + len(motion) - 1) % (2 * len(motion) - 2) - len(motion) + 1)  # to and fro
    positions = motion.positions[frames][:, :60]
    observed = np.ones(positions.shape[:2], bool)
    for marker, start, length in random.integers([0, 0, 12], [60, 7000, 181], (200, 3)):
        observed[start : start + length, marker] = False
    positions = np.where(observed[..., None], positions, np.float32("nan"))
    broken = Motion(positions, observed, fps, Skeleton.cloud(motion.skeleton.names[:60]))
    print(shared.head("method", "CPU s"))
    for name in METHODS:
        began = time.process_time()
        fill(name).complete(broken)
        told = "auto before" if name == "before" else name
        print(shared.row(told, f"{time.process_time() - began:.2f}"), flush=True)


def main() -> None:
    flags = {"people": ["s06", "s07"], "subjects": ["06", "16"], "seed": 0, "every": 1, "per_take": 4}
    options = shared.options(__doc__, data=Path, **flags, speed=False, fragments=False)
    print(f"{shared.python()}, {shared.here()}, seed {options.seed}")
    if options.speed:
        return speed(options.data, options.subjects, options.seed)
    if options.fragments:
        sets = {
            f"UI-PRMD, {', '.join(options.people)}": real(options.data, options.people, options.every),
            "made on takes that crawl and fall": crawling(options.data, options.seed),
        }
        return joins(sets, options.seed, options.per_take)
    motions = real(options.data, options.people, options.every)
    table(f"UI-PRMD, {', '.join(options.people)}", motions, (0.2, 1, 2), options)
    motions = made(options.data, options.subjects, options.every, options.seed)
    table(f"Markers made on CMU's {', '.join(options.subjects)}", motions, (0.2, 1, 5), options)
    motions = crawling(options.data, options.seed)
    return table("Markers made on takes that crawl and fall", motions, (0.2, 0.5, 1, 5), options)


if __name__ == "__main__":
    main()
