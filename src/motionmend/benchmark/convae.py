"""The protocol of Kaufmann et al. 2020 (ConvAE): tables 1 and 2, lost joints, gap and context sweeps, bone lengths.

What the paper's "root overwritten" means, read in the authors' code. Their networks give poses in body-local space:
relative to the root on the floor, seen along the heading, and that root path and heading are replaced by the true ones
before poses are compared in the world. What is left is the distance between body-local poses, and the same can be had
of any method that gives world positions: `rows.body_local` takes from each motion, the true one and the guessed one,
its own root path and heading. This is the metric BODY_LOCAL, and compares with the paper's rows of networks.
The paper's row "Linear Interpolation" is not computed so: it interpolates world positions and compares them in the
world, with the root's own error in them. This is the metric WORLD; the paper's row is that of `linear`.
Both are means over the joints but the root on the floor (21 there, BODY's 21 here), with the standard deviation over
all joints and frames, not over windows.

Not as in the paper: joints of a clip that is shorter than a window are not held still to pad it, those clips are
left out; subjects are split, not clips; the noise and dropout experiments there leave the root path alone and count
the root's zero error (a factor of 21/22), here the world positions are damaged and the root is not counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..body.joints import BODY, JOINT
from ..corpora.corpus import Corpus
from ..damage import corruption
from ..metrics import positional
from ..networks.rows import body_local
from ..progress import Stage, silent
from . import quality
from .figures import box_figure, stem
from .method import Method
from .results import TRUTH, Cell, Protocol, evenly
from .trials import Harm, Means, Trial, announced, missing, noisy, played, whole_windows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = np.ndarray

BODY_LOCAL, WORLD = "3D error, body-local", "3D error, world"
LOST_ONLY = "3D error of the lost samples, world"
STRIDE = 120  # frames between windows, as the paper's own are cut
GAPS = {0: "any", 60: "fill", 120: "fill"}  # frames, and what methods do
SAMPLED = 400  # windows for noise and dropout
NOISES = (0.0625, 0.09375)  # metres per axis: sigma = 1.0 and 1.5 in data units of 6.25 cm
DROPOUTS = (0.3, 0.5)
LOST = {  # figure 8
    "left elbow and hand": ("left_forearm", "left_hand"),
    "both knees, right toe": ("right_shin", "left_shin", "right_toe"),
}
SWEPT_GAPS, SEED_FRAMES = (5, 20, 80, 250), 50  # frames; the paper does not say how many were known
CONTEXTS, CONTEXT_GAP = (1, 5, 10, 25, 50), 80
BONES = {  # figure 5: the bone that ends in
    "right thigh": "right_shin", "right shin": "right_foot", "left thigh": "left_shin",
    "right foot": "right_toe", "spine": "chest", "right forearm": "right_hand",
}  # fmt: skip
PERCENTILES = (5, 25, 50, 75, 95)
BONE_TASKS = {"0 frames": "bone lengths, whole window", "120 frames": "bone lengths, gap of 120 frames"}  # of infilling
BATCH = 64
CLASSICAL = {"fill": "hermite"}
EVERYONE = range(len(BODY))

PROTOCOL = Protocol(
    name="convae",
    fps=60,
    frames=240,
    unit="cm",
    describe=(
        "Kaufmann et al. 2020, section 4: windows of 240 frames at 60 fps, every 120 frames; clips shorter than a "
        "window are left out. Infilling (table 1): a gap of every joint for 0, 60 or 120 frames in the middle, "
        "errors over the gap only, and over the whole window for 0 frames, where networks rewrite and fills are "
        f"exactly 0. Noise and dropout (table 2): {SAMPLED} windows drawn from the split, all if it has fewer; "
        "Gaussian noise of 62.5 and 93.75 mm per axis; each joint of each frame lost with probability 0.3 and "
        "0.5; errors over the whole window. Lost joints: two or three for the whole window, as in figure 8. For "
        "dropout and lost joints a network's raw output is measured over the whole window, as in the paper, and "
        f"what it puts in place of the lost samples alone. Gap length: 5 to 250 frames between {SEED_FRAMES} known "
        f"ones on each side, of the same moments; context: 1 to 50 known frames on each side of {CONTEXT_GAP}. "
        "Body-local errors are between poses relative to each motion's own root path and heading: the paper's "
        "rows of networks, where these are overwritten with the truth. Errors in the world are the paper's row "
        "Linear Interpolation, read at linear. Means and standard deviations in cm over all joints and frames. "
        "The noise is on positions in the world, so it also disturbs the path, heading and travel that a network is "
        "shown; the authors add it to poses in body-local space and leave the travel clean. "
        "Bone lengths: percentiles over windows and frames, in per cent of the true length (figure 5)."
    ),
    unjudged=tuple(BONES),
    spread=True,
)  # fmt: skip


def starts(corpus: Corpus, split: str, limit: int | None = None) -> Array:
    """The windows `(W,)` of tables 1 and 2; InputError as `trials.whole_windows`."""
    return whole_windows(corpus, split, PROTOCOL.frames, STRIDE, limit)


def trials(corpus: Corpus, split: str, seed: int = 0, limit: int | None = None) -> list[Trial]:
    """All of the protocol. Sweeps whose windows the split does not have are left out.

    Raises
    ------
    InputError : for a corpus of other joints than BODY's, or without a whole window of 240 frames.
    """
    frames, windows = PROTOCOL.frames, starts(corpus, split, limit)
    drawn = np.sort(np.random.default_rng(seed).permutation(windows)[:SAMPLED])
    found = [
        Trial("infilling", _frames(gap), windows, frames, missing(EVERYONE, gap, everywhere=not gap), GAPS[gap])
        for gap in GAPS
    ]
    found += [Trial("noise", f"{sigma * 1000:g} mm", drawn, frames, noisy(sigma), "restore") for sigma in NOISES]
    found += [Trial("dropout", f"{share:.0%}", drawn, frames, dropped(share), "raw") for share in DROPOUTS]
    for name, joints in LOST.items():
        lost = missing([JOINT[joint] for joint in joints], frames, everywhere=True)
        found.append(Trial("joints lost", name, drawn, frames, lost, "raw"))
    longest = max(SWEPT_GAPS) + 2 * SEED_FRAMES
    swept = evenly(corpus.starts(split, longest, STRIDE, whole=True), limit)
    found += [_sweep("gap length", swept, longest, gap, SEED_FRAMES, _frames(gap)) for gap in SWEPT_GAPS]
    longest = CONTEXT_GAP + 2 * max(CONTEXTS)
    swept = evenly(corpus.starts(split, longest, STRIDE, whole=True), limit)
    found += [_sweep("context", swept, longest, CONTEXT_GAP, known, _frames(known)) for known in CONTEXTS]
    return [trial for trial in found if len(trial.starts)]


def _sweep(task: str, windows: Array, longest: int, gap: int, known: int, setting: str) -> Trial:
    """The middle of longer windows, so that every column has its gap around the same moments."""
    frames = gap + 2 * known
    return Trial(task, setting, windows + (longest - frames) // 2, frames, missing(EVERYONE, gap))


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

    limit : at most so many windows for each task.

    Raises
    ------
    InputError : as `trials`.
    """
    del train
    cells = []
    for trial in announced(trials(corpus, split, seed, limit), stage):
        for name, tally in measure_trial(trial, corpus, methods, seed).items():
            cells += tally.cells(trial, name)
    return sorted(cells, key=lambda cell: cell.task in BONE_TASKS.values())  # bones after errors


