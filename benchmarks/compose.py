"""How well clips are placed, and how smooth chains and blends are, on real takes. Prints Markdown tables.

    python benchmarks/compose.py --data DIR [--every 3] [--seed 0]

Placement: both sides of a gap in one take are chained as if they were two clips. The truth is where the second one
stood: how far its first frame's hips are from there, and by how much it was turned. Medians and means over gaps.
Chains and blends: the report's seams, against the takes' own 99th percentile, and the speed of standing feet.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from shared import head, options, row

import motionmend as mm
from motionmend.body.mapping import map_rig

SECONDS = (0.1, 0.3, 0.6, 1.0, 1.5)
LEAST = 0.7  # seconds of a clip
ARM = ("upper_arm", "forearm", "hand")


def placed(takes: list[mm.Take], seconds: float, rng: np.random.Generator) -> str:
    """One row of the first table."""
    apart, turned, skate = [], [], []
    for take in takes:
        gap, least = round(seconds * take.fps), round(LEAST * take.fps)
        if len(take) < gap + 2 * least:
            continue
        first = int(rng.integers(least, len(take) - gap - least + 1))
        second = first + gap
        told = mm.chain([(take, (first - least, first)), (take, (second, second + least))], gap=gap, method="eased")
        root = take.rig.translations[second, 0] - told.rig.translations[least + gap, 0]
        apart.append(100 * np.linalg.norm(root[[0, 2]]))
        turned.append(abs(float(told.report.pieces[1].how.split("turned by ")[1].split("°")[0])))
        skate.append(told.report.checks["foot_skate"]["value"] or 0.0)
    values = [f"{np.median(each):.1f} ({np.mean(each):.1f})" for each in (apart, turned)]
    return row(f"{seconds} s", len(apart), *values, f"{np.mean(skate):.0f}")


def blended(takes: list[mm.Take], fade: str, rng: np.random.Generator) -> str:
    """One row of the second table: half a second of another right arm in the middle of each take."""
    jumps, kinks, count = [], [], 0
    for take in takes:
        source = takes[int(rng.integers(len(takes)))]
        found = map_rig(take.skeleton, take.motion.positions).found
        names = [take.skeleton.names[found[f"right_{part}"]] for part in ARM]
        start = int(rng.integers(1, len(source) - int(source.fps) // 2))
        told = mm.blend(take, source, joints=names, frames=(start, start + int(source.fps) // 2), at=len(take) // 2,
                        fade=fade, method="eased")  # fmt: skip
        checks, count = told.report.checks, count + 1
        jumps.append(checks["seam_jump"]["typical"] / checks["seam_jump"]["own"])
        kinks.append(checks["seam_kink"]["typical"] / checks["seam_kink"]["own"])
    return row(fade, count, f"{np.median(jumps):.2f}", f"{np.median(kinks):.2f}")


def main() -> None:
    told = options(__doc__, data=Path, every=3, seed=0)
    takes = [mm.load(path) for path in sorted(told.data.rglob("*.bvh"))[:: told.every]]
    takes = [take for take in takes if len(take) > 2.3 * take.fps]
    rng = np.random.default_rng(told.seed)
    print(head("gap", "takes", "off by, cm", "turned by, °", "standing feet, mm/s"))
    for seconds in SECONDS:
        print(placed(takes, seconds, rng), flush=True)
    print("\n" + head("fade", "takes", "jump / own", "kink / own"))
    for fade in ("0.1s", "0.2s", "0.4s", "0.6s"):
        print(blended(takes, fade, rng), flush=True)


if __name__ == "__main__":
    main()
