"""What kind of gap it is: a whole body, a limb, a lower limb, an extremity, markers, by what is missing with it."""

from __future__ import annotations

import numpy as np

from ..body.joints import LIMBS
from ..body.mapping import Mapping
from ..gaps import Gaps
from ..motion import Motion, Rig

KINDS = {
    "body": "the whole rig is missing",
    "limb": "a whole limb is missing",
    "lower limb": "the outer part of a limb is missing",
    "extremity": "a hand, a foot or a head is missing",
    "all points": "every point is missing",
    "leg joints": "joints of a leg are missing",
    "joints": "joints of a skeleton are missing",
    "markers": "markers of a cloud are missing",
    "many markers": "many markers of a cloud are missing at once",
}
# Of a limb's length, from its branch to its tip: with less missing it is the lower limb, or an extremity.
LIMB_SHARE, EXTREMITY_SHARE = 2 / 3, 1 / 4
MANY_SHARE = 0.3  # of a cloud's markers, on average through the gap


def point_kinds(motion: Motion, gaps: Gaps, mapping: Mapping | None = None) -> list[str]:
    """Each gap's kind, for a motion of points; `mapping` tells which are a leg's."""
    joints = np.full(len(motion.skeleton), "joints" if motion.skeleton.has_bones else "markers", "U12")
    if motion.skeleton.has_bones and mapping:
        joints[_legs(mapping)] = "leg joints"
    kinds, seen = joints[gaps.joint], np.concatenate([[0], np.cumsum(motion.observed.any(axis=1))])
    if not motion.skeleton.has_bones:
        there = motion.observed[:, motion.observed.any(axis=0)]
        missing = np.concatenate([[0], np.cumsum(there.shape[1] - there.sum(axis=1))])
        most = MANY_SHARE * there.shape[1] * gaps.length
        kinds = np.where(missing[gaps.stop] - missing[gaps.start] > most, "many markers", kinds)
    return np.where(seen[gaps.stop] == seen[gaps.start], "all points", kinds).tolist()


def _legs(mapping: Mapping) -> list[int]:
    """A person's thighs, shins, feet and toes, those that the rig has."""
    legs = [mapping.joints[joint] for side in ("left_leg", "right_leg") for joint in LIMBS[side]]
    return [joint for joint in legs if joint >= 0]


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
