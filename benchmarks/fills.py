"""Every fill on every kind of gap, planted in CMU takes: mean error in mm. Prints Markdown tables.

    python benchmarks/fills.py --data DIR [--subjects 06 16] [--seed 0]

DIR holds the folder `cmu`, with one folder a subject. A rig loses its body, an arm, a leg, a forearm, a shin, a hand or
a foot, again and again along each take, for as long as the column says. Real marker files are not among these
data: markers are made here, three or four on each bone, riding on it with 1 to 5 mm of slow soft-tissue drift (0.3 s)
and 0.1 mm of jitter. The error is that of the missing joints or markers, in space.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import shared

import motionmend.io as io
from motionmend.fills.auto import Auto, rig_methods
from motionmend.fills.channels import RIG_FILLS, fill_rig
from motionmend.fills.points import FILLS, Fill
from motionmend.motion import Motion, Rig, Skeleton
from motionmend.rotations import apply, between

Array = np.ndarray

SECONDS = (0.1, 0.3, 0.5, 0.7, 0.9, 1.2)
LOST = {  # kind in auto.WINNERS -> part -> its name in CMU's three spellings
    "limb": {"arm": ("lhumerus", "LeftArm", "lShldr"), "leg": ("lfemur", "LeftUpLeg", "lThigh")},
    "lower limb": {"forearm": ("rradius", "RightForeArm", "rForeArm"), "shin": ("rtibia", "RightLeg", "rShin")},
    "extremity": {"hand": ("lwrist", "LeftHand", "lHand"), "foot": ("lfoot", "LeftFoot", "lFoot")},
}


def takes(folder: Path, subjects: list[str]) -> list[tuple[str, Rig, float]]:
    found = []
    for path in sorted(path for subject in subjects for path in (folder / subject).glob("*_*.[ab][mv][ch]")):
        take = io.load(path, fps=120)
        start = 1 if path.suffix == ".bvh" else 0  # the converter's T-pose
        rig = take.rig
        assert rig is not None
        cut = {name: getattr(rig, name)[start:] for name in ("rotations", "translations", "trusted")}
        found.append((path.stem, replace(rig, **cut), take.fps))
    return found


def holes(frames: int, length: int, random: np.random.Generator) -> Array:
    """`(frames,)` bool: False in gaps of this length all along the take."""
    whole, start = np.ones(frames, bool), int(random.integers(15, 40))
    while start + length + 15 < frames:
        whole[start : start + length] = False
        start += length + int(random.integers(15, 60))
    return whole


def below(skeleton: Skeleton, names: tuple[str, ...]) -> Array:
    lost = np.zeros(len(skeleton), bool)
    for joint, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents)):
        lost[joint] = name in names or (parent >= 0 and lost[parent])
    return lost


def in_mm(misses: list[Array]) -> float:
    return 1e3 * float(np.mean(np.concatenate(misses)))


Row = list[float]


def table(title: str, rows: dict[str, Row]) -> None:
    print(f"\n**{title}**, mean error in mm\n")
    print(shared.seconds_head(["method"], SECONDS))
    best = [min(column) for column in zip(*(row for name, row in rows.items() if name in RIG_FILLS))]
    for name, row in rows.items():
        cells = (f"**{value:.1f}**" if value <= least else f"{value:.1f}" for value, least in zip(row, best))
        print(shared.row(name, *cells), flush=True)


def mean(tables: list[dict[str, Row]]) -> dict[str, Row]:
    return {name: np.mean([rows[name] for rows in tables], axis=0).tolist() for name in tables[0]}


def rig_row(data: list, lost: tuple[str, ...] | None, fill: Callable[[Rig, float], Array], seed: int) -> Row:
    """fill : (rig with distrusted channels, fps) -> positions."""
    row = []
    for seconds in SECONDS:
        misses, random = [], np.random.default_rng(seed)
        for _, rig, fps in data:
            whole = holes(len(rig.trusted), round(seconds * fps), random)
            gone = np.ones(len(rig.skeleton), bool) if lost is None else below(rig.skeleton, lost)
            broken = replace(rig, trusted=whole[:, None] | ~gone)
            misses.append(np.linalg.norm(fill(broken, fps) - rig.kinematics[0], axis=-1)[~broken.observed()])
        row.append(in_mm(misses))
    return row


def by_turns(method) -> Callable[[Rig, float], Array]:
    return lambda rig, fps: fill_rig(rig, fps, method)[0].kinematics[0]


def in_space(fill: Fill) -> Callable[[Rig, float], Array]:
    return lambda rig, fps: fill.complete(rig.motion(fps)).positions


def with_markers(rig: Rig, fps: float, per_bone: int, random: np.random.Generator) -> tuple[Motion, Array]:
    """A cloud of markers that ride on a rig's bones, and the joint `(markers,)` that each rides on."""
    joints, world = rig.kinematics
    names, owners, tracks = [], [], []
    for joint, children in enumerate(rig.skeleton.children):
        bone = rig.offsets[children[0]] if children else np.zeros(3)
        if np.linalg.norm(bone) < 0.08:
            continue
        frame = between(np.array([0.0, 1.0, 0.0]), bone)
        for marker in range(per_bone):
            angle = 2 * np.pi * (marker + random.uniform(-0.2, 0.2)) / per_bone
            around = apply(frame, np.array([np.cos(angle), 0.0, np.sin(angle)]) * random.uniform(0.04, 0.08))
            drift = _slow_noise(len(joints), round(0.3 * fps), random) * random.uniform(1e-3, 5e-3)
            place = bone * random.uniform(0.1, 0.9) + around + drift
            tracks.append(joints[:, joint] + apply(world[:, joint], place) + random.normal(0, 1e-4, (len(joints), 3)))
            names.append(f"{rig.skeleton.names[joint]}{marker}")
            owners.append(joint)
    positions = np.stack(tracks, axis=1).astype(np.float32)
    return Motion(positions, np.ones(positions.shape[:2], bool), fps, Skeleton.cloud(names)), np.array(owners)


