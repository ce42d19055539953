"""Classical fills for points: straight lines, Hermite and cubic splines, and donors.

Every fill is a `Completer`, kept in `FILLS` under its name. They compute in float64, read observed samples
only, and change nothing that is observed. A joint that is never observed stays so. A gap at the take's edge
has no far end: if it is at most EDGE_SECONDS long it is extrapolated by `curves.settle` (the velocity dies
away), and otherwise left unobserved; `Gaps.is_edge` says which gaps these are. Three donors of one body know how
it went on, so with them edges of any length are filled. `local`, `regression`, `pca` and `average` are the
published fills for markers, which learn from the whole take.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..gaps import Gaps, covered, groups
from ..motion import Motion
from . import average, local, pca, regression
from .curves import CURVES
from .donors import Chart, bone_chart, near, pattern_chart, rigid_chart
from .lessons import LEAST, lesson

Array = np.ndarray

EDGE_SECONDS = 1.0
BORDER_SECONDS = 0.03  # on each side of where a gap's donors change
LEARNED_SHARE = 0.1  # of a gap's length, at least, a joint must be seen elsewhere
DAY = 86_400.0  # seconds, longer than any take


class Fill:
    """A Completer that fills gap by gap, and can tell how it filled each."""

    def complete(self, motion: Motion) -> Motion:
        """See `Completer`."""
        return self.fill(motion)[0]

    def fill(self, motion: Motion) -> tuple[Motion, Gaps]:
        """The completed motion, and its gaps with `method` and `donors` told."""
        out = motion.positions.copy()
        gaps = self.fill_gaps(out, motion, Gaps.of(motion.observed))
        filled = covered(gaps.pick(gaps.method != ""), motion.observed.shape)
        return replace(motion, positions=out, observed=motion.observed | filled), gaps

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """Write what is missing in `gaps` into `out (frames, joints, 3)`; the gaps with what was done."""
        raise NotImplementedError


@dataclass(frozen=True)
class CurveFill(Fill):
    """Crosses each gap by the curve of this name in `curves.CURVES`: "linear", "hermite" or "cubic"."""

    name: str
    edge_seconds: float = EDGE_SECONDS

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        return cross(out, motion.positions, motion.observed, motion.fps, gaps, self.name, self.edge_seconds)


def cross(
    out: Array, values: Array, observed: Array, fps: float, gaps: Gaps, name: str, edge_seconds: float
) -> Gaps:
    """Fill `gaps` of `values (frames, joints, dimensions)` into `out` by a curve; the gaps with `method` set."""
    curve, rows = CURVES[name], np.flatnonzero(crossable(gaps, fps, edge_seconds))
    for group in groups(gaps.pick(rows), observed, curve.reach(fps)):
        samples = values[group.frames, group.joints].astype(np.float64)
        out[group.missing, group.joints] = curve.across(group.length, group.times, fps) @ samples
    method = gaps.method.copy()
    method[rows] = name
    return replace(gaps, method=method)


def crossable(gaps: Gaps, fps: float, edge_seconds: float) -> Array:
    """`(gaps,)` bool: gaps with both ends, and those with one that are short enough to extrapolate."""
    short = gaps.length <= max(1, round(edge_seconds * fps))
    return ~gaps.is_blank & (short | ~gaps.is_edge)


@dataclass(frozen=True)
class DonorFill(Fill):
    """Crosses each gap by a curve in coordinates that move with other joints, observed through the gap.

    chart : `donors.pattern_chart`, the difference to one donor; `donors.bone_chart`, that to a joint above it in the
        skeleton; or `donors.rigid_chart`, the place in the frame of three or more that keep their distances.
    donors : names to choose from; all joints if empty.
    edge_seconds : gaps at the take's edge are carried by donors up to this length.
    otherwise : fills the gaps for which no donors qualify.
    """

    name: str
    chart: Callable[..., Chart | None]
    donors: tuple[str, ...] = ()
    curve: str = "eased"
    edge_seconds: float = EDGE_SECONDS
    otherwise: Fill = CurveFill("eased")

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        method, donors = gaps.method.copy(), {}
        for row, chart in self.charts(motion, gaps):
            start, stop, joint = int(gaps.start[row]), int(gaps.stop[row]), gaps.joint[row]
            out[start:stop, joint] = chart.path(start, stop, motion.fps, self.curve)
            method[row], donors[row] = self.name, chart.donors
        rest = np.flatnonzero(method == gaps.method)
        others = self.otherwise.fill_gaps(out, motion, gaps.pick(rest))
        method[rest] = others.method
        donors |= {int(rest[row]): chosen for row, chosen in others.donors.items()}
        return replace(gaps, method=method, donors=donors)

    def charts(self, motion: Motion, gaps: Gaps) -> Iterator[tuple[int, Chart]]:
        """For each gap that has donors, its row and its Chart."""
        allowed = self.allowed(motion)
        hidden = np.cumsum(np.pad(~motion.observed, ((1, 0), (0, 0))), axis=0, dtype=np.int32)
        reach = CURVES[self.curve].reach(motion.fps)
        for row in np.flatnonzero(self.within_reach(motion, gaps)).tolist():
            joint, start, stop = int(gaps.joint[row]), int(gaps.start[row]), int(gaps.stop[row])
            through = hidden[min(stop + 1, len(motion))] == hidden[max(start - 1, 0)]
            seen = near(motion.observed[:, joint], start, stop, reach)
            chart = self.look(motion, joint, start, stop, seen, allowed & through)
            if chart is not None:
                yield row, chart

    def within_reach(self, motion: Motion, gaps: Gaps) -> Array:
        """`(gaps,)` bool: what may be tried."""
        return crossable(gaps, motion.fps, self.edge_seconds)

    def allowed(self, motion: Motion) -> Array:
        """`(joints,)` bool: who may be a donor."""
        allowed = np.zeros(len(motion.skeleton), bool)
        allowed[[motion.skeleton.index(name) for name in self.donors] or slice(None)] = True
        return allowed

    def look(self, *gap) -> Chart | None:
        """The Chart of a gap, as `donors.pattern_chart` takes it."""
        return self.chart(*gap)


@dataclass(frozen=True)
class LearnedFill(DonorFill):
    """A DonorFill whose chart learns from all of the take where the joint is among others, and fills its edges, too.

    Where too few are seen all through a gap, each stretch of it gets those that are seen there. Frames that are left,
    and those about a stretch's end, are crossed by `eased`; `Gaps.reasons` counts them.

    chart : makes one of a `lessons.Lesson`: that of `local`, `regression`, `pca` or `average`.
    most : donors of a lesson.
    teaching : `(frames, joints, 3)`, other takes' frames of the same joints in the same order, metres, NaN where
        unseen; they teach beside the take's own.
    """

    curve: str = "ramp"
    edge_seconds: float = DAY
    most: int = regression.DONORS
    teaching: Array | None = None

    def look(self, *gap) -> Chart | None:
        """See `DonorFill.look`."""
        one = lesson(*gap, most=self.most, teaching=self.teaching)
        return None if one is None else self.chart(one)

    def within_reach(self, motion: Motion, gaps: Gaps) -> Array:
        """See `DonorFill.within_reach`: not what is lost for long and was hardly ever seen."""
        seen = motion.observed.sum(axis=0)
        if self.teaching is not None:
            seen = seen + np.isfinite(self.teaching[..., 0]).sum(axis=0)
        return super().within_reach(motion, gaps) & (gaps.length * LEARNED_SHARE <= seen[gaps.joint])

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """See `Fill.fill_gaps`."""
        done = super().fill_gaps(out, motion, gaps)
        method, donors, reasons = done.method.copy(), dict(done.donors), {}
        for row in np.flatnonzero((method != self.name) & self.within_reach(motion, gaps)).tolist():
            joint, start, stop = int(gaps.joint[row]), int(gaps.start[row]), int(gaps.stop[row])
            stretches = list(self._stretches(motion, joint, start, stop))
            path, crossed = self._stitched(motion, joint, start, stop, stretches)
            if crossed >= 0:
                out[start:stop, joint] = path
                method[row] = self.name
                donors[row] = tuple(sorted({donor for *_, chart in stretches for donor in chart.donors}))
                reasons[row] = f"{crossed} of its {stop - start} frames by eased: too few others were seen there"
        return replace(done, method=method, donors=donors, reasons=reasons)

    def _stretches(self, motion: Motion, joint: int, start: int, stop: int) -> Iterator[tuple[int, int, Chart]]:
        """Stretches `[first, last)` of a gap that have donors of their own, and their charts: halves, quarters, …"""
        ends = [frame for frame in (start - 1, stop) if 0 <= frame < len(motion)]
        allowed = self.allowed(motion) & motion.observed[ends].all(axis=0)
        seen = near(motion.observed[:, joint], start, stop, CURVES[self.curve].reach(motion.fps))
        enough = (motion.observed[start:stop] & allowed).sum(axis=1) >= LEAST
        shortest, waiting = 4 * _border(motion.fps), [(start, stop)]
        while waiting:
            first, last = waiting.pop()
            if last - first < shortest or not enough[first - start : last - start].any():
                continue
            through = allowed & motion.observed[first:last].all(axis=0)
            chart = self.look(motion, joint, start, stop, seen, through)
            if chart is not None:
                yield first, last, chart
            else:
                middle = (first + last) // 2
                waiting += [(first, middle), (middle, last)]

    def _stitched(
        self, motion: Motion, joint: int, start: int, stop: int, stretches: list[tuple[int, int, Chart]]
    ) -> tuple[Array, int]:
        """The path `(gap frames, 3)` by its stretches, and how many frames a curve had to cross; -1 if it cannot."""
        path = motion.positions[:, joint : joint + 1].astype(np.float64)
        known, border = motion.observed[:, joint : joint + 1].copy(), _border(motion.fps)
        for first, last, chart in stretches:
            inner = slice(first + border * (first > start), last - border * (last < stop))
            inside = np.full((len(path), 3), np.nan)
            inside[start:stop] = chart.path(start, stop, motion.fps, self.curve)
            path[inner, 0], known[inner] = inside[inner], True
        left = Gaps.of(known)
        left = left.pick((left.start >= start) & (left.stop <= stop))
        done = cross(path, path.copy(), known, motion.fps, left, "eased", EDGE_SECONDS)
        whole = stretches and np.all(done.method != "")
        return path[start:stop, 0], int(left.length.sum()) if whole else -1


def _border(fps: float) -> int:
    """How many frames on each side of where a gap's donors change are left to a curve."""
    return max(1, round(BORDER_SECONDS * fps))


FILLS: dict[str, Fill] = {
    "linear": CurveFill("linear"),
    "hermite": CurveFill("hermite"),
    "eased": CurveFill("eased"),
    "cubic": CurveFill("cubic"),
    "pattern": DonorFill("pattern", pattern_chart),
    "bones": DonorFill("bones", bone_chart),
    "rigid": DonorFill("rigid", rigid_chart, curve="linear", edge_seconds=DAY),
    "local": LearnedFill("local", local.local_chart, curve="linear", most=local.TRIED),
    "regression": LearnedFill("regression", regression.regressed),
    "pca": LearnedFill("pca", pca.pca_chart, most=pca.DONORS),
    "average": LearnedFill("average", average.average_chart, most=average.MANY),
}
