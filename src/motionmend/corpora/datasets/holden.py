"""The collection of Holden, Saito and Komura 2016 (CMU, HDM05, MHAD and Edinburgh's captures on one skeleton).

Processed BVH: folders such as `cmu/`, 31 joints at 120 fps, of which the authors' export takes 21 joints and every
second frame, whatever frame time a file states. NPZ: `data_cmu.npz` with one array `clips`, by the authors in windows
`(windows, 240, 73)` of 60 fps, half a window apart; by Kaufmann's preparation the same in `train/` and `valid/`, or
whole takes `(frames, 73)`. A row is 22 joints x 3, local to the root on the floor (joint 0, smoothed) and turned to
face +z; the root's velocity along x and z, in the next frame's facing, and its turn about y until the next frame
(radians); four foot contacts. Here the velocities are summed up again, the 21 joints are put back into the world, and
windows that overlap are joined into the takes that they were cut from.

A unit is 6.25 cm: Holden's code multiplies by it, and every centimetre in the ConvAE paper rests on it. (CMU's own
are 5.64 cm.)
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ... import io
from ...body.mapping import map_rig
from ...errors import InputError
from ...motion import Array, Motion, Skeleton
from ...progress import Stage, silent
from ..corpus import Dropped
from ._objects import archive_of, numbers, objects
from .raw import Raw

NAME = "holden"
LICENCE = "academic and non-commercial use, by the terms of each collection in it"
CREDIT = (
    "Holden, Saito, Komura: A Deep Learning Framework for Character Motion Synthesis and Editing, SIGGRAPH 2016, "
    "with data of CMU (mocap.cs.cmu.edu), HDM05 and Berkeley MHAD."
)
# Those that ConvAE and XMAE use; Kinect's and terrain's captures are left out by both.
DATABASES = ("cmu", "hdm05", "mhad", "edin_locomotion", "edin_xsens", "edin_misc", "edin_punching")
METRES = 0.0625
WINDOW, STEP, ROWS = 240, 120, 73
FPS = 60.0
SPLITS = {"train": "train", "valid": "validation"}  # Kaufmann's folders
SKELETON = Skeleton(
    ("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase", "RightUpLeg", "RightLeg", "RightFoot", "RightToeBase",
     "Spine", "Spine1", "Neck1", "Head", "LeftArm", "LeftForeArm", "LeftHand", "LeftHandIndex1",
     "RightArm", "RightForeArm", "RightHand", "RightHandIndex1"),
    (-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 11, 13, 14, 15, 11, 17, 18, 19),
)  # fmt: skip


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The takes of the seven databases, from their BVH files where there are any, else from the NPZ files.

    BVH and the authors' NPZ have no splits; Kaufmann's `train/` and `valid/` are the train and validation splits.

    Raises
    ------
    InputError : if there is neither.
    """
    for inside in (".", "processed", "data/processed", "motionsynth_data/data/processed"):
        root = source / inside
        folders = [root / name for name in DATABASES if any((root / name).glob("*.bvh"))]
        if folders:
            yield from _loose(source, root, folders, stage)
            return
    archives = sorted(source.rglob("data_*.npz"))
    if split := [path for path in archives if path.parent.name in SPLITS]:
        archives = split  # raw/ beside them has the same takes
    if not archives:
        raise InputError("no take", where=source, expected="folders of BVH such as cmu/, or files such as data_cmu.npz")
    for path in archives:
        database, file = path.stem.removeprefix("data_"), path.relative_to(source).as_posix()
        if database in DATABASES:
            yield from _packed(path, file, database, stage)
        else:
            yield Dropped(file, "not one of the seven databases that the papers use")


def _loose(source: Path, root: Path, folders: list[Path], stage: Stage) -> Iterator[Raw | Dropped]:
    for other in sorted(path for path in root.iterdir() if path.is_dir() and path not in folders):
        if any(other.glob("*.bvh")):
            yield Dropped(other.relative_to(source).as_posix(), "not one of the seven databases that the papers use")
    for folder in folders:
        for path in sorted(folder.glob("*.bvh")):
            file = path.relative_to(source).as_posix()
            stage(file)
            if path.name == "rest.bvh":
                yield Dropped(file, "the rest pose, no take")
                continue
            try:
                yield _bvh(path, file)
            except InputError as error:
                yield Dropped(file, str(error).removeprefix(f"{path}: "))