def _slow_noise(frames: int, width: int, random: np.random.Generator) -> Array:
    """`(frames, 3)` noise smoothed over `width` frames, of standard deviation 1 over the three axes together."""
    kernel = np.hanning(width + 2)
    noise = np.stack([np.convolve(random.normal(size=frames + width + 1), kernel, "valid") for _ in range(3)], -1)
    return noise / np.sqrt(3 * np.sum(kernel**2))


def marker_row(clouds: list, lost: Callable, fill: Fill, seed: int) -> Row:
    row = []
    for seconds in SECONDS:
        misses, random = [], np.random.default_rng(seed)
        for motion, owners in clouds:
            whole = holes(len(motion), round(seconds * motion.fps), random)
            gone = lost(owners, random)
            filled = fill.complete(replace(motion, observed=whole[:, None] | ~gone))
            unseen = np.ix_(~whole, gone)
            misses.append(np.linalg.norm(filled.positions[unseen] - motion.positions[unseen], axis=-1).ravel())
        row.append(in_mm(misses))
    return row


def one_marker(owners: Array, random: np.random.Generator) -> Array:
    return np.arange(len(owners)) == random.integers(len(owners))


def a_few_markers(owners: Array, random: np.random.Generator) -> Array:
    gone = np.zeros(len(owners), bool)
    gone[random.choice(len(owners), 5, replace=False)] = True
    return gone


def one_bone(owners: Array, random: np.random.Generator) -> Array:
    return owners == random.choice(np.unique(owners))


def all_markers(owners: Array, random: np.random.Generator) -> Array:
    del random
    return np.ones(len(owners), bool)


def asked(doc: str | None, **more: str) -> tuple[argparse.Namespace, list, str]:
    """The command line, the takes that it means, and what they are in words. `more` options by name: their defaults."""
    options = shared.options(doc, data=Path, subjects=["06", "16"], seed=0, every=1, **more)
    data = takes(options.data / "cmu", options.subjects)[:: options.every]
    frames = sum(len(rig.trusted) for _, rig, _ in data)
    subjects = ", ".join(options.subjects)
    return options, data, f"{len(data)} takes, {frames} frames, subjects {subjects}, seed {options.seed}"


def main() -> None:
    options, data, told = asked(__doc__)
    print(f"{told}, {shared.python()}")

    turns = {name: by_turns(name) for name in RIG_FILLS} | {"auto": by_turns(rig_methods)}
    turns["hermite in space"] = in_space(FILLS["hermite"])
    fills = {**FILLS, "auto": Auto()}
    space = {name: in_space(fill) for name, fill in fills.items()}
    table("Rig, the body", {name: rig_row(data, None, fill, options.seed) for name, fill in turns.items()})
    joints = []
    for kind, parts in LOST.items():
        tables = []
        for part, lost in parts.items():
            tables.append({name: rig_row(data, lost, fill, options.seed) for name, fill in turns.items()})
            table(f"Rig, {part}", tables[-1])
            if kind != "extremity":
                joints.append({name: rig_row(data, lost, fill, options.seed) for name, fill in space.items()})
        table(f"Rig, {kind}: {' and '.join(parts)}", mean(tables))
    table("Joints of a skeleton as points: arm, leg, forearm and shin", mean(joints))

    for title, per_bone, lost in (
        ("One marker of four on a bone", 4, one_marker),
        ("One marker of three on a bone", 3, one_marker),
        ("Five markers anywhere, four on a bone", 4, a_few_markers),
        ("All four markers of a bone", 4, one_bone),
        ("All markers", 3, all_markers),
    ):
        random = np.random.default_rng(options.seed)
        clouds = [with_markers(rig, fps, per_bone, random) for _, rig, fps in data]
        table(title, {name: marker_row(clouds, lost, fill, options.seed) for name, fill in fills.items()})


if __name__ == "__main__":
    main()
