"""Which fill for which gap: by trial beside the gap where that can be, otherwise by who won on validation takes.

`python benchmarks/fills.py --data DIR` measures every method on every kind of gap; WINNERS holds who won. A new
method is measured there and joins by its name. Whether a network does better still is asked in `repairs.chooser`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..body.mapping import Mapping, map_rig
from ..errors import InputError, nearest_names
from ..gaps import Gaps
from ..motion import Motion, Rig
from .kinds import KINDS, point_kinds, rig_kinds
from .points import FILLS, DonorFill, Fill, LearnedFill

Array = np.ndarray

CURVES_AND_DONORS = ("eased", "bones", "pattern", "rigid")
TRIED = {"markers": (*CURVES_AND_DONORS, "average"), "many markers": (*CURVES_AND_DONORS, "average")}
TRIED_BY = {"average": "regression"}  # the best of its models, in a quarter of the time
TRIAL_SECONDS = 0.05  # shorter gaps are not worth a trial
CROWD, CROWD_SECONDS = 12, 0.3  # among so many markers `average` needs no trial in gaps from this length on
TRIAL_MARGIN = 1.2  # how many times better than the winner of the table another must be
MOST_TRIALS = 1000
# kind -> donors at hand (0, 1, or 3 that move as one body) -> (below this many seconds, method), …
WINNERS: dict[str, dict[int, tuple[tuple[float, str], ...]]] = {
    "body": {0: ((np.inf, "eased"),)},
    "limb": {0: ((np.inf, "eased"),)},
    "lower limb": {0: ((0.6, "eased"), (np.inf, "rigid"))},
    "extremity": {0: ((0.2, "bones"), (np.inf, "rigid"))},
    "all points": {0: ((np.inf, "eased"),)},
    "leg joints": {0: ((np.inf, "eased"),), 1: ((0.2, "bones"), (np.inf, "pattern"))},
    "joints": {0: ((np.inf, "eased"),), 1: ((np.inf, "bones"),)},
    "markers": {0: ((np.inf, "eased"),), 1: ((np.inf, "pattern"),), 3: ((np.inf, "average"),)},
    "many markers": {0: ((np.inf, "eased"),), 1: ((np.inf, "pattern"),), 3: ((0.8, "rigid"), (np.inf, "average"))},
}


def choose(kind: str, seconds: float, donors: int = 0) -> tuple[str, str]:
    """The method for a gap, and why.

    kind : one of KINDS. seconds : the gap's length. donors : joints that qualify as donors, three or more only
    if they keep their distances.
    """
    if kind not in WINNERS:
        raise InputError(f"unknown kind of gap {kind!r}", hint=nearest_names(kind, WINNERS))
    at_hand = max(count for count in WINNERS[kind] if count <= donors)
    method = next(method for below, method in WINNERS[kind][at_hand] if seconds < below)
    helped = f", {at_hand} or more donors" if at_hand else ""
    return method, f"{KINDS[kind]}{helped}, {seconds:.2f} s: {method} won on validation"


@dataclass(frozen=True)
class Auto(Fill):
    """A Completer that chooses for each gap: `Gaps.method` records which, `Gaps.reasons` why.

    Each gets the winner for its kind, length and donors, unless a trial on the good frames beside it finds a method
    that is clearly better there: the same points are hidden for the same time right before and right after the gap.

    donors : names of joints or markers to choose donors from; all if empty.
    mapping : which joints are a person's; `map_rig`'s answer otherwise.
    teaching : other takes' frames, for fills that learn; see `points.LearnedFill`.
    """

    donors: tuple[str, ...] = ()
    mapping: Mapping | None = None
    teaching: Array | None = None

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """Fall from the method for three donors to that for one and to that for none, as each gap's chart allows."""
        chains, reasons = self.chosen(motion, gaps, point_kinds(motion, gaps, self.person(motion)))
        return self.filled(out, motion, gaps, chains, reasons)

    def person(self, motion: Motion) -> Mapping:
        """Which joints are a person's."""
        seen = np.where(motion.observed[..., None], motion.positions, np.nan)
        return self.mapping or map_rig(motion.skeleton, seen)

    def chosen(self, motion: Motion, gaps: Gaps, kinds: list[str]) -> tuple[list[tuple[str, ...]], dict[int, str]]:
        """For each gap the methods to fall through, and, by row, why where a trial decided."""
        chains = [
            tuple(dict.fromkeys(choose(kind, length / motion.fps, donors)[0] for donors in (3, 1, 0)))
            for kind, length in zip(kinds, gaps.length)
        ]
        reasons = {}
        for row, name in self._tried(motion, gaps, kinds, chains).items():
            chains[row] = tuple(dict.fromkeys((name, "eased")))
            reasons[row] = f"{name} did best on the good frames beside it"
        return chains, reasons

    def filled(
        self, out: Array, motion: Motion, gaps: Gaps, chains: list[tuple[str, ...]], reasons: dict[int, str]
    ) -> Gaps:
        """Write each gap's fill into `out (frames, joints, 3)`, by the methods of its chain."""
        method, donors, reasons = gaps.method.copy(), {}, dict(reasons)
        for chain in sorted(set(chains)):
            rows = np.flatnonzero([other == chain for other in chains])
            done = self._chained(chain, self.teaching).fill_gaps(out, motion, gaps.pick(rows))
            method[rows] = done.method
            donors |= {int(rows[row]): chosen for row, chosen in done.donors.items()}
            reasons |= {int(rows[row]): why for row, why in done.reasons.items()}
        return replace(gaps, method=method, donors=donors, reasons=reasons)

    def _tried(
        self, motion: Motion, gaps: Gaps, kinds: list[str], chains: list[tuple[str, ...]]
    ) -> dict[int, str]:
        """The methods that trials decide, by row; the longest gaps first, as trials take time."""
        together: dict[tuple[int, int], list[int]] = {}
        hidden = np.cumsum(np.pad(~motion.observed, ((1, 0), (0, 0))), axis=0)
        crowd = (hidden[gaps.stop] == hidden[gaps.start]).sum(axis=1) >= CROWD
        sure = crowd & (gaps.length >= CROWD_SECONDS * motion.fps)
        for row, kind in enumerate(kinds):
            if kind == "markers" and sure[row] and chains[row][0] == "average":
                continue
            if kind != "all points" and not gaps.is_edge[row] and not gaps.is_blank[row]:
                together.setdefault((int(gaps.start[row]), int(gaps.stop[row])), []).append(row)
        long = [span for span in together if span[1] - span[0] >= TRIAL_SECONDS * motion.fps]
        decided = {}
        for start, stop in sorted(long, key=lambda span: span[0] - span[1])[:MOST_TRIALS]:
            rows = together[start, stop]
            tried = TRIED.get(kinds[rows[0]], CURVES_AND_DONORS)
            errors = self._trial(motion, gaps.joint[rows], start, stop, tried)
            if errors is not None:
                for row, scores in zip(rows, errors.T):
                    best, expected = int(np.argmin(scores)), scores[tried.index(chains[row][0])]
                    if scores[best] == expected or TRIAL_MARGIN * scores[best] <= expected:
                        decided[row] = tried[best]
        return decided

    def _trial(
        self, motion: Motion, joints: Array, start: int, stop: int, tried: tuple[str, ...]
    ) -> Array | None:
        """Each tried method's mean error `(methods, joints)` on gaps like this one before and after it, or None."""
        length, context = stop - start, max(3, round(0.1 * motion.fps))
        hidden = np.asarray(~motion.observed[start:stop].all(axis=0))
        errors = []
        for first in (start - context - length, stop + context):
            around = slice(max(first - 4 * context, 0), first + length + 4 * context)
            judged = slice(first - context, first + length + context)
            if judged.start < 0 or judged.stop > len(motion) or not motion.observed[judged][:, joints].all():
                continue
            inside = np.arange(first, first + length) - around.start
            observed = motion.observed[around].copy()
            observed[:, hidden & ~np.isin(np.arange(len(hidden)), joints)] = False  # no donors in the gap itself
            observed[inside[:, None], joints] = False
            part = replace(motion, positions=motion.positions[around], observed=observed)
            truth = part.positions[inside][:, joints]
            others = None if tried == CURVES_AND_DONORS else self._others(motion, around)
            fills = (self._chained((TRIED_BY.get(name, name), "eased"), others).complete(part) for name in tried)
            misses = [fill.positions[inside][:, joints] - truth for fill in fills]
            errors.append(np.linalg.norm(misses, axis=-1).mean(axis=1))
        return np.mean(errors, axis=0) if errors else None

    def _others(self, motion: Motion, around: slice) -> Array:
        """What teaches in a trial on the frames `around`: the take's other frames, and those of other takes."""
        seen = np.where(motion.observed[..., None], motion.positions, np.float32(np.nan))
        rest = np.concatenate([seen[: around.start], seen[around.stop :]])
        return rest if self.teaching is None else np.concatenate([rest, self.teaching])

    def _chained(self, chain: tuple[str, ...], teaching: Array | None) -> Fill:
        fill = FILLS[chain[-1]]
        for name in reversed(list(dict.fromkeys(chain))):
            one = FILLS[name]
            if isinstance(one, DonorFill):
                fill = replace(one, donors=self.donors, otherwise=fill)
            if isinstance(fill, LearnedFill):
                fill = replace(fill, teaching=teaching)
        return fill


def rig_methods(rig: Rig, gaps: Gaps, fps: float) -> Array:
    """The winners `(gaps,)` among the fills for a rig; `channels.fill_rig` takes this function as its method."""
    kinds = zip(rig_kinds(rig, gaps), gaps.length)
    return np.array([choose(kind, length / fps)[0] for kind, length in kinds], "U12")
