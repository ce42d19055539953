"""The protocol of Kania et al. 2021 (TrajeVAE): one start pose, the paths of k joints, many samples of what follows.

Also the paths of other windows for the same pose (appendix C): of those whose given joints begin within REACH of where
they are in the pose, both seen from where the body stands and faces. What the other window goes on with is the truth.

The joints are given in the paper's order, which it motivates by the variance of their coordinates: right foot, left
foot, right hand, left hand. For its figure 6, on to all joints, it names none; ORDER goes on by that variance as it is
on the CMU training subjects, with the first pose's hips at the origin. A method sees the start pose and the given paths
in the world, NaN in place of the others, and is never told more. With K = 1 it gives its one best guess.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..body.joints import BODY, JOINT
from ..corpora.corpus import Corpus
from ..metrics.sampling import SampleScores, bone_stretch, control_error, displacements, flattened
from ..progress import Stage, silent
from . import quality
from .method import Method
from .neighbours import Stand
from .results import TRUTH, Cell, Protocol, evenly
from .trials import Means, no_window, whole_windows

Array = np.ndarray

STRIDE = 25  # frames
ORDER = (
    "right_foot", "left_foot", "right_hand", "left_hand", "right_forearm", "right_toe", "right_shin", "left_forearm",
    "left_toe", "left_shin", "right_upper_arm", "head", "left_upper_arm", "left_shoulder", "right_shoulder", "neck",
    "right_thigh", "chest", "left_thigh", "spine", "hips",
)  # fmt: skip
GIVEN = {50: (0, 1, 2, 3, 4, 7, 10, 14, 21), 1: (0, 1, 2, 3, 4)}  # K -> every k
OTHERS, REACH = (50, (1, 2, 3, 4)), 0.01  # K and every k; metres, of the given joints as one vector
BATCH = 16
CLASSICAL = {"sample": "zero-velocity"}
UNITS = {
    "APD": "m", "ADE": "m", "FDE": "m", "MMADE": "m", "MMFDE": "m",
    "control error": "cm", "bone stretch": "%", "greatest bone stretch": "%", "pop after the start pose": "mm",
    **{name: quality.UNITS[name] for name in ("jitter", "foot skate")},
}  # fmt: skip

PROTOCOL = Protocol(
    name="trajevae",
    fps=50,
    frames=101,
    unit="m",
    describe=(
        "Kania et al. 2021, section 4: windows of 1 + 100 frames at 50 fps, every 25 frames. Given: the first "
        "pose and the paths of k joints in the order right foot, left foot, right hand, left hand, then by "
        "variance to all 21. K samples, or for K = 1 one best guess: a network's is its prior's mean, decoded. "
        "APD, ADE, FDE, MMADE, MMFDE are of poses with the hips "
        "at the origin in every frame, the other 20 joints as one vector of 60, in m: about 4 times a mean error "
        "per joint, and not to be compared to the paper's 48 to the digit. ADE and FDE are the least over the "
        "samples; MM: the mean over all windows of the split whose start pose lies within 0.5. Control error: "
        "mean distance of the given joints from their paths, in the world; bone stretch: mean and greatest change "
        "of length against the start pose; both over all samples. Pop: the change of velocity right after the "
        "start pose; that, jitter and foot skate (of feet that are slow and low) are of the first sample. Other paths: "
        "the paths of another window of the split for the same pose, where the given joints begin within 1 cm of "
        "theirs (appendix C); the other window's future is the truth. The authors' code does not turn pairs to face "
        "one way, counts a window with itself as a pair, and takes the future of the pose's own window for the truth."
    ),
    highest=("APD",),
    unjudged=("pop after the start pose",),
)  # fmt: skip


def starts(corpus: Corpus, split: str, limit: int | None = None) -> Array:
    """The windows `(W,)` in which every joint is observed throughout.

    Raises
    ------
    InputError : for a corpus of other joints than BODY's, or without such a window.
    """
    return evenly(_whole(corpus, split)[0], limit)


def _whole(corpus: Corpus, split: str) -> tuple[Array, Array]:
    """All windows of a split: first frames `(W,)` and positions `(W, 1 + T, J, 3)`."""
    found = whole_windows(corpus, split, PROTOCOL.frames, STRIDE)
    positions, observed = corpus.windows(found, PROTOCOL.frames)
    whole = observed.all(axis=(1, 2))
    if not whole.any():
        raise no_window(corpus, split, PROTOCOL.frames)
    return found[whole], positions[whole]


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
    """All columns for all methods that sample; see the package for what a protocol is.

    limit : score at most so many windows; the groups for MMADE and MMFDE are of all.

    Raises
    ------
    InputError : as `starts`.
    """
    del train
    _, truths = _whole(corpus, split)
    chosen = evenly(np.arange(len(truths)), limit)
    # What the truth has of itself does not change with k.
    own = Tally()
    for block in _blocks(chosen):
        own.add_quality(truths[block, 0], truths[block, None, 1:], corpus.fps)
    cells = []
    for count, every in GIVEN.items():
        for given in every:
            task, setting = f"K = {count}", f"k = {given}"
            means = {}
            for method in methods:
                if method.can_sample(count * len(chosen)):
                    stage(f"{method.name}, {task}, {setting}")
                    means[method.name] = measure_one(method, truths, chosen, given, count, seed, corpus.fps)
            means[TRUTH] = own.all()
            for key, unit in UNITS.items():
                cells += [Cell(task, setting, name, key, found[key], None, unit)
                          for name, found in means.items() if key in found]  # fmt: skip
    return cells + _others(truths, methods, corpus.fps, seed, limit, stage)


def _others(
    truths: Array, methods: Sequence[Method], fps: float, seed: int, limit: int | None, stage: Stage
) -> list[Cell]:
    """The columns for the paths of other windows; none where no two windows begin alike."""
    cells, (count, every) = [], OTHERS
    for given in every:
        mixed = exchanged(truths, given)
        chosen = evenly(np.arange(len(mixed)), limit)
        task, setting = f"other paths, K = {count}", f"k = {given}, {len(chosen)} pairs"
        for method in methods if len(mixed) else ():
            if method.can_sample(count * len(chosen)):
                stage(f"{method.name}, {task}, {setting}")
                means = measure_one(method, mixed, chosen, given, count, seed, fps)
                cells += [Cell(task, setting, method.name, key, means[key], None, UNITS[key])
                          for key in ("APD", "ADE", "FDE", "control error", "bone stretch")]  # fmt: skip
    return cells


def exchanged(truths: Array, given: int) -> Array:
    """Windows `(P, 1 + T, J, 3)` that begin with the pose of one of `truths (W, 1 + T, J, 3)` and go on as another."""
    stand = Stand.of(truths[:, 0])
    poses = stand.inward(truths[:, 0])[:, told(given)].reshape(len(truths), -1).astype(float)
    apart = np.linalg.norm(poses[:, None] - poses, axis=-1)
    pose, other = np.nonzero((apart < REACH) & ~np.eye(len(truths), dtype=bool))
    futures = stand[pose].outward(stand[other].inward(truths[other, 1:]))
    return np.concatenate([truths[pose, :1], futures], axis=1, dtype=np.float32)


def measure_one(
    method: Method, truths: Array, chosen: Array, given: int, count: int, seed: int, fps: float
) -> dict[str, float]:
    """One method's means over the `chosen` of all windows `truths (W, 1 + T, J, 3)`, with `given` joints told."""
    scores, tally = SampleScores(truths), Tally()
    for block in _blocks(chosen):
        samples = _samples(method, truths[block], given, count, seed, int(block[0]))
        scores.add(block, samples)
        tally.add_samples(truths[block], samples, told(given))
        tally.add_quality(truths[block, 0], samples, fps)
    found = scores.means() | tally.all()
    return {key: found[key] for key in UNITS if key in found and not (key == "APD" and count == 1)}


