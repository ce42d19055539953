"""The verb `blend`: joints of one take, the motion of another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional, arg

from .common import Output, Reading, checked, written


@dataclass(frozen=True, kw_only=True)
class Blend(Reading):
    """Put the motion that some joints have in another take into this one; touch nothing else.

    The joints are turned as a body sees them from where it faces, and take some time to go there and back.
    """

    file: Positional[Path]
    """The take."""
    output: Output
    """The new file."""
    source: Annotated[Path, arg(name="from", metavar="FILE")]
    """The take whose motion is put in; of any rate, and of any rig in which a person is found."""
    joints: Annotated[str, arg(metavar="NAMES")]
    """Joints, named as in the take: RightArm,RightForeArm,RightHand."""
    frames: Annotated[str, arg(metavar="START:STOP")]
    """Which frames of the other take: 40:55 or 0.5s:0.8s."""
    at: Annotated[str, arg(metavar="FRAME")]
    """Where they begin in this one: 120 or 2s."""
    fade: str = "0.4s"
    """How long the joints take to go there, and to go back."""
    whole: bool = False
    """Hide the rest of the body for that time, too, so that a network may let it answer."""
    method: str = "auto"
    """How to fill; a method of `repair`."""
    map: Optional[Path] = None
    """A TOML file that says which joint is which."""
    json: bool = False
    """Print the report as JSON."""
    force: bool = False
    """Overwrite files that exist."""

    def run(self) -> int:
        from ..composition.blending import blend
        from ..progress import following

        checked(self.output, (self.file, self.source), self.force)
        with following(self.file.name) as stage:
            stage("reading")
            take, source = self.load(self.file), self.load(self.source)
            result = blend(
                take, source, joints=self.joints, frames=self.frames, at=self.at, fade=self.fade, whole=self.whole,
                method=self.method, map=self.map, stage=stage,
            )  # fmt: skip
        return written(result, self)
