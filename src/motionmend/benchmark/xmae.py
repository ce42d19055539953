"""The protocol of Björkstrand et al. 2023 (XMAE), sections 4.1 and 4.2."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .. import damage, metrics, rotations
from ..body import BODY, LIMBS
from ..corpus import Corpus
from ..errors import InputError
from ..motion import Skeleton
from ..progress import Stage, silent
from . import quality
from .methods import Method, Windows
from .results import TRUTH, Cell, Protocol, evenly

Array = np.ndarray

PROTOCOL = Protocol(
    name="xmae",
    fps=60,
    frames=60,
    unit="mm",
    describe=(
        "Björkstrand et al. 2023, section 4: windows of 1 s at 60 fps, one after the other. Missing: the full "
        "skeleton, one arm or one leg, for 0.1 to 0.9 s in the middle. Displaced: one arm, by one constant offset of "
        "0.5 to 1 m in a random direction, for the same times; nobody is told which samples are off. Arms and legs are "
        "averages of left and right. Noise: Gaussian on every joint's position, or on every joint's rotation but the "
        "hips', in every frame. MPJPE in mm over the missing or displaced samples only, over everything for noise; a "
        "joint that the capture never saw counts nowhere. Root-relative: hips at the origin in every frame. Limb σ: "
        "each bone's standard deviation of length over the window. At 0.9 s, 3 frames are known on each side. Under "
        "“told where” the displaced samples are hidden first, which is the task “arm missing”, and its numbers. The "
        "paper plots its noise on positions without numbers; these sigmas are ours."
    ),
)  # fmt: skip

BATCH = 128
GAPS = (0.1, 0.3, 0.5, 0.7, 0.9)  # seconds
POSITION_SIGMAS = (0.01, 0.02, 0.05, 0.1)  # metres
ROTATION_SIGMAS = (0.05, 0.10, 0.15)  # radians, of the paper's table 4
ARM, LEG = ("left_arm", "right_arm"), ("left_leg", "right_leg")
ERRORS = ("MPJPE, root-relative", "MPJPE, global", "limb σ")

Damage = Callable[[Array, np.random.Generator], tuple[Array, Array, Array]]


@dataclass(frozen=True)
class Trial:
    """One column of one table, for one side of the body.

    harm : `(positions (B, T, J, 3), rng) -> (damaged positions, hidden (B, T, J), judged (B, T, J))`.
    restores : whether the samples are to be corrected (`Method.restore`) or filled (`Method.fill`).
    """

    task: str
    setting: str
    harm: Damage
    restores: bool = False

    def doing(self, method: Method) -> Windows | None:
        """What the method does here; None if it cannot."""
        return method.restore if self.restores else method.fill


def trials(skeleton: Skeleton) -> list[Trial]:
    """All of the protocol, the sides of a limb one after the other."""
    everyone = range(len(skeleton))
    found = [Trial("full skeleton missing", _said(seconds), missing(everyone, seconds)) for seconds in GAPS]
    for task, sides in (("arm missing", ARM), ("leg missing", LEG)):
        found += [
            Trial(task, _said(seconds), missing(limb(skeleton, side), seconds)) for seconds in GAPS for side in sides
        ]
    for seconds in GAPS:
        for side in ARM:
            harm = displaced(limb(skeleton, side), seconds)
            found.append(Trial("arm displaced", _said(seconds), harm, restores=True))
    for sigma in POSITION_SIGMAS:
        found.append(Trial("noise on positions", f"{sigma * 1000:.0f} mm", noisy(sigma), restores=True))
    for sigma in ROTATION_SIGMAS:
        turned = noisy_turns(sigma, skeleton.parents)
        found.append(Trial("noise on rotations", f"{sigma:.2f} rad", turned, restores=True))
    return found


def starts(corpus: Corpus, split: str, limit: int | None = None) -> Array:
    """The windows `(W,)`, one after the other in each clip.

    Raises
    ------
    InputError : if the split has no whole window of 1 s.
    """
    found = corpus.starts(split, PROTOCOL.frames, PROTOCOL.frames, whole=True)
    if not len(found):
        raise InputError(
            f"no window of {PROTOCOL.frames} frames in the split {split!r}", where=corpus.path,
            hint="its clips are too short, or joints are missing everywhere",
        )  # fmt: skip
    return evenly(found, limit)


def measure(
    corpus: Corpus,
    split: str,
    methods: Sequence[Method],
    *,
    seed: int = 0,
    limit: int | None = None,
    train: Corpus | None = None,
    stage: Stage = silent,
) -> list[Cell]:
    """All tasks for all methods; see the package for what a protocol is.

    Raises
    ------
    InputError : for a corpus without BODY's limbs, or without a whole window.
    """
    del train
    windows = starts(corpus, split, limit)
    tallies: dict[tuple[str, str, str], list[Tally]] = {}
    todo = trials(corpus.skeleton)
    for number, trial in enumerate(todo):
        stage(f"{trial.task}, {trial.setting} ({number + 1} of {len(todo)})")
        for method, tally in measure_trial(trial, corpus, windows, methods, seed).items():
            tallies.setdefault((trial.task, trial.setting, method), []).append(tally)
    cells = [cell for key, sides in tallies.items() for cell in _cells(*key, sides)]
    told = [cell for cell in cells if cell.task == "arm missing" and cell.metric in ERRORS and cell.method != TRUTH]
    return cells + [replace(cell, task="arm displaced, told where") for cell in told]


def quick(method: Method, corpus: Corpus, split: str, *, windows: int, seed: int = 0) -> dict[str, float]:
    """A few numbers to watch a network by, on so many windows: the mean over three gaps of the full skeleton first."""
    left = {(trial.task, trial.setting): trial for trial in reversed(trials(corpus.skeleton))}
    found = starts(corpus, split, windows)

    def tally(task: str, setting: str) -> Tally:
        return measure_trial(left[task, setting], corpus, found, [method], seed, judge_quality=False)[method.name]

    relative, world, _ = ERRORS
    gaps = [tally("full skeleton missing", _said(seconds)) for seconds in (0.3, 0.5, 0.9)]
    return {
        "full skeleton, root-relative": float(np.mean([each.value(relative) for each in gaps])),
        "full skeleton, global": float(np.mean([each.value(world) for each in gaps])),
        "arm missing 0.5 s": tally("arm missing", "0.5 s").value(world),
        "arm displaced 0.5 s": tally("arm displaced", "0.5 s").value(world),
        "noise 50 mm": tally("noise on positions", "50 mm").value(world),
    }


def measure_trial(
    trial: Trial, corpus: Corpus, windows: Array, methods: Sequence[Method], seed: int, judge_quality: bool = True
) -> dict[str, Tally]:
    """What each method that can do the trial scored, by its name, and the truth's own quality under TRUTH.

    All trials of one seed draw the same numbers, so that columns differ by their size and not by luck.
    """
    able = [(method.name, do) for method in methods if (do := trial.doing(method)) is not None]
    tallies = {name: Tally() for name in (*(name for name, _ in able), TRUTH)}
    rng = np.random.default_rng(seed)
    for truth, seen in _batches(corpus, windows):
        damaged, hidden, judged = trial.harm(truth, rng)
        judged = judged & seen
        damaged = np.where(hidden[..., None], np.float32(np.nan), damaged)
        done = {}
        for name, do in able:
            guess = do(damaged, seen & ~hidden, corpus.fps, corpus.skeleton)
            done[name] = np.where(seen[..., None], guess, np.float32(np.nan))
        standing = quality.contacts(truth, corpus.fps, corpus.skeleton) if judge_quality else None
        for name, guess in {**done, TRUTH: truth}.items():
            tallies[name].add_errors(truth, guess, judged, corpus.skeleton, judge=name != TRUTH)
            if judge_quality:
                tallies[name].add(quality.measure(truth, guess, judged, corpus.fps, corpus.skeleton, standing))
    return tallies


def _batches(corpus: Corpus, windows: Array) -> Iterator[tuple[Array, Array]]:
    for first in range(0, len(windows), BATCH):
        yield corpus.windows(windows[first : first + BATCH], PROTOCOL.frames)


class Tally:
    """Weighted means, and window means of the errors for their spread."""

    def __init__(self):
        self.sums: dict[str, list[float]] = {}
        self.windows: dict[str, list[Array]] = {}

    def add(self, values: dict[str, tuple[float, int]]) -> None:
        """Means with their weights, of some more windows."""
        for name, (value, weight) in values.items():
            total = self.sums.setdefault(name, [0.0, 0.0])
            total[0] += value * weight
            total[1] += weight

    def add_errors(self, truth: Array, guess: Array, judged: Array, skeleton: Skeleton, judge: bool) -> None:
        """ERRORS of some more windows; only limb σ, which needs no truth, unless `judge`."""
        for name, root in zip(ERRORS, (skeleton.index("hips"), None)) if judge else ():
            here = judged if root is None else judged & np.isfinite(truth[:, :, root, None, 0])
            apart = np.where(here, metrics.distances(truth, guess, root), 0) * 1000
            count = here.sum(axis=(1, 2))
            self.add({name: (float(apart.sum()) / max(int(count.sum()), 1), int(count.sum()))})
            some = count > 0
            self.windows.setdefault(name, []).append(apart.sum(axis=(1, 2))[some] / count[some])
        self.add({"limb σ": (metrics.limb_sigma(guess, skeleton.parents), len(guess))})

    def value(self, name: str) -> float:
        total, weight = self.sums.get(name, (0.0, 0.0))
        return total / weight if weight else float("nan")

    def spread(self, name: str) -> float | None:
        return float(np.std(np.concatenate(self.windows[name]))) if name in self.windows else None


def _cells(task: str, setting: str, method: str, sides: list[Tally]) -> Iterator[Cell]:
    """The mean of both sides' values, metric by metric."""
    for metric in sides[0].sums:
        values = [side.value(metric) for side in sides]
        spreads = [spread for side in sides if (spread := side.spread(metric)) is not None]
        spread = float(np.mean(spreads)) if spreads else None
        unit = quality.UNITS.get(metric, PROTOCOL.unit)
        yield Cell(task, setting, method, metric, float(np.mean(values)), spread, unit)


