"""Joints that disagree with the rest: displaced ones, told by bones that stretch and by a prediction without them.

For points only: the bones of a rig of channels cannot stretch. Where a link (a bone, or two children of one parent)
is longer or shorter than it ever is, the joints that may be at fault are tried in turn. Twins may have changed places;
one offset may make all links fit again; or a fill that does not see these joints makes them fit, and lies further
from what the file says than it errs elsewhere in the take. What none of these explains is told and left.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..body.joints import JOINT
from ..body.links import Links, Stretch, find_links, find_stretches
from ..body.mapping import Mapping, map_rig, to_body
from ..damage.planting import mirrored_pairs
from ..motion import Array, Motion
from .offsets import LEAST_OFFSET, RAMP, Offsets, jumps_across
from .prediction import Predictions

BESIDE = 15.0  # seconds of the take on both sides of a stretch that are looked at
JOINED = 0.5  # seconds for which all may seem to fit within one offset's stretch
LONGEST_FILLED = 1.0  # seconds; what lasts longer is moved back or told
EDGE_FILLED = 0.3  # seconds, at an end of the take
EXPLAINED = 0.5  # share of the misfit that a fill may leave
CLEARLY = 2.0  # how many times its own error a prediction must lie off the file
HEALED = 0.4  # share of their jumps that twins may keep at the seams once they are exchanged
TRUNK = ("spine", "chest", "neck", "head")
TOO_MUCH = 0.6  # share of the frames with misfits from which on it is the take that is strange


@dataclass(frozen=True)
class Disagreement:
    """Some joints (indices) that are wrong over frames `[start, stop)`.

    cause : "displaced", or "swap" with pairs in turn, left, right. shift : metres to add to put them right.
    """

    cause: str
    joints: tuple[int, ...]
    start: int
    stop: int
    certainty: float
    detail: str
    shift: tuple[float, float, float] | None = None

    @property
    def found(self) -> tuple[str, tuple[int, ...], int, int, float, str]:
        return self.cause, self.joints, self.start, self.stop, self.certainty, self.detail


def disagreements(motion: Motion) -> list[Disagreement]:
    """The joints of a motion of points that disagree with the others; what is not observed is not looked at."""
    body, places = _with_bones(motion)
    if len(body) < 10 or not body.skeleton.has_bones:
        return []
    points = np.where(body.observed[..., None], body.positions.astype(float), np.nan)
    # Of a person's names, those of the trunk leave out vertebrae, and a neck that nods is no bone that shrinks.
    links = find_links(body, points, () if body is motion else [JOINT[name] for name in TRUNK])
    if not len(links):
        return []
    misfits = links.misfits(points)
    stretches = find_stretches(misfits, links, body.fps)
    wrong = np.zeros(len(body), bool)
    for stretch in stretches:
        wrong[stretch.start : stretch.stop] = True
    if not stretches or wrong.mean() > TOO_MUCH:
        return []
    mapping = map_rig(body.skeleton, points)
    found: list[Disagreement] = []
    while stretches:
        stretch = stretches.pop(0)
        at = stretch.joints(links)
        # A swap shows on the left and on the right.
        if any(one.cause == "swap" and at & set(one.joints) and stretch.meets(one.start, one.stop) for one in found):
            continue
        verdicts = _Judge.beside(stretch, body, links, mapping).verdicts()
        for other in [each for each in stretches if set(each.rows) & set(stretch.rows)]:
            # Bones may fit for a while though the joint is off all the time.
            longer = replace(stretch, stop=other.stop, rows=tuple(sorted({*stretch.rows, *other.rows})))
            near = 0 <= other.start - stretch.stop <= JOINED * body.fps
            if near and (joined := _Judge.beside(longer, body, links, mapping).shifted()):
                stretch, verdicts = longer, joined
                stretches.remove(other)
        found += verdicts
    return [replace(one, joints=tuple(places[joint] for joint in one.joints)) for one in found]


def _with_bones(motion: Motion) -> tuple[Motion, Sequence[int]]:
    """The motion itself if it has bones, else that of the person in it; and the own joints' indices."""
    if motion.skeleton.has_bones:
        return motion, range(len(motion.skeleton))
    seen = np.where(motion.observed[..., None], motion.positions, np.nan)
    mapping = map_rig(motion.skeleton, seen)
    if not mapping.is_person:
        return motion, ()
    return to_body(motion, mapping), mapping.joints


