"""The verb `convert`: the same take in another format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from .common import Output, Reading


@dataclass(frozen=True, kw_only=True)
class Convert(Reading):
    """Write a take in another format: BVH, C3D, TRC, CSV, NPZ, or GLB for Blender and game engines."""

    file: Positional[Path]
    """The take."""
    output: Output
    """The new file; its suffix names the format."""
    force: bool = False
    """Overwrite the output."""

    def run(self) -> int:
        from ..io import save

        take = self.load(self.file)
        print(f"written: {save(take, self.output, force=self.force)}")
        return 0
