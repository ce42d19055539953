"""A curve or a network: for each gap what won on validation takes, fills first and networks on top of them.

`python benchmarks/network_gaps.py --data DIR` and `motionmend benchmark gaps` measure the networks that ship;
NETWORK_WINS holds where they won.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..body.mapping import Mapping
from ..fills.auto import Auto
from ..fills.kinds import KINDS, point_kinds
from ..gaps import Gaps
from ..motion import Motion

Array = np.ndarray

# network -> kind -> from so many seconds, and below so many, an installed network of this name did better than any fill
# and any network before it here, if it saw so many joints of the body.
NETWORK_WINS: dict[str, dict[str, tuple[float, float, int]]] = {
    "mend": {
        "body": (0.25, 3.5, 0),
        "limb": (0.25, 2.5, 12),
        "lower limb": (0.25, 1.1, 12),
        "extremity": (0.25, 4.0, 12),
        "all points": (0.15, 3.5, 0),
        "leg joints": (0.15, 4.0, 12),
        "joints": (0.15, 4.0, 12),
    },
    "xmae": {"lower limb": (1.1, 1.6, 12)},
    "convae": {"limb": (2.5, 6.0, 12), "joints": (4.0, 6.0, 12)},
}


def network_for(kind: str, seconds: float, seen: int, there: Iterable[str]) -> str:
    """The network, among those that are there, for a gap of this kind and length, with so many of BODY's joints seen
    throughout; "" where a fill is better."""
    for name in there:
        shortest, longest, least = NETWORK_WINS.get(name, {}).get(kind, (np.inf, 0.0, 0))
        if shortest <= seconds < longest and seen >= least:
            return name
    return ""


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


@dataclass(frozen=True)
class Chooser(Auto):
    """`Auto`, which leaves gaps of a person's joints to networks where those won.

    improve : by name, the installed networks' `NetworkFill.improve`, for gaps in NETWORK_WINS in takes of a person.
    """

    improve: dict[str, Callable[[Array, Motion, Gaps], tuple[Array, dict[int, float]]]] = field(default_factory=dict)

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """See `Auto.fill_gaps`: the fills write first, and a network's word is added to what they wrote."""
        mapping = self.person(motion)
        kinds = point_kinds(motion, gaps, mapping)
        chains, reasons = self.chosen(motion, gaps, kinds)
        learned: dict[int, str] = {}
        if self.improve and mapping.is_person:
            learned = network_rows(gaps, kinds, motion.observed, motion.fps, mapping, self.improve)
        for row in learned:
            chains[row] = ("bones", "eased")  # what a network's word is added to
        done = self.filled(out, motion, gaps, chains, reasons)
        method, donors, expected = done.method.copy(), dict(done.donors), {}
        for name, improve in self.improve.items():
            rows = np.array([row for row, network in learned.items() if network == name], int)
            if not len(rows):
                continue
            improved, off = improve(out, motion, replace(gaps, method=method).pick(rows))
            expected |= {int(rows[row]): error for row, error in off.items()}
            for row in rows[improved].tolist():
                method[row], reasons[row] = name, network_reason(name, kinds[row], float(gaps.length[row] / motion.fps))
                donors.pop(row, None)
        return replace(done, method=method, donors=donors, reasons=reasons, expected=expected)
