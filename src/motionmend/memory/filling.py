"""The fill that asks a memory, for points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..fills.curves import CURVES
from ..fills.points import FILLS, Fill
from ..gaps import Gaps
from ..motion import Motion
from . import bases, recalling
from .descriptors import Layout
from .sessions import Session, remember, versions

Array = np.ndarray

ITSELF = "itself"  # the take whose gap it is, among those that teach
MOST_NAMED = 3  # takes that a reason names
TOLD, UNTOLD = 0.05, 0.005  # a take that has less of the weight is not named, or not even counted


@dataclass(frozen=True)
class Recall(Fill):
    """Fills each gap by what the most similar stretches of the take itself and of others did beyond their curves.

    sessions : the others. without : hashes of takes among them that do not teach, such as this one as it was read.
    otherwise : fills the gaps that memory has no answer for; `Gaps.reasons` tells which.
    base : what neighbours are compared beyond.
    """

    sessions: Sequence[Session] = ()
    without: frozenset[str] = frozenset()
    otherwise: Fill = field(default_factory=lambda: FILLS["bones"])
    base: bases.Base = bases.eased

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """See `Fill.fill_gaps`."""
        method, reasons, observed = gaps.method.copy(), {}, motion.observed.copy()
        itself = remember(motion, None, ITSELF)
        sessions, without = (itself, *self.sessions), self.without | versions(itself, self.sessions)
        for rows, start, stop in together(gaps):
            lost = gaps.joint[rows]
            answer = recalling.ask(motion, lost, start, stop, sessions, without, self.base)
            if isinstance(answer, recalling.Answer):
                out[start:stop, lost] = self._answered(motion, answer, start, stop)
                observed[start:stop, lost], method[rows] = True, "recall"
            reasons |= dict.fromkeys(rows.tolist(), told(answer))
        left = np.flatnonzero(method != "recall")
        told_so_far = replace(motion, positions=out.copy(), observed=observed)
        others = self.otherwise.fill_gaps(out, told_so_far, gaps.pick(left))
        return taken_over(replace(gaps, method=method, reasons=reasons), others, left)

    def _answered(self, motion: Motion, answer: recalling.Answer, start: int, stop: int) -> Array:
        """`(frames, lost, 3)` at the take's rate: its base, and what the neighbours add."""
        needed = np.union1d(answer.layout.lost, answer.layout.anchors if answer.layout.anchor >= 0 else ())
        layout, window = own_window(answer.layout, motion.observed[:, needed.astype(int)], start, stop, motion.fps)
        base = self.base(motion.positions[None, window].astype(float), layout, motion.fps)[0]
        return base + answer.at_frames(answer.beyond, stop - start)


def taken_over(gaps: Gaps, others: Gaps, rows: Array) -> Gaps:
    """The gaps, of which other fills have written those in `rows`."""
    method = gaps.method.copy()
    method[rows] = others.method
    donors, expected = (
        {int(rows[row]): said for row, said in each.items()} for each in (others.donors, others.expected)
    )
    return replace(gaps, method=method, donors=donors, expected=expected)


def own_window(layout: Layout, observed: Array, start: int, stop: int, fps: float) -> tuple[Layout, slice]:
    """A gap's layout at its take's own rate, with so many frames beside it as a curve looks at and are observed."""
    reach = CURVES["eased"].reach(fps)
    whole = np.asarray(observed.all(axis=1))
    before = recalling.known(whole[max(start - reach, 0) : start][::-1])
    after = recalling.known(whole[stop : stop + reach])
    steps = stop - start + (before >= 0 and after >= 0)
    return replace(layout, before=before, after=after, steps=steps), slice(start - before - 1, stop + after + 1)


def together(gaps: Gaps) -> Iterator[tuple[Array, int, int]]:
    """The gaps of the same frames: their rows, and these frames; none of points that are never seen."""
    rows = np.flatnonzero(~gaps.is_blank)
    spans, which = np.unique(np.stack([gaps.start[rows], gaps.stop[rows]], axis=1), axis=0, return_inverse=True)
    for number, (start, stop) in enumerate(spans.tolist()):
        yield rows[which.reshape(-1) == number], start, stop


def told(answer: recalling.Answer | str) -> str:
    """For the report: from which takes a gap was filled, or why from none."""
    if isinstance(answer, str):
        return answer
    first, *others = answer.sources()
    sources = [first, *(each for each in others if each[1] >= UNTOLD)]
    named = [f"{name} ({share:.0%})" for name, share in sources[:MOST_NAMED] if share >= TOLD] or [first[0]]
    more = len(sources) - len(named)
    return "as in " + ", ".join(named) + (f" and {more} more" if more else "")
