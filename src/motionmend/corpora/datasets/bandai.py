"""Bandai-Namco Research Motiondataset-2 (arXiv 2306.08861): clips of 10 contents in 7 styles, BVH at 30 fps, 22
joints.

All have one figure's bones (legs of 0.801 m in all 1,451). The lowest joint, the ball of a foot, stands at 0.042 m,
the height of the figure's sole (in runs, whose feet hardly rest, at 0.055 m): y = 0 is the ground. The licence
forbids commercial use, of weights too.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...errors import InputError
from ...progress import Stage, silent
from ..corpus import Dropped
from .raw import Raw, Source
from .reading import takes

NAME = "bandai"
LICENCE = "CC-BY-NC-4.0"
CREDIT = "Bandai-Namco Research Motiondataset, arXiv 2306.08861."
PREFIX = "dataset-2_"


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The clips in data/, all of the train split.

    Raises
    ------
    InputError : if there are none.
    """
    folder = next((each for each in (source, source / "bandai-namco-2") if (each / "data").is_dir()), source)
    paths = sorted(path for path in folder.rglob("*.bvh") if path.name.startswith(PREFIX))
    if not paths:
        raise InputError("no clip", where=source, expected=f"data/{PREFIX}walk_normal_001.bvh, …")
    sources = [
        Source(
            path, path.relative_to(folder).as_posix(), path.stem.removeprefix(PREFIX), split="train", licence=LICENCE,
            unit="cm", ground="file",
        )
        for path in paths
    ]  # fmt: skip
    yield from takes(sources, stage)