def quick(method: Method, corpus: Corpus, split: str, *, windows: int, seed: int = 0) -> dict[str, float]:
    """A few numbers to watch a network by, on so many windows: the mean of gaps of 60 and 120 frames first."""
    tried = [trial for trial in trials(corpus, split, seed, windows) if trial.task in ("infilling", "dropout")]
    found = {trial.setting: measure_trial(trial, corpus, [method], seed, False)[method.name] for trial in tried}
    errors = {setting: float(tally.errors[BODY_LOCAL].mean) for setting, tally in found.items()}
    return {
        "infilling, body-local": (errors["60 frames"] + errors["120 frames"]) / 2,
        "60 frames": errors["60 frames"],
        "120 frames": errors["120 frames"],
        "120 frames, world": float(found["120 frames"].errors[WORLD].mean),
        "0 frames": errors["0 frames"],
        "dropout 30%": errors["30%"],
    }


def measure_trial(
    trial: Trial, corpus: Corpus, methods: Sequence[Method], seed: int, judge_quality: bool = True
) -> dict[str, Tally]:
    """What each method that can do the trial scored, by its name, and the truth's own quality under TRUTH."""
    tallies: dict[str, Tally] = {}
    for block in played(trial, corpus, methods, seed, BATCH):
        truth, judged, poses = block.truth, block.judged, body_local(block.truth)
        standing = quality.contacts(truth, corpus.fps, BODY) if judge_quality else None
        for name, guess in block.guesses.items():
            tally = tallies.setdefault(name, Tally())
            if name != TRUTH:
                tally.add(BODY_LOCAL, positional.distances(poses, body_local(guess))[judged] * 100)
                apart = positional.distances(truth, guess) * 100
                tally.add(WORLD, apart[judged])
                if trial.does == "raw":
                    tally.add(LOST_ONLY, apart[block.hidden])
            if judge_quality:
                tally.quality.add(quality.measure(truth, guess, judged, corpus.fps, BODY, standing))
            if _bone_task(trial):
                tally.add_bones(truth, guess, judged)
    return tallies


