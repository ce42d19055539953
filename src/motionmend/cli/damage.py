"""The verb `damage`: harm done on purpose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional, UseAppendAction

from ..errors import InputError
from .common import Output, Reading


@dataclass(frozen=True, kw_only=True)
class Damage(Reading):
    """Plant damage in a good take, to try a repair on it. The same seed plants the same damage."""

    file: Positional[Path]
    """A good take."""
    output: Output
    """The damaged file."""
    gap: UseAppendAction[tuple[str, ...]] = ()
    """Frames in which all joints are lost: 120:180. In a BVH, which cannot say "missing", they hold still."""
    lost: UseAppendAction[tuple[str, ...]] = ()
    """Joints and frames: LeftForeArm,LeftHand:300:360."""
    held: UseAppendAction[tuple[str, ...]] = ()
    """Joints that freeze while the rest moves, and frames."""
    jump: UseAppendAction[tuple[str, ...]] = ()
    """Joints that jump away and back, and frames."""
    swap: UseAppendAction[tuple[str, ...]] = ()
    """Joints that are exchanged, each with its left or right twin, and frames: LeftHand:40:80."""
    displaced: UseAppendAction[tuple[str, ...]] = ()
    """Joints off by a constant offset, and frames."""
    dropout: float = 0.0
    """Share of single samples lost, 0 to 1."""
    noise: str = "0"
    """Standard deviation of Gaussian noise on positions: 5mm, 0.5cm, 0.005 (metres)."""
    seed: int = 0
    """Seed of the random numbers."""
    force: bool = False
    """Overwrite the output."""

    def run(self) -> int:
        from ..damage.planting import plant
        from ..io import save
        from ..ranges import parse_length, parse_lost, parse_range

        take = self.load(self.file)
        spots = {
            name: [parse_lost(spec, take) for spec in getattr(self, name)]
            for name in ("lost", "held", "jump", "swap", "displaced")
        }
        gaps = [parse_range(gap, len(take), take.fps) for gap in self.gap]
        noise = parse_length(self.noise)
        if not (gaps or any(spots.values()) or self.dropout or noise):
            raise InputError("no damage was named", hint="say --gap, --lost, --held, --jump, --dropout or --noise")
        if not 0 <= self.dropout <= 1:
            raise InputError(f"a dropout of {self.dropout:g}", expected="a share from 0 to 1")
        broken = plant(take, gaps=gaps, dropout=self.dropout, noise=noise, seed=self.seed, **spots)
        print(f"written: {save(broken, self.output, force=self.force)}")
        return 0
