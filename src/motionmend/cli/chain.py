"""The verb `chain`: one motion of several clips."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional

from .common import Output, Reading, checked, paths, written

Clips = Annotated[tuple, paths("CLIP")]
_RANGE = re.compile(r"(.+):([^:/\\]*:[^:/\\]*)")


@dataclass(frozen=True, kw_only=True)
class Chain(Reading):
    """Make one motion of several clips: each goes on from where the last one ended, and the gaps are filled.

    Clips are turned about the vertical and moved on the floor, and stay as they are in all else.
    """

    clips: Positional[Clips]
    """Takes in their order. walk.bvh:40:80 means these frames of it."""
    output: Output
    """The new file, with the first clip's rig and rate."""
    gap: str = "1s"
    """Between two clips: 75 or 1.25s; 50,100,75 for one length each."""
    method: str = "auto"
    """How to fill; a method of `repair`."""
    map: Optional[Path] = None
    """A TOML file that says which joint is which."""
    json: bool = False
    """Print the report as JSON."""
    force: bool = False
    """Overwrite files that exist."""

    def run(self) -> int:
        from ..composition.chaining import chain
        from ..progress import following

        named = [_clip(str(name)) for name in self.clips]
        checked(self.output, [path for path, _ in named], self.force)
        with following(self.output.name) as stage:
            stage("reading")
            takes = {path: self.load(path) for path in dict.fromkeys(path for path, _ in named)}
            result = chain(
                [(takes[path], frames) for path, frames in named], gap=self.gap, method=self.method, map=self.map,
                stage=stage,
            )  # fmt: skip
        return written(result, self)


def _clip(name: str) -> tuple[Path, str]:
    """A file and its frames: all of them, unless two numbers follow its name."""
    found = _RANGE.fullmatch(name)
    if found and not Path(name).exists():
        return Path(found[1]), found[2]
    return Path(name), ":"
