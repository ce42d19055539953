"""A motion on the rig of another one, by where BODY's joints are: for rigs that share neither names nor proportions.

Rigs agree on limbs and hardly on trunks: where a spine bends, and where collar bones begin, is each rig's own. So limbs
take each bone's direction, and a trunk is posed by its two ends, the hips' and the shoulders', on which the rig keeps
its own joints where it usually has them.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..body.joints import BODY, JOINT, LIMBS
from ..body.mapping import Mapping, to_body
from ..constraints.ground import leg_length
from ..errors import InputError
from ..motion import Array, Motion, Rig, Take
from ..rigs.fitting import fit, scatter
from ..rotations import apply, inverse, normalised
from .composing import ancestors

LOWER = [JOINT[name] for name in ("hips", "spine", "left_thigh", "right_thigh")]
UPPER = [JOINT[f"{side}_{part}"] for side in ("left", "right") for part in ("shoulder", "upper_arm")]
UPPER += [JOINT[name] for name in ("chest", "neck", "head")]
BONES = [bone for limb in LIMBS.values() for bone in pairwise(limb)]
ENDS = ("thigh", "upper_arm")


def transferred(take: Take, ours: Mapping, motion: Motion, theirs: Mapping, source: str) -> Rig:
    """The take's rig posed as the body in `motion` is, in the rig's own size, with the floor at 0 in both.

    What positions cannot say (twist, fingers, the face) is as in the take's first frame.

    Raises
    ------
    InputError : naming `source`, where one of the bodies lacks a hip or a shoulder, or samples of it are missing.
    """
    assert take.rig is not None
    own, other = to_body(take.motion, ours), to_body(motion, theirs)
    ends = [JOINT[f"{side}_{part}"] for side in ("left", "right") for part in ENDS]
    if min(ours.joints[joint] for joint in ends) < 0 or min(theirs.joints[joint] for joint in ends) < 0:
        raise InputError("hips and shoulders are not both there, and its rig is another", where=source,
                         hint="chain takes of one rig, or say in a map file which joint is which")  # fmt: skip
    if not other.observed[:, [joint for joint in range(len(BODY)) if theirs.joints[joint] >= 0]].all():
        raise InputError("some of its samples are missing", where=source, hint="repair it first")
    targets = _targets(own, other.positions.astype(float))
    rig, frames = take.rig, len(motion)
    still = replace(
        rig,
        rotations=np.repeat(rig.rotations[:1], frames, axis=0),
        translations=np.repeat(rig.translations[:1], frames, axis=0),
        trusted=np.ones((frames, len(take.skeleton)), bool),
    )
    free = still.trusted.copy()
    if (hips := ours.joints[JOINT["hips"]]) >= 0 and rig.moves[hips] and (above := ancestors(take.skeleton, hips)):
        # A root on the floor stays where it is, and the hips go from it.
        free[:, above] = False
        places, attitudes = (each[:, above[0]] for each in still.kinematics)
        shifts = still.translations.copy()
        shifts[:, hips] = apply(inverse(attitudes), targets[:, JOINT["hips"]] - places)
        still = replace(still, translations=shifts)
    guess = replace(take, document=None).with_rig(still)
    fitted = fit(guess, scatter(targets, ours.joints, len(take.skeleton)), free).rig
    assert fitted is not None
    return fitted


def _targets(own: Motion, points: Array) -> Array:
    """The joints `(frames, J, 3)` of a body of the proportions of `own`, posed as `points`; NaN where unknown."""
    points = points * _scale(own, points)
    whole = own.positions.astype(float)
    low, high, spine = _girdles(points)
    its_low, its_high, its_spine = _girdles(whole)
    targets = np.full_like(points, np.nan)
    middle = points[:, [JOINT["left_thigh"], JOINT["right_thigh"]]].mean(axis=1)
    its_middle = whole[:, [JOINT["left_thigh"], JOINT["right_thigh"]]].mean(axis=1)
    top, its_top = middle + normalised(spine) * np.median(np.linalg.norm(its_spine, axis=-1)), its_middle + its_spine
    for joints, frame, origin, its_frame, its_origin in (
        (LOWER, low, middle, its_low, its_middle),
        (UPPER, high, top, its_high, its_top),
    ):
        usual = np.einsum("fji,fkj->fki", its_frame, whole[:, joints] - its_origin[:, None]).mean(axis=0)
        targets[:, joints] = origin[:, None] + np.einsum("fij,kj->fki", frame, usual)
    for start, end in BONES:
        length = np.median(np.linalg.norm(whole[:, end] - whole[:, start], axis=-1))
        targets[:, end] = targets[:, start] + normalised(points[:, end] - points[:, start]) * length
    return targets


def _scale(own: Motion, points: Array) -> float:
    legs = [leg_length(each) for each in (own, replace(own, positions=points.astype(np.float32),
                                                       observed=np.isfinite(points).all(axis=-1)))]  # fmt: skip
    return legs[0] / legs[1] if np.isfinite(legs).all() else 1.0


def _girdles(points: Array) -> tuple[Array, Array, Array]:
    """Frames of the hips and of the shoulders, `(frames, 3, 3)`, columns left, up, ahead; and from one to the other."""
    hips, shoulders = (points[:, [JOINT[f"left_{part}"], JOINT[f"right_{part}"]]] for part in ENDS)
    spine = shoulders.mean(axis=1) - hips.mean(axis=1)
    frames = []
    for pair in (hips, shoulders):
        left = normalised(pair[:, 0] - pair[:, 1])
        up = normalised(spine - left * np.sum(spine * left, axis=-1, keepdims=True))
        frames.append(np.stack([left, up, np.cross(left, up)], axis=-1))
    return frames[0], frames[1], spine
