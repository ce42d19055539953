"""Gaps of every length in bodies, arms and legs: how much of a classical fill's error a method leaves.

A protocol of our own, by which the house network is chosen and judged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..body.joints import BODY, JOINT
from ..corpora.corpus import Corpus
from ..damage import corruption
from ..progress import Stage, silent
from .method import Method
from .methods import find
from .results import TRUTH, Cell, Protocol, evenly
from .trials import Harm, Means, Trial, announced, missing, no_window, played, refuse_other_joints

Array = np.ndarray

WORLD, ROOTED = "MPJPE", "MPJPE from the hips"
SHARE, ROOTED_SHARE = "share of the classical fill's MPJPE", "share of the classical fill's MPJPE from the hips"
SECONDS = (0.1, 0.2, 0.3, 0.5, 0.9, 1.5, 2.0, 3.0, 4.0, 6.0)
LIMBS = (0.2, 0.5, 0.9, 1.5, 2.0)
BODIES = "whole body"
LOST = {"leg": ("left_shin", "left_foot", "left_toe"), "arm": ("left_forearm", "left_hand")}
ENDS = "end of a take"
REFERENCE = {BODIES: "eased", ENDS: "eased", "leg": "bones", "arm": "bones"}
SHORT, LONG = 96, 240  # frames of a window: for gaps of up to LONGEST seconds, and for longer ones
LONGEST = 2.0
STRIDE = 24
BATCH = 64
QUICK = {BODIES: (0.3, 0.5, 0.9, 1.5, 2.0), "leg": (0.5, 0.9), "arm": (0.5, 0.9), ENDS: (0.5,)}
CLASSICAL = {"fill": "eased"}

PROTOCOL = Protocol(
    name="gaps",
    fps=30,
    frames=SHORT,
    unit="mm",
    describe=(
        f"Windows of {SHORT} frames at 30 fps ({LONG} for gaps of more than {LONGEST:g} s), every {STRIDE} frames of "
        "all clips that are long enough. All joints, one leg (knee, foot, toe) or one arm (elbow, hand) are lost in "
        "the middle, or all joints up to the end. Mean distances over the lost samples, in the world and relative to "
        "the hips (of lost limbs, whose hips are seen, both are the same), and as shares of those of `eased`, of "
        "`bones` for limbs. Ours; in no paper."
    ),
)  # fmt: skip


def starts(corpus: Corpus, split: str, limit: int | None = None) -> Array:
    """The windows `(W,)` of gaps of up to LONGEST seconds; InputError if there is none, or for other joints."""
    refuse_other_joints(corpus)
    found = corpus.starts(split, SHORT, STRIDE)
    if not len(found):
        raise no_window(corpus, split, SHORT)
    return evenly(found, limit)


def trials(corpus: Corpus, split: str, limit: int | None = None) -> list[Trial]:
    """All of the protocol; gaps that no clip is long enough for are left out."""
    short, long = starts(corpus, split, limit), evenly(corpus.starts(split, LONG, STRIDE), limit)
    found = [_trial(BODIES, range(len(BODY)), seconds, short if seconds <= LONGEST else long) for seconds in SECONDS]
    for part, names in LOST.items():
        found += [_trial(part, [JOINT[name] for name in names], seconds, short) for seconds in LIMBS]
    found += [Trial(ENDS, f"{seconds:g} s", short, SHORT, ending(_frames(seconds))) for seconds in LIMBS]
    return [trial for trial in found if len(trial.starts)]


def _trial(task: str, joints: Sequence[int], seconds: float, windows: Array) -> Trial:
    frames = SHORT if seconds <= LONGEST else LONG
    return Trial(task, f"{seconds:g} s", windows, frames, missing(joints, _frames(seconds)))


def ending(frames: int) -> Harm:
    """Everything lost in the last `frames`."""

    def lose(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        del rng
        length = positions.shape[1]
        lost = np.broadcast_to(
            corruption.limb_mask(length, positions.shape[2], range(len(BODY)), (length - frames, length)),
            positions.shape[:3],
        )
        return positions, lost, lost

    return lose


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
    """All gaps for all methods that fill; see the package for what a protocol is.

    limit : at most so many windows for each gap. InputError as `starts`.
    """
    del train
    return measured(announced(trials(corpus, split, limit), stage), corpus, methods, seed)


def quick(method: Method, corpus: Corpus, split: str, *, windows: int, seed: int = 0) -> dict[str, float]:
    """Shares, in the world and from the hips, of a few gaps on so many windows; the first is their mean."""
    wanted = {(task, f"{seconds:g} s") for task, lengths in QUICK.items() for seconds in lengths}
    some = [each for each in trials(corpus, split, windows) if (each.task, each.setting) in wanted]
    cells = measured(some, corpus, [method], seed)
    both = {(cell.task, cell.setting, cell.metric): cell.value for cell in cells if cell.method == method.name}
    found: dict[str, float] = {}
    for trial in some:
        name = f"{trial.task}, {trial.setting}"
        found[name] = both[trial.task, trial.setting, SHARE]
        if trial.task == BODIES:
            found[f"{name}, from the hips"] = both[trial.task, trial.setting, ROOTED_SHARE]
    return {"mean share": float(np.mean(list(found.values()))), **found}


def measured(trials: Iterable[Trial], corpus: Corpus, methods: Sequence[Method], seed: int) -> list[Cell]:
    """Cells of some trials."""
    cells: list[Cell] = []
    for trial in trials:
        reference = find(REFERENCE[trial.task])
        asked = [*methods, *([reference] if reference.name not in {each.name for each in methods} else [])]
        tallies: dict[str, Means] = {}
        for block in played(trial, corpus, asked, seed, BATCH):
            for name, guess in block.guesses.items():
                if name != TRUTH:
                    tallies.setdefault(name, Means()).add(errors(block.truth, guess, block.judged))
        classical = tallies[reference.name]
        for method in methods:
            if tally := tallies.get(method.name):
                for metric, share in ((WORLD, SHARE), (ROOTED, ROOTED_SHARE)):
                    value = tally.value(metric)
                    part = value / classical.value(metric)
                    cells.append(Cell(trial.task, trial.setting, method.name, metric, value, None, PROTOCOL.unit))
                    cells.append(Cell(trial.task, trial.setting, method.name, share, part, None, ""))
    return cells


def errors(truth: Array, guess: Array, judged: Array) -> dict[str, tuple[float, int]]:
    """Mean distances in mm over what is `judged (B, T, J)`, in the world and from the hips, and of how many samples."""
    off = guess - truth
    hips = np.where(judged[:, :, :1, None], off[:, :, :1], 0)  # seen hips are where they are
    count = int(judged.sum())
    kinds = {WORLD: off, ROOTED: off - hips}
    return {name: (1000 * float(np.linalg.norm(each, axis=-1)[judged].mean()), count) for name, each in kinds.items()}


def _frames(seconds: float) -> int:
    return round(seconds * PROTOCOL.fps)
