"""LaFAN1's transitions: 5, 15, 30 or 45 frames missing between 10 frames of past and one key frame.

Harvey et al. 2020 (Robust Motion In-betweening), as in the data set's public evaluation. It measures
rotations, so it reads BVH itself, from the published archive or a folder of its takes, and no corpus.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .. import io
from ..corpora.datasets.lafan1 import LARGEST, unpacked
from ..errors import InputError
from ..fills.channels import RIG_FILLS, fill_rig
from ..fills.curves import CURVES
from ..metrics.positional import Moments
from ..metrics.rotational import l2p, l2q, npss_mean, npss_terms
from ..motion import Rig, Skeleton, Take
from ..progress import Stage, silent
from ..rotations import apply, between, continuous, forward_kinematics, from_rotvec, inverse, multiply, to_rotvec
from .method import Method
from .results import Cell, Protocol, evenly

Array = np.ndarray

FPS, PAST, FRAMES, STRIDE = 30.0, 10, 65, 40
STATISTICS_FRAMES, STATISTICS_STRIDE = 50, 20  # of the training windows that normalise positions
LENGTHS = (5, 15, 30, 45)
SUBJECTS = {"train": (1, 2, 3, 4), "test": (5,)}
BLOCK = 256  # windows at once

PROTOCOL = Protocol(
    "lafan1", FPS, FRAMES, "",
    "Transitions of 5, 15, 30 and 45 frames at 30 fps after 10 known frames and before one key frame, on LaFAN1's "
    "subject 5 (Harvey et al. 2020): L2Q and L2P on world quaternions and normalised world positions, NPSS "
    "on world quaternions. Fills are of turns, in the world for linear, hermite and cubic.",
    source=True,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one skeleton: `rotations (W, T, J, 4)` and `translations (W, T, J, 3)`, in the parent's frame."""

    skeleton: Skeleton
    rotations: Array
    translations: Array

    def __len__(self) -> int:
        return len(self.rotations)

    def __getitem__(self, at) -> Windows:
        """What NumPy would give of rows, or of rows and frames."""
        return replace(self, rotations=self.rotations[at], translations=self.translations[at])

    def world(self) -> tuple[Array, Array]:
        """World positions `(W, T, J, 3)` and rotations `(W, T, J, 4)`."""
        turns, shifts = (array.reshape(-1, *array.shape[2:]) for array in (self.rotations, self.translations))
        positions, turns = forward_kinematics(turns, shifts, self.skeleton.parents)
        return positions.reshape(self.translations.shape), turns.reshape(self.rotations.shape)


def measure(
    source: Path,
    split: str,
    methods: Sequence[Method],
    *,
    seed: int = 0,
    limit: int | None = None,
    train: object = None,
    stage: Stage = silent,
    lengths: Sequence[int] = LENGTHS,
) -> list[Cell]:
    """L2Q, L2P and NPSS of zero velocity, of interpolation, and of each of `methods` that can fill a rig.

    Parameters
    ----------
    source : lafan1.zip, or a folder with its BVH files anywhere in it; files end in _subject1.bvh to _subject5.bvh.
    split : "test" (subject 5), or "train" (subjects 1 to 4, who normalise the positions in any case).
    methods : those named in `channels.RIG_FILLS` are measured; the others do not speak rotations and are left out.
    limit : this many windows, spread evenly over all. seed, train : not needed, nothing here is drawn or learnt.
    lengths : missing frames, from 1 to 54.

    Raises
    ------
    InputError : no such source, not LaFAN1, a split that it does not have.
    """
    del seed, train
    if split not in SUBJECTS:
        raise InputError(f"LaFAN1 has no split {split!r}", expected="one of " + ", ".join(SUBJECTS))
    if not all(1 <= length < FRAMES - PAST for length in lengths):
        raise ValueError(f"transitions have 1 to {FRAMES - PAST - 1} frames, not {tuple(lengths)}")
    std, test = _read(Path(source), SUBJECTS[split], limit, stage)
    ways: dict[str, Way] = {"zero-velocity": zero_velocity, "interpolation": interpolation}
    ways |= {method.name: rig_fill(method.name) for method in methods if method.name in RIG_FILLS}
    cells = []
    for length in lengths:
        for name, way in ways.items():
            stage(f"{length} frames, {name}")
            cells += _cells(f"{length} frames", name, _scores(test, way, length, std))
    return cells