# Damage -----------------------------------------------------------------------------------------------------


def limb(skeleton: Skeleton, name: str) -> list[int]:
    """The indices of a limb's joints. InputError if the skeleton is not made of BODY's joints."""
    names = [BODY.names[joint] for joint in LIMBS[name]]
    lacking = [joint for joint in names if joint not in skeleton.names]
    if lacking:
        raise InputError(
            f"the corpus has no joint {lacking[0]!r}", expected="the joints of BODY",
            hint="build it without --native",
        )  # fmt: skip
    return [skeleton.index(joint) for joint in names]


def _span(shape: tuple[int, ...], joints: Sequence[int], seconds: float) -> Array:
    span = damage.centred_span(shape[1], round(seconds * PROTOCOL.fps))
    return np.broadcast_to(damage.limb_mask(shape[1], shape[2], joints, span), shape[:3])


def missing(joints: Sequence[int], seconds: float) -> Damage:
    """Joints lost in the middle."""

    def lose(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        del rng
        lost = _span(positions.shape, joints, seconds)
        return positions, lost, lost

    return lose


def displaced(joints: Sequence[int], seconds: float) -> Damage:
    """Joints off by one constant offset a window."""

    def shift(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        moved = _span(positions.shape, joints, seconds)
        offsets = damage.constant_offsets(len(positions), rng)
        return damage.displace(positions, moved, offsets), np.zeros_like(moved), moved

    return shift


def noisy(sigma: float) -> Damage:
    """Gaussian noise of `sigma` metres on each coordinate of every joint."""

    def shake(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        everywhere = np.ones(positions.shape[:3], bool)
        return damage.position_noise(positions, sigma, rng), ~everywhere, everywhere

    return shake


def noisy_turns(sigma: float, parents: Sequence[int]) -> Damage:
    """Every joint but the root turned by a Gaussian rotation vector, `sigma` radians about each axis.

    What hangs on a joint turns with it, and bones keep their lengths. The vectors are drawn in the world: being
    isotropic, they are the same noise in the joint's own axes. What hangs on a joint that was never seen stays.
    """

    def shake(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        still = np.broadcast_to(rotations.IDENTITY, (*positions.shape[:3], 4))
        turns = damage.rotation_noise(still, sigma, rng)
        out, whole = positions.astype(float), still.copy()
        for joint, parent in enumerate(parents):
            if parent >= 0:
                bone = positions[:, :, joint].astype(float) - positions[:, :, parent]
                out[:, :, joint] = out[:, :, parent] + rotations.apply(whole[:, :, parent], bone)
                whole[:, :, joint] = rotations.multiply(whole[:, :, parent], turns[:, :, joint])
        everywhere = np.ones(positions.shape[:3], bool)
        return np.where(np.isfinite(out), out, positions).astype(np.float32), ~everywhere, everywhere

    return shake


def _said(seconds: float) -> str:
    return f"{seconds:g} s"
