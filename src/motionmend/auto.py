"""Which fill for which gap: by trial beside the gap where that can be, otherwise by who won on validation takes.

`python benchmarks/fills.py --data DIR` measures every method on every kind of gap; WINNERS holds who won. A new
method is measured there and joins by its name. `python benchmarks/network_gaps.py --data DIR` does so for the network
that ships, on top of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .body import LIMBS, Mapping, map_rig
from .errors import InputError, nearest_names
from .fills import FILLS, DonorFill, Fill
from .gaps import Gaps
from .motion import Motion, Rig

Array = np.ndarray

KINDS = {
    "body": "the whole rig is missing",
    "limb": "a whole limb is missing",
    "lower limb": "the outer part of a limb is missing",
    "extremity": "a hand, a foot or a head is missing",
    "all points": "every point is missing",
    "leg joints": "joints of a leg are missing",
    "joints": "joints of a skeleton are missing",
    "markers": "markers of a cloud are missing",
}

# Of a limb's length, from its branch to its tip: with less missing it is the lower limb, or an extremity.
LIMB_SHARE, EXTREMITY_SHARE = 2 / 3, 1 / 4

TRIED = ("eased", "bones", "pattern", "rigid")
TRIAL_SECONDS = 0.05  # shorter gaps are not worth a trial
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
    "markers": {0: ((np.inf, "eased"),), 1: ((np.inf, "pattern"),), 3: ((np.inf, "rigid"),)},
}

# network -> kind -> from so many seconds, and below so many, an installed network of this name did better than any fill
# and any network before it here, if it saw so many joints of the body.
NETWORK_WINS: dict[str, dict[str, tuple[float, float, int]]] = {
    "xmae": {
        "body": (0.4, 1.2, 0),
        "limb": (0.4, 1.2, 12),
        "lower limb": (0.4, 1.6, 12),
        "extremity": (0.4, 2.5, 12),
        "all points": (0.4, 1.2, 0),
        "leg joints": (0.4, 4.0, 12),
        "joints": (0.4, 2.5, 12),
    },
    "convae": {
        "body": (1.2, 6.0, 0),
        "limb": (1.2, 6.0, 12),
        "all points": (1.2, 6.0, 0),
        "joints": (2.5, 6.0, 12),
    },
}


def network_for(kind: str, seconds: float, seen: int, there: Iterable[str]) -> str:
    """The network, among those that are there, for a gap of this kind and length, with so many of BODY's joints seen
    throughout; "" where a fill is better."""
    for name in there:
        shortest, longest, least = NETWORK_WINS.get(name, {}).get(kind, (np.inf, 0.0, 0))
        if shortest <= seconds < longest and seen >= least:
            return name
    return ""


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
    mapping : which joints are a person's; `body.map_rig`'s answer otherwise.
    improve : by name, the installed networks' `network_fill.NetworkFill.improve`, for gaps in NETWORK_WINS in takes of
        a person.
    """

    donors: tuple[str, ...] = ()
    mapping: Mapping | None = None
    improve: dict[str, Callable[[Array, Motion, Gaps], Array]] = field(default_factory=dict)

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """Fall from the method for three donors to that for one and to that for none, as each gap's chart allows."""
        seen = np.where(motion.observed[..., None], motion.positions, np.nan)
        mapping = self.mapping or map_rig(motion.skeleton, seen)
        kinds = point_kinds(motion, gaps, mapping)
        chains = [
            tuple(dict.fromkeys(choose(kind, length / motion.fps, donors)[0] for donors in (3, 1, 0)))
            for kind, length in zip(kinds, gaps.length)
        ]
        reasons = {}
        for row, name in self._tried(motion, gaps, kinds, chains).items():
            chains[row] = tuple(dict.fromkeys((name, "eased")))
            reasons[row] = f"{name} did best on the good frames beside it"
        learned: dict[int, str] = {}
        if self.improve and mapping.is_person:
            learned = network_rows(gaps, kinds, motion.observed, motion.fps, mapping, self.improve)
        for row in learned:
            chains[row] = ("bones", "eased")  # what a network's word is added to
        method, donors = gaps.method.copy(), {}
        for chain in sorted(set(chains)):
            rows = np.flatnonzero([other == chain for other in chains])
            done = self._chained(chain).fill_gaps(out, motion, gaps.pick(rows))
            method[rows] = done.method
            donors |= {int(rows[row]): chosen for row, chosen in done.donors.items()}
        for name, improve in self.improve.items():
            rows = np.array([row for row, network in learned.items() if network == name], int)
            improved = improve(out, motion, replace(gaps, method=method).pick(rows)) if len(rows) else rows
            for row in rows[improved].tolist():
                method[row], reasons[row] = name, network_reason(name, kinds[row], float(gaps.length[row] / motion.fps))
                donors.pop(row, None)
        return replace(gaps, method=method, donors=donors, reasons=reasons)

    def _tried(
        self, motion: Motion, gaps: Gaps, kinds: list[str], chains: list[tuple[str, ...]]
    ) -> dict[int, str]:
        """The methods that trials decide, by row; the longest gaps first, as trials take time."""
        together: dict[tuple[int, int], list[int]] = {}
        for row, kind in enumerate(kinds):
            if kind != "all points" and not gaps.is_edge[row] and not gaps.is_blank[row]:
                together.setdefault((int(gaps.start[row]), int(gaps.stop[row])), []).append(row)
        long = [span for span in together if span[1] - span[0] >= TRIAL_SECONDS * motion.fps]
        decided = {}
        for start, stop in sorted(long, key=lambda span: span[0] - span[1])[:MOST_TRIALS]:
            rows = together[start, stop]
            errors = self._trial(motion, gaps.joint[rows], start, stop)
            if errors is not None:
                for row, scores in zip(rows, errors.T):
                    best, expected = int(np.argmin(scores)), scores[TRIED.index(chains[row][0])]
                    if scores[best] == expected or TRIAL_MARGIN * scores[best] <= expected:
                        decided[row] = TRIED[best]
        return decided

    def _trial(self, motion: Motion, joints: Array, start: int, stop: int) -> Array | None:
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
            fills = (self._chained((name, "eased")).complete(part) for name in TRIED)
            misses = [fill.positions[inside][:, joints] - truth for fill in fills]
            errors.append(np.linalg.norm(misses, axis=-1).mean(axis=1))
        return np.mean(errors, axis=0) if errors else None

    def _chained(self, chain: tuple[str, ...]) -> Fill:
        fill = FILLS[chain[-1]]
        for name in reversed(list(dict.fromkeys(chain))):
            one = FILLS[name]
            if isinstance(one, DonorFill):
                fill = replace(one, donors=self.donors, otherwise=fill)
        return fill


