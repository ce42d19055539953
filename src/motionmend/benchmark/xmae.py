"""The protocol of Björkstrand et al. 2023 (XMAE), sections 4.1 and 4.2."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from .. import rotations
from ..body.joints import BODY, JOINT, LIMBS
from ..corpora.corpus import Corpus
from ..damage import corruption
from ..metrics import positional
from ..progress import Stage, silent
from . import quality
from .method import Method
from .results import TRUTH, Cell, Protocol
from .trials import Harm, Means, Trial, announced, middle, missing, noisy, played, whole_windows

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
        "paper adds noise on rotations to SMPL's axis-angle numbers; here small turns are composed with each joint's. "
        "Its table 3 is without global translation and rotation: the global errors on a corpus built with --local. It "
        "plots its noise on positions without numbers; these sigmas are ours."
    ),
)  # fmt: skip

BATCH = 128
CLASSICAL = {"fill": "hermite", "restore": "butterworth"}
GAPS = (0.1, 0.3, 0.5, 0.7, 0.9)  # seconds
POSITION_SIGMAS = (0.01, 0.02, 0.05, 0.1)  # metres
ROTATION_SIGMAS = (0.05, 0.10, 0.15)  # radians, of the paper's table 4
ARM, LEG = ("left_arm", "right_arm"), ("left_leg", "right_leg")
ERRORS = ("MPJPE, root-relative", "MPJPE, global", "limb σ")


def starts(corpus: Corpus, split: str, limit: int | None = None) -> Array:
    """The windows `(W,)`, one after the other in each clip; InputError as `trials.whole_windows`."""
    return whole_windows(corpus, split, PROTOCOL.frames, PROTOCOL.frames, limit)


def trials(corpus: Corpus, split: str, limit: int | None = None) -> list[Trial]:
    """All of the protocol, the sides of a limb one after the other.

    Raises
    ------
    InputError : for a corpus of other joints than BODY's, or without a whole window of 1 s.
    """
    windows = starts(corpus, split, limit)

    def trial(task: str, setting: str, harm: Harm, does: str) -> Trial:
        return Trial(task, setting, windows, PROTOCOL.frames, harm, does)

    everyone = tuple(range(len(BODY)))
    arms, legs = ([LIMBS[side] for side in sides] for sides in (ARM, LEG))
    found = [
        trial(task, _said(seconds), missing(joints, _frames(seconds)), "fill")
        for task, parts in (("full skeleton missing", [everyone]), ("arm missing", arms), ("leg missing", legs))
        for seconds in GAPS
        for joints in parts
    ]
    found += [
        trial("arm displaced", _said(seconds), displaced(joints, _frames(seconds)), "restore")
        for seconds in GAPS
        for joints in arms
    ]
    found += [
        trial("noise on positions", f"{sigma * 1000:.0f} mm", noisy(sigma), "restore") for sigma in POSITION_SIGMAS
    ]
    found += [
        trial("noise on rotations", f"{sigma:.2f} rad", noisy_turns(sigma), "restore") for sigma in ROTATION_SIGMAS
    ]
    return found


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
    InputError : as `trials`.
    """
    del train
    tallies: dict[tuple[str, str, str], list[Tally]] = {}
    for trial in announced(trials(corpus, split, limit), stage):
        for method, tally in measure_trial(trial, corpus, methods, seed).items():
            tallies.setdefault((trial.task, trial.setting, method), []).append(tally)
    cells = [cell for key, sides in tallies.items() for cell in _cells(*key, sides)]
    told = [cell for cell in cells if cell.task == "arm missing" and cell.metric in ERRORS and cell.method != TRUTH]
    return cells + [replace(cell, task="arm displaced, told where") for cell in told]


def quick(method: Method, corpus: Corpus, split: str, *, windows: int, seed: int = 0) -> dict[str, float]:
    """A few numbers to watch a network by, on so many windows: the mean over three gaps of the full skeleton first."""
    left = {(trial.task, trial.setting): trial for trial in reversed(trials(corpus, split, windows))}

    def tally(task: str, setting: str) -> Tally:
        return measure_trial(left[task, setting], corpus, [method], seed, judge_quality=False)[method.name]

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
    trial: Trial, corpus: Corpus, methods: Sequence[Method], seed: int, judge_quality: bool = True
) -> dict[str, Tally]:
    """What each method that can do the trial scored, by its name, and the truth's own quality under TRUTH."""
    tallies: dict[str, Tally] = {}
    for block in played(trial, corpus, methods, seed, BATCH):
        standing = quality.contacts(block.truth, corpus.fps, BODY) if judge_quality else None
        for name, guess in block.guesses.items():
            tally = tallies.setdefault(name, Tally())
            if name != TRUTH:
                tally.add_errors(block.truth, guess, block.judged)
            tally.add({"limb σ": (positional.limb_sigma(guess, BODY.parents), len(guess))})
            if judge_quality:
                tally.add(quality.measure(block.truth, guess, block.judged, corpus.fps, BODY, standing))
    return tallies


class Tally(Means):
    """Means of all that is measured, and window means of the errors for their spread."""

    def __init__(self):
        super().__init__()
        self.windows: dict[str, list[Array]] = {}

    def add_errors(self, truth: Array, guess: Array, judged: Array) -> None:
        """Both MPJPEs of some more windows."""
        for name, root in zip(ERRORS, (JOINT["hips"], None)):
            here = judged if root is None else judged & np.isfinite(truth[:, :, root, None, 0])
            apart = np.where(here, positional.distances(truth, guess, root), 0) * 1000
            count = here.sum(axis=(1, 2))
            self.add({name: (float(apart.sum()) / max(int(count.sum()), 1), int(count.sum()))})
            some = count > 0
            self.windows.setdefault(name, []).append(apart.sum(axis=(1, 2))[some] / count[some])

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


# Harm -------------------------------------------------------------------------------------------------------


def displaced(joints: Sequence[int], frames: int) -> Harm:
    """Joints off by one constant offset a window, for so many frames in the middle."""

    def shift(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        moved = middle(positions.shape[:3], joints, frames)
        offsets = corruption.constant_offsets(len(positions), rng)
        return corruption.displace(positions, moved, offsets), np.zeros_like(moved), moved

    return shift


def noisy_turns(sigma: float) -> Harm:
    """Every joint but the root turned by a Gaussian rotation vector, `sigma` radians about each axis.

    What hangs on a joint turns with it, and bones keep their lengths. The vectors are drawn in the world: being
    isotropic, they are the same noise in the joint's own axes. What hangs on a joint that was never seen stays.
    """

    def shake(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        still = np.broadcast_to(rotations.IDENTITY, (*positions.shape[:3], 4))
        turns = corruption.rotation_noise(still, sigma, rng)
        out, whole = positions.astype(float), still.copy()
        for joint, parent in enumerate(BODY.parents):
            if parent >= 0:
                bone = positions[:, :, joint].astype(float) - positions[:, :, parent]
                out[:, :, joint] = out[:, :, parent] + rotations.apply(whole[:, :, parent], bone)
                whole[:, :, joint] = rotations.multiply(whole[:, :, parent], turns[:, :, joint])
        everywhere = np.ones(positions.shape[:3], bool)
        return np.where(np.isfinite(out), out, positions).astype(np.float32), ~everywhere, everywhere

    return shake


def _said(seconds: float) -> str:
    return f"{seconds:g} s"


def _frames(seconds: float) -> int:
    return round(seconds * PROTOCOL.fps)