def quick(method: Method, corpus: Corpus, split: str, *, windows: int, seed: int = 0) -> dict[str, float]:
    """A few numbers to watch a network by, on so many windows: ADE of 10 samples, the mean over k = 0 to 4, first."""
    positions, _ = corpus.windows(starts(corpus, split, windows), PROTOCOL.frames)
    found: dict[str, list[float]] = {"ADE": [], "FDE": [], "ADE, K = 1": [], "APD": [], "control error": []}
    groups = np.arange(len(positions))
    for given in GIVEN[1]:
        several = measure_one(method, positions, groups, given, 10, seed, corpus.fps)
        for name in ("ADE", "FDE", "APD", *(["control error"] if given else [])):
            found[name].append(several[name])
        guess = _samples(method, positions, given, 1, seed, 0)
        best = [displacements(flattened(some), flattened(truth[None, 1:]))[0] for some, truth in zip(guess, positions)]
        found["ADE, K = 1"].append(float(np.mean(best)))
    return {name: float(np.mean(values)) for name, values in found.items()}


def told(count: int) -> Array:
    """`(J,)` bool: the first `count` joints of ORDER."""
    mask = np.zeros(len(BODY), bool)
    mask[[JOINT[name] for name in ORDER[:count]]] = True
    return mask


def _samples(method: Method, truths: Array, given: int, count: int, seed: int, first: int) -> Array:
    """The method's `(B, K, T, J, 3)` for windows `truths (B, 1 + T, J, 3)`, of which it sees what it may see."""
    assert method.sample is not None
    mask = np.broadcast_to(told(given), truths[:, 1:].shape[:-1])
    trajectories = np.where(mask[..., None], truths[:, 1:], np.float32(np.nan))
    own = int(np.random.SeedSequence([seed, given, count, first]).generate_state(1)[0])
    samples = method.sample(truths[:, 0].copy(), trajectories, mask.copy(), count, own)
    wanted = (len(truths), count, *truths[:, 1:].shape[1:])
    if samples.shape != wanted:
        raise ValueError(f"{method.name} gave samples {samples.shape}, not {wanted}")
    same = np.array_equal(samples, np.broadcast_to(samples[:, :1], wanted))
    return samples[:, :1] if same else samples  # one guess, K times over, scores the same, and sooner