def network_reason(name: str, kind: str, seconds: float) -> str:
    return f"{KINDS[kind]}, {seconds:.2f} s: {name} won on validation"


def network_rows(
    gaps: Gaps, kinds: Sequence[str], observed: Array, fps: float, mapping: Mapping, there: Iterable[str]
) -> dict[int, str]:
    """The gaps, of joints that networks know, that are better left to one of those that are there: row to network."""
    known = [joint for joint in mapping.joints if joint >= 0]
    rows = np.flatnonzero(np.isin(gaps.joint, known) & ~gaps.is_edge & ~gaps.is_blank).tolist()
    hidden = np.cumsum(np.pad(~observed[:, known], ((1, 0), (0, 0))), axis=0)
    seen = (hidden[gaps.stop] == hidden[gaps.start]).sum(axis=1)
    chosen = {row: network_for(kinds[row], float(gaps.length[row] / fps), int(seen[row]), there) for row in rows}
    return {row: name for row, name in chosen.items() if name}


def point_kinds(motion: Motion, gaps: Gaps, mapping: Mapping | None = None) -> list[str]:
    """Each gap's kind, for a motion of points; `mapping` tells which are a leg's."""
    kinds = np.full(len(motion.skeleton), "joints" if motion.skeleton.has_bones else "markers", "U12")
    if motion.skeleton.has_bones and mapping:
        kinds[_legs(mapping)] = "leg joints"
    seen = np.concatenate([[0], np.cumsum(motion.observed.any(axis=1))])
    alone = seen[gaps.stop] == seen[gaps.start]
    return np.where(alone, "all points", kinds[gaps.joint]).tolist()


def _legs(mapping: Mapping) -> list[int]:
    """A person's thighs, shins, feet and toes, those that the rig has."""
    legs = [mapping.joints[joint] for side in ("left_leg", "right_leg") for joint in LIMBS[side]]
    return [joint for joint in legs if joint >= 0]


def rig_methods(rig: Rig, gaps: Gaps, fps: float) -> Array:
    """The winners `(gaps,)` among the fills for a rig; `rigfills.fill_rig` takes this function as its method."""
    kinds = zip(rig_kinds(rig, gaps), gaps.length)
    return np.array([choose(kind, length / fps)[0] for kind, length in kinds], "U12")


def rig_kinds(rig: Rig, gaps: Gaps) -> list[str]:
    """Each gap's kind, for a rig: by how much is missing above the joint, halfway through the gap."""
    parents, missing, shares = rig.skeleton.parents, ~rig.trusted, _limb_shares(rig)
    kinds = []
    for joint, start, stop in zip(gaps.joint.tolist(), gaps.start, gaps.stop):
        lost = missing[(start + stop) // 2]
        while parents[joint] >= 0 and lost[parents[joint]]:
            joint = parents[joint]
        if parents[joint] < 0:
            kinds.append("body")
        elif shares[joint] > LIMB_SHARE:
            kinds.append("limb")
        else:
            kinds.append("lower limb" if shares[joint] > EXTREMITY_SHARE else "extremity")
    return kinds


def _limb_shares(rig: Rig) -> list[float]:
    """For each joint, which share of its limb hangs on it, from the branch above to the farthest tip."""
    parents, children = rig.skeleton.parents, rig.skeleton.children
    bones = np.linalg.norm(rig.offsets, axis=-1)
    below = np.zeros(len(parents))
    for joint, offset in rig.ends:
        below[joint] = max(below[joint], np.linalg.norm(offset))
    for joint in reversed(range(len(parents))):
        if parents[joint] >= 0:
            below[parents[joint]] = max(below[parents[joint]], below[joint] + bones[joint])
    above = np.zeros(len(parents))
    for joint, parent in enumerate(parents):
        if parent < 0 or parents[parent] < 0:
            continue
        limbs = sorted((below[child] + bones[child] for child in children[parent]), reverse=True)
        # Two long ones part at the chest and begin limbs; short ones part at a hand and still belong to the arm.
        if len(limbs) < 2 or limbs[1] <= above[parent]:
            above[joint] = above[parent] + bones[joint]
    return [float(b / (a + b)) if a + b > 0 else 1.0 for a, b in zip(above, below)]
