"""What a diagnosis says: findings, what of them is untrusted, and those that can be undone without a guess."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..damage.planting import exchange_channels
from ..motion import Array, Take

CERTAIN = 0.6  # what `untrusted` needs; below it a finding is only told
UNSURE = 0.5


@dataclass(frozen=True)
class Finding:
    """One thing found: `cause` in `joints` (names as in the file) over frames `[start, stop)`.

    cause : gap, lost, dropout, held, jump, swap, displaced, noise or t-pose.
    certainty : 0 to 1; a rough share of such findings that are truly damage.
    detail : what was seen, in words. indices : the joints' indices; a swap has its pairs in turn, left, right.
    shift : metres to add to points that are displaced by one offset, where that is known; None otherwise.
    """

    cause: str
    joints: tuple[str, ...]
    start: int
    stop: int
    certainty: float
    detail: str
    indices: tuple[int, ...]
    shift: tuple[float, float, float] | None = None

    @property
    def is_undone(self) -> bool:
        """Whether `undone` puts it right, so that nothing needs to be filled: its values are good, but elsewhere."""
        return self.certainty >= CERTAIN and (self.cause == "swap" or self.shift is not None)


def told(finding: Finding) -> dict[str, Any]:
    """A finding for reports: its names, without what only a repair wants to know."""
    facts = asdict(finding)
    del facts["indices"], facts["shift"]
    return facts


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """findings : in order of their first frame. untrusted : `(frames, joints)` bool, what to replace."""

    findings: tuple[Finding, ...]
    untrusted: Array


def undone(take: Take, finding: Finding) -> Take:
    """The take with a swap exchanged back, or an offset taken out again: nothing is interpolated, nothing lost."""
    if finding.shift is None:
        return unswap(take, finding)
    positions = take.motion.positions.copy()
    positions[finding.start : finding.stop, list(finding.indices)] += np.array(finding.shift, np.float32)
    return take.with_motion(replace(take.motion, positions=positions))


def unswap(take: Take, finding: Finding) -> Take:
    """The take with the left and right values of a swap exchanged back: nothing is interpolated, nothing lost."""
    order = np.arange(len(take.skeleton))
    left, right = list(finding.indices[::2]), list(finding.indices[1::2])
    order[left], order[right] = right, left
    start, stop = finding.start, finding.stop
    if take.rig is None:
        positions, observed = take.motion.positions.copy(), take.motion.observed.copy()
        positions[start:stop], observed[start:stop] = positions[start:stop, order], observed[start:stop, order]
        return take.with_motion(replace(take.motion, positions=positions, observed=observed))
    rotations, translations = take.rig.rotations.copy(), take.rig.translations.copy()
    exchange_channels(take.rig, rotations, translations, order, start, stop)
    return take.with_rig(replace(take.rig, rotations=rotations, translations=translations))
