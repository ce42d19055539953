"""How fast is reading a BVH file with forward kinematics, against pybvh, on the same files in one run?

    python benchmarks/bvh_read.py takes/*.bvh

Prints the best of five for each file and tool (milliseconds) and the ratio; below 1 we are faster. Files that
pybvh refuses are named and left out of the total.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
import pybvh
from shared import best, parser

import motionmend.io


def ours(path: str) -> np.ndarray:
    return motionmend.io.load(path).motion.positions


def theirs(path: str) -> np.ndarray:
    return pybvh.read_bvh_file(path).joint_positions()


def best_of_five(path: str, *readers: Callable[[str], np.ndarray]) -> np.ndarray:
    """Seconds of each reader."""
    return np.array([*best({read.__name__: partial(read, path) for read in readers}, 5).values()])


def main() -> None:
    line = parser(__doc__)
    line.add_argument("takes", nargs="+", help="BVH files")
    paths = line.parse_args().takes
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
    main()
