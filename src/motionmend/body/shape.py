"""A body by its shape: the trunk along a rig's tree, people whose joints have foreign names, and quadrupeds."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np

from ..motion import Skeleton
from . import names

Array = np.ndarray

Parsed = Sequence[tuple[str, str]]


def trunk(skeleton: Skeleton, parsed: Parsed, limbs: Mapping[str, int], sample: Array | None) -> dict[str, int]:
    """Hips, spine, chest, neck and head: along the tree between legs, arms and head, or else by names alone.

    A joint that lies where the one before it lies is passed over: many rigs begin with a spine joint inside
    the hips. The chest is where the arms branch off.
    """
    named = {part: names.middles(parsed, part) for part in names.MIDDLE_STEMS}
    arms = [limbs.get(f"{side}_shoulder", limbs.get(f"{side}_upper_arm", -1)) for side in names.SIDES]
    thighs = [limbs.get(f"{side}_thigh", -1) for side in names.SIDES]
    hips = _ancestor(skeleton, thighs, named["hips"])
    branch = _ancestor(skeleton, arms)
    if hips < 0 or branch < 0:
        return _trunk_by_names(parsed, named)

    spine = _path(skeleton, branch)
    if hips in spine:
        spine = spine[spine.index(hips) + 1 :]
    else:
        spine = [joint for joint in spine if joint in named["spine"] + named["chest"]]
    neck = _neck(skeleton, branch, set(limbs.values()), named)
    if spine and spine[-1] in named["neck"]:
        neck.insert(0, spine.pop())

    found = {"hips": hips}
    if spine:
        found["chest"] = spine.pop()
    if sample is None and len(spine) > 1 and parsed[spine[0]][1] == "lowerback":
        del spine[0]  # CMU's lower back begins at the root
    found |= _first_apart("spine", spine, hips, sample)
    if neck:
        found["head"] = next((joint for joint in neck if joint in named["head"]), neck[-1])
        found |= _first_apart("neck", neck[: neck.index(found["head"])], found.get("chest", hips), sample)
    return found


def _trunk_by_names(parsed: Parsed, named: dict[str, list[int]]) -> dict[str, int]:
    found = {part: named[part][0] for part in ("hips", "neck", "head") if named[part]}
    spine = names.upwards(parsed, named["spine"] + named["chest"])
    if ("", "thorax") in parsed and ("left", "knee") in parsed:
        # Human3.6M's 17 joints: Thorax is the base of the neck, Neck or Nose that of the head, Head its crown.
        thorax = parsed.index(("", "thorax"))
        spine.remove(thorax)
        base = named["nose"] + named["neck"] + named["head"]
        found["neck"] = thorax
        if base:
            found["head"] = base[0]
    elif named["nose"]:
        found.pop("head", None)  # a keypoint detector's Head is the crown
    if spine and (len(spine) > 1 or named["spine"][:1] == spine):
        found["spine"] = spine[0]
    if spine and (len(spine) > 1 or named["chest"][:1] == spine):
        found["chest"] = spine[-1]
    return found


def is_quadruped(names: Iterable[str], found: Mapping[str, int], sample: Array | None) -> bool:
    """Whether this is an animal on four legs, whose joints rigs often call a person's.

    It has a tail or paws and no posture that denies it; or it goes on all fours all the time, and its trunk
    is longer than a person's against its legs, so that a take of crawling stays a person's.
    """
    animal = any(re.search(r"tail(?!or)|hoof|paw|horse|hindleg|foreleg", name.casefold()) for name in names)
    posture = _posture(found, sample)
    if posture is None:
        return animal
    on_fours, trunk_by_leg = posture
    return on_fours > (0.5 if animal else 0.8) and (animal or trunk_by_leg > 0.85)


def _posture(found: Mapping[str, int], sample: Array | None) -> tuple[float, float] | None:
    """The share of frames on all fours, and the trunk's length by thigh and shin; None if it cannot be told."""
    needed = [[f"{side}_{part}" for side in names.SIDES] for part in ("thigh", "shin", "upper_arm", "forearm")]
    if sample is None or any(name not in found for pair in needed for name in pair):
        return None
    thigh, shin, upper_arm, forearm = (sample[:, [found[name] for name in pair]].mean(axis=1) for pair in needed)
    lower = [found[name] for name in ("left_foot", "right_foot") if name in found]
    foot = sample[:, lower].mean(axis=1) if lower else shin
    spine, leg, arm = upper_arm - thigh, foot - thigh, forearm - upper_arm
    seen = np.isfinite(spine + leg + arm).all(axis=-1)
    if not seen.any():
        return None
    length = np.linalg.norm(shin - thigh, axis=-1) + np.linalg.norm(foot - shin, axis=-1)
    across = np.abs(_cosine(spine, leg)) < 0.6
    both_down = _cosine(arm, leg) > 0.5
    return float((across & both_down)[seen].mean()), float(np.median(_ratio(spine, length)[seen]))


