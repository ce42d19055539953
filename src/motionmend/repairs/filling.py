"""Which code fills a take: points by a Completer, channels by fills for rigs, and networks on top of either."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..body.mapping import Mapping, map_rig
from ..constraints import feet
from ..constraints.bones import keep_lengths, reference_lengths
from ..constraints.seams import meet_rig_seams
from ..errors import InputError, nearest_names
from ..fills.auto import rig_methods
from ..fills.channels import fill_rig
from ..fills.curves import CURVES
from ..fills.kinds import rig_kinds
from ..fills.points import FILLS, DonorFill, Fill, LearnedFill
from ..gaps import Gaps, covered
from ..memory.channels import recall_rig
from ..memory.filling import Recall, taken_over
from ..memory.sessions import Session
from ..metrics.positional import bone_lengths
from ..motion import Motion, Take
from ..rigs.fitting import fit
from . import network_fill
from .chooser import NETWORK_WINS, Chooser, network_reason, network_rows
from .varied_fill import GENERATIVE, varied

RECALL = "recall"
KEEP_SECONDS = 0.2  # gaps of points longer than this keep the lengths of bones
STEADY_METRES = 0.002  # bones that vary more than this have no length to keep


def fill(
    take: Take,
    method: str,
    donors: Sequence[str] = (),
    legs: Sequence[feet.Leg] = (),
    mapping: Mapping | None = None,
    seed: int = 0,
    variant: int = 1,
    teachers: Sequence[Session] = (),
    itself: str = "",
) -> tuple[Take, Gaps]:
    """The take with its untrusted samples filled, and its gaps with the method of each.

    teachers : for "recall", the takes that teach besides this one. itself : this one's hash among them.
    legs : joints of whole legs (`feet.legs`), to be aimed at their joints' paths where one was lost alone.
    mapping : for the network, which joint is which. seed, variant : of a generative network's way.
    """
    if method not in (names := ["auto", RECALL, *NETWORK_WINS, *GENERATIVE, *FILLS]):
        raise InputError(f"no method is named {method!r}", hint=nearest_names(method, names))
    if method == RECALL:
        return _recalled(take, donors, legs, mapping, teachers, frozenset([itself]))
    for name in donors:
        take.skeleton.index(name)
    if donors and take.rig is not None:
        found = "donors were named for a take of channels, whose joints follow their parents"
        raise InputError(found, where=take.source, hint="leave --donors out")
    seen = np.where(take.motion.observed[..., None], take.motion.positions, np.nan)
    mapping = mapping or map_rig(take.skeleton, seen)
    networks = _networks(method, mapping, seed, variant)
    if take.rig is None:
        motion, gaps = _completer(method, donors, mapping, networks).fill(take.motion)
        return take.with_motion(_bones_kept(take.motion, motion, gaps)), gaps
    by_turns = method in FILLS and not isinstance(FILLS[method], LearnedFill)
    rig, gaps = fill_rig(take.rig, take.fps, method if by_turns else rig_methods)
    if method in FILLS and not by_turns:
        return _on_learned_paths(take, take.with_rig(rig), gaps, method)
    filled = _feet_on_their_paths(take, take.with_rig(rig), method, legs)
    if method in GENERATIVE:
        filled, gaps = _by_network(take, filled, gaps, "auto", mapping, _networks("auto", mapping))
    return _by_network(take, filled, gaps, method, mapping, networks)


def _recalled(
    take: Take, donors: Sequence[str], legs: Sequence[feet.Leg], mapping: Mapping | None, teachers: Sequence[Session],
    without: frozenset[str],
) -> tuple[Take, Gaps]:  # fmt: skip
    """The take filled by memory wherever that has an answer, and the rest by `auto`."""
    seen = np.where(take.motion.observed[..., None], take.motion.positions, np.nan)
    mapping = mapping or map_rig(take.skeleton, seen)
    if take.rig is None:
        otherwise = _completer("auto", donors, mapping, _networks("auto", mapping))
        motion, gaps = Recall(teachers, without, otherwise).fill(take.motion)
        return take.with_motion(_bones_kept(take.motion, motion, gaps)), gaps
    rig, gaps = recall_rig(take.rig, take.motion, teachers, without)
    recalled = take.with_rig(rig)
    left = np.flatnonzero(gaps.method != RECALL)
    if not len(left):
        return recalled, gaps
    filled, others = fill(recalled, "auto", donors, legs, mapping)
    return filled, taken_over(gaps, others, left)


def _networks(method: str, mapping: Mapping, seed: int = 0, variant: int = 1) -> dict[str, network_fill.NetworkFill]:
    """By name the network that is asked for, or all those that `auto` may take."""
    if method in FILLS:
        return {}
    if method in GENERATIVE:
        found = {method: varied(method, seed, variant)}
    else:
        found = network_fill.installed() if method == "auto" else {method: network_fill.required(method)}
    return {name: replace(network, mapping=mapping) for name, network in found.items()}


def _completer(
    method: str, donors: Sequence[str], mapping: Mapping, networks: dict[str, network_fill.NetworkFill]
) -> Fill:
    if method == "auto":
        improve = {name: network.improve for name, network in networks.items()}
        return Chooser(tuple(donors), mapping, improve=improve)
    if method in networks:
        base = _networks("auto", mapping) if method in GENERATIVE else {}
        return replace(networks[method], base=_completer("auto", donors, mapping, base))
    chosen = FILLS[method]
    return replace(chosen, donors=tuple(donors)) if isinstance(chosen, DonorFill) else chosen


def _by_network(
    take: Take, filled: Take, gaps: Gaps, method: str, mapping: Mapping, networks: dict[str, network_fill.NetworkFill]
) -> tuple[Take, Gaps]:
    """A take of channels with those gaps by the network that were asked of it, or that are better left to it."""
    if not networks or take.rig is None:
        return filled, gaps
    if not mapping.is_person:
        nobody = {} if method == "auto" else dict.fromkeys(range(len(gaps)), network_fill.NOBODY)
        return filled, replace(gaps, reasons=gaps.reasons | nobody)
    kinds, chosen = rig_kinds(take.rig, gaps), dict.fromkeys(range(len(gaps)), method)
    if method == "auto":
        chosen = network_rows(gaps, kinds, take.trusted, take.fps, mapping, networks)
    method_of, reasons, expected = gaps.method.copy(), dict(gaps.reasons), dict(gaps.expected)
    for name in dict.fromkeys(chosen.values()):
        rows = np.array([row for row, other in chosen.items() if other == name])
        wanted = covered(gaps.pick(rows), take.trusted.shape)
        filled, decided, off = networks[name].fill_take(take, filled, wanted)
        done = np.zeros(len(gaps), bool)
        for row in rows.tolist():
            here = slice(gaps.start[row], gaps.stop[row]), gaps.joint[row]
            done[row] = decided[here].all()
            if done[row]:
                expected.pop(row, None)  # another's word
            if done[row] and np.isfinite(off[here]).all():
                expected[row] = float(np.median(off[here]))
            if done[row] and method == "auto":
                reasons[row] = network_reason(name, kinds[row], float(gaps.length[row] / take.fps))
        if method == name:
            reasons = {row: why for row, why in reasons.items() if not done[row]}
            reasons |= networks[name].reasons(gaps, done, take.fps, "no joint that the network knows hangs on it")
        method_of[done] = name
    return filled, replace(gaps, method=method_of, reasons=reasons, expected=expected)


def _on_learned_paths(before: Take, filled: Take, gaps: Gaps, method: str) -> tuple[Take, Gaps]:
    """A take of channels whose joints follow the paths that a fill for points finds for them, bones kept.

    What no path decides stays as the winners among the fills for rigs have it: twist about a bone, hands and heads.
    """
    assert before.rig is not None and filled.rig is not None
    motion, found = FILLS[method].fill(before.motion)
    there = covered(found.pick(found.method == method), before.trusted.shape)
    decides = there & (np.array(before.skeleton.parents) < 0)  # a root places itself, others what hangs on them
    for joint, parent in enumerate(before.skeleton.parents):
        if parent >= 0:
            decides[:, parent] |= there[:, joint]
    where = decides & filled.trusted & ~before.rig.trusted
    method_of, reasons = gaps.method.copy(), dict(gaps.reasons)
    for row, (joint, start, stop) in enumerate(zip(gaps.joint, gaps.start, gaps.stop)):
        if where[start:stop, joint].all():
            method_of[row] = method
        else:
            where[start:stop, joint] = False
            reasons[row] = f"no joint whose path {method} finds hangs on it"
    if not where.any():
        return filled, replace(gaps, reasons=reasons)
    posed = fit(filled, np.where(there[..., None], motion.positions, np.nan), where)
    assert posed.rig is not None
    met = meet_rig_seams(posed.rig, replace(posed.rig, trusted=~where), before.fps)
    return filled.with_rig(replace(met, trusted=filled.rig.trusted)), replace(gaps, method=method_of, reasons=reasons)


def _feet_on_their_paths(before: Take, filled: Take, method: str, legs: Sequence[feet.Leg]) -> Take:
    """Where a leg alone was lost, pose it by the paths of its knee, ankle and toe rather than by its turns.

    A foot moves by the floor, not by the hips: on validation takes this is the better of the two by about a
    tenth for legs, and the worse one for arms and for whole bodies.
    """
    curve = FILLS[method if method in CURVES else "eased"]
    where, follow = np.zeros((2, *before.trusted.shape), bool)
    for thigh, shin, foot, toe in legs:
        turning = [thigh, shin, foot]
        # A leg that is lost for good has no paths, and its turns were not filled either.
        alone = ~before.trusted[:, turning].any(axis=1) & before.motion.observed[:, thigh]
        alone &= filled.trusted[:, turning].all(axis=1)
        where[:, turning] |= alone[:, None]
        follow[:, [shin, foot, max(toe, foot)]] |= alone[:, None]
    if not where.any():
        return filled
    paths = curve.complete(before.motion)
    targets = np.where((follow & paths.observed)[..., None], paths.positions, np.nan)
    return fit(filled, targets, where)


def _bones_kept(before: Motion, filled: Motion, gaps: Gaps) -> Motion:
    """Filled points back at their bones' lengths, for bones that have one, in gaps long enough for it to matter.

    On validation takes this lowers the error from about 0.2 s on, and raises it in shorter gaps.
    """
    if not before.skeleton.has_bones:
        return filled
    lengths = reference_lengths(before)
    points = np.where(before.observed[..., None], before.positions, np.nan)
    loose = np.abs(bone_lengths(points, before.skeleton.parents) - lengths) > STEADY_METRES
    lengths = np.where(loose.mean(axis=0) > 0.05, np.nan, lengths)
    long = covered(gaps.pick(gaps.length > KEEP_SECONDS * before.fps), before.observed.shape)
    return keep_lengths(filled, lengths, long & filled.observed)
