"""Options that several verbs share, said at length: for `tuple[Path, ...]` tyro imports typeguard, which is slow."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg
from tyro.constructors import PrimitiveConstructorSpec


def paths(what: str) -> PrimitiveConstructorSpec:
    """Any number of paths, shown in the help as `what`."""
    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=f"{what} [{what} ...]",
        instance_from_str=lambda names: tuple(map(Path, names)),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda paths: [str(path) for path in paths],
    )


Files = Annotated[tuple, paths("FILE")]
Folders = Annotated[tuple, paths("FOLDER")]
Output = Annotated[Path, arg(aliases=["-o"], metavar="PATH")]
