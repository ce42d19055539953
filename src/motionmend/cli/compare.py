"""The verb `compare`: how far one take is from another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from tyro.conf import Positional

from .common import Reading


@dataclass(frozen=True, kw_only=True)
class Compare(Reading):
    """Measure how far a take is from another: MPJPE, bone lengths, seams, samples that differ."""

    file: Positional[Path]
    """The reference."""
    other: Positional[Path]
    """The take to measure."""
    frames: Optional[str] = None
    """Only these frames: 120:180 or 1s:1.5s."""
    json: bool = False
    """Print JSON for machines."""

    def run(self) -> int:
        from ..repairs.comparison import compare

        result = compare(self.load(self.file), self.load(self.other), self.frames)
        print(result.to_json() if self.json else result)
        return 0
