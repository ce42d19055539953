"""What protocols share: their windows, what a trial does to them and asks of the methods, and means."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..body.joints import BODY
from ..corpora.corpus import Corpus
from ..damage import corruption
from ..errors import InputError
from ..progress import Stage
from .method import Method, Windows
from .results import TRUTH, evenly

Array = np.ndarray
Rng = np.random.Generator

Harm = Callable[[Array, Rng], tuple[Array, Array, Array]]


@dataclass(frozen=True, eq=False)
class Trial:
    """One column of one table.

    starts `(W,)`, frames : its windows.
    harm : `(positions (B, T, J, 3), rng) -> (damaged positions, hidden (B, T, J), judged (B, T, J))`.
    does : "fill"; "restore" for methods that rewrite; "raw", which restores where a method can do both;
        "any", which restores where it can, and otherwise fills.
    """

    task: str
    setting: str
    starts: Array
    frames: int
    harm: Harm
    does: str = "fill"

    def doing(self, method: Method) -> Windows | None:
        """What the method does here; None if it cannot."""
        if self.does == "any":
            return method.restore or method.fill
        if self.does == "raw":
            return method.restore if method.fill and method.restore else method.fill
        return getattr(method, self.does)


@dataclass(frozen=True, eq=False)
class Block:
    """Some windows of a trial, done.

    truth `(B, T, J, 3)`, NaN for joints that the capture never saw. hidden, judged `(B, T, J)` bool: never such joints.
    guesses : as `truth`, by the name of each method that can do the trial; last the truth itself, under TRUTH.
    """

    truth: Array
    hidden: Array
    judged: Array
    guesses: dict[str, Array]


def played(trial: Trial, corpus: Corpus, methods: Sequence[Method], seed: int, batch: int) -> Iterator[Block]:
    """A trial, `batch` windows at a time.

    All trials of one seed draw the same numbers, so that columns differ by their size and not by luck.
    """
    able = {method.name: do for method in methods if (do := trial.doing(method)) is not None}
    rng = np.random.default_rng(seed)
    for first in range(0, len(trial.starts), batch):
        truth, seen = corpus.windows(trial.starts[first : first + batch], trial.frames)
        damaged, hidden, judged = trial.harm(truth, rng)
        damaged = np.where(hidden[..., None], np.float32(np.nan), damaged)
        guesses = {}
        for name, do in able.items():
            guess = do(damaged, seen & ~hidden, corpus.fps, corpus.skeleton)
            guesses[name] = np.where(seen[..., None], guess, np.float32(np.nan))
        yield Block(truth, hidden & seen, judged & seen, guesses | {TRUTH: truth})


def announced(trials: Sequence[Trial], stage: Stage) -> Iterator[Trial]:
    """The trials, one after the other, with a word on which it is."""
    for number, trial in enumerate(trials, 1):
        stage(f"{trial.task}, {trial.setting} ({number} of {len(trials)})")
        yield trial


class Means:
    """Weighted means by name, gathered bit by bit."""

    def __init__(self):
        self.sums: dict[str, tuple[float, float]] = {}

    def add(self, values: Mapping[str, tuple[float, float]]) -> None:
        """Means with their weights, of some more windows."""
        for name, (value, weight) in values.items():
            total, weights = self.sums.get(name, (0.0, 0.0))
            self.sums[name] = total + value * weight, weights + weight

    def value(self, name: str) -> float:
        """NaN for what has no weight."""
        total, weight = self.sums.get(name, (0.0, 0.0))
        return total / weight if weight else float("nan")

    def values(self) -> dict[str, float]:
        return {name: self.value(name) for name in self.sums}


# Windows ----------------------------------------------------------------------------------------------------


def whole_windows(corpus: Corpus, split: str, frames: int, stride: int, limit: int | None = None) -> Array:
    """First frames `(W,)` of windows in which no joint comes or goes, of a corpus of BODY's joints.

    Raises
    ------
    InputError : for a corpus of other joints, or without such a window.
    """
    refuse_other_joints(corpus)
    found = corpus.starts(split, frames, stride, whole=True)
    if not len(found):
        raise no_window(corpus, split, frames)
    return evenly(found, limit)


def refuse_other_joints(corpus: Corpus) -> None:
    """InputError for a corpus of other joints than BODY's."""
    if corpus.skeleton != BODY:
        raise InputError("its joints are not BODY's", where=corpus.path, hint="build it without --native")


def no_window(corpus: Corpus, split: str, frames: int) -> InputError:
    return InputError(
        f"no whole window of {frames} frames in the split {split!r}", where=corpus.path,
        hint="its clips are too short, or joints are missing everywhere",
    )  # fmt: skip


# Harm -------------------------------------------------------------------------------------------------------


def middle(shape: tuple[int, ...], joints: Sequence[int], frames: int) -> Array:
    """`shape` (B, T, J) bool, True for some joints in the middle `frames`."""
    span = corruption.centred_span(shape[1], frames)
    return np.broadcast_to(corruption.limb_mask(shape[1], shape[2], joints, span), shape)


def missing(joints: Sequence[int], frames: int, *, everywhere: bool = False) -> Harm:
    """Joints lost for so many frames in the middle. Judged is what is lost, or all that is there."""

    def lose(positions: Array, rng: Rng) -> tuple[Array, Array, Array]:
        del rng
        lost = middle(positions.shape[:3], joints, frames)
        return positions, lost, np.ones_like(lost) if everywhere else lost

    return lose


def noisy(sigma: float) -> Harm:
    """Gaussian noise of `sigma` metres on each coordinate of every joint."""

    def shake(positions: Array, rng: Rng) -> tuple[Array, Array, Array]:
        nowhere = np.zeros(positions.shape[:3], bool)
        return corruption.position_noise(positions, sigma, rng), nowhere, ~nowhere

    return shake
