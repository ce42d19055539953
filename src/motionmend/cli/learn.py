"""The verb `learn`: takes in, one memory out, for many repairs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from .common import Files, Output, Reading, complain


@dataclass(frozen=True, kw_only=True)
class Learn(Reading):
    """Remember takes, so that repairs can learn from them: repair … --learn session.memory."""

    files: Positional[Files]
    """Takes, folders of takes, patterns, or other memories."""
    output: Output
    """The memory, such as session.memory."""
    force: bool = False
    """Overwrite a file that exists."""

    def run(self) -> int:
        from ..errors import InputError
        from ..progress import following
        from ..repairs.learning import learn

        if self.output.exists() and not self.force:
            hint = "choose another name, or overwrite it with --force"
            raise InputError("the file exists", where=self.output, hint=hint)
        bad = []

        def skip(error: Exception, path: Path) -> None:
            bad.append(complain(error, path))

        with following(self.output.name) as stage:
            memory = learn(self.files, skip=skip, read=self.load, stage=stage)
        path = memory.save(self.output, force=self.force)
        print(f"{memory}\nwritten: {path} ({path.stat().st_size / 1e6:.1f} MB)")
        return min(len(bad), 1)
