"""`auto` against every classical fill on takes that nothing here was trained on or chosen by. Prints a table.

    python benchmarks/strangers.py FOLDER [--every 20] [--seed 0]

FOLDER holds BVH takes of people, of whatever rig: another studio's, or your own. Holes are planted all along each take,
in the whole body, a left arm, or a right leg, and filled in the file's own channels as `repair` fills them. The numbers
are mean errors of what was missing, in mm, and for `auto` its share of the best of the others.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from fills import holes
from shared import parser, python, row, seconds_head

import motionmend.io as io
from motionmend.body.joints import LIMBS
from motionmend.body.mapping import map_rig
from motionmend.constraints import feet
from motionmend.fills.channels import RIG_FILLS
from motionmend.motion import Take
from motionmend.repairs import filling, network_fill

Array = np.ndarray
SECONDS = (0.1, 0.3, 0.5, 0.7, 0.9, 1.2, 2.0)
PARTS = ("body", "left_arm", "right_leg")


def gone(take: Take, joints: tuple[int, ...], part: str) -> Array:
    """`(joints,)` bool: the part, and all that hangs on it."""
    if part == "body":
        return np.ones(len(take.skeleton), bool)
    lost = np.isin(np.arange(len(take.skeleton)), [joints[joint] for joint in LIMBS[part]])
    for joint, parent in enumerate(take.skeleton.parents):
        lost[joint] |= parent >= 0 and lost[parent]
    return lost


def missed(take: Take, whole: Array, lost: Array, mapping, methods: list[str]) -> Array | None:
    """Each method's errors in mm, `(methods, samples)`; None where nothing of the take is missing."""
    assert take.rig is not None
    broken = replace(take.rig, trusted=whole[:, None] | ~lost)
    unseen = ~broken.observed()
    if not unseen.any():
        return None
    damaged, errors = replace(take, rig=broken, motion=broken.motion(take.fps)), []
    for method in methods:
        filled, _ = filling.fill(damaged, method, (), feet.legs(mapping.joints), mapping)
        errors.append(1e3 * np.linalg.norm(filled.motion.positions - take.motion.positions, axis=-1)[unseen])
    return np.array(errors)


def main() -> None:
    line = parser(__doc__, every=20, seed=0)
    line.add_argument("folder", type=Path)
    options = line.parse_args()
    takes = [io.load(path) for path in sorted(options.folder.rglob("*.bvh"))[:: options.every]]
    found = [(take, map_rig(take.skeleton, take.motion.positions)) for take in takes]
    people = [(take, mapping) for take, mapping in found if mapping.is_person and min(mapping.joints) >= 0]
    methods = [*RIG_FILLS, "auto"]
    minutes = sum(len(take) / take.fps for take, _ in people) / 60
    networks = "; ".join(f"{name}: {each.completer.budget}" for name, each in network_fill.installed().items())
    print(f"{len(people)} takes, {minutes:.1f} min, seed {options.seed}; {networks}; "
          f"{python()}\n")  # fmt: skip
    for part in PARTS:
        print(seconds_head([part.replace("_", " ")], SECONDS))
        columns = []
        for seconds in SECONDS:
            random = np.random.default_rng(options.seed)
            each = [missed(take, holes(len(take), max(1, round(seconds * take.fps)), random),
                           gone(take, mapping.joints, part), mapping, methods) for take, mapping in people]  # fmt: skip
            columns.append(np.concatenate([errors for errors in each if errors is not None], axis=1).mean(axis=1))
        for at, method in enumerate(methods):
            cells = [f"{column[at]:.1f}" + (f" ({column[at] / column[:-1].min():.3f})" if method == "auto" else "")
                     for column in columns]  # fmt: skip
            print(row(method, *cells))
        print(flush=True)


if __name__ == "__main__":
    main()