def _blocks(chosen: Array) -> list[Array]:
    return [chosen[first : first + BATCH] for first in range(0, len(chosen), BATCH)]


class Tally(Means):
    """Means of what is measured in the world, and the greatest bone stretch."""

    def __init__(self):
        super().__init__()
        self.greatest = float("nan")

    def add_samples(self, truths: Array, samples: Array, given: Array) -> None:
        """Control error and bone stretch of `samples (B, K, T, J, 3)`; given `(J,)` bool."""
        mask = np.broadcast_to(given, samples.shape[2:4])
        for truth, some in zip(truths, samples):
            if given.any():
                self.add({"control error": (control_error(some, truth[1:], mask), 1)})
            mean, greatest = bone_stretch(some, truth[0], BODY.parents)
            self.add({"bone stretch": (mean, 1)})
            self.greatest = float(np.fmax(self.greatest, greatest))

    def add_quality(self, pose: Array, samples: Array, fps: float) -> None:
        """The pop after `pose (B, J, 3)`, jitter and foot skate of the first of `samples (B, K, T, J, 3)`."""
        first = samples[:, 0]
        pop = np.linalg.norm(first[:, 1].astype(float) - 2 * first[:, 0] + pose, axis=-1)
        self.add({"pop after the start pose": (float(pop.mean()) * 1000, len(pop))})
        whole = np.concatenate([pose[:, None], first], axis=1)
        touched = np.ones(whole.shape[:3], bool)
        # Against itself: its feet stand when they stand, not when the true ones would.
        found = quality.measure(whole, whole, touched, fps, BODY)
        self.add({name: found[name] for name in ("jitter", "foot skate") if name in found})

    def all(self) -> dict[str, float]:
        return self.values() | ({"greatest bone stretch": self.greatest} if np.isfinite(self.greatest) else {})
