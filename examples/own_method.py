"""Fill a gap by a method of your own, on plain arrays, and write the result into the BVH's channels.

    python examples/own_method.py walk.bvh filled.bvh 120 180

The method here is a straight line between the gap's ends, in five lines of NumPy; put a network in its place.
`fit` then turns positions into the rig's own rotations: bones keep their lengths, all other frames their bytes.
"""

import sys

import numpy as np

import motionmend as mm


def straight_lines(positions: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Positions `(frames, joints, 3)` with the frames from start to stop on the line between their neighbours."""
    filled = positions.copy()
    share = np.linspace(0, 1, stop - start + 2)[1:-1, None, None]
    filled[start:stop] = (1 - share) * positions[start - 1] + share * positions[stop]
    return filled


def main(source: str, target: str, start: int, stop: int) -> None:
    take = mm.load(source)
    targets = straight_lines(take.motion.positions, start, stop)

    where = np.zeros((len(take), len(take.skeleton)), bool)
    where[start:stop] = True
    # The first guess decides what positions cannot say: the turn about a bone, and the fingers.
    guess = mm.repair(take, gaps=[(start, stop)], method="linear")
    fixed = mm.fit(guess, targets, where)

    mm.save(fixed, target)
    print(mm.compare(take, fixed, (start, stop)))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
