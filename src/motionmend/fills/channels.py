"""The fills' curves on what moves a rig: each joint's turn, in the world or in its parent's frame, and shifts.

A gap's chart is the rotation vectors about m, halfway along the shortest turn between its ends:
c(t) = log(m^-1 q(t)). There both ends lie at plus and minus half of the turn, so the straight line is exactly
slerp (Shoemake 1985), a steady spin about one axis is a straight line too, and the Hermite and spline
curves are those of the positions. Signs of quaternions do not matter to it.

A person moves a limb through the world rather than against the trunk: with the hips known and a leg lost,
turns filled in the parent's frame pass every jerk of the hips on to the foot. Measured, turns in the world are
better for all but long gaps of a forearm, so "linear", "hermite", "eased" and "cubic" fill those. The parent is a
joint's natural donor: "pattern" and "bones" fill the eased curve and "rigid" the straight one in the parent's frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .. import rotations
from ..gaps import Gaps, Group, covered, groups
from ..motion import Rig
from .curves import CURVES, Curve, velocity, velocity_frames
from .points import EDGE_SECONDS, cross, crossable

Array = np.ndarray

# method -> curve, and whether in the world
RIG_FILLS = {
    "linear": ("linear", True),
    "hermite": ("hermite", True),
    "eased": ("eased", True),
    "cubic": ("cubic", True),
    "pattern": ("eased", False),
    "bones": ("eased", False),
    "rigid": ("linear", False),
}


def fill_rig(
    rig: Rig,
    fps: float,
    method: str | Callable[[Rig, Gaps, float], Array] = "hermite",
    edge_seconds: float = EDGE_SECONDS,
) -> tuple[Rig, Gaps]:
    """The rig with its untrusted turns and shifts filled, and the gaps with `method` set.

    Parameters
    ----------
    method : one of RIG_FILLS for all gaps, or what chooses one for each: `(rig, gaps, fps) -> (gaps,)` names.
    edge_seconds : gaps at the take's edge are extrapolated, in the parent's frame, up to this length.

    Trusted entries come back bit for bit. `trusted` becomes True where a gap was filled; a joint that is never
    trusted, and a longer edge, keep their numbers and stay untrusted.
    """
    gaps = Gaps.of(rig.trusted)
    names = np.full(len(gaps), method) if isinstance(method, str) else method(rig, gaps, fps)
    names = np.where(crossable(gaps, fps, edge_seconds), names, "")
    filled = covered(gaps.pick(names != ""), rig.trusted.shape)
    rig = replace(
        rig,
        rotations=_fill_turns(rig, fps, gaps, names, filled),
        translations=_fill_shifts(rig, fps, gaps, names, edge_seconds),
        trusted=rig.trusted | filled,
    )
    return rig, replace(gaps, method=names)


def _fill_shifts(rig: Rig, fps: float, gaps: Gaps, names: Array, edge_seconds: float) -> Array:
    shifts = rig.translations.copy()
    moves = (np.array(rig.skeleton.parents) < 0) | rig.moves
    for name in np.unique(names[names != ""]):
        rows = (names == name) & moves[gaps.joint]
        cross(shifts, rig.translations, rig.trusted, fps, gaps.pick(rows), RIG_FILLS[name][0], edge_seconds)
    return shifts


def _fill_turns(rig: Rig, fps: float, gaps: Gaps, names: Array, filled: Array) -> Array:
    """Down the hierarchy, so that a joint's parent is whole by the time its own turn is filled in the world."""
    turns, known = rig.rotations.copy(), rig.trusted | filled
    world, sound = np.empty_like(turns), np.empty_like(known)
    still = np.broadcast_to(rotations.IDENTITY, (len(turns), 4))
    rows_of = np.split(np.arange(len(gaps)), np.searchsorted(gaps.joint, np.arange(1, len(rig.skeleton))))
    for joint, parent in enumerate(rig.skeleton.parents):
        rows = rows_of[joint][names[rows_of[joint]] != ""]
        above, whole = (still, np.ones(len(turns), bool)) if parent < 0 else (world[:, parent], sound[:, parent])
        outside = np.array([RIG_FILLS[name][1] for name in names[rows]], bool) & _stands(gaps.pick(rows), whole, fps)
        for frame, chosen in ((above, rows[outside]), (still, rows[~outside])):
            for name in np.unique(names[chosen]):
                curve = CURVES[RIG_FILLS[name][0]]
                _cross_turns(turns, frame, rig, fps, gaps.pick(chosen[names[chosen] == name]), curve)
        world[:, joint] = rotations.multiply(above, turns[:, joint])
        sound[:, joint] = whole & known[:, joint]
    return turns


