"""Damage planted in a take on purpose: to measure repairs and diagnosis, and to try things.

The same seed plants the same damage. The masks and offsets themselves are made in `damage`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..errors import InputError
from ..motion import Array, Rig, Take
from ..rotations import from_rotvec, multiply, normalised
from .corruption import Stretch, dropouts, stretches_mask


@dataclass(frozen=True)
class Planted:
    """One piece of planted damage: its cause and joint indices, in frames `[start, stop)`."""

    cause: str
    joints: tuple[int, ...]
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class Truth:
    """What was planted: `mask (frames, joints)` is True where the file's own numbers were damaged.

    masks : one such mask a cause. Noise touches everything that can move, and is in `masks` but not in `mask`.
    planted : the stretches; dropouts and noise, which have none, are one entry for the whole take.
    """

    mask: Array
    masks: dict[str, Array] = field(default_factory=dict)
    planted: tuple[Planted, ...] = ()


def plant(take: Take, **damage: Any) -> Take:
    """The damaged take alone; the options are those of `plant_and_tell`."""
    return plant_and_tell(take, **damage)[0]


def plant_and_tell(
    take: Take,
    *,
    gaps: Sequence[tuple[int, int]] = (),
    lost: Sequence[Stretch] = (),
    held: Sequence[Stretch] = (),
    jump: Sequence[Stretch] = (),
    swap: Sequence[Stretch] = (),
    displaced: Sequence[Stretch] = (),
    dropout: float = 0.0,
    noise: float = 0.0,
    size: float = 0.3,
    seed: int = 0,
) -> tuple[Take, Truth]:
    """Damage a take, and say where.

    Parameters
    ----------
    gaps : frames `(start, stop)` in which every joint is lost.
    lost : `(joint indices, start, stop)`, half-open. In points: NaN, unobserved. A file of channels has no
        way to say that a number is missing; what recorders do is to repeat the last value, so there the
        joints' turns (and shifts, for joints that have them) hold the value of frame `start - 1`, or of
        frame `stop` where the stretch begins the take.
    held : the same stretches, repeating the last value in points too.
    jump : a constant offset over a stretch of a few frames (a spike), or to the end of the take (a step).
    displaced : a constant offset over a longer stretch. One offset a joint and stretch, in a random direction.
    swap : the stretch of each joint named is exchanged with its left or right twin's; twins are known by
        their names.
    dropout : the share of single samples that are lost, drawn independently: NaN in points; in channels the
        sample repeats the one before it, which is how exporters write a frame that a sensor missed.
    noise : standard deviation in metres, per axis. In points it is added to the coordinates; in channels to
        the root's position, and every turn is disturbed so that the furthest end of what hangs on the joint
        moves by about that much (noise over that length, in radians, per axis).
    size : length of the offsets of `jump` and `displaced`: metres for points, radians for turns. Roots of a
        rig are shifted by `size` metres instead of turned.
    seed : for everything that is drawn.

    Raises
    ------
    InputError : for a swap of joints without twins, a dropout outside 0 to 1, a negative noise.

    Returns
    -------
    The damaged take and the truth. In a take of points `observed` is False where the numbers are gone. In a
    take of channels `trusted` is as it was: the file does not know. Untouched samples are bitwise the same.
    """
    if not 0 <= dropout <= 1 or not noise >= 0:
        raise InputError(f"dropout {dropout:g}, noise {noise:g}", expected="a dropout from 0 to 1, noise of 0 or more")
    rng = np.random.default_rng(seed)
    frames, joints = take.motion.observed.shape
    everyone = range(joints)
    wanted: dict[str, list[Stretch]] = {
        "gap": [(everyone, *gap) for gap in gaps],
        "lost": list(lost),
        "held": list(held),
        "jump": list(jump),
        "swap": [(with_twins(take.skeleton.names, which), start, stop) for which, start, stop in swap],
        "displaced": list(displaced),
    }
    planted = [
        Planted(cause, tuple(int(joint) for joint in which), start, stop)
        for cause, stretches in wanted.items()
        for which, start, stop in stretches
    ]
    masks = {
        cause: stretches_mask(frames, joints, stretches) for cause, stretches in wanted.items() if stretches
    }
    for cause, share in (("dropout", dropout), ("noise", noise)):
        if share > 0:
            masks[cause] = dropouts((frames, joints), share if cause == "dropout" else 1.0, rng)
            planted.append(Planted(cause, tuple(everyone), 0, frames))
    if take.rig is None:
        damaged = _damage_points(take, wanted, masks, noise, size, rng)
    else:
        damaged = take.with_rig(_damage_rig(take.rig, wanted, masks, noise, size, rng))
    visible = [mask for cause, mask in masks.items() if cause != "noise"]
    mask = np.logical_or.reduce(visible) if visible else np.zeros((frames, joints), bool)
    return damaged, Truth(mask, masks, tuple(planted))


def _damage_points(take: Take, wanted, masks, noise: float, size: float, rng: np.random.Generator) -> Take:
    positions, observed = take.motion.positions.copy(), take.motion.observed.copy()
    if noise > 0:
        positions += rng.normal(0, noise, positions.shape).astype(np.float32)
    for which, start, stop in wanted["swap"]:
        order = exchanged(take.skeleton.names, which)
        positions[start:stop], observed[start:stop] = positions[start:stop, order], observed[start:stop, order]
    for which, start, stop in wanted["jump"] + wanted["displaced"]:
        offset = size * _directions(rng, len(which))
        positions[start:stop, list(which)] += offset.astype(np.float32)
    for which, start, stop in wanted["held"]:
        _hold(positions, which, start, stop)
        _hold(observed, which, start, stop)
    gone = np.zeros_like(observed)
    for cause in ("gap", "lost", "dropout"):
        gone |= masks.get(cause, False)
    positions[gone] = np.nan
    return take.with_motion(replace(take.motion, positions=positions, observed=observed & ~gone))


def _damage_rig(rig: Rig, wanted, masks, noise: float, size: float, rng: np.random.Generator) -> Rig:
    rotations, translations = rig.rotations.copy(), rig.translations.copy()
    frames, joints = rig.trusted.shape
    roots = np.array([parent < 0 for parent in rig.skeleton.parents])
    turns = np.array([bool(order) for order in rig.orders])
    if noise > 0:
        moving = roots & rig.moves
        translations[:, moving] += rng.normal(0, noise, (frames, int(moving.sum()), 3))
        angles = rng.normal(0, 1, (frames, joints, 3)) * (noise / _reach(rig))[:, None]
        rotations[:, turns] = multiply(rotations, from_rotvec(angles))[:, turns]
    for which, start, stop in wanted["swap"]:
        exchange_channels(rig, rotations, translations, exchanged(rig.skeleton.names, which), start, stop)
    for which, start, stop in wanted["jump"] + wanted["displaced"]:
        for joint, direction in zip(which, _directions(rng, len(which))):
            if roots[joint] and rig.moves[joint]:
                translations[start:stop, joint] += size * direction
            elif turns[joint]:
                axes = np.array([axis in rig.orders[joint] for axis in "XYZ"])
                turn = from_rotvec(size * normalised(np.where(axes, direction, 0.0) + 1e-9 * axes))
                rotations[start:stop, joint] = multiply(turn, rotations[start:stop, joint])
    for which, start, stop in wanted["held"] + wanted["gap"] + wanted["lost"]:
        _hold(rotations, which, start, stop)
        _hold(translations, which, start, stop)
    if "dropout" in masks:
        # The last frame before each that was not dropped itself; frame 0 has none, and stays.
        last = np.maximum.accumulate(np.where(masks["dropout"], 0, np.arange(frames)[:, None]), axis=0)
        masks["dropout"][0] = False
        rotations = np.take_along_axis(rotations, last[..., None], axis=0)
        translations = np.take_along_axis(translations, last[..., None], axis=0)
    return replace(rig, rotations=rotations, translations=translations)


def _hold(values: Array, joints: Sequence[int], start: int, stop: int) -> None:
    source = start - 1 if start > 0 else min(stop, len(values) - 1)
    values[start:stop, list(joints)] = values[source, list(joints)]


def _directions(rng: np.random.Generator, count: int) -> Array:
    return normalised(rng.normal(size=(count, 3)))


def _reach(rig: Rig) -> Array:
    """`(joints,)` metres along the bones from each joint to the furthest end of what hangs on it; at least 0.05."""
    reach = np.zeros(len(rig.skeleton))
    for joint, offset in rig.ends:
        reach[joint] = max(reach[joint], np.linalg.norm(offset))
    for joint, parent in reversed(list(enumerate(rig.skeleton.parents))):
        if parent >= 0:
            reach[parent] = max(reach[parent], reach[joint] + np.linalg.norm(rig.offsets[joint]))
    return np.maximum(reach, 0.05)


def mirrored_pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """The left and right twins among joint or marker names, as index pairs, left first.

    "LeftArm" and "RightArm", "lhumerus" and "rhumerus", "UpperArm_L", "LASI", "mixamorig:LeftHand", "thigh.l":
    a pair is two names that differ in their side alone.
    """
    index = {name: joint for joint, name in enumerate(names)}
    pairs = []
    for name, left in index.items():
        right = next((index[other] for other in _right_names(name) if other in index), None)
        if right is not None and right != left:
            pairs.append((left, right))
    return pairs


_SIDES = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
# A word, then a letter that stands alone, then one that opens or ends the name.
_SIDE_PATTERNS = (r"[Ll]eft|LEFT", r"(?<![^\W_])[lL](?![^\W_])", r"(?<![^\W_])[lL]", r"(?<=[a-z0-9])L(?![^\W_])")


def _right_names(left: str) -> Iterable[str]:
    for pattern in _SIDE_PATTERNS:
        for match in re.finditer(pattern, left):
            yield left[: match.start()] + _SIDES[match.group()] + left[match.end() :]


def with_twins(names: Sequence[str], joints: Iterable[int]) -> list[int]:
    """`joints` and their twins, left before right; InputError if one has none."""
    wanted = set(map(int, joints))
    twins = [joint for pair in mirrored_pairs(names) if wanted & set(pair) for joint in pair]
    if alone := wanted - set(twins):
        raise InputError(f"{names[min(alone)]!r} has no left or right twin", expected="names that differ in their side")
    return twins


def exchanged(names: Sequence[str], joints: Iterable[int]) -> Array:
    """`(joints,)` the index that each joint's values come from when `joints` and their twins change places."""
    order = np.arange(len(names))
    twins = with_twins(names, joints)
    order[twins[::2]], order[twins[1::2]] = twins[1::2], twins[::2]
    return order


def exchange_channels(rig: Rig, rotations: Array, translations: Array, order: Array, start: int, stop: int) -> None:
    """Exchange turns in place, and shifts where both twins have position channels."""
    rotations[start:stop] = rotations[start:stop, order]
    order = np.where(rig.moves & rig.moves[order], order, np.arange(len(order)))
    translations[start:stop] = translations[start:stop, order]
