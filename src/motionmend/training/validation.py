"""How good a network is while it trains: its protocol's own metric, and a picture of what it repairs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from ..benchmark.results import evenly
from ..corpora.corpus import Corpus
from ..errors import InputError
from ..motion import Skeleton
from ..networks.models.network import Network
from .config import Settings
from .state import aside

Array = np.ndarray

Validate = Callable[[Network, Corpus, Settings, Path], dict[str, float]]
DRAWN = 3  # windows in a picture


def scores_of(network: Network, corpus: Corpus, settings: Settings, picture: Path) -> dict[str, float]:
    """Scores of a network on the split "validation", and a picture of a few repairs.

    By its protocol where that can be measured on this corpus, otherwise its loss. The windows and their damage
    are the same in every validation.
    """
    from ..benchmark import quick
    from ..networks.loading import module_completer

    completer = module_completer(network, corpus.skeleton)
    draw_samples(completer.windows, corpus, network.frames, picture)
    if judge(network, corpus) == "loss":
        return {"loss": held_out_loss(network, corpus, settings)}
    return quick(network.protocol, completer, corpus, "validation", settings.validation_windows, settings.seed)


def classical_scores(network: Network, corpus: Corpus, settings: Settings) -> tuple[str, dict[str, float]]:
    """Who would do without a network, and how well, on the windows and damage that `scores_of` looks at.

    ("", {}) where validation goes by the loss.
    """
    from ..benchmark import classical, quick

    if judge(network, corpus) == "loss":
        return "", {}
    by, windows = network.protocol, settings.validation_windows
    return classical(by), quick(by, None, corpus, "validation", windows, settings.seed)


def judge(network: Network, corpus: Corpus) -> str:
    """What validation goes by: the network's protocol, or "loss" where it is not for such windows."""
    from ..benchmark import check, protocol

    if not network.protocol:
        return "loss"
    module = protocol(network.protocol)
    try:
        check(module.PROTOCOL, corpus, "validation")
    except InputError:
        return "loss"
    return network.protocol if module.PROTOCOL.frames == network.frames and hasattr(module, "quick") else "loss"


def described(network: Network, corpus: Corpus, settings: Settings) -> str:
    """What validation's numbers are, in a phrase for the model card."""
    from ..benchmark import protocol

    by, where = judge(network, corpus), f"the split validation of {corpus.name}"
    if by == "loss":
        return f"the loss on at most {settings.validation_windows} windows of {where}"
    unit = protocol(by).PROTOCOL.unit
    return f"protocol {by}, quick form: at most {settings.validation_windows} windows of {where}; errors in {unit}"


@torch.no_grad()
def held_out_loss(network: Network, corpus: Corpus, settings: Settings) -> float:
    """The mean loss over windows of the split "validation", corrupted as in training."""
    starts = evenly(corpus.starts("validation", network.frames, 1, pad=True), settings.validation_windows)
    device = next(network.parameters()).device
    losses = []
    for first in range(0, len(starts), settings.batch):
        windows = corpus.windows(starts[first : first + settings.batch], network.frames)
        batch = network.batch(*windows, np.random.default_rng([settings.seed, first]), settings.steps)
        tensors = {name: torch.from_numpy(np.ascontiguousarray(each)).to(device) for name, each in batch.items()}
        losses.append(network.loss(tensors, settings.steps)["loss"].float())
    return float(torch.cat(losses).mean())


def hidden_middles(corpus: Corpus, frames: int, count: int) -> tuple[Array, Array, Array]:
    """Windows whose middle half is hidden: truth and damaged positions `(W, T, J, 3)`, and observed `(W, T, J)`.

    From the split "validation" where there is one, otherwise from "train".
    """
    split = "validation" if corpus.in_split("validation") else "train"
    truth, seen = corpus.windows(evenly(corpus.starts(split, frames, 1, pad=True), count), frames)
    observed = seen.copy()
    observed[:, frames // 4 : frames - frames // 4] = False
    return truth, np.where(observed[..., None], truth, np.float32(np.nan)), observed


def draw_samples(
    repair: Callable[[Array, Array], Array], corpus: Corpus, frames: int, path: Path, moments: int = 7
) -> None:
    """Draw windows whose middle half was hidden: the truth in grey, the repair of hidden frames in colour.

    Parameters
    ----------
    repair : `repair(positions (W, T, J, 3), observed (W, T, J)) -> positions`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    truth, damaged, observed = hidden_middles(corpus, frames, DRAWN)
    repaired = repair(damaged, observed)
    shown = np.linspace(0, frames - 1, min(moments, frames)).astype(int)
    figure = Figure(figsize=(1.8 * len(shown), 2.4 * len(truth)), layout="constrained")
    axes = figure.subplots(len(truth), len(shown), squeeze=False)
    for window, row in enumerate(axes):
        for axis, frame in zip(row, shown):
            hidden = not observed[window, frame].any()
            _draw(axis, truth[window, frame], corpus.skeleton, "0.7")
            if hidden:
                _draw(axis, repaired[window, frame], corpus.skeleton, "tab:red")
            axis.set_aspect("equal")
            axis.set_axis_off()
            axis.set_title(f"frame {frame}" + (", hidden" if hidden else ""), fontsize=8)
    path.parent.mkdir(exist_ok=True)
    with aside(path) as part:
        FigureCanvasAgg(figure).print_png(str(part))


def _draw(axis, pose: Array, skeleton: Skeleton, colour: str) -> None:
    """One pose `(J, 3)` seen at a slant from the front; joints without a number are left out."""
    flat = np.stack([0.8 * pose[:, 0] + 0.6 * pose[:, 2], pose[:, 1] + 0.2 * (0.6 * pose[:, 0] - 0.8 * pose[:, 2])], 1)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            axis.plot(*flat[[joint, parent]].T, color=colour, linewidth=1.2)
    if not skeleton.has_bones:
        axis.plot(*flat.T, ".", color=colour)