def _bvh(path: Path, file: str) -> Raw:
    take = io.load(path, unit="m", up="y", fps=2 * FPS)
    if missing := set(SKELETON.names) - set(take.skeleton.names):
        raise InputError(f"no joint {min(missing)}", expected="the 31 joints of Holden's skeleton")
    joints = [take.skeleton.index(name) for name in SKELETON.names]
    positions = take.motion.positions[:, joints] * np.float32(METRES)
    motion = Motion(positions, take.motion.observed[:, joints], 2 * FPS, SKELETON)
    subject = f"cmu_{path.stem.split('_')[0]}" if path.parent.name == "cmu" else ""
    name = f"{path.parent.name}_{path.stem}"
    return Raw(name, file, subject, "", motion, map_rig(SKELETON).rig, LICENCE, io.sha256_of(path), take.notes)


def _packed(path: Path, file: str, database: str, stage: Stage) -> Iterator[Raw]:
    archive = archive_of(path)
    if "clips" not in archive.keys:
        held = ", ".join(sorted(archive.keys)[:6]) or "nothing"
        raise InputError(f"it holds {held}", where=path, expected="the array clips (windows, 240, 73)")
    stored = objects(archive, "clips")
    clips = [numbers(clip, f"{path}:clips[{number}]") for number, clip in enumerate(stored)]
    for number, clip in enumerate(clips):
        if clip.ndim != 2 or clip.shape[1] != ROWS or clip.dtype.kind != "f" or not len(clip):
            found = f"clips of {clip.dtype} {clip.shape}"
            raise InputError(found, where=f"{path}:clips[{number}]", expected=f"floats (frames, {ROWS})")
    sha256, rig, split = io.sha256_of(path), map_rig(SKELETON).rig, SPLITS.get(path.parent.name, "")
    whole = joined(clips) if all(len(clip) == WINDOW for clip in clips) else clips
    for number, rows in enumerate(whole):
        name = f"{database}_{split}_{number:04d}" if split else f"{database}_{number:04d}"
        stage(name)
        positions = world(rows)
        motion = Motion(positions, np.asarray(np.isfinite(positions).all(axis=-1)), FPS, SKELETON)
        yield Raw(name, f"{file}/{number}", "", split, motion, rig, LICENCE, sha256, floor=0.0)


def world(rows: Array) -> Array:
    """`(frames, 21, 3)` float32 metres of rows `(frames, 73)`; the first frame is at the origin and faces +z."""
    rows = rows.astype(np.float64)
    local, velocity, turns = rows[:, 3:66].reshape(-1, 21, 3), rows[:, 66:68], rows[:, 68]
    # The facing of frame t is that of frame 0 and all turns before t; local = facing * (position - root).
    facing = np.concatenate([[0.0], np.cumsum(turns)])[:, None]
    steps = _turned(velocity[:, 0], velocity[:, 1], -facing[1:, 0])
    x, z = (np.concatenate([[0.0], np.cumsum(step)[:-1]])[:, None] for step in steps)
    turned = _turned(local[..., 0], local[..., 2], -facing[:-1])
    return (np.stack([x + turned[0], local[..., 1], z + turned[1]], axis=-1) * METRES).astype(np.float32)


def _turned(x: Array, z: Array, angle: Array) -> tuple[Array, Array]:
    """x and z turned about y: a positive angle takes z towards x."""
    return np.cos(angle) * x + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * x


def joined(windows: list[Array]) -> list[Array]:
    """Takes out of windows `(240, 73)` that start every 120 frames, in order; overlaps are known by being equal.

    The last window of a take is padded at both ends with its first and last row, standing still; that is cut off.
    """
    takes: list[list[Array]] = []
    before = np.empty((0, ROWS))
    for window in windows:
        rows = _unpadded(window)
        shared = before[STEP:][: len(rows)]
        if len(shared) and np.array_equal(shared, rows[: len(shared)], equal_nan=True):
            takes[-1].append(rows[len(shared) :])
        else:
            takes.append([rows])
        before = rows
    return [np.concatenate(parts) for parts in takes]


def _unpadded(window: Array) -> Array:
    same = (window[1:, :66] == window[:-1, :66]).all(axis=1)
    still = (window[:, 66:69] == 0).all(axis=1)
    first = int(np.argmin(np.append(same & still[:-1], False)))
    last = int(np.argmin(np.append((same & still[1:])[::-1], False)))
    padded = first > 0 and first - last in (0, 1) and first + last < len(window)
    return window[first : len(window) - last] if padded else window
