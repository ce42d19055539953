"""List the gaps of a marker file, fill the short ones, and save.

    python examples/gap_list.py walk_with_gaps.c3d filled.c3d

Works on C3D, TRC, CSV and NPZ. Prints one line a gap, longest first, and what was done about it.
"""

import sys

import motionmend as mm
from motionmend.gaps import Gaps

LONGEST = 0.5  # seconds; longer gaps are left, and stay marked as missing


def main(source: str, target: str) -> None:
    take = mm.load(source)
    gaps = Gaps.of(take.motion.observed)
    for row in sorted(range(len(gaps)), key=lambda row: -gaps.length[row]):
        name = take.skeleton.names[gaps.joint[row]]
        print(f"{gaps.start[row]}:{gaps.stop[row]}  {gaps.length[row] / take.fps:.2f} s  {name}")

    fixed = mm.repair(take, max_gap=f"{LONGEST}s")
    print(fixed.report)
    mm.save(fixed, target)


if __name__ == "__main__":
    main(*sys.argv[1:])
