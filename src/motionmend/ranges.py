"""Stretches of a take as people write them: `120:180`, `0.5s:0.8s`, `LeftForeArm,LeftHand:300:360`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

import numpy as np

from .errors import InputError
from .motion import Array, Take

_TIME = re.compile(r"(-?\d+)|(-?\d*\.?\d+(?:[eE][-+]?\d+)?)s")

Range = str | tuple[int | None, int | None]


def parse_range(range: Range, frames: int, fps: float) -> tuple[int, int]:
    """The frames `[start, stop)` a range means in a take: zero-based, half-open, as in Python.

    `"120:180"`, `"0.5s:0.8s"`, `":60"`, `"-30:"` (the last thirty), or a tuple `(120, 180)`. A time means the
    nearest frame. InputError if it cannot be read or holds no frame of the take.
    """
    parts = range.strip().split(":") if isinstance(range, str) else list(range)
    if len(parts) != 2:
        raise InputError(f"cannot read the range {range!r}", expected="start:stop, such as 120:180 or 0.5s:0.8s")
    start, stop = (_frame(part, range, fps) for part in parts)
    begin, end, _ = slice(start, stop).indices(frames)
    if begin >= end:
        raise InputError(f"the range {range!r} holds no frame of a take of {frames} frames ({frames / fps:.3f} s)")
    return begin, end


def parse_frames(text: str, fps: float) -> int:
    """A length in frames, from `"60"` or `"0.5s"`."""
    frames = _frame(text, text, fps)
    if frames is None or frames < 0:
        raise InputError(f"cannot read the length {text!r}", expected="frames (60) or seconds (0.5s)")
    return frames


def _frame(part: str | int | None, whole: object, fps: float) -> int | None:
    if part is None or part == "":
        return None
    if isinstance(part, int | np.integer):
        return int(part)
    if isinstance(part, str) and (match := _TIME.fullmatch(part.strip())):
        frames, seconds = match.groups()
        # Halves go up, so that neighbouring ranges in seconds meet without a frame lost or shared.
        return int(frames) if frames else math.floor(float(seconds) * fps + 0.5)
    hint = "frames are whole numbers, times end in s"
    raise InputError(f"cannot read {part!r} in {whole!r}", expected="a frame (120) or a time (0.5s)", hint=hint)


def split_names(spec: str, take: Take) -> tuple[list[int], str]:
    """The joints that `spec` names and what follows their last colon: `"A,B:300:360"` → ([a, b], "300:360").

    Names are matched exactly and may hold colons themselves; without a range the whole take is meant (":").
    """
    known = take.skeleton.names
    for colons in (2, 0):
        names, *rest = spec.rsplit(":", colons) if colons else [spec]
        listed = [names] if names in known else names.split(",")
        if len(rest) == colons and all(name in known for name in listed):
            return [take.skeleton.index(name) for name in listed], ":".join(rest) or ":"
    tail = re.search(r":[^:]*:[^:]*$", spec)
    names = spec[: tail.start()] if tail else spec
    for name in names.split(","):
        take.skeleton.index(name)  # raises, and names the nearest
    raise InputError(f"cannot read {spec!r}", expected="joints:start:stop, such as LeftForeArm,LeftHand:300:360")


def parse_length(text: str) -> float:
    """A length in metres, from `"5mm"`, `"0.5cm"`, `"0.005m"` or plain metres."""
    match = re.fullmatch(r"\s*(\d*\.?\d+(?:[eE][-+]?\d+)?)\s*(mm|cm|m|)\s*", text)
    if not match:
        raise InputError(f"cannot read the length {text!r}", expected="a number with its unit, such as 5mm")
    return float(match[1]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "": 1.0}[match[2]]


Lost = str | tuple[str | Iterable[str], int | None, int | None]


def parse_lost(lost: Lost, take: Take) -> tuple[list[int], int, int]:
    """The joints and frames of one `--lost`: a string, or a tuple `(names, start, stop)`."""
    if isinstance(lost, str):
        joints, range = split_names(lost, take)
    else:
        names, start, stop = lost
        names = [names] if isinstance(names, str) else names
        joints, range = [take.skeleton.index(name) for name in names], (start, stop)
    return joints, *parse_range(range, len(take), take.fps)


def mask_of(take: Take, gaps: Iterable[Range] = (), lost: Iterable[Lost] = ()) -> Array:
    """The `(frames, joints)` bool mask of what `gaps` (all joints) and `lost` (some) name."""
    mask = np.zeros((len(take), len(take.skeleton)), bool)
    for gap in gaps:
        start, stop = parse_range(gap, len(take), take.fps)
        mask[start:stop] = True
    for item in lost:
        joints, start, stop = parse_lost(item, take)
        mask[start:stop, joints] = True
    return mask
