"""Where samples are missing: the gaps of a mask, and gaps that can be filled by one and the same formula."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Gaps:
    """The maximal unobserved stretches of a mask, one row a gap: parallel arrays `(gaps,)`.

    joint, start, stop : whose gap it is, and its frames `[start, stop)`.
    before, after : good samples next to it, up to the next gap or the end of the take. Where one of them is 0
        nothing is known on that side, and a fill extrapolates (`is_edge`); where both are, the joint is never
        seen (`is_blank`).
    method : what filled it, "" for nothing.
    donors : for the gaps that were filled with the help of other joints, their indices, by row.
    reasons : for the gaps whose method was chosen for a reason of their own, that reason, by row.
    expected : for the gaps whose method says how far off it expects to be, that error in metres (median), by row.
    """

    joint: Array
    start: Array
    stop: Array
    before: Array
    after: Array
    method: Array
    donors: dict[int, tuple[int, ...]] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)
    expected: dict[int, float] = field(default_factory=dict)

    @classmethod
    def of(cls, observed: Array) -> Gaps:
        """The gaps of a `(frames, joints)` bool mask, ordered by joint and then by start."""
        frames, joints = observed.shape
        hidden = np.zeros((joints, frames + 2), np.int8)
        hidden[:, 1:-1] = ~observed.T
        edges = np.diff(hidden, axis=1)
        joint, start = np.nonzero(edges == 1)
        stop = np.nonzero(edges == -1)[1]
        same = joint[1:] == joint[:-1]
        between = start[1:] - stop[:-1]
        before, after = start.copy(), frames - stop
        before[1:][same] = between[same]
        after[:-1][same] = between[same]
        return cls(joint, start, stop, before, after, np.zeros(len(joint), "U12"))

    def __len__(self) -> int:
        return len(self.joint)

    @property
    def length(self) -> Array:
        return self.stop - self.start

    @property
    def is_edge(self) -> Array:
        return (self.before == 0) ^ (self.after == 0)

    @property
    def is_blank(self) -> Array:
        return (self.before == 0) & (self.after == 0)

    def pick(self, rows: Array) -> Gaps:
        """Only these rows (indices or a bool mask)."""
        columns = ("joint", "start", "stop", "before", "after", "method")
        picked = {name: getattr(self, name)[rows] for name in columns}
        return replace(self, **picked, donors={}, reasons={}, expected={})


@dataclass(frozen=True, eq=False)
class Group:
    """Gaps of one length whose good neighbours lie at the same places.

    rows : indices into the Gaps. length : frames in the gap.
    times `(samples,)` : when the neighbours are, in frames; the gap is 1 … length, a seam is at 0 or length + 1.
    frames, joints : indices `(rows, samples)` and `(rows, 1)` of the neighbours.
    missing `(rows, length)` : frames to be filled.
    """

    rows: Array
    length: int
    times: Array
    frames: Array
    joints: Array
    missing: Array


def groups(gaps: Gaps, observed: Array, reach: int) -> Iterator[Group]:
    """Sort gaps into groups, each with the good samples at most `reach` frames from its seams."""
    if not len(gaps):
        return
    left, right = np.arange(-reach, 0), np.arange(reach)
    frames = np.concatenate([gaps.start[:, None] + left, gaps.stop[:, None] + right], axis=1)
    inside = (frames >= 0) & (frames < len(observed))
    seen = inside & observed[np.where(inside, frames, 0), gaps.joint[:, None]]
    key = np.concatenate([gaps.length[:, None].astype(">i4").view(np.uint8), np.packbits(seen, axis=1)], axis=1)
    key = np.ascontiguousarray(key).view(np.dtype((np.void, key.shape[1])))[:, 0]
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(group, kind="stable")
    bounds = np.searchsorted(group[order], np.arange(len(first) + 1))
    for one, begin, end in zip(first, bounds[:-1], bounds[1:]):
        rows, pattern, length = order[begin:end], seen[one], int(gaps.length[one])
        times = np.concatenate([left + 1, right + length + 1])[pattern]
        missing = gaps.start[rows, None] + np.arange(length)
        yield Group(rows, length, times, frames[rows][:, pattern], gaps.joint[rows, None], missing)


def longer(observed: Array, max_gap: int) -> Array:
    """`(frames, joints)` bool: the unobserved entries in gaps of more than `max_gap` frames (`--max-gap`)."""
    gaps = Gaps.of(observed)
    return covered(gaps.pick(gaps.length > max_gap), observed.shape)


def covered(gaps: Gaps, shape: tuple[int, ...]) -> Array:
    """`(frames, joints)` bool: the entries that lie in these gaps."""
    steps = np.zeros((shape[0] + 1, shape[1]), np.int8)
    steps[gaps.start, gaps.joint] += 1
    steps[gaps.stop, gaps.joint] -= 1
    return np.cumsum(steps[:-1], axis=0, dtype=np.int8).astype(bool)
