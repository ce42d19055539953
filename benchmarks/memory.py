"""What memory costs: seconds to learn, to open and to ask, beside reading the same files and the curves. Prints a table.

    python benchmarks/memory.py --data DIR [--files 40]

DIR holds `cmu.csv` and the folder `cmu`. Some BVH takes are read, and learned; the longest are put end to end, again
and again, for memories of 1 h and 10 h, and for takes of 10 min with 60 gaps of the whole rig and of 1 min of 60 markers
with 200 gaps, which are filled by `eased` and by `recall` from the take itself.
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
from motionmend.memory import recalling
from motionmend.memory.sessions import RATE, Session, joined, remember
from motionmend.memory.storing import Memory
from motionmend.motion import Motion, Skeleton, Take


def timed(way: Callable[[], Any]) -> tuple[Any, float]:
    began = time.perf_counter()
    return way(), time.perf_counter() - began


def megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def lasting(session: Session, minutes: float) -> Session:
    """The session's takes again and again, under other names."""
    times = int(np.ceil(minutes * 60 * RATE / len(session)))
    copies = [
        replace(session, takes=tuple(replace(take, sha256=f"{take.sha256} {number}") for take in session.takes))
        for number in range(times)
    ]
    return joined(copies)[0]


def repeated(take: Take, seconds: float) -> Take:
    assert take.rig is not None
    frames = np.arange(round(seconds * take.fps)) % len(take)
    names = ("rotations", "translations", "trusted")
    return take.with_rig(replace(take.rig, **{name: getattr(take.rig, name)[frames] for name in names}))


def markers(take: Take, count: int, seconds: float) -> Take:
    """A cloud of joints and of points between them, one marker each."""
    places = repeated(take, seconds).motion
    random = np.random.default_rng(0)
    pairs, shares = random.integers(len(take.skeleton), size=(2, count)), random.uniform(0, 0.2, (count, 1))
    positions = (1 - shares) * places.positions[:, pairs[0]] + shares * places.positions[:, pairs[1]]
    skeleton = Skeleton.cloud([f"m{marker}" for marker in range(count)])
    motion = Motion(positions.astype(np.float32), np.ones(positions.shape[:2], bool), take.fps, skeleton)
    return Take(motion, None, None, take.units, "npz", "markers.npz")


def main() -> None:
    asked = shared.options(__doc__, data=Path, files=40)
    paths = [path for path, _ in shared.cmu_trials(asked.data, "train") if path.suffix == ".bvh"][: asked.files]
    takes, reading = timed(lambda: [mm.load(path) for path in paths])
    minutes = sum(take.motion.seconds for take in takes) / 60
    print(f"{len(paths)} takes, {minutes:.1f} min, {shared.here()}\n")
    print(shared.head("what", "seconds", "against"))
    _, learning = timed(lambda: mm.learn(paths))
    print(shared.row("learn them", f"{learning:.2f}", f"{learning / reading:.2f} of reading them"), flush=True)

    longest = max(takes, key=len)
    whole = longest.motion
    one = joined([remember(whole, longest.rig, "longest", "0")])[0]
    observed = whole.observed.copy()
    start = len(whole) // 2
    observed[start : start + round(0.9 * whole.fps)] = False
    for hours in (1, 10):
        before = megabytes()
        session = lasting(one, 60 * hours)
        with tempfile.TemporaryDirectory() as folder:
            path = Memory((session,)).save(Path(folder) / "much.memory")
            size = path.stat().st_size / 1e9
            del session
            memory, opening = timed(lambda path=path: Memory.open(path))
            print(shared.row(f"open {hours} h", f"{opening:.2f}", f"{size:.2f} GB"), flush=True)
            for what, lost in (("a whole body", None), ("a leg", ["LeftLeg", "LeftFoot", "LeftToeBase"])):
                joints = [memory.sessions[0].index[name] for name in lost or longest.skeleton.names]
                seen = whole.observed.copy()
                seen[start : start + round(0.9 * whole.fps), joints] = False
                broken = replace(whole, observed=seen)
                ask = lambda joints=joints, broken=broken, memory=memory: recalling.ask(  # noqa: E731
                    broken, np.array(joints), start, start + round(0.9 * broken.fps), memory.sessions, frozenset()
                )
                ask()
                spent = min(timed(ask)[1] for _ in range(3))
                grown = f"{megabytes() - before:.0f} MB more at the most"
                print(shared.row(f"ask {hours} h for 0.9 s of {what}", f"{spent:.3f}", grown), flush=True)

    long = repeated(longest, 600)
    random = np.random.default_rng(0)
    spans = [(first, first + round(0.6 * long.fps)) for first in range(round(5 * long.fps), len(long), round(10 * long.fps))]
    cloud = markers(longest, 60, 60)
    each = [(f"m{random.integers(60)}", first, first + 40) for first in random.integers(20, len(cloud) - 60, 200)]
    for what, take, damage in (
        (f"10 min of BVH at {long.fps:g} fps, {len(spans[:60])} gaps", long, {"gaps": spans[:60]}),
        (f"1 min of 60 markers at {cloud.fps:g} fps, 200 gaps", cloud, {"lost": each}),
    ):
        spent = {name: timed(lambda name=name: mm.repair(take, method=name, **damage))[1] for name in ("eased", "recall")}  # noqa: B023
        more = spent["recall"] - spent["eased"]
        print(shared.row(what, f"{spent['recall']:.1f}", f"{more:.1f} more than `eased`"), flush=True)


if __name__ == "__main__":
    main()
