"""Any folder of takes that the readers know, and of which nothing else is known.

Units, axes, rig and rate are found as for a single take. The file's y = 0 is kept as the ground where the feet stand
within 15 cm of it, as they do in what was captured with a floor; otherwise the ground is under the feet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from ...errors import InputError
from ...io import FORMATS
from ...progress import Stage, silent
from ..corpus import Dropped
from .raw import Raw, Source
from .reading import takes

NAME = ""  # the folder's own
LICENCE = "unknown"
CREDIT = ""
# Text files are as good as never takes: licences, read-me files.
SUFFIXES = tuple(end for format in FORMATS.values() if format.reads for end in format.suffixes if end != ".txt")


def read(source: Path, *, stage: Stage = silent, rates: Mapping[str, float] | None = None) -> Iterator[Raw | Dropped]:
    """The takes in a folder and the folders below it, by path; in no split.

    Parameters
    ----------
    rates : true frames per second of files whose own word is wrong, by relative path.

    Raises
    ------
    InputError : if the folder holds no take.
    """
    paths = [
        path
        for path in sorted(source.rglob("*"))
        if path.suffix.lower() in SUFFIXES and path.is_file() and not path.name.startswith(".")
    ]
    if not paths:
        raise InputError("no take in this folder", where=source, expected=f"files ending in {', '.join(SUFFIXES)}")
    stems = [path.relative_to(source).with_suffix("").as_posix() for path in paths]
    sources = []
    for path, stem in zip(paths, stems):
        file = path.relative_to(source).as_posix()
        name = stem if stems.count(stem) == 1 else file
        sources.append(Source(path, file, name, licence=LICENCE, fps=(rates or {}).get(file)))
    yield from takes(sources, stage)