def _stands(gaps: Gaps, whole: Array, fps: float) -> Array:
    """`(gaps,)` bool: gaps with both ends whose parent is known in every frame that matters to them."""
    reach = max(curve.reach(fps) for curve in CURVES.values())
    holes = np.concatenate([[0], np.cumsum(~whole)])
    first, last = np.maximum(gaps.start - reach, 0), np.minimum(gaps.stop + reach, len(whole))
    return (holes[first] == holes[last]) & ~gaps.is_edge


def _cross_turns(turns: Array, frame: Array, rig: Rig, fps: float, gaps: Gaps, curve: Curve) -> None:
    """Fill the gaps of one joint into `turns`, along a curve as seen from `frame (frames, 4)`."""
    if not len(gaps):
        return
    joint, members = int(gaps.joint[0]), list(groups(gaps, rig.trusted, curve.reach(fps)))
    seen = rotations.multiply(frame, rig.rotations[:, joint])
    start, stop = seen[np.maximum(gaps.start - 1, 0)], seen[np.minimum(gaps.stop, len(seen) - 1)]
    start[gaps.before == 0] = stop[gaps.before == 0]  # an edge is seen from its only end
    stop[gaps.after == 0] = start[gaps.after == 0]
    turn = _logarithm(start, stop)
    if rig.skeleton.parents[joint] < 0:
        for group in members:
            turn[group.rows] = _whole_turns(turn[group.rows], seen[group.frames], group, fps)
    middle = rotations.multiply(start, rotations.from_rotvec(turn / 2))

    # Into the charts and out of them all at once: there may be thousands of groups.
    rows = np.concatenate([np.repeat(group.rows, len(group.times)) for group in members])
    frames = np.concatenate([group.frames.ravel() for group in members])
    # Beyond a turn of pi the logarithm comes round from the other side: take the one next to its own end.
    ends = np.where((frames < gaps.start[rows])[:, None], -turn[rows] / 2, turn[rows] / 2)
    vectors = _same_turn_near(ends, _logarithm(middle[rows], seen[frames]))
    inside, done = [], 0
    for group in members:
        samples = vectors[done : done + group.frames.size].reshape(*group.frames.shape, 3)
        inside.append((curve.across(group.length, group.times, fps) @ samples).reshape(-1, 3))
        done += group.frames.size
    owners = np.concatenate([np.repeat(group.rows, group.length) for group in members])
    missing = np.concatenate([group.missing.ravel() for group in members])
    crossed = rotations.multiply(middle[owners], rotations.from_rotvec(np.concatenate(inside)))
    turns[missing, joint] = rotations.multiply(rotations.inverse(frame[missing]), crossed)


def _logarithm(base: Array, q: Array) -> Array:
    return rotations.to_rotvec(rotations.multiply(rotations.inverse(base), q))


def _same_turn_near(target: Array, vectors: Array) -> Array:
    """Of the rotation vectors that mean the same rotations as `vectors`, whole turns apart, those by `target`."""
    axis = rotations.normalised(vectors)
    ahead = np.sum(axis * (target - vectors), axis=-1, keepdims=True)
    return vectors + axis * 2 * np.pi * np.round(ahead / (2 * np.pi))


def _whole_turns(turn: Array, samples: Array, group: Group, fps: float) -> Array:
    """The turns `(gaps, 3)` across gaps of a root, which may have gone round; a limb's joint cannot.

    It turned by more than pi only if the slower of the spins at its two ends, kept up through the gap, says so.
    """
    reach, span = velocity_frames(fps), group.length + 1
    axis, kept = rotations.normalised(turn), []
    for seam, near in ((0, group.times <= 0), (span, group.times > group.length)):
        near = near & (np.abs(group.times - seam) < reach)
        if near.sum() < 2:
            return turn
        base = samples[:, np.flatnonzero(group.times == seam)]
        spin = velocity(group.times[near], seam) @ _logarithm(base, samples[:, near])
        kept.append(span * np.sum(spin * axis, axis=-1, keepdims=True))
    one, other = kept
    slower = np.where(np.abs(one) < np.abs(other), one, other)
    goes_round = (one * other > 0) & (np.abs(slower) > np.pi)
    return np.where(goes_round, _same_turn_near(axis * slower, turn), turn)
