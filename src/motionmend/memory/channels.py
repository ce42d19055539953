"""The fill that asks a memory, for the channels of a rig: bones keep their lengths, whatever the neighbours did.

The answer is linear in the neighbours, so the weights found by comparing positions serve every channel: what is added
to a curve is the weighted sum of the rotation vectors from the neighbours' curves to their truth, log(curve⁻¹ truth).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..gaps import Gaps
from ..motion import Motion, Rig, Take
from ..rotations import from_rotvec, inverse, multiply, to_rotvec
from . import bases, recalling
from .filling import ITSELF, own_window, together, told
from .neighbours import ALIKE, gathered
from .recalling import Answer
from .sessions import RATE, Session, mirror_axis, remember, versions, with_ends

Array = np.ndarray

SHORT = 0.01  # metres: bones shorter than this have no direction to speak of
LEANING = 0.1  # of a bone's length by which its direction may differ between rigs that teach each other


def recall_rig(
    rig: Rig, motion: Motion, sessions: Sequence[Session] = (), without: frozenset[str] = frozenset()
) -> tuple[Rig, Gaps]:
    """`rig`, with those of its gaps filled that memory has an answer for, and all its gaps, told.

    motion : of `rig`. sessions, without : see `filling.Recall`.
    """
    gaps = Gaps.of(rig.trusted)
    rotations, shifts, trusted = rig.rotations.copy(), rig.translations.copy(), rig.trusted.copy()
    method, reasons = gaps.method.copy(), {}
    points = with_ends(rig, motion)
    itself = remember(motion, rig, ITSELF)
    without |= versions(itself, sessions)
    able = [session for session in (itself, *sessions) if _alike(session, rig)]
    moves = rig.moves | (np.array(rig.skeleton.parents) < 0)
    for rows, start, stop in together(gaps):
        lost = np.sort(gaps.joint[rows])
        hanging = _hanging(points, rig, lost, start, stop)
        answer = recalling.ask(points, hanging, start, stop, able, without) if len(hanging) else recalling.TOO_SHORT
        if isinstance(answer, Answer):
            turns, places = _answered(rig, answer, lost, start, stop, motion.fps)
            rotations[start:stop, lost] = turns
            moving = moves[lost]
            shifts[start:stop, lost[moving]] = places[:, moving]
            trusted[start:stop, lost] = True
            method[rows] = "recall"
        reasons |= dict.fromkeys(rows.tolist(), told(answer))
    filled = replace(rig, rotations=rotations, translations=shifts, trusted=trusted)
    return filled, replace(gaps, method=method, reasons=reasons)


def unlike(sessions: Sequence[Session], take: Take) -> int:
    """How many takes in memory can teach this one nothing, because their joints or markers are others."""
    if take.rig is None:
        names = set(take.skeleton.names)
        strange = [len(names & session.index.keys()) < ALIKE * len(names) for session in sessions]
    else:
        strange = [not _alike(session, take.rig) for session in sessions]
    return sum(len(session.takes) for session, other in zip(sessions, strange) if other)


def _alike(session: Session, rig: Rig) -> bool:
    """Whether a session's channels mean the same as the rig's: the same joints, bones in the same directions."""
    joints = len(rig.skeleton)
    if session.offsets is None or session.rotations is None or len(session.offsets) != joints:
        return False
    names, parents = session.skeleton.names[:joints], session.skeleton.parents[:joints]
    if names != rig.skeleton.names or parents != rig.skeleton.parents:
        return False
    apart = np.linalg.norm(_directions(session.offsets) - _directions(rig.offsets), axis=-1)
    return bool(np.all(apart[1:] < LEANING))


def _directions(bones: Array) -> Array:
    return bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), SHORT)


def _hanging(points: Motion, rig: Rig, lost: Array, start: int, stop: int) -> Array:
    """The points that hang on lost channels, and are seen right beside the gap."""
    moves = rig.moves | (np.array(rig.skeleton.parents) < 0)
    hangs = np.zeros(len(points.skeleton), bool)
    for point, parent in enumerate(points.skeleton.parents):
        own = point < len(moves) and moves[point] and point in lost
        hangs[point] = own or (parent >= 0 and (hangs[parent] or parent in lost))
    for seam in (start - 1, stop):
        if 0 <= seam < len(points):
            hangs &= points.observed[seam]
    return np.flatnonzero(hangs)


def _answered(rig: Rig, answer: Answer, lost: Array, start: int, stop: int, fps: float) -> tuple[Array, Array]:
    """The turns `(frames, lost, 4)` and shifts `(frames, lost, 3)` of a gap."""
    parents = rig.skeleton.parents
    layout, window = own_window(answer.layout, rig.trusted[:, lost], start, stop, fps)
    inner = _inner(rig.trusted[window], parents, lost)
    own = rig.rotations[None, window], rig.translations[None, window]
    turns, places = (each[0] for each in bases.eased_channels(*own, parents, lost.tolist(), inner, layout, fps))
    more, moved = np.zeros((2, len(answer.layout.missing), len(lost), 3))
    roots = np.array([parents[joint] < 0 for joint in lost])
    for rows, session, its, mirrored in answer.near.groups():
        first = answer.near.start[rows]
        rotations, shifts = (gathered(session, name, first, its.length) for name in ("rotations", "shifts"))
        if mirrored:
            rotations, shifts = mirrored_channels(rotations, shifts, session, parents)
        base, base_shifts = bases.eased_channels(rotations, shifts, parents, lost.tolist(), inner, its, RATE)
        truth = rotations[:, its.missing][:, :, lost]
        weights = answer.weights[rows]
        more += np.tensordot(weights, to_rotvec(multiply(inverse(base), truth)), 1)
        apart = shifts[:, its.missing][:, :, lost] - base_shifts
        apart[:, :, roots] = recalling.turned(apart[:, :, roots], answer.near.turn[rows], False)
        moved += np.tensordot(weights, apart, 1)
    frames = stop - start
    turns = multiply(turns, from_rotvec(answer.at_frames(more, frames)))
    return turns, places + answer.at_frames(moved, frames)


def _inner(trusted: Array, parents: Sequence[int], lost: Array) -> list[int]:
    """Those of the lost joints whose parent's turn in the world is not known in a window of frames."""
    known = np.zeros(len(parents), bool)
    for joint, parent in enumerate(parents):
        known[joint] = (parent < 0 or known[parent]) and (joint in lost or bool(trusted[:, joint].all()))
    return [joint for joint in lost.tolist() if parents[joint] >= 0 and not known[parents[joint]]]


def mirrored_channels(
    rotations: Array, shifts: Array, session: Session, parents: Sequence[int]
) -> tuple[Array, Array]:
    """Channels `(…, joints, 4 or 3)` of a rig whose motion is the mirror image, in x, of what they were."""
    assert session.twins is not None and session.offsets is not None
    twins = session.twins[: len(parents)]
    axis = mirror_axis(session.offsets, twins)
    assert axis is not None
    flip = np.where(np.arange(3) == axis, -1.0, 1.0)
    rotations = rotations[..., twins, :] * np.append(-flip, 1.0).astype(rotations.dtype)
    shifts = shifts[..., twins, :] * flip.astype(shifts.dtype)
    for root in np.flatnonzero(np.array(parents) < 0):
        shifts[..., root, :] *= flip * [-1, 1, 1]
        if axis != 0:  # the world is mirrored in x, the rest pose in another axis: half a turn about the third
            half = np.append(np.isin(np.arange(3), (0, axis), invert=True), False).astype(rotations.dtype)
            rotations[..., root, :] = multiply(half, rotations[..., root, :])
    return rotations, shifts