def _cells(setting: str, method: str, scores: dict[str, Array]) -> list[Cell]:
    task = "transition"
    cells = [
        Cell(task, setting, method, metric, float(scores[metric].mean()), float(scores[metric].std()), "")
        for metric in ("L2Q", "L2P")
    ]
    npss = npss_mean(scores["distance"], scores["power"])
    return [*cells, Cell(task, setting, method, "NPSS", npss, None, "")]


def _scores(test: Windows, way: Way, length: int, std: Array) -> dict[str, Array]:
    """What the metrics need of every window, a block of windows at a time."""
    blocks = []
    for first in range(0, len(test), BLOCK):
        windows = test[first : first + BLOCK, : PAST + length + 1]
        places, turns = windows[:, PAST:-1].world()
        guessed_places, guessed_turns = way(windows).world()
        distance, power = npss_terms(*(q.reshape(*q.shape[:2], -1) for q in (turns, guessed_turns)))
        blocks.append((l2q(turns, guessed_turns), l2p(places, guessed_places, std), distance, power))
    names = "L2Q", "L2P", "distance", "power"
    return {name: np.concatenate(rows) for name, rows in zip(names, zip(*blocks))}


# A Way takes windows of 10 past frames, n that are missing and 1 key frame; it may read the known ones only, and
# returns the missing. Its quaternions run on from the last past frame without a flip.
Way = Callable[[Windows], Windows]


def zero_velocity(windows: Windows) -> Windows:
    """The last past pose, held."""
    missing = windows.rotations.shape[1] - PAST - 1
    return windows[:, np.full(missing, PAST - 1)]


def interpolation(windows: Windows) -> Windows:
    """Straight lines for the root's place, slerp (Shoemake 1985) for each joint's turn in its parent's frame."""
    missing = windows.rotations.shape[1] - PAST - 1
    along = (np.arange(1, missing + 1) / (missing + 1))[:, None, None]
    (q, after_q), (x, after_x) = (
        (array[:, PAST - 1, None], array[:, -1, None]) for array in (windows.rotations, windows.translations)
    )
    rotations = multiply(q, from_rotvec(along * to_rotvec(multiply(inverse(q), after_q))))
    return Windows(windows.skeleton, rotations, x + along * (after_x - x))


def rig_fill(name: str) -> Way:
    """The fill of turns and shifts that `repair` would use under this name, all windows as one long take."""
    # Between windows lies an unknown stretch that no curve can look across; it is filled too, and thrown away.
    apart = max(curve.reach(FPS) for curve in CURVES.values())

    def way(windows: Windows) -> Windows:
        count, frames, joints = windows.rotations.shape[:3]
        known = np.zeros((count, frames + apart, joints), bool)
        known[:, :PAST] = known[:, frames - 1] = True
        rotations, translations = (
            np.pad(array, ((0, 0), (0, apart), (0, 0), (0, 0)), mode="edge")
            for array in (windows.rotations, windows.translations)
        )
        rotations[~known], translations[~known] = np.nan, np.nan
        long = count * (frames + apart) - apart
        rig = Rig(
            windows.skeleton,
            rotations.reshape(-1, joints, 4)[:long],
            translations.reshape(-1, joints, 3)[:long],
            known.reshape(-1, joints)[:long],
            windows.translations[0, 0],
            np.ones(joints, bool),
            ("",) * joints,
        )
        rig, _ = fill_rig(rig, FPS, name)
        kept = (np.arange(count) * (frames + apart))[:, None] + np.arange(PAST - 1, frames - 1)
        turns = continuous(rig.rotations[kept].swapaxes(0, 1)).swapaxes(0, 1)
        return Windows(windows.skeleton, turns[:, 1:], rig.translations[kept[:, 1:]])

    return way


