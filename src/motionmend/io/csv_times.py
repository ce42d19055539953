"""A table's frames per second: from the user, a header, or a column of times."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from ..units import Hints
from .csv_cells import Text
from .csv_headers import Layout

Array = np.ndarray

_PER_SECOND = ((r"\bm(illi)?s", 1e3), (r"\b(us|µs|microsec\w*)\b", 1e6), (r"\bns\b", 1e9), (r"\bs\b|\bsec", 1.0))


def rate(
    text: Text, layout: Layout, hints: Hints, counts: Mapping[int, Array], lines: Array
) -> tuple[float, str, list[str]]:
    """Frames per second, where they come from in words, and remarks on what is odd.

    Parameters
    ----------
    counts : per column, `(frames,)` numbers: at least those of `layout.frame` and `layout.time`.
    lines : `(frames,)` index of a line of each frame.

    Raises
    ------
    InputError : if time goes backwards, or nothing tells the rate.
    """
    remarks: list[str] = []
    told, title = None, ""
    if layout.frame is not None:
        steps = np.diff(counts[layout.frame])
        odd = np.flatnonzero(steps != np.sort(steps)[(len(steps) - 1) // 2] if len(steps) else [])
        if len(odd):
            line = lines[odd[0] + 1] + 1
            remarks.append(f"frame numbers are not consecutive, first at line {line}; rows are taken as they come")
    if layout.time is not None:
        times = counts[layout.time]
        back = np.flatnonzero(np.diff(times) < 0)
        if len(back):
            found = f"time goes backwards, from {times[back[0]]:g} to {times[back[0] + 1]:g}"
            raise InputError(found, where=text.at(int(lines[back[0] + 1]), layout.time))
        title = layout.titles[layout.time] if layout.time < len(layout.titles) else "time"
        told = _told_by(times[np.isfinite(times)], title, remarks)
    if hints.fps:
        return hints.fps, f"{hints.fps:g} fps as you said", remarks
    if layout.fps:
        if told and abs(told / layout.fps - 1) > 0.02:
            remarks.append(f"the header says {layout.fps:g} fps, the time column {told:g}; the header is believed")
        return layout.fps, f"{layout.fps:g} fps as the header says", remarks
    if told:
        return told, f'time column "{title}" → {told:g} fps', remarks
    raise InputError(
        "nothing in the file tells its rate", where=text.path, expected="a column of times or a rate in the header",
        hint="give the frames per second with --fps",
    )  # fmt: skip


def _told_by(times: Array, title: str, remarks: list[str]) -> float | None:
    if len(times) < 2 or not times[-1] > times[0]:
        return None
    steps = np.diff(times)
    median = float(np.median(steps))
    plain = title.lower().replace("_", " ")
    typical = median or float(steps.mean())
    per_second = next((number for word, number in _PER_SECOND if re.search(word, plain)), None)
    if per_second is None:
        # Nobody records at under one frame a second, so steps of 1 and more are not seconds.
        per_second = 1.0 if typical < 1 else 1e3 if typical < 1e3 else 1e6 if typical < 1e6 else 1e9
    # Times are rounded: the last decimal in use bounds by how much a step may be off for that reason alone.
    digits = next((d for d in range(10) if np.abs(times - np.round(times, d)).max() <= 1e-12 * np.abs(times).max()), 10)
    uneven = np.abs(steps - median) > 0.1 * median + 1.01 * 10.0**-digits
    if uneven.any() and median > 0:
        shown = [value * 1e3 / per_second for value in (median, steps.min(), steps.max())]
        remarks.append(
            f"time steps are uneven: mostly {shown[0]:.4g} ms, from {shown[1]:.4g} to {shown[2]:.4g} ms,"
            f" {uneven.sum()} of {len(steps)} off by over 10 %; frames are treated as evenly spaced"
        )
        return rounded(per_second / median, 0.005)
    span = float(times[-1] - times[0])
    return rounded(per_second * len(steps) / span, 10.0**-digits / span + 1e-6)


def rounded(fps: float, tolerance: float) -> float:
    """The roundest rate within a relative tolerance; film and video rates (24000/1001) count as round."""
    for candidate in (round(fps), round(fps * 1.001) / 1.001, *(round(fps, digits) for digits in (1, 2, 3))):
        if abs(candidate / fps - 1) <= tolerance:
            return float(candidate)
    return fps
