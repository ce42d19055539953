"""What a memory costs to learn, to open and to ask, beside reading the same files and the curves. Prints a table.

    python benchmarks/memory.py --data DIR [--files 40]

DIR holds `cmu.csv` and the folder `cmu`. Some BVH takes are read, and learned. The 21 joints of the longest, again and
again, make memories of 1 h and of 10 h, which are asked for 0.9 s. It makes a take of 10 min with 60 gaps of the whole
rig as well, and 1 min of 60 markers with 200 gaps, filled by `eased` and by `recall` from the take itself. Seconds are
the processor's.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shared

import motionmend as mm
from motionmend.body.mapping import map_rig, to_body
from motionmend.memory import recalling
from motionmend.memory.sessions import RATE, Session, joined, remember
from motionmend.memory.storing import Memory
from motionmend.motion import Motion, Skeleton, Take

LEG = ("left_shin", "left_foot", "left_toe")


def timed(way: Callable[[], Any]) -> tuple[Any, float]:
    began = time.process_time()
    return way(), time.process_time() - began


def lasting(motion: Motion, hours: float) -> Session:
    """A motion's memory again and again, as takes of other names."""
    one = remember(motion, None, "again")
    times = int(np.ceil(hours * 3600 * RATE / len(one)))
    takes = (replace(one.takes[0], name=f"{number:05}", sha256=f"{number}") for number in range(times))
    return joined(replace(one, takes=(take,)) for take in takes)[0]


def repeated(take: Take, seconds: float) -> Take:
    assert take.rig is not None
    frames = np.arange(round(seconds * take.fps)) % len(take)
    names = ("rotations", "translations", "trusted")
    return take.with_rig(replace(take.rig, **{name: getattr(take.rig, name)[frames] for name in names}))


def markers(take: Take, count: int, seconds: float) -> Take:
    """A cloud of points near joints."""
    places = repeated(take, seconds).motion
    random = np.random.default_rng(0)
    pairs, shares = random.integers(len(take.skeleton), size=(2, count)), random.uniform(0, 0.2, (count, 1))
    positions = (1 - shares) * places.positions[:, pairs[0]] + shares * places.positions[:, pairs[1]]
    skeleton = Skeleton.cloud([f"m{marker}" for marker in range(count)])
    motion = Motion(positions.astype(np.float32), np.ones(positions.shape[:2], bool), take.fps, skeleton)
    return Take(motion, None, None, take.units, "npz", "markers.npz")


def asking(memory: Memory, body: Motion, names: tuple[str, ...]) -> float:
    """Seconds for 0.9 s of these joints, the first time they are asked for."""
    start, length = len(body) // 2, round(0.9 * body.fps)
    lost = np.array([body.skeleton.index(name) for name in names])
    observed = body.observed.copy()
    observed[start : start + length, lost] = False
    broken, no_takes = replace(body, observed=observed), frozenset[str]()
    for session in memory.sessions:
        session.sizes.clear()
    answer, spent = timed(lambda: recalling.ask(broken, lost, start, start + length, memory.sessions, no_takes))
    assert isinstance(answer, recalling.Answer), answer
    return spent


def main() -> None:
    asked = shared.options(__doc__, data=Path, files=40)
    paths = [path for path, _ in shared.cmu_trials(asked.data, "train") if path.suffix == ".bvh"][: asked.files]
    mm.learn(paths[:1])  # what is imported
    takes, reading = timed(lambda: [mm.load(path) for path in paths])
    longest = max(takes, key=len)
    minutes = sum(take.motion.seconds for take in takes) / 60
    del takes
    print(f"{len(paths)} takes, {minutes:.1f} min, {shared.here()}\n")
    print(shared.head("what", "seconds", "that is"))
    _, learning = timed(lambda: mm.learn(paths))
    print(shared.row("learn them", f"{learning:.2f}", f"{learning / reading:.2f} of reading them"), flush=True)

    body = to_body(longest.motion, map_rig(longest.skeleton, longest.motion.positions))
    seen = np.flatnonzero(body.observed.any(axis=0))
    skeleton = Skeleton.cloud([body.skeleton.names[joint] for joint in seen])
    body = Motion(body.positions[:, seen], body.observed[:, seen], body.fps, skeleton)
    for hours in (1, 10):
        with tempfile.TemporaryDirectory() as folder:
            path = Memory((lasting(body, hours),)).save(Path(folder) / "much.memory")
            memory, opening = timed(lambda path=path: Memory.open(path))
            print(shared.row(f"open {hours} h", f"{opening:.2f}", f"{path.stat().st_size / 1e9:.2f} GB"), flush=True)
            for what, names in (("a whole body", skeleton.names), ("a leg", LEG)):
                spent = asking(memory, body, tuple(name for name in names if name in skeleton.names))
                print(shared.row(f"ask {hours} h for {what}", f"{spent:.2f}", ""), flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(shared.row("memory in use, at the most", "", f"{peak:.1f} GB"), flush=True)

    long, cloud, random = repeated(longest, 600), markers(longest, 60, 60), np.random.default_rng(0)
    first = round(5 * long.fps) + round(10 * long.fps) * np.arange(60)
    gaps = [(int(start), int(start) + round(0.6 * long.fps)) for start in first]
    places = random.integers(20, len(cloud) - 60, 200)
    lost = [(f"m{random.integers(60)}", int(start), int(start) + 40) for start in places]
    for what, take, damage in (
        (f"10 min of BVH at {long.fps:g} fps, 60 gaps", long, {"gaps": gaps}),
        (f"1 min of 60 markers at {cloud.fps:g} fps, 200 gaps", cloud, {"lost": lost}),
    ):
        eased, recalled = (
            timed(lambda name=name, take=take, damage=damage: mm.repair(take, method=name, **damage))[1]
            for name in ("eased", "recall")
        )
        print(shared.row(what, f"{recalled:.1f}", f"{recalled - eased:.1f} more than `eased`"), flush=True)


if __name__ == "__main__":
    main()
