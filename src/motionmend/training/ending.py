"""What a finished run leaves behind: the trained network as a checkpoint folder, with what it took."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from accelerate import Accelerator

from ..corpora.corpus import Corpus
from ..networks.models.network import Network
from .config import Settings
from .runs import machine
from .validation import hidden_middles

Export = Callable[[Network, Path, Sequence[Corpus], dict[str, Any], dict[str, float]], object]


def budget(
    settings: Settings, corpora: Sequence[Corpus], steps: int, seconds: float, accelerator: Accelerator
) -> dict[str, Any]:
    """What training took, for the checkpoint and its model card.

    steps : taken by the weights that are exported. seconds : that the whole run took.
    """
    from ..benchmark.provenance import commit

    def words(each: Sequence[str]) -> str:
        return "; ".join(dict.fromkeys(each))

    return ({"began with": began(settings.start)} if settings.start else {}) | {
        "steps": steps, "steps of the run": settings.steps, "batch": settings.batch, "seconds": round(seconds),
        "machine": machine(accelerator.device), "processes": accelerator.num_processes,
        "threads": torch.get_num_threads(), "precision": settings.precision, "seed": settings.seed, "commit": commit(),
        "corpus": ", ".join(each.name for each in corpora), "data sha256": ", ".join(each.sha256 for each in corpora),
        "licence": words([each.licence for each in corpora]), "credit": words([each.credit for each in corpora]),
    }  # fmt: skip


def began(start: str) -> str:
    """The weights that training began with, in words."""
    from ..networks.checkpoints import load

    checkpoint = load(start)
    return f"{checkpoint.name}: {checkpoint.summary}"


def exported(
    network: Network, folder: Path, corpora: Sequence[Corpus], spent: dict[str, Any], scores: dict[str, float]
) -> Path:
    """Export into the run's own folder, in place of an earlier export; checked on real windows."""
    from ..networks.export import export

    _, positions, observed = hidden_middles(corpora[0], network.frames, 8)
    return export(
        network, folder, skeleton=corpora[0].skeleton, windows=(positions, observed), budget=spent,
        validation=scores, force=True,
    )  # fmt: skip
