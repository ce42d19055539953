"""ReActIdle (arXiv 2509.05023): 22 takes of people who idle, acted and genuine; BVH, 24 fps, no hands, no toes.

The files' y = 0 is near the hips, 0.6 to 0.9 m above the ankles, so the ground is where the feet stand. Bone lengths
are of each take's own: people come out 1.4 to 2.0 m tall, and the legs of 003 acted and 003 genuine, perhaps one
person's, differ by 14 % (the genuine one has the bones of 002), so takes are not held against each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...errors import InputError
from ...progress import Stage, silent
from ..corpus import Dropped
from .raw import Raw, Source
from .reading import takes

NAME = "reactidle"
LICENCE = "MIT"
CREDIT = "ReActIdle, arXiv 2509.05023."


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The takes in acted/ and genuine/, all of the train split.

    Raises
    ------
    InputError : if there are none.
    """
    folder = next((each for each in (source, source / "reactidle") if (each / "acted").is_dir()), source)
    paths = sorted([*folder.glob("acted/*.bvh"), *folder.glob("genuine/*.bvh")])
    if not paths:
        raise InputError("no take", where=source, expected="acted/001_acted.bvh, genuine/000_genuine.bvh, …")
    sources = [
        Source(
            path, path.relative_to(folder).as_posix(), path.stem, subject=path.stem.split("_")[0], split="train",
            licence=LICENCE, ground="feet",
        )
        for path in paths
    ]  # fmt: skip
    yield from takes(sources, stage)
