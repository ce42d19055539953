"""BODY, the 21 joints that every network speaks, and which of them are a limb's or each other's mirror image."""

from __future__ import annotations

from ..motion import Skeleton
from .names import SIDES

_PART_PARENTS = {"shoulder": "chest", "upper_arm": "shoulder", "forearm": "upper_arm", "hand": "forearm",
                 "thigh": "hips", "shin": "thigh", "foot": "shin", "toe": "foot"}  # fmt: skip
PARTS = tuple(_PART_PARENTS)


def _body() -> Skeleton:
    parents = {"hips": "", "spine": "hips", "chest": "spine", "neck": "chest", "head": "neck"}
    for side in SIDES:
        for part, parent in _PART_PARENTS.items():
            parents[f"{side}_{part}"] = parent if parent in ("hips", "chest") else f"{side}_{parent}"
    names = tuple(parents)
    return Skeleton(names, tuple(names.index(parent) if parent else -1 for parent in parents.values()))


BODY = _body()
JOINT = {name: index for index, name in enumerate(BODY.names)}
LEFT_RIGHT = tuple((JOINT[f"left_{part}"], JOINT[f"right_{part}"]) for part in _PART_PARENTS)
LIMBS = {
    f"{side}_{limb}": tuple(JOINT[f"{side}_{part}"] for part in parts)
    for side in SIDES
    for limb, parts in (("arm", ("upper_arm", "forearm", "hand")), ("leg", ("thigh", "shin", "foot", "toe")))
}