def _bone_task(trial: Trial) -> str | None:
    """The task under which a trial's bone lengths are told, if it looks at them."""
    return BONE_TASKS.get(trial.setting) if trial.task == "infilling" else None


class Tally:
    """What comes together over the batches of a trial for one method."""

    def __init__(self):
        self.errors: dict[str, positional.Moments] = {}
        self.quality = Means()
        self.lengths: dict[str, list[Array]] = {}

    def add(self, name: str, errors: Array) -> None:
        self.errors.setdefault(name, positional.Moments()).add(errors)

    def add_bones(self, truth: Array, guess: Array, judged: Array) -> None:
        """The lengths of BONES at the judged samples, in per cent of the true ones."""
        true, guessed = (positional.bone_lengths(positions, BODY.parents) for positions in (truth, guess))
        for bone, end in BONES.items():
            joint = JOINT[end]
            here = judged[..., joint] & (true[..., joint] > 0)
            if here.any():  # some rigs have no toes
                shares = 100 * guessed[..., joint][here] / true[..., joint][here]
                self.lengths.setdefault(bone, []).append(shares.astype(np.float32))

    def cells(self, trial: Trial, method: str) -> Iterator[Cell]:
        """All that is known; a method that left samples empty has errors of NaN, and nothing else to be judged by."""
        for name, moments in self.errors.items():
            yield Cell(trial.task, trial.setting, method, name, float(moments.mean), float(moments.std), PROTOCOL.unit)
        if any(np.isnan(moments.mean) for moments in self.errors.values()):
            return
        for name, value in self.quality.values().items():
            yield Cell(trial.task, trial.setting, method, name, value, None, quality.UNITS[name])
        task = _bone_task(trial) or ""
        for bone, parts in self.lengths.items():
            for share, value in zip(PERCENTILES, np.percentile(np.concatenate(parts), PERCENTILES)):
                yield Cell(task, f"{share}th percentile", method, bone, float(value), None, "%")


def figures(cells: Sequence[Cell]) -> dict[str, Figure]:
    """Box plots of bone lengths by the cells' percentiles, as figure 5: one PNG a task, in place of its lines."""
    drawn = {}
    for task in BONE_TASKS.values():
        found = {(c.method, c.metric, c.setting): c.value for c in cells if c.task == task and c.method != TRUTH}
        bones = list(dict.fromkeys(bone for _, bone, _ in found))
        rows = {
            name: [[found[name, bone, f"{share}th percentile"] for share in PERCENTILES] for bone in bones]
            for name in dict.fromkeys(name for name, _, _ in found)
        }
        if rows:
            title = f"{task}: median, quartiles, 5th and 95th percentile"
            drawn[stem(task)] = box_figure(title, rows, bones, "length, % of the true one", 100)
    return drawn


def dropped(share: float) -> Harm:
    """Each joint of each frame lost with this probability, on its own; all is judged."""

    def drop(positions: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        hidden = corruption.dropouts(positions.shape[:3], share, rng)
        return positions, hidden, np.ones_like(hidden)

    return drop


def _frames(count: int) -> str:
    return f"{count} frames" if count != 1 else "1 frame"