def _read(source: Path, subjects: tuple[int, ...], limit: int | None, stage: Stage) -> tuple[Array, Windows]:
    """The standard deviation `(J, 3)` of the training set's world positions, and the windows to be scored."""
    skeleton, spread, found = None, Moments(), []
    for subject, take in _takes(source, {*SUBJECTS["train"], *subjects}, stage):
        skeleton = skeleton or take.skeleton
        if take.skeleton != skeleton or take.rig is None:
            raise InputError("another skeleton than in the takes before it", where=take.source)
        if abs(take.fps - FPS) > 0.1:
            raise InputError(f"{take.fps:g} fps", where=take.source, expected=f"{FPS:g} fps")
        if subject in SUBJECTS["train"]:
            windows = _windows(take, take.rig, STATISTICS_FRAMES, STATISTICS_STRIDE)
            for first in range(0, len(windows), BLOCK):
                places = windows[first : first + BLOCK].world()[0]
                spread.add(places.reshape(-1, *places.shape[2:]))
        if subject in subjects:
            found.append(_windows(take, take.rig, FRAMES, STRIDE))
    if skeleton is None or not spread.count or not sum(map(len, found)):
        whose = ", ".join(map(str, sorted({*SUBJECTS["train"], *subjects})))
        raise InputError(
            "too few takes", where=source, expected=f"BVH files of subjects {whose} named like walk1_subject5.bvh",
            hint=f"a take needs more than {FRAMES} frames",
        )
    if not (spread.std > 0).all():
        raise InputError("the training takes do not move", where=source)
    rotations = np.concatenate([windows.rotations for windows in found])
    translations = np.concatenate([windows.translations for windows in found])
    return spread.std, Windows(skeleton, rotations, translations)[evenly(np.arange(len(rotations)), limit)]


def _windows(take: Take, rig: Rig, length: int, stride: int) -> Windows:
    """Windows of a take; the root's mean on the floor is put at the origin, its Y axis in the 10th frame faces x."""
    starts = np.arange(0, len(take) - length, stride)
    rows = starts[:, None] + np.arange(length)
    rotations, translations = continuous(rig.rotations)[rows], rig.translations[rows]
    floor = [0, 2]
    translations[:, :, 0, floor] -= translations[:, :, 0, floor].mean(axis=1, keepdims=True)
    facing = apply(rotations[:, PAST - 1, 0], np.array([0.0, 1.0, 0.0])) * [1, 0, 1]
    turn = inverse(between(np.array([1.0, 0.0, 0.0]), facing))[:, None]
    rotations[:, :, 0] = multiply(turn, rotations[:, :, 0])
    translations[:, :, 0] = apply(turn, translations[:, :, 0])
    return Windows(take.skeleton, rotations, translations)


def _takes(source: Path, subjects: set[int], stage: Stage) -> Iterator[tuple[int, Take]]:
    """The takes of these subjects with their subject, by name, one at a time; LaFAN1 is in cm, Y up."""
    if source.is_dir():
        for path in sorted(source.rglob("*.bvh")):
            if (subject := _subject(path.name)) in subjects:
                stage(f"reading {path.name}")
                yield subject, io.load(path, unit="cm", up="y")
        return
    if not source.is_file():
        raise InputError("no such file or folder", where=source, expected="lafan1.zip, or a folder of its BVH files")
    for path, size in unpacked(source, lambda name: _subject(name) in subjects):
        stage(f"reading {path.name}")
        if size > LARGEST:
            raise InputError(f"{path.name} has {size:,} bytes, more than a take has", where=source)
        yield _subject(path.name), io.load(path, unit="cm", up="y")


def _subject(name: str) -> int:
    """The number in "walk1_subject5.bvh"; 0 for other names, and for the shadows that macOS puts into archives."""
    match = re.fullmatch(r"[^.].*_subject(\d{1,3})\.bvh", name, re.I)
    return int(match[1]) if match else 0
