"""What hangs below: whether the world bears out what one joint's channels say.

Solvers let hips jump and legs jump back by as much. Nothing shows in the world, and hips mended alone would throw
the feet: so what was found is filled on trial, and what hangs on it must not move more roughly for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..fills.channels import fill_rig
from ..fills.curves import velocity_frames
from ..fills.points import FILLS
from ..metrics.positional import steps
from ..motion import Array, Motion, Rig
from ..rotations import apply

SEAM = 3  # frames from which a seam's roughness is measured, on each side

Piece = tuple[int, int, int]  # joint, start, stop


def excused_points(motion: Motion, limits: dict[Piece, float]) -> set[Piece]:
    """The pieces of points whose replacement leaves them rougher at their seams than their limits."""
    if not limits:
        return set()
    hidden = np.zeros_like(motion.observed)
    for joint, start, stop in limits:
        hidden[start:stop, joint] = True
    known = motion.observed & ~hidden
    filled = FILLS["hermite"].complete(replace(motion, observed=known))
    before, after = (
        np.nan_to_num(steps(np.where(one.observed[..., None], one.positions, np.nan))[0]) for one in (motion, filled)
    )
    free: set[Piece] = set()
    for (joint, start, stop), limit in limits.items():
        rows = _seam_rows([(joint, start, stop)], len(before))
        if after[rows, joint].sum() > limit * before[rows, joint].sum():
            free.add((joint, start, stop))
    return free


def _seam_rows(pieces: list[Piece], frames: int) -> Array:
    """The frames whose steps show how the pieces' seams fit."""
    rows = np.unique([[start - 1, start, start + 1, stop - 1, stop, stop + 1] for _, start, stop in pieces])
    return rows[(rows >= 0) & (rows < frames)]


def excused(rig: Rig, fps: float, limits: dict[Piece, float]) -> set[Piece]:
    """The pieces whose replacement leaves what hangs on their joints rougher than their limits.

    Those of one chain are judged together. If they fail, the uppermost joint, for which the others may make up,
    is excused, and the rest is judged again.
    """
    parents = rig.skeleton.parents
    below = np.eye(len(parents), dtype=bool)
    for joint, parent in reversed(list(enumerate(parents))):
        if parent >= 0:
            below[parent] |= below[joint]
    free: set[Piece] = set()
    pieces = list(limits)
    while chains := _chains(pieces, below, 2 * SEAM):
        pieces = []
        for chain, roughness in zip(chains, _roughness(rig, fps, chains, below)):
            if roughness > max(limits[piece] for piece in chain):
                top = min(joint for joint, _, _ in chain)  # parents come before their children
                free |= {piece for piece in chain if piece[0] == top}
                pieces += [piece for piece in chain if piece[0] != top]
    return free


def _chains(pieces: list[Piece], below: Array, slack: int) -> list[list[Piece]]:
    """Pieces at most `slack` frames apart, of joints that hang on one another: `below[a, b]` if b hangs on a."""
    done: list[list[Piece]] = []
    near: list[list[Piece]] = []
    for piece in sorted(pieces, key=lambda piece: piece[1]):
        chain, others = [piece], []
        for other in near:
            if max(stop for _, _, stop in other) + slack < piece[1]:
                done.append(other)
            elif any(below[piece[0], joint] or below[joint, piece[0]] for joint, _, _ in other):
                chain += other
            else:
                others.append(other)
        near = [*others, chain]
    return done + near


def _roughness(rig: Rig, fps: float, chains: list[list[Piece]], below: Array) -> Iterator[float]:
    """For each chain, how rough what hangs on it is at its seams once it is filled, against before."""
    reach = velocity_frames(fps) + SEAM
    hidden, near = np.zeros_like(rig.trusted), np.zeros(len(rig.trusted), bool)
    for joint, start, stop in (piece for chain in chains for piece in chain):
        hidden[start:stop, joint] = near[max(0, start - reach) : stop + reach] = True
    at = np.flatnonzero(near)
    # Frames from elsewhere become neighbours here, but further from every gap and seam than anything looks.
    part = replace(rig, rotations=rig.rotations[at], translations=rig.translations[at], trusted=~hidden[at])
    before, after = (_jumps(one) for one in (part, fill_rig(part, fps)[0]))
    moved = below.copy()
    np.fill_diagonal(moved, below.sum(axis=1) == 1)  # where nothing hangs on a joint, itself
    for chain in chains:
        rows = np.searchsorted(at, _seam_rows(chain, len(near)))
        place = np.ix_(rows, moved[[joint for joint, _, _ in chain]].any(axis=0))
        yield float(after[place].sum() / max(before[place].sum(), 1e-6))


def _jumps(rig: Rig) -> Array:
    """`(frames, joints)` mm by which each step of a joint in the world departs from the steps around it.

    That of three marks, fixed to the joint at 10 cm along its axes: so turns count as well as places.
    """
    places, turns = rig.kinematics
    jumps = [steps(places + apply(turns, 0.1 * axis))[0] for axis in np.eye(3)]
    return np.nan_to_num(np.sum(jumps, axis=0))