def search(skeleton: Skeleton, sample: Array) -> tuple[dict[str, int], str] | None:
    """A person in a rig whose names mean nothing: two long legs on one joint, two arms on a later one.

    Left and right come from where the toes point, or the knees bend. Returns the joints and a word for
    `Mapping.rig`; None where nothing has a person's shape.
    """
    pairs = _limb_pairs(skeleton, sample)
    for hips, *legs in pairs:
        for chest, *arms in pairs:
            path = _path(skeleton, chest)
            if hips == chest or hips not in path or set(path) & {*legs[0], *legs[1]}:
                continue
            found = _person(skeleton, sample, hips, chest, legs, arms)
            if found:
                return _sided(sample, found)
    return None


def _limb_pairs(skeleton: Skeleton, sample: Array) -> list[tuple[int, list[int], list[int]]]:
    """Pairs of chains of three joints or more with the same bone lengths that hang on one joint, longest first."""
    pairs, depth = [], _depths(skeleton)
    for joint, children in enumerate(skeleton.children):
        long = [child for child in children if depth[child] >= 2][:20]
        chains = [_chain(skeleton, sample, child, depth) for child in long] if len(long) > 1 else []
        for one, other in combinations([chain for chain in chains if len(chain) >= 3], 2):
            lengths = np.array([_bones(sample, chain)[:2] for chain in (one, other)])
            if len(one) == len(other) and np.all(np.abs(lengths[0] - lengths[1]) < 0.15 * lengths.max(axis=0)):
                pairs.append((float(lengths.sum()), joint, one, other))
    return [pair[1:] for pair in sorted(pairs, key=lambda pair: -pair[0])[:50]]


def _chain(skeleton: Skeleton, sample: Array, joint: int, depth: Sequence[int]) -> list[int]:
    """From a joint down its longest line, without joints that lie where the one before lies; at most six."""
    chain = [joint]
    while skeleton.children[joint] and len(chain) < 6:
        joint = max(skeleton.children[joint], key=depth.__getitem__)
        if not _coincide(sample, joint, chain[-1]):
            chain.append(joint)
    return chain


def _person(
    skeleton: Skeleton, sample: Array, hips: int, chest: int, legs: list[list[int]], arms: list[list[int]]
) -> dict[str, int] | None:
    """The joints of a body with these limbs, if its proportions are a person's."""
    leg, arm = _bones(sample, legs[0]), _bones(sample, arms[0])
    thigh = _two_bones(leg)
    leg_length = leg[thigh : thigh + 2].sum()
    # The collar bones begin side by side, the upper arms a chest apart.
    across = np.array([_length(sample, left, right) for left, right in zip(*arms)])
    upper = _two_bones(arm * (across[:-1] > 0.2 * leg_length))
    arm_length, height = arm[upper : upper + 2].sum(), _length(sample, hips, chest)
    if not (
        0.6 < leg[thigh] / leg[thigh + 1] < 1.6
        and 0.6 < arm[upper] / arm[upper + 1] < 2.0
        and 0.4 < arm_length / leg_length < 1.0
        and 0.2 < height / leg_length < 0.95
        and 0.2 < across[upper] / leg_length < 0.8
    ):
        return None
    found = {"hips": hips, "chest": chest}
    for side, leg_chain, arm_chain in zip(names.SIDES, legs, arms):
        found |= {f"{side}_{part}": j for part, j in zip(("thigh", "shin", "foot", "toe"), leg_chain[thigh:])}
        found |= {f"{side}_{part}": j for part, j in zip(("upper_arm", "forearm", "hand"), arm_chain[upper:])}
        if upper:
            found[f"{side}_shoulder"] = arm_chain[upper - 1]
    path = _path(skeleton, chest)
    found |= _first_apart("spine", path[path.index(hips) + 1 : -1], hips, sample)
    neck = _neck(skeleton, chest, {arms[0][0], arms[1][0]}, {})
    if neck:
        # Beyond the head's base there may be its crown, or a jaw.
        found["head"] = [joint for joint in neck if not _length(sample, neck[0], joint) > 0.28 * leg_length][-1]
        found |= _first_apart("neck", neck[: neck.index(found["head"])], chest, sample)
    return found


def _two_bones(lengths: Array) -> int:
    """Where in a limb its two long bones begin."""
    return int(np.argmax(np.minimum(lengths[:-1], lengths[1:])[:3]))


