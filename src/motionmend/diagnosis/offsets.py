"""Joints that are off by one offset: how large it is, and from which frame to which.

Two witnesses tell it: the joints' links, which must all fit without it, in frame after frame; and the seams, where the
joints jump by it. So even an offset that lasts longer than anybody could predict a movement can be taken out again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..body.links import SHORT, Links, Stretch, closed
from ..motion import Array, runs

RAMP = 0.3  # seconds in which an offset may grow or fade
HIDDEN = 0.2  # seconds for which bones may happen to fit at the start or end of a displaced stretch
LEAST_OFFSET = 0.015  # metres
MOST_DOUBT = 0.03  # metres by which an offset may be wrong
LEAST_STEADY = 0.4  # seconds for which an offset that grows and fades must last to be known
SHARP = 4.0  # times the usual: from there on a jump from one frame to the next is one


@dataclass(frozen=True, eq=False)
class Seam:
    """Between a frame outside of a stretch and one inside all joints jump by `jumps (joints, 3)` metres.

    errors `(joints,)` : by how much they seem to jump elsewhere. joints : those that are suspected.
    """

    outside: int
    inside: int
    joints: list[int]
    jumps: Array
    errors: Array

    @property
    def is_sharp(self) -> bool:
        return abs(self.outside - self.inside) == 1

    @property
    def jump(self) -> Array:
        return self.jumps[self.joints].mean(axis=0)

    @property
    def error(self) -> float:
        return float(self.errors[self.joints].mean())

    def agrees(self, offset: Array, moved: Array, family: list[int]) -> bool:
        """Whether the moved ones of these joints jump by the offset, and the others do not."""
        off = np.linalg.norm(self.jumps - moved[:, None] * offset, axis=-1)[family]
        return not (off > np.maximum(3 * self.errors[family], max(0.01, 0.2 * np.linalg.norm(offset)))).any()


@dataclass(frozen=True, eq=False)
class Shift:
    """Joints that are off by one offset in frames `[start, stop)`, which grows from `first` and fades to `last`.

    is_sure : the offset is known well enough to take it out. is_sharp : it comes and goes from one frame to the next.
    """

    joints: tuple[int, ...]
    offset: Array
    start: int
    stop: int
    first: int
    last: int
    is_sure: bool
    is_sharp: bool


@dataclass(frozen=True, eq=False)
class Offsets:
    """Finds offsets in `points (frames, joints, 3)` metres, NaN where not known."""

    points: Array
    links: Links
    fps: float
    jumps: dict[int, tuple[Array, Array]] = field(default_factory=dict)  # by width, as they are asked for

    def shift(self, stretch: Stretch, joints: tuple[int, ...]) -> Shift | None:
        """The offset of these joints that explains the misfits and the seams, and the frames in which it does."""
        # Misfits have several minima: the seams, if they are sharp, tell which.
        found = self._shift(stretch, joints, True)
        return found if found and found.is_sure else self._shift(stretch, joints, False) or found

    def _shift(self, stretch: Stretch, joints: tuple[int, ...], by_seams: bool) -> Shift | None:
        fps, frames = self.fps, slice(stretch.start, stretch.stop)
        rows = np.flatnonzero(self.links.touching(joints) | np.isin(np.arange(len(self.links)), stretch.rows))
        links, points = self.links.pick(rows), self.points[frames]
        moved = np.isin(np.arange(points.shape[1]), joints)
        fading = 0 if by_seams else min(round(0.12 * fps), len(points) // 4)
        first, last = fading, len(points) - fading
        solved = solve_offset(points[first:last], links, moved)  # it may still grow before and fade after
        for turn in range(3):
            if turn or by_seams:
                seams = self._seams(stretch, stretch.start + first, stretch.start + last, joints)
                if not seams:
                    return None
                weights = np.array([1 / max(seam.error, 0.001) ** 2 for seam in seams])
                guess = np.average([seam.jump for seam in seams], axis=0, weights=weights)
                solved = solve_offset(points[first:last], links, moved, guess, float(weights.sum() ** -0.5))
            after = np.abs(links.misfits(points - np.where(moved[:, None], solved[0], 0.0)))
            fits = ~(after > np.maximum(0.004, 5 * links.noise)).any(axis=1)
            first, last = max(runs(closed(np.asarray(fits), 2)), key=lambda run: run[1] - run[0], default=(0, 0))
            if last - first <= max(5, 0.1 * fps, 0.5 * len(points)):
                return None
        offset, doubt = solved
        size = np.linalg.norm(offset)
        sure = size >= max(LEAST_OFFSET, 3 * doubt) and doubt <= MOST_DOUBT + 0.1 * size
        if max(first, len(points) - last) > RAMP * fps:
            return None
        seams = self._seams(stretch, stretch.start + first, stretch.start + last, joints)
        family = sorted({*joints, *self.links.ends[rows].ravel().tolist()})
        if not all(seam.agrees(offset, moved, family) for seam in seams):
            return None
        start, stop = stretch.start + first, stretch.start + last
        before, after = start, stop
        for seam in seams:
            if seam.inside > seam.outside:
                start, before = seam.inside, seam.outside + 1
            else:
                stop, after = seam.inside + 1, seam.outside
        sharp = all(seam.is_sharp for seam in seams)
        sure &= any(seam.is_sharp for seam in seams) or last - first >= LEAST_STEADY * fps
        return Shift(joints, offset, start, stop, before, after, bool(sure), sharp)

    def _seams(self, stretch: Stretch, start: int, stop: int, joints: tuple[int, ...]) -> list[Seam]:
        """How these joints, wrong in `[start, stop)`, jump where the stretch begins and ends inside the take."""
        reach, far = max(3, round(0.05 * self.fps)), max(3, round(HIDDEN * self.fps))
        frames, seams = len(self.points), []
        here = list(joints)
        for inside, edge, inward in ((start, stretch.start, 1), (stop - 1, stretch.stop - 1, -1)):
            if edge == (0 if inward > 0 else frames - 1):
                continue
            left, right = sorted((edge - 3 * inward, inside + inward))
            jumps, errors = self.jumps_at(right - left)
            errors = 1.5 * errors  # where it begins to grow is known less well than where it jumps
            if left < 0 or left >= len(jumps) or not np.isfinite(jumps[left, here]).all():
                continue
            # Where all of that is one jump from one frame to the next, it is known to the frame.
            steps, usual = self.jumps_at(1)
            lower, upper = (edge - far, inside + reach) if inward > 0 else (inside - reach, edge + far)
            first = max(0, lower - 1)
            near = steps[first : max(upper, 0)][:, here].mean(axis=1)
            sizes = np.nan_to_num(np.linalg.norm(near, axis=-1))
            whole = np.linalg.norm(jumps[left, here].mean(axis=0))
            if len(sizes) and sizes.max() > max(SHARP * usual[here].mean(), 0.7 * whole):
                left = first + int(sizes.argmax())
                right, jumps, errors = left + 1, steps, usual
            outside, inside = (left, right) if inward > 0 else (right, left)
            seams.append(Seam(outside, inside, here, inward * jumps[left], errors))
        return seams

    def jumps_at(self, width: int) -> tuple[Array, Array]:
        """From each frame to the one `width` later how far all joints jump, and what is usual of them."""
        if width not in self.jumps:
            jumps = jumps_across(self.points, width)
            sizes = np.linalg.norm(jumps, axis=-1)
            known = np.isfinite(sizes).any(axis=0)
            errors = np.full(sizes.shape[1], np.inf)
            if known.any():
                errors[known] = np.nanquantile(sizes[:, known], 0.8, axis=0)
            self.jumps[width] = jumps, errors
        return self.jumps[width]


def solve_offset(
    points: Array, links: Links, moved: Array, guess: Array | None = None, error: float = np.inf
) -> tuple[Array, float]:
    """The one offset `(3,)` of the `moved` joints that makes their links fit best, and by how much it may be wrong.

    points : `(frames, joints, 3)`, NaN where not known. moved : `(joints,)` bool. guess `(3,)`, error : what seams say
    of the offset, and how well they know it; all in metres.

    Gauss-Newton on the misfits of the links between moved and other joints, those that no offset explains weighed
    down.
    """
    sign = moved[links.ends].astype(float) @ np.array([1.0, -1.0])
    crossing = np.flatnonzero(sign)
    ends, lengths, sign = links.ends[crossing], links.lengths[crossing], sign[crossing]
    apart = (points[:, ends[:, 0]] - points[:, ends[:, 1]]) * sign[:, None]  # the moved one against the other
    known = np.isfinite(apart).all(axis=-1)
    apart = np.nan_to_num(apart)
    scale = np.maximum(0.004, 3 * links.noise[crossing])
    exact = max(0.001, float(np.median(links.noise)))
    seams = len(points) * (exact / max(error, 1e-6)) ** 2  # as if so many frames told all three coordinates
    guess = np.zeros(3) if guess is None else guess
    offset, curvature = guess.astype(float), np.eye(3)
    for _ in range(30):
        here = apart - offset
        size = np.linalg.norm(here, axis=-1)
        along = here / np.maximum(size, 1e-9)[..., None]
        miss = np.where(lengths < SHORT, size, size - lengths)
        weight = known / (1 + (miss / scale) ** 2)
        directions = np.einsum("fli,flj->flij", along, along)
        directions[:, lengths < SHORT] = np.eye(3)
        curvature = np.einsum("fl,flij->ij", weight, directions) + (seams + 1e-6) * np.eye(3)
        step = np.linalg.solve(curvature, np.einsum("fl,fl,fli->i", weight, miss, along) + seams * (guess - offset))
        offset = offset + step
        if np.linalg.norm(step) < 1e-6:
            break
    least = np.linalg.eigvalsh(curvature)[0] / max(len(points), 1)
    return offset, float(exact / np.sqrt(max(least, 1e-12)))


def jumps_across(points: Array, width: int) -> Array:
    """`(frames - width, joints, 3)` metres: by how much the way to each frame misses that from `width` frames on.

    Both are continued to the middle at the speeds they have there; NaN where these are not known.
    """
    speeds = np.full_like(points, np.nan)
    speeds[2:] = (points[2:] - points[:-2]) / 2  # by which it arrives
    ahead = np.full_like(points, np.nan)
    ahead[:-2] = speeds[2:]  # and by which it sets out
    arrives, sets_out = points + width / 2 * speeds, points - width / 2 * ahead
    return sets_out[width:] - arrives[: max(0, len(points) - width)]
