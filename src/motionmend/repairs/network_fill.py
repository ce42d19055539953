"""A network among the fills: its answer in the gaps, met at their seams, for points and for the channels of a rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ..body.mapping import Mapping, map_rig
from ..constraints.seams import meet_rig_seams, meet_seams
from ..errors import InputError
from ..fills.auto import Auto
from ..fills.points import Fill
from ..gaps import Gaps, covered
from ..motion import Motion, Take
from ..networks import checkpoints
from ..networks.completers import NetworkCompleter
from ..networks.loading import load_completer
from ..rigs.fitting import fit
from .chooser import NETWORK_WINS

Array = np.ndarray

NOBODY = "the network found no person here"
UNKNOWN = "the network does not know this joint"


@lru_cache(maxsize=1)
def installed() -> dict[str, NetworkFill]:
    """The fills by those of the networks of `chooser.NETWORK_WINS` that are installed, by name."""
    return {name: NetworkFill(load_completer(name)) for name in NETWORK_WINS if name in checkpoints.names()}


def required(name: str) -> NetworkFill:
    """That of this name among the `installed`, or an InputError that says how to get it."""
    found = installed().get(name)
    if found is None:
        raise absent(name)
    return found


def absent(name: str) -> InputError:
    """What there is to say where no network of this name is installed."""
    hint = f"put its checkpoint folder where ${checkpoints.PATH_VARIABLE} says, or use --method auto"
    return InputError(f"no network named {name!r} is installed", hint=hint)


@dataclass(frozen=True, eq=False)
class Answer:
    """A network's word on what a motion lacks, `(frames, joints, …)`, NaN where it has none.

    values : positions, seams met. change : their difference from the curves that the network begins at; NaN everywhere
    where it begins at none. expected : how far off it expects to be, metres; NaN everywhere where it does not say.
    """

    values: Array
    change: Array
    expected: Array


@dataclass(frozen=True)
class NetworkFill(Fill):
    """Fills the joints that the network knows, also at a take's edges and where they are never seen.

    A network that begins at curves is asked how far from them the truth is, and that is added to what `base` fills:
    a curve at the take's own rate, with all of the take beside the gap, is better than one inside a window.

    base : fills the rest too: joints that the network does not know, and takes in which no person is found.
    mapping : which joint is which; `mapping.map_rig`'s answer otherwise.
    """

    completer: NetworkCompleter
    base: Fill = field(default_factory=Auto)
    mapping: Mapping | None = None

    @property
    def name(self) -> str:
        return self.completer.name

    def fill_gaps(self, out: Array, motion: Motion, gaps: Gaps) -> Gaps:
        """See `Fill.fill_gaps`. The whole motion is one question to the network, whichever gaps are asked for."""
        done = self.base.fill_gaps(out, motion, gaps)
        improved, expected = self.improve(out, motion, done)
        method = np.where(improved, self.name, done.method)
        person = self._mapping(motion).is_person
        why = self.reasons(done, improved, motion.fps) if person else dict.fromkeys(range(len(gaps)), NOBODY)
        kept = {row: because for row, because in done.reasons.items() if not improved[row]}
        others = {row: off for row, off in done.expected.items() if not improved[row]}
        return replace(done, method=method, reasons=kept | why, expected=others | expected)

    def reasons(self, gaps: Gaps, improved: Array, fps: float, unknown: str = UNKNOWN) -> dict[int, str]:
        """What the report says of a person's gaps, by row. improved : `(gaps,)` bool, those on which it has a word."""
        del gaps, fps
        return dict.fromkeys(np.flatnonzero(~improved).tolist(), unknown)

    def improve(self, out: Array, motion: Motion, gaps: Gaps) -> tuple[Array, dict[int, float]]:
        """Write the network's word into `out (frames, joints, 3)`, on top of what fills have written there.

        Returns `(gaps,)` bool: the gaps on which it has a word; and `Gaps.expected` of those.
        `Gaps.method` is "" where nothing was written yet.
        """
        # What it is not asked for, and fills have written, is as good as seen: thousands of dropouts need not all go
        # through the network.
        written = np.isfinite(out).all(axis=-1) & (out != motion.positions).any(axis=-1)
        seen = motion.observed | (written & ~covered(gaps, motion.observed.shape))
        told = seen | covered(gaps.pick(gaps.method != ""), seen.shape)
        answer = self.answer(_told(replace(motion, positions=out.astype(np.float32), observed=seen), told))
        own, change = answer.values, answer.change
        improved, expected = np.zeros(len(gaps), bool), {}
        for row, (joint, start, stop) in enumerate(zip(gaps.joint, gaps.start, gaps.stop)):
            here = slice(start, stop), joint
            improved[row] = np.isfinite(own[here]).all()
            if improved[row]:
                added = gaps.method[row] and np.isfinite(change[here]).all()
                out[here] = out[here] + change[here] if added else own[here]
                if np.isfinite(answer.expected[here]).all():
                    expected[row] = float(np.median(answer.expected[here]))
        return improved, expected

    def answer(self, motion: Motion) -> Answer:
        """What the network says of all that is not observed.

        motion : where it is not observed it holds what fills say, NaN where they say nothing.
        """
        points = _told(motion, motion.observed).positions
        mapping = self._mapping(motion)
        nothing = np.full(motion.positions.shape, np.nan)
        if not mapping.is_person:
            return Answer(nothing, nothing, nothing[..., 0])
        motion = replace(motion, positions=points)
        said, curves = (
            each.answered(motion, mapping) if each else None for each in (self.completer, self._curves())
        )
        assert said is not None
        missing = ~motion.observed
        own = np.where(missing[..., None], said[..., :3], np.nan)
        if curves is None:
            change = nothing
        else:
            # At the network's rate nothing is added where something is observed; at others a little is, just before a
            # gap, and must not be missed there.
            beyond = (said - curves)[..., :3]
            beyond = meet_seams(beyond, np.zeros_like(beyond), motion.observed, motion.fps, own=True)
            change = np.where(missing[..., None], beyond, np.nan)
        expected = np.where(missing, said[..., 3], np.nan)
        return Answer(meet_seams(own, points, motion.observed, motion.fps), change, expected)

    def _mapping(self, motion: Motion) -> Mapping:
        return self.mapping or map_rig(motion.skeleton, _told(motion, motion.observed).positions)

    def _curves(self) -> NetworkCompleter | None:
        """A network that answers nothing but the curves; None where this one does not begin at curves."""
        nothing = getattr(self.completer.space, "nothing", None)
        return NetworkCompleter(self.completer.description, nothing) if nothing else None

    def fill_take(self, before: Take, filled: Take, wanted: Array) -> tuple[Take, Array, Array]:
        """`filled`, whose rig other fills have completed, posed where `before` has gaps as the network would have it.

        wanted : `(frames, joints)` bool, the channels that it may decide.

        What it has no word on stays as it is in `filled`: twist about a bone, fingers, the face. Also returned:
        `(frames, joints)` bool, the channels that it decided, and how far off it expects what hangs on them to be,
        metres, NaN where it does not say.
        """
        assert before.rig is not None and filled.rig is not None
        seen = replace(filled.rig, trusted=before.rig.trusted | (filled.rig.trusted & ~wanted)).observed()
        answer = self.answer(replace(_told(filled.motion, filled.motion.observed), observed=seen))
        own, change = answer.values, answer.change
        improved = (filled.motion.observed & ~seen)[..., None] & np.isfinite(change)
        targets = np.where(improved, filled.motion.positions + change, own)
        there = np.asarray(np.isfinite(targets).all(axis=-1))
        roots = np.array(before.skeleton.parents) < 0  # they place themselves, others what hangs on them
        decides, expected = there & roots, np.where(roots, answer.expected, np.nan)
        for joint, parent in enumerate(before.skeleton.parents):
            if parent >= 0:
                decides[:, parent] |= there[:, joint]
                expected[:, parent] = np.fmax(expected[:, parent], answer.expected[:, joint])
        where = decides & wanted & ~before.rig.trusted
        if not where.any():
            return filled, where, expected
        posed = fit(filled, targets, where)
        assert posed.rig is not None
        # Differences die away at the seams by themselves; what fills had left open has yet to meet them.
        rig = meet_rig_seams(posed.rig, replace(posed.rig, trusted=filled.rig.trusted), before.fps)
        return filled.with_rig(replace(rig, trusted=filled.rig.trusted | where)), where, expected


def _told(motion: Motion, where: Array) -> Motion:
    """The motion with NaN for all but these of its positions."""
    return replace(motion, positions=np.where(where[..., None], motion.positions, np.float32(np.nan)))
