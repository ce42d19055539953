"""Installed networks against `auto` without any, by kind and length of gap, in CMU's validation takes. Prints a table.

    python benchmarks/network_gaps.py --data DIR [--networks mend xmae convae] [--subjects 06 16] [--every 3] [--seed 0]

The same holes as in `fills.py`, in rigs and in the same rigs' joints as points. The numbers are the mean errors of
what is missing by `auto`, in mm, and each network's as a share of that, as `repair --method` has it. Where a share is
below 1 and the least for a kind, NETWORK_WINS of `repairs/chooser.py` may have it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from fills import LOST, asked, below, holes
from shared import python, seconds_head

from motionmend.body.mapping import map_rig
from motionmend.constraints import feet
from motionmend.fills.kinds import point_kinds, rig_kinds
from motionmend.gaps import Gaps
from motionmend.motion import Take, Units
from motionmend.repairs import filling, network_fill
from motionmend.repairs.chooser import NETWORK_WINS

Array = np.ndarray
SECONDS = (0.2, 0.3, 0.5, 0.7, 0.9, 1.2, 2.0, 3.0)
PARTS = {"body": None} | {part: lost for parts in LOST.values() for part, lost in parts.items()}


def errors(
    data: list, networks: list[str], lost: tuple[str, ...] | None, seconds: float, points: bool, seed: int
) -> tuple[str, Array]:
    """The kinds that these gaps have for `auto`; and the mean errors of `auto` and of each network, mm."""
    misses: dict[str, list[Array]] = {name: [] for name in ("auto", *networks)}
    random, kinds = np.random.default_rng(seed), set()
    for name, rig, fps in data:
        whole = holes(len(rig.trusted), round(seconds * fps), random)
        gone = np.ones(len(rig.skeleton), bool) if lost is None else below(rig.skeleton, lost)
        broken = replace(rig, trusted=whole[:, None] | ~gone)
        unseen = ~broken.observed()
        if not unseen.any():
            continue
        take = Take(broken.motion(fps), broken, None, Units(1.0, "y", "CMU's"), "bvh", name)
        mapping = map_rig(rig.skeleton, rig.kinematics[0])
        legs = feet.legs(mapping.joints)
        if points:
            take = replace(take, rig=None)
            kinds |= set(point_kinds(take.motion, Gaps.of(take.motion.observed), mapping))
        else:
            kinds |= set(rig_kinds(broken, Gaps.of(broken.trusted)))
        for method, found in misses.items():
            filled, _ = filling.fill(take, method, (), legs, mapping)
            found.append(np.linalg.norm(filled.motion.positions - rig.kinematics[0], axis=-1)[unseen])
    return ", ".join(sorted(kinds)), np.array([1e3 * np.concatenate(found).mean() for found in misses.values()])


def main() -> None:
    options, data, told = asked(__doc__, networks=list(NETWORK_WINS))
    found = [network_fill.required(name).completer for name in options.networks]
    for name in NETWORK_WINS:
        NETWORK_WINS[name] = {}
    print(f"{told}; {'; '.join(f'{each.name}: {each.budget}' for each in found)}; {python()}\n")
    print(seconds_head(["lost", "kinds"], SECONDS))
    for points in (False, True):
        for part, lost in PARTS.items():
            cells, kinds = [], ""
            for seconds in SECONDS:
                kinds, (plain, *learned) = errors(data, options.networks, lost, seconds, points, options.seed)
                shares = (f"{name} {each / plain:.2f}" for name, each in zip(options.networks, learned))
                cells.append(f"{plain:.1f}: {', '.join(shares)}")
            print(f"| {part}, {'points' if points else 'rig'} | {kinds} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
