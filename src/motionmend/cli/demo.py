"""The verb `demo`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .common import Output


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Repair a bundled damaged take, and write it, its report and a picture into a folder."""

    output: Output = Path("demo")
    """The folder."""

    def run(self) -> int:
        from ..repairs.demonstration import demo

        demo(self.output)
        return 0
