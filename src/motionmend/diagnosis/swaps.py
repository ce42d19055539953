"""Left and right twins that have taken each other's places: found, and put back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..damage.planting import mirrored_pairs
from ..motion import Array
from .symptoms import Track, continuous_track, known_rows, length, usual

Swap = tuple[int, int, float, list[int]]  # start, stop, certainty, joints: left, right, left, right


def find_swaps(tracks: list[Track], names: Sequence[str], fps: float) -> list[Swap]:
    """Stretches in which left and right twins, known by the joints' names, have each other's values."""
    if not tracks:
        return []
    frames = len(tracks[0].values)
    by_place = {(track.joint, track.turns): track for track in tracks}
    twins = [
        (by_place[left, turns], by_place[right, turns])
        for left, right in mirrored_pairs(names)
        for turns in (True, False)
        if (left, turns) in by_place and (right, turns) in by_place
    ]
    costs = [_costs(left, right, fps) for left, right in twins]
    support: Counter[tuple[int, int]] = Counter()
    single: list[int] = []
    for (left, _), (kept, other) in zip(twins, costs):
        seams = _seams(kept, other, left.least, fps)
        support.update(zip(seams[::2], seams[1::2]))
        single += seams[len(seams) // 2 * 2 :]
    stretches: dict[tuple[int, int], float] = {}
    known: set[int] = set()
    # Twins that miss a seam of their limb's swap pair the wrong ones: what most of the limb says comes first.
    for stretch, _ in support.most_common():
        if not known & set(stretch):
            stretches[stretch] = 0.9
            known |= set(stretch)
    for seam in sorted(set(single) - known):
        # Which part is the wrong one cannot be known; likelier the shorter.
        stretches[(seam, frames) if seam > frames / 2 else (0, seam)] = 0.5
    swaps = []
    for (start, stop), certainty in sorted(stretches.items()):
        seams = [seam for seam in (start, stop) if 0 < seam < frames]
        joints = [
            joint
            for (left, right), (kept, other) in zip(twins, costs)
            for joint in (left.joint, right.joint)
            # Joined by twins that are too alike at one of the seams to show it by themselves.
            if other[seams].sum() < 0.7 * kept[seams].sum() and kept[seams].sum() > left.least
        ]
        swaps.append((start, stop, certainty, list(dict.fromkeys(joints))))
    return swaps


def exchange_tracks(tracks: list[Track], joints: Sequence[int], start: int, stop: int) -> None:
    """Exchange back, in place, the values of twins: `joints` has left, right, left, right."""
    by_place = {(track.joint, track.turns): track.values for track in tracks}
    frames = slice(start, stop)
    for left, right in zip(joints[::2], joints[1::2]):
        for turns in (True, False):
            if (left, turns) in by_place and (right, turns) in by_place:
                one, two = by_place[left, turns], by_place[right, turns]
                one[frames], two[frames] = two[frames].copy(), one[frames].copy()
                if turns:
                    one[:], two[:] = continuous_track(one), continuous_track(two)


def _costs(left: Track, right: Track, fps: float) -> tuple[Array, Array]:
    """`(frames,)` each: how far twins are torn just before each frame if they stay, and if they change places.

    Both sides of a seam are continued to its middle at their speeds, so that hands that pass one another
    are no swap. An exchange tears both alike, so the lesser counts twice. 0 and infinity where there is no
    seam to judge.
    """
    frames = len(left.values)
    kept, other = np.zeros(frames), np.full(frames, np.inf)
    at = np.flatnonzero(known_rows(left.values) & known_rows(right.values))
    if len(at) < 4:
        return kept, other
    sides = [track.values[at] for track in (left, right)]
    apart_by = np.diff(at)[:, None]  # frames; more than one where some are missing
    half = 0.5 * apart_by[1:-1]
    ends = [side[1:-2] + half * (side[1:-2] - side[:-3]) / apart_by[:-2] for side in sides]
    starts = [side[2:-1] - half * (side[3:] - side[2:-1]) / apart_by[2:] for side in sides]

    def apart(a: Array, b: Array) -> Array:
        return np.minimum(length(a - b), length(a + b)) if left.turns else length(a - b)

    near = apart_by[1:-1, 0] <= max(1, round(0.1 * fps))
    seams = at[2:-1][near]
    kept[seams] = 2 * np.minimum(apart(ends[0], starts[0]), apart(ends[1], starts[1]))[near]
    other[seams] = (apart(ends[0], starts[1]) + apart(ends[1], starts[0]))[near]
    return kept, other


def _seams(kept: Array, other: Array, least: float, fps: float) -> list[int]:
    """Frames at which twins plainly take each other's places."""
    window = max(6, round(0.1 * fps))
    seams = np.flatnonzero((other < 0.4 * kept) & (kept > 4 * least))
    return [int(seam) for seam in seams if kept[seam] > 8 * usual(kept, int(seam), int(seam), window)]