def _sided(sample: Array, found: dict[str, int]) -> tuple[dict[str, int], str]:
    """The same with each pair of limbs called left and right as it is, or without limbs if that cannot be told."""

    def middle(part: str) -> Array:
        return (sample[:, found[f"left_{part}"]] + sample[:, found[f"right_{part}"]]) / 2

    # A bent knee stands forward of the leg's line, a foot forward of its shin. These are lengths, not unit
    # vectors, because a straight knee says little. Right-handed: up × forward points left.
    shin = middle("foot") - middle("shin")
    forward = middle("shin") - (middle("thigh") + middle("foot")) / 2
    if "left_toe" in found and "right_toe" in found:
        foot = middle("toe") - middle("foot")
        along = np.sum(foot * shin, axis=-1, keepdims=True) / np.sum(shin * shin, axis=-1, keepdims=True)
        forward = forward + foot - along * shin
    leftward = np.cross(middle("upper_arm") - middle("thigh"), forward)
    sided = {name: joint for name, joint in found.items() if "_" not in name}
    arms, legs = ("upper_arm", "shoulder", "forearm", "hand"), ("thigh", "shin", "foot", "toe")
    for parts in (arms, legs):
        across = sample[:, found[f"left_{parts[0]}"]] - sample[:, found[f"right_{parts[0]}"]]
        votes = np.sum(leftward * across, axis=-1)
        votes = votes[np.isfinite(votes)]
        if not np.abs(votes.sum()) > 0.5 * np.abs(votes).sum():
            middles = {name: joint for name, joint in found.items() if "_" not in name}
            return middles, "by topology, left and right unknown"
        sides = names.SIDES if votes.sum() > 0 else names.SIDES[::-1]
        for part in parts:
            for side, true_side in zip(names.SIDES, sides):
                if f"{side}_{part}" in found:
                    sided[f"{true_side}_{part}"] = found[f"{side}_{part}"]
    return sided, "by topology"


def _path(skeleton: Skeleton, joint: int) -> list[int]:
    """From the root to the joint, both included."""
    path = []
    while joint >= 0:
        path.append(joint)
        joint = skeleton.parents[joint]
    return path[::-1]


def _ancestor(skeleton: Skeleton, joints: Sequence[int], preferred: Sequence[int] = ()) -> int:
    """The deepest of the `preferred`, or of all joints, that stands above all of these; -1 if there is none."""
    if min(joints) < 0:
        return -1
    paths = [_path(skeleton, joint)[:-1] for joint in joints]
    common = [joint for joint in paths[0] if all(joint in path for path in paths)]
    return ([joint for joint in common if joint in preferred] or common or [-1])[-1]


def _neck(skeleton: Skeleton, branch: int, limbs: set[int], named: Mapping[str, list[int]]) -> list[int]:
    """The joints from where the arms branch off up to the head."""
    for head in sorted(named.get("head", ())):
        path = _path(skeleton, head)
        if branch in path[:-1]:
            return path[path.index(branch) + 1 :]
    depth = _depths(skeleton)
    parents = {joint for limb in limbs for joint in _path(skeleton, limb)}
    chain: list[int] = []
    while True:
        above = [joint for joint in skeleton.children[branch] if joint not in parents]
        if not above or (chain and len(above) > 1):
            return chain
        branch = max(above, key=depth.__getitem__)
        chain.append(branch)


def _depths(skeleton: Skeleton) -> list[int]:
    """For each joint, how many joints the longest line below it has."""
    depth = [0] * len(skeleton)
    for joint in range(len(skeleton) - 1, -1, -1):
        parent = skeleton.parents[joint]
        if parent >= 0:
            depth[parent] = max(depth[parent], depth[joint] + 1)
    return depth


def _first_apart(part: str, joints: Sequence[int], start: int, sample: Array | None) -> dict[str, int]:
    """The first of the joints that does not lie on `start`, under the name `part`."""
    apart = [joint for joint in joints if sample is None or not _coincide(sample, joint, start)]
    return {part: apart[0]} if apart else {}


def _coincide(sample: Array, one: int, other: int) -> bool:
    """Whether two joints lie within a hundredth of the body's size of each other."""
    size = _finite_median(np.ptp(np.nan_to_num(sample - sample[:, :1]), axis=1).max(axis=-1))
    return _length(sample, one, other) < 0.01 * size


def _bones(sample: Array, chain: Sequence[int]) -> Array:
    return np.array([_length(sample, one, other) for one, other in pairwise(chain)])


def _length(sample: Array, one: int, other: int) -> float:
    return _finite_median(np.linalg.norm(sample[:, one] - sample[:, other], axis=-1))


def _finite_median(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else np.nan


def _cosine(a: Array, b: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sum(a * b, axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))


def _ratio(vector: Array, length: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.linalg.norm(vector, axis=-1) / length
