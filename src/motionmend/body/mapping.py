"""BODY, the 21 joints that every network speaks, and how any rig maps to it.

`map_rig` finds a rig's joints by their names (`body_names`) and its tree, or by its shape alone
(`body_shape`). Everything works in any units and axes, because the readers ask for `stature` and `upward`
before they know either.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping as MappingABC
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import InputError, nearest_names
from ..motion import Motion, Skeleton
from . import names, shape
from .joints import BODY, JOINT

Array = np.ndarray


@dataclass(frozen=True)
class Mapping:
    """Which of a rig's joints is which of BODY's.

    joints : for each of BODY's 21 joints the index of the rig's, or -1 where it has none.
    rig : the convention recognised ("Mixamo"), "by names", "by topology", or "" where nothing was found.
    unmapped : the names of the rig's joints that no joint of BODY stands for.
    is_person : enough of a human body was found to treat the take as one.
    """

    joints: tuple[int, ...]
    rig: str
    unmapped: tuple[str, ...]
    is_person: bool

    @cached_property
    def found(self) -> dict[str, int]:
        """BODY's joints that the rig has: name → the rig's index."""
        return {name: joint for name, joint in zip(BODY.names, self.joints) if joint >= 0}


def map_rig(
    skeleton: Skeleton, positions: Array | None = None, overrides: MappingABC[str, str] | None = None
) -> Mapping:
    """Find BODY's joints in a rig, a set of keypoints or of joint centres.

    Parameters
    ----------
    positions : `(frames, joints, 3)`, any units and axes (right-handed), NaN where missing. They tell a
        person from a quadruped, coincident joints apart, and find bodies whose names mean nothing.
    overrides : BODY's name → the rig's name, as `read_map` gives; "" says that the rig has no such joint.

    Raises
    ------
    InputError : for an override that names no joint of BODY or of the rig.
    """
    sample = None if positions is None else sampled(positions)
    parsed = names.parsed(skeleton.names)
    found = names.limbs(parsed)
    found |= shape.trunk(skeleton, parsed, found, sample)
    rig = names.convention(skeleton.names) or "by names"
    if not _is_body(found) or len(found) < 8:  # half the joints of the plainest stick figure
        shaped = None if sample is None else shape.search(skeleton, sample)
        if shaped and len(shaped[0]) > len(found):
            found, rig = shaped
        elif not _is_body(found):
            rig = ""
    person = _is_body(found) and not shape.is_quadruped(skeleton.names, found, sample)
    for name, joint_name in (overrides or {}).items():
        if name not in JOINT:
            raise InputError(f"BODY has no joint {name!r}", hint=nearest_names(name, BODY.names))
        found.pop(name, None)
        if joint_name:
            found[name] = skeleton.index(joint_name)
    if overrides:
        person = _is_body(found)
    used = set(found.values())
    unmapped = tuple(name for joint, name in enumerate(skeleton.names) if joint not in used)
    return Mapping(tuple(found.get(name, -1) for name in BODY.names), rig, unmapped, person)


def _is_body(found: MappingABC[str, int]) -> bool:
    """Whether both legs or both arms are there with their two bones, or all four limbs in part."""

    def both(*parts: str) -> bool:
        return all(f"{side}_{part}" in found for side in names.SIDES for part in parts)

    return both("thigh", "shin", "foot") or both("upper_arm", "forearm", "hand") or both("forearm", "shin")


def read_map(path: str | os.PathLike) -> dict[str, str]:
    """The overrides in a TOML file: one line a joint, such as `left_forearm = "LeftElbow"`.

    Raises
    ------
    InputError : if it is not TOML, names no joint of BODY, or gives something else than a name.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text("utf-8-sig"))
    except OSError as error:
        raise InputError(error.strerror or "cannot be read", where=path) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not TOML: {error}", where=path, hint='write lines such as hips = "Pelvis"') from None
    for name, joint in table.items():
        if name not in JOINT:
            raise InputError(f"BODY has no joint {name!r}", where=path, hint=nearest_names(name, BODY.names))
        if not isinstance(joint, str):
            raise InputError(f"{name} = {joint!r}", where=path, expected="the name of a joint, in quotes")
    return table


def to_body(motion: Motion, mapping: Mapping) -> Motion:
    """The motion of BODY's 21 joints; those that the rig lacks are NaN and unobserved."""
    joints = np.array(mapping.joints)
    absent = joints < 0
    positions = motion.positions[:, joints]
    positions[:, absent] = np.nan
    return Motion(positions, motion.observed[:, joints] & ~absent, motion.fps, BODY)


def sampled(positions: Array, count: int = 100) -> Array:
    """About `count` frames spread over the take, float64."""
    return np.asarray(positions[:: max(1, len(positions) // count)], float)
