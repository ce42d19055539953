"""A network among the fills: its answer in the gaps, met at their seams, for points and for the channels of a rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from . import checkpoints
from .body import Mapping, map_rig
from .constraints import meet_rig_seams, meet_seams
from .errors import InputError
from .fills import CurveFill, Fill
from .fitting import fit
from .gaps import Gaps
from .motion import Motion, Take
from .networks import NetworkCompleter, load_completer

Array = np.ndarray

NAME = "xmae"


@lru_cache(maxsize=1)
def installed() -> NetworkFill | None:
    """The fill by the installed network of this name; None where there is none."""
    return NetworkFill(load_completer(NAME)) if NAME in checkpoints.names() else None


def required() -> NetworkFill:
    """`installed`, or an InputError that says how to get it."""
    found = installed()
    if found is None:
        hint = f"put its checkpoint folder where ${checkpoints.PATH_VARIABLE} says, or use --method auto"
        raise InputError(f"no network named {NAME!r} is installed", hint=hint)
    return found


@dataclass(frozen=True)
class NetworkFill(Fill):
    """Fills the joints that the network knows, also at a take's edges and where they are never seen.

    otherwise : fills the joints that it does not know, and takes in which no person is found.
    mapping : which joint is which; `body.map_rig`'s answer otherwise.
    """

    completer: NetworkCompleter
    otherwise: CurveFill = field(default_factory=lambda: CurveFill("eased"))
    mapping: Mapping | None = None

    @property
    def name(self) -> str:
        return NAME

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """See `Fill.fill_gaps`. The whole motion is one question to the network, whichever gaps are asked for."""
        answered = self.answer(motion)
        method = gaps.method.copy()
        for row, (joint, start, stop) in enumerate(zip(gaps.joint, gaps.start, gaps.stop)):
            values = answered[start:stop, joint]
            if np.isfinite(values).all():
                out[start:stop, joint], method[row] = values, self.name
        rest = np.flatnonzero(method != self.name)
        others = self.otherwise.fill_gaps(out, motion, gaps.pick(rest))
        method[rest] = others.method
        donors = gaps.donors | {int(rest[row]): chosen for row, chosen in others.donors.items()}
        why = "the network does not know this joint" if len(rest) < len(gaps) else "the network found no person here"
        return replace(gaps, method=method, donors=donors, reasons=gaps.reasons | dict.fromkeys(rest.tolist(), why))

    def answer(self, motion: Motion) -> Array:
        """Positions `(frames, joints, 3)` of what is not observed, seams met; NaN where the network has no word."""
        points = np.where(motion.observed[..., None], motion.positions, np.float32(np.nan))
        mapping = self.mapping or map_rig(motion.skeleton, points)
        if not mapping.is_person:
            return np.full(motion.positions.shape, np.nan)
        whole = self.completer.complete(replace(motion, positions=points), mapping)
        values = np.where(whole.observed[..., None], whole.positions, np.nan)
        return meet_seams(values, points, motion.observed, motion.fps)

    def fill_take(self, before: Take, filled: Take) -> tuple[Take, Array]:
        """`filled`, whose rig other fills have completed, posed where `before` has gaps as the network would have it.

        What it has no word on stays as guessed: twist about a bone, fingers, the face. Also `(frames, joints)` bool,
        the channels that it decided.
        """
        assert before.rig is not None and filled.rig is not None
        targets = np.where(before.motion.observed[..., None], np.nan, self.answer(before.motion))
        there = np.asarray(np.isfinite(targets).all(axis=-1))
        decides = there & (np.array(before.skeleton.parents) < 0)  # a root places itself, others what hangs on them
        for joint, parent in enumerate(before.skeleton.parents):
            if parent >= 0:
                decides[:, parent] |= there[:, joint]
        where = decides & ~before.rig.trusted
        if not where.any():
            return filled, where
        posed = fit(filled, targets, where)
        assert posed.rig is not None
        trusted = before.rig.trusted | (filled.rig.trusted & ~where)
        rig = meet_rig_seams(posed.rig, replace(filled.rig, trusted=trusted), before.fps)
        return filled.with_rig(replace(rig, trusted=filled.rig.trusted | where)), where
