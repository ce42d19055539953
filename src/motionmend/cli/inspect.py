"""The verb `inspect`: what is in a take, and what cannot be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from tyro.conf import Positional

from .common import Files, Reading, each


@dataclass(frozen=True, kw_only=True)
class Inspect(Reading):
    """Say what is in a take, which rig it is, and what is untrusted and why. Changes nothing."""

    files: Positional[Files]
    """Takes: BVH, AMC (with its ASF), C3D, TRC, CSV, NPZ."""
    map: Optional[Path] = None
    """A TOML file that says which joint is which: `left_forearm = "LeftElbow"`."""
    json: bool = False
    """Print JSON for machines."""

    def run(self) -> int:
        from ..repairs.inspecting import inspect

        def one(path: Path) -> None:
            print(inspect(self.load(path), self.map, as_json=self.json))

        return each(self.files, one)
