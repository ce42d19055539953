"""How fast is reading a BVH file with forward kinematics, against pybvh, on the same files in one run?

    python benchmarks/bvh_read.py takes/*.bvh

Prints the best of five for each file and tool (milliseconds) and the ratio; below 1 we are faster. Files that
pybvh refuses are named and left out of the total.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable

import numpy as np
import pybvh

import motionmend.io


def ours(path: str) -> np.ndarray:
    return motionmend.io.load(path).motion.positions


def theirs(path: str) -> np.ndarray:
    return pybvh.read_bvh_file(path).joint_positions()


def best_of_five(path: str, *readers: Callable[[str], np.ndarray]) -> np.ndarray:
    """Seconds of each reader, taken in turns so that a busy moment of the machine hits all of them."""
    times = np.empty((5, len(readers)))
    for row in times:
        for at, read in enumerate(readers):
            start = time.perf_counter()
            read(path)
            row[at] = time.perf_counter() - start
    return times.min(axis=0)


def main(paths: list[str]) -> None:
    if not paths:
        sys.exit(__doc__)
    warnings.simplefilter("ignore")
    total = np.zeros(2)
    print(f"{'frames':>7} {'motionmend':>11} {'pybvh':>9} {'ratio':>6}  file")
    for path in paths:
        frames = len(ours(path))
        try:
            theirs(path)
        except Exception as error:
            print(f"{frames:7d} {best_of_five(path, ours)[0] * 1e3:8.1f} ms   refused         {path}: {error}")
            continue
        both = best_of_five(path, ours, theirs)
        total += both
        print(f"{frames:7d} {both[0] * 1e3:8.1f} ms {both[1] * 1e3:6.1f} ms {both[0] / both[1]:6.2f}  {path}")
    if total[1]:
        print(f"all files pybvh reads: {total[0]:.3f} s against {total[1]:.3f} s, ratio {total[0] / total[1]:.2f}")


if __name__ == "__main__":
    main(sys.argv[1:])