@dataclass(frozen=True, eq=False)
class _Judge:
    """Finds who is at fault in a stretch, in the part of the take beside it.

    first : the part's first frame in the take. stretch : in frames of the part. misfits `(frames, links)` of
    points `(frames, joints, 3)` : metres, NaN where not known.
    """

    first: int
    stretch: Stretch
    motion: Motion
    points: Array
    links: Links
    misfits: Array
    offsets: Offsets
    predictions: Predictions

    @classmethod
    def beside(cls, stretch: Stretch, motion: Motion, links: Links, mapping: Mapping) -> _Judge:
        reach = round(BESIDE * motion.fps)
        first = max(0, stretch.start - reach)
        part = slice(first, stretch.stop + reach)
        motion = replace(motion, positions=motion.positions[part], observed=motion.observed[part])
        points = np.where(motion.observed[..., None], motion.positions.astype(float), np.nan)
        stretch = replace(stretch, start=stretch.start - first, stop=stretch.stop - first)
        misfits = links.misfits(points)
        predictions = Predictions(motion, points, links, misfits, mapping)
        return cls(first, stretch, motion, points, links, misfits, Offsets(points, links, motion.fps), predictions)

    def verdicts(self) -> list[Disagreement]:
        return self.swapped() or self.shifted() or self.predicted()

    def _found(
        self, cause: str, joints: Sequence[int], start: int, stop: int, certainty: float, detail: str,
        shift: tuple[float, float, float] | None = None,
    ) -> Disagreement:  # fmt: skip
        return Disagreement(cause, tuple(joints), start + self.first, stop + self.first, certainty, detail, shift)

    def _suspects(self) -> list[tuple[int, ...]]:
        """Each joint at a misfitting link alone, and all that hangs on it; never more than half of all joints."""
        skeleton = self.motion.skeleton
        below = [{joint} for joint in range(len(skeleton))]
        for joint, parent in reversed(list(enumerate(skeleton.parents))):
            if parent >= 0:
                below[parent] |= below[joint]
        at = sorted(self.stretch.joints(self.links))
        sets = [{joint} for joint in at] + [below[joint] for joint in at]
        there = np.isfinite(self.points[self.stretch.start : self.stretch.stop]).any(axis=(0, 2))
        known = set(np.flatnonzero(there).tolist())
        kept = [tuple(sorted(each & known)) for each in sets if len(each) <= len(skeleton) / 2]
        return sorted(dict.fromkeys(each for each in kept if each), key=len)

    def _misfit_by(self, joints: tuple[int, ...]) -> str:
        """What was seen, in words: of the links at the joints, the one that misfits most."""
        rows = [row for row in self.stretch.rows if np.isin(self.links.ends[row], joints).any()]
        rows = rows or list(self.stretch.rows)
        sizes = np.nan_to_num(self.misfits[self.stretch.start : self.stretch.stop, rows])
        frame, column = np.unravel_index(np.argmax(np.abs(sizes)), sizes.shape)
        one, other = (self.motion.skeleton.names[joint] for joint in self.links.ends[rows[int(column)]])
        much = 1000 * sizes[frame, column]
        return f"{one} to {other} is up to {abs(much):.0f} mm {'longer' if much > 0 else 'shorter'} than usual"

    # Twins that changed places --------------------------------------------------------------------------------

    def swapped(self) -> list[Disagreement]:
        """Twins whose bones, and whose ways at the seams, fit once they have changed places."""
        pairs = mirrored_pairs(self.motion.skeleton.names)
        twin = dict(pairs) | {right: left for left, right in pairs}
        frames = slice(self.stretch.start, self.stretch.stop)
        for joints in self._suspects():
            if not all(joint in twin and twin[joint] not in joints for joint in joints):
                continue
            both = [*joints, *(twin[joint] for joint in joints)]
            if not np.isfinite(self.points[frames][:, both]).any(axis=(0, 2)).all():
                continue
            order = np.arange(self.points.shape[1])
            order[both] = [twin[joint] for joint in both]
            rows = np.flatnonzero(self.links.touching(tuple(both)))
            links = self.links.pick(rows)
            before = np.abs(self.misfits[frames][:, rows])
            after = np.abs(links.misfits(self.points[frames][:, order]))
            more = np.nansum(np.maximum(after - links.weak, 0)), np.nansum(np.maximum(before - links.weak, 0))
            if more[0] > 0.1 * more[1] or np.nanmean(after > links.strong) > 0.02:
                continue
            start, stop = (self._seam(edge, both) for edge in (self.stretch.start, self.stretch.stop))
            if not self._heals(start, stop, order, both):
                continue
            left_right = [joint for pair in pairs if pair[0] in both for joint in pair]
            detail = f"{self._misfit_by(joints)}; with left and right exchanged back all bones fit"
            return [self._found("swap", left_right, start, stop, 0.9, detail)]
        return []

    def _seam(self, edge: int, joints: list[int]) -> int:
        """The frame near `edge` before which these joints jump most."""
        if edge in (0, len(self.points)):
            return edge
        reach = max(3, round(0.05 * self.motion.fps))
        first = max(0, edge - 1 - reach)
        jumps = self.offsets.jumps_at(1)[0][first : edge + reach]
        return first + 1 + int(np.nan_to_num(np.linalg.norm(jumps[:, joints], axis=-1)).sum(axis=1).argmax())

    def _heals(self, start: int, stop: int, order: Array, joints: list[int]) -> bool:
        """Whether these joints no longer jump at the seams of a stretch in which they take each other's places."""
        exchanged = self.points.copy()
        exchanged[start:stop] = exchanged[start:stop, order]
        seams = [seam - 1 for seam in (start, stop) if 2 < seam < len(self.points) - 2]
        before, after = (jumps_across(points, 1)[seams][:, joints] for points in (self.points, exchanged))
        before, after = (np.nan_to_num(np.linalg.norm(jumps, axis=-1)).sum() for jumps in (before, after))
        return bool(after <= HEALED * before)

    # One offset -----------------------------------------------------------------------------------------------

    def shifted(self) -> list[Disagreement]:
        """Those that one offset puts right, and the frames in which it grows and fades."""
        suspects, found = self._suspects(), []
        for one in self._extents():
            found = [shift for joints in suspects if (shift := self.offsets.shift(one, joints))]
            longest = max((shift.stop - shift.start for shift in found), default=0)
            found = [shift for shift in found if shift.stop - shift.start >= 0.8 * longest]
            if len(found) > 1:  # what jumps in and out from frame to frame is no accident of the bones
                found = [shift for shift in found if shift.is_sure and shift.is_sharp] or found
            if found:
                break
        if len(found) != 1 or not found[0].is_sure:
            return []  # none, or two explanations
        shift = found[0]
        size = f"{1000 * np.linalg.norm(shift.offset):.0f} mm"
        detail = f"off by {size}: {self._misfit_by(shift.joints)}; without this offset all bones fit"
        x, y, z = (-float(each) for each in shift.offset)
        parts = [self._found("displaced", shift.joints, shift.start, shift.stop, 0.9, detail, (x, y, z))]
        detail = f"the offset of {size} grows or fades here"
        for start, stop in ((shift.first, shift.start), (shift.stop, shift.last)):
            if start < stop:
                parts.append(self._found("displaced", shift.joints, start, stop, 0.9, detail))
        return parts

    def _extents(self) -> Iterator[Stretch]:
        """The stretch, and up to an end of the take that is near: bones may seem to fit for a moment."""
        near, frames = round(RAMP * self.motion.fps), len(self.points)
        yield self.stretch
        if 0 < self.stretch.start <= near:
            yield replace(self.stretch, start=0)
        if 0 < frames - self.stretch.stop <= near:
            yield replace(self.stretch, stop=frames)

    # A prediction ---------------------------------------------------------------------------------------------

    def predicted(self) -> list[Disagreement]:
        """Joints that a fill, which errs by little here, would have elsewhere; or what is told and left."""
        frames, fps = len(self.points), self.motion.fps
        start, stop = max(0, self.stretch.start - 2), min(frames, self.stretch.stop + 2)
        at_edge = self.stretch.start == 0 or self.stretch.stop == frames
        scores = []
        if stop - start <= (EDGE_FILLED if at_edge else LONGEST_FILLED) * fps:
            for joints in self._suspects():
                guess = self.predictions.hidden(joints, start, stop, 0, frames)
                if np.isfinite(guess[start:stop, list(joints)]).all():
                    scores.append((self.predictions.left(self.stretch, joints, guess), joints, guess))
        told = self._told()
        if not scores:
            return told
        best = min(score for score, _, _ in scores)
        score, joints, guess = next(each for each in scores if each[0] <= 1.2 * best)  # the fewest joints first
        rivals = [other for mark, other, _ in scores if mark < 1.5 * score and not set(other) & set(joints)]
        if score > EXPLAINED or rivals:
            return told
        here = list(joints)
        apart = np.linalg.norm(guess[start:stop, here] - self.points[start:stop, here], axis=-1)
        off = float(apart[np.isfinite(apart)].mean())  # a suspect is seen in some frames at least
        error = self.predictions.own_error(joints, start, stop)
        if not off > max(LEAST_OFFSET, CLEARLY * error):
            return told
        detail = f"{self._misfit_by(joints)}; predicted without it {1000 * off:.0f} mm away, "
        detail += f"where such predictions err by {1000 * error:.0f} mm"
        return [self._found("displaced", joints, start, stop, 0.8, detail)]

    def _told(self) -> list[Disagreement]:
        """Told and left: it is not plain which joint is at fault, or by how much."""
        at = tuple(sorted(self.stretch.joints(self.links)))
        detail = f"{self._misfit_by(at)}; which joint is wrong, or by how much, is not plain"
        return [self._found("displaced", at, self.stretch.start, self.stretch.stop, 0.5, detail)]
