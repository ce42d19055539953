"""What an animation came to: how near the given paths it is, what its bones do, and whether its windows join unseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..body.joints import BODY
from ..constraints.checks import SEAM_FLOOR, SEAM_SLACK
from ..constraints.ground import above_ground
from ..constraints.paths import TOLERANCE
from ..metrics import positional
from ..motion import runs
from ..repairs.report import table, to_json

Array = np.ndarray


@dataclass(frozen=True)
class Unreached:
    """Frames `[start, stop)` in which a joint is more than 5 mm from its path, and by how much at most, mm."""

    start: int
    stop: int
    by: float


@dataclass(frozen=True)
class Controlled:
    """A given path and the joint that was to follow it; `part` is BODY's name for it.

    frames : how many say where the joint is to be, after `joined`, the first and last in `[start, stop)`.
    network, result : the distance between the two in mm, mean and greatest, as the network has it and as it is now; NaN
        without frames. begins : mm from the pose to where the path begins; joined : frames over which the one is led
        into the other, 0 where it begins in the pose.
    """

    joint: str
    frames: int
    network: tuple[float, float]
    result: tuple[float, float]
    unreached: tuple[Unreached, ...] = ()
    begins: float = 0.0
    joined: int = 0
    part: str = ""
    start: int = 0
    stop: int = 0

    @classmethod
    def of(cls, name: str, path: Array, given: Array, own: Array, result: Array, joined: int) -> Controlled:
        """path, own, result : `(frames, 3)` metres; given : `(frames,)` bool."""
        told = given & (np.arange(len(given)) >= max(1, joined))  # frame 0 is the pose's
        off = [1000 * np.linalg.norm(each - path, axis=-1) for each in (own, result)]
        means = [(float(d[told].mean()), float(d[told].max())) if told.any() else (np.nan, np.nan) for d in off]
        first, last = (int(told.argmax()), len(told) - int(told[::-1].argmax())) if told.any() else (0, 0)
        beyond = runs(told & (off[1] > 1000 * TOLERANCE))
        spans = tuple(Unreached(start, stop, float(off[1][start:stop].max())) for start, stop in beyond)
        return cls(name, int(told.sum()), means[0], means[1], spans, joined=joined, start=first, stop=last)


@dataclass(frozen=True)
class Seam:
    """The greatest step in the frames where one window changes into the next, less what the velocity on both sides
    explains, mm; beside 99 % of all other steps. `frames` are where each change begins."""

    value: float
    own: float
    ok: bool
    frames: tuple[int, ...]

    @classmethod
    def of(cls, positions: Array, changes: Sequence[tuple[int, int]]) -> Seam | None:
        """positions : `(frames, J, 3)` metres. changes : frames `[start, stop)`. None without any."""
        inside = np.zeros(len(positions), bool)
        for start, stop in changes:
            inside[start : stop + 2] = True
        jumps = positional.steps(positions)[0]
        ours, usual = (values[np.isfinite(values)] for values in (jumps[inside], jumps[~inside]))
        if not len(ours):
            return None
        worst, own = float(ours.max()), float(np.percentile(usual, 99)) if len(usual) else 0.0
        return cls(worst, own, worst <= max(SEAM_SLACK * own, SEAM_FLOOR), tuple(start for start, _ in changes))


@dataclass(frozen=True)
class Variant:
    """One animation. network_bones, bones : by how much bones are longer or shorter than in the pose, % of their
    length, mean and greatest, as the network has it and as it is now. network_floor, floor : how far the lowest foot is
    above or below where it would stand, mm, mean and greatest, the same way. output : its file."""

    number: int
    control: tuple[Controlled, ...]
    network_bones: tuple[float, float]
    bones: tuple[float, float]
    network_floor: tuple[float, float]
    floor: tuple[float, float]
    seam: Seam | None
    output: str = ""


@dataclass(frozen=True)
class AnimationReport:
    """What was made of a pose, one `Variant` or several. `to_json` is for machines, `str()` for people.

    frame : of the pose in its file. frames : of the animation. diversity : 0 where the best guess was asked for.
    """

    source: str
    format: str
    frame: int
    frames: int
    fps: float
    units: str
    network: str
    seed: int
    diversity: float
    variants: tuple[Variant, ...]
    notes: tuple[str, ...] = ()

    def to_json(self) -> str:
        return to_json(asdict(self))

    @classmethod
    def joined(cls, reports: Sequence[AnimationReport]) -> AnimationReport:
        """One report of several on the same pose."""
        return replace(reports[0], variants=tuple(variant for each in reports for variant in each.variants))

    def written(self, output: str) -> AnimationReport:
        """Of the only variant, with its file."""
        return replace(self, variants=(replace(self.variants[0], output=output),))

    def __str__(self) -> str:
        lines = [
            f"{self.source}: pose of frame {self.frame}, {self.frames} frames at {self.fps:g} fps by {self.network}",
            f"  units: {self.units}",
            *(f"  note: {note}" for note in self.notes),
        ]
        paths = [_path_row(variant, path) for variant in self.variants for path in variant.control]
        if paths:
            head = ("variant", "joint", "network", "now", "not reached")
            lines += ["", "distance from the given paths, mean and greatest", table(head, paths)]
        for path in self.variants[0].control:
            if path.joined:
                lines.append(f"  {path.joint}: its path begins {path.begins:.0f} mm from the pose, and is joined "
                             f"by frame {path.joined}")  # fmt: skip
        head = ("variant", "bones' stretch, network", "now", "lowest foot off the ground, network", "now",
                "step where windows join", "")  # fmt: skip
        lines += ["", "checks", table(head, [_check_row(variant) for variant in self.variants])]
        return "\n".join(lines)


def _path_row(variant: Variant, path: Controlled) -> tuple[str, ...]:
    told = [_millimetres(each) for each in (path.network, path.result)]
    worst = sorted(sorted(path.unreached, key=lambda span: -span.by)[:3], key=lambda span: span.start)
    spans = ", ".join(f"{span.start}:{span.stop} by up to {span.by:.0f} mm" for span in worst)
    rest = f" and {len(path.unreached) - 3} more" if len(path.unreached) > 3 else ""
    return (str(variant.number), path.joint, *told, spans + rest)


def _check_row(variant: Variant) -> tuple[str, ...]:
    stretch = [f"{mean:.2f}, {most:.2f} %" for mean, most in (variant.network_bones, variant.bones)]
    floor = [_millimetres(each) for each in (variant.network_floor, variant.floor)]
    seam = variant.seam
    told = f"{seam.value:.2g} mm; 99 % elsewhere: {seam.own:.2g}" if seam else "one window"
    fine = (seam is None or seam.ok) and not any(path.unreached for path in variant.control)
    return (str(variant.number), *stretch, *floor, told, "ok" if fine else "LOOK")


def _millimetres(values: tuple[float, float]) -> str:
    mean, most = values
    return f"{mean:.1f}, {most:.1f} mm" if np.isfinite(mean) else "–"


def off_ground(positions: Array, ground: float) -> tuple[float, float]:
    """Mean and greatest distance of the lowest foot of `positions (frames, J, 3)` from where it would stand, mm."""
    off = 1000 * np.abs(above_ground(positions, ground))
    return (float(off.mean()), float(off.max())) if np.isfinite(off).all() else (float("nan"), float("nan"))


def stretch(positions: Array, pose: Array, bones: Sequence[int]) -> tuple[float, float]:
    """Mean and greatest change of length of some of BODY's bones, each named by its lower joint, in % of the pose's.

    positions : `(frames, J, 3)`; pose : `(J, 3)`. NaN without bones.
    """
    lengths, usual = (positional.bone_lengths(each, BODY.parents)[..., list(bones)] for each in (positions, pose[None]))
    change = 100 * np.abs(lengths / np.where(usual > 0, usual, np.nan) - 1)
    change = change[np.isfinite(change)]
    return (float(change.mean()), float(change.max())) if len(change) else (float("nan"), float("nan"))
