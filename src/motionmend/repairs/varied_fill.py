"""Gaps filled in many plausible ways: a fill, and added to it how a generative network's samples differ.

Such a network goes on from the pose before a gap and knows nothing of what comes after: its own answer is no nearer to
the truth than a straight line. What it does know is how else a body might have moved. So a variant is what the base
fills, plus the difference between one sample and the network's best guess, which dies away at the gap's seams.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ..body.joints import BODY
from ..body.mapping import to_body
from ..body.standing import whole
from ..errors import InputError
from ..fills.curves import least_jerk
from ..gaps import Gaps, covered
from ..motion import Motion, runs
from ..networks.generative import GenerativeCompleter
from ..networks.loading import load_completer
from ..rigs.fitting import scatter
from .network_fill import UNKNOWN, Answer, NetworkFill, absent

Array = np.ndarray

GENERATIVE = ("trajevae",)
SHORTEST = 0.1  # seconds: in a shorter gap there is one way to go
FADE, SHARE = 0.4, 0.25  # seconds in which a difference comes and goes, or this share of a gap where that is longer
ASTRAY = 0.5  # metres at most from what the base fills: in many seconds the network goes anywhere
FEWEST = 3  # joints of a pose from which the others can be guessed
FAR = 10.0  # metres, for what was not seen together


def must_vary(method: str, variants: int, seed: int) -> None:
    """InputError unless this method fills a gap in so many ways."""
    if variants < 1 or seed < 0:
        raise InputError(f"{variants} variants of seed {seed}", expected="1 or more, of a seed from 0 on")
    if variants > 1 and method not in GENERATIVE:
        hint = f"use the method {GENERATIVE[0]}, or ask for one variant"
        raise InputError(f"{variants} variants are asked of {method}, which fills a gap in one way", hint=hint)


def varied(name: str, seed: int, variant: int) -> VariedFill:
    """The fill by the generative network of this name; InputError if none is installed."""
    return VariedFill(_generative(name), seed=seed, variant=variant)


@lru_cache(maxsize=1)
def _generative(name: str) -> GenerativeCompleter:
    try:
        loaded = load_completer(name)
    except InputError:
        raise absent(name) from None
    if not isinstance(loaded, GenerativeCompleter) or loaded.skeleton.names != BODY.names:
        found = f"the network installed as {name} does not go on from a pose of the {len(BODY)} joints of a body"
        raise InputError(found, hint="train it anew, or use --method auto")
    return loaded


@dataclass(frozen=True)
class VariedFill(NetworkFill):
    """One of the ways in which gaps may be filled: the same seed and variant, the same bits.

    Gaps that begin with the take have no pose before them, and short ones no room: there the base's fill stays. Joints
    that are never seen, on which the base has no word, are where the network's sample puts them.

    seed, variant : from 0 on, and from 1 on. They and the frame of the pose decide the network's noise.
    """

    completer: GenerativeCompleter
    seed: int = 0
    variant: int = 1

    def reasons(self, gaps: Gaps, improved: Array, fps: float, unknown: str = UNKNOWN) -> dict[int, str]:
        """See `NetworkFill.reasons`."""
        late = gaps.stop[(gaps.start == 0) & (gaps.method == "") & ~gaps.is_blank].max(initial=0)
        why = np.where(gaps.start <= late, "no whole pose comes before it", unknown)
        why = np.where(gaps.length < SHORTEST * fps, "too short to go another way", why)
        return {row: str(why[row]) for row in np.flatnonzero(~improved).tolist()}

    def improve(self, out: Array, motion: Motion, gaps: Gaps) -> tuple[Array, dict[int, float]]:
        """See `NetworkFill.improve`. Points that are none of the network's joints go along with the nearest that is."""
        before = out.copy()
        improved, expected = super().improve(out, motion, gaps)
        if improved.all() or not improved.any():
            return improved, expected
        moved, nearest = np.nan_to_num(out - before), self._nearest(motion)
        for row in np.flatnonzero(~improved & (gaps.method != "")):
            joint, start, stop = gaps.joint[row], gaps.start[row], gaps.stop[row]
            seams = [frame for frame in (start - 1, stop) if 0 <= frame < len(out)]
            # A joint that is still on its way at a seam of this gap would leave a jump there.
            if motion.observed[seams, nearest[joint]].all() and np.any(moved[start:stop, nearest[joint]]):
                out[start:stop, joint] += moved[start:stop, nearest[joint]]
                improved[row] = True
        return improved, expected

    def _nearest(self, motion: Motion) -> Array:
        """For each joint of a motion `(joints,)` which of the network's is nearest to it, by the motion's numbering."""
        joints = np.array([joint for joint in self._mapping(motion).joints if joint >= 0])
        frames = np.linspace(0, len(motion) - 1, min(len(motion), 100)).round().astype(int)
        seen = np.where(motion.observed[frames, :, None], motion.positions[frames], np.nan)
        apart = np.linalg.norm(seen[:, :, None] - seen[:, None, joints], axis=-1)
        return joints[np.where(np.isfinite(apart), apart, FAR).mean(axis=0).argmin(axis=1)]

    def answer(self, motion: Motion) -> Answer:
        """See `NetworkFill.answer`: the variant, and how it differs from what the base says, nothing at the seams."""
        mapping = self._mapping(motion)
        body = to_body(motion, mapping)
        told = np.asarray(np.isfinite(body.positions).all(axis=-1))
        ever = np.asarray(told.any(axis=0))
        values, change = np.full((2, *body.positions.shape), np.nan)
        if mapping.is_person and ever.sum() >= FEWEST:
            change = self._apart(body, told, ever)
            values = body.positions + change
            never = ~ever & (np.array(mapping.joints) >= 0)
            if never.any() and told[0, ever].all():
                moved = replace(body, positions=(body.positions + np.nan_to_num(change)).astype(np.float32))
                way = _from_pose(moved, told, ever, 0, len(body))
                values[0, never], values[1:, never] = way.positions[0, never], self._sampled(way, 0)[:, never]
        values, change = (scatter(each, mapping.joints, len(motion.skeleton)) for each in (values, change))
        return Answer(values, change, np.full(motion.observed.shape, np.nan))

    def _apart(self, body: Motion, told: Array, ever: Array) -> Array:
        """How the sample differs from the best guess where the base fills gaps, `(frames, J, 3)` metres; NaN elsewhere.

        told, ever : see `_spans`.
        """
        gaps = Gaps.of(body.observed)
        gaps = gaps.pick(gaps.length >= SHORTEST * body.fps)
        known = [told[start:stop, joint].all() for joint, start, stop in zip(gaps.joint, gaps.start, gaps.stop)]
        gaps = gaps.pick(np.array(known, bool))
        change = np.full(body.positions.shape, np.nan)
        for begin, stop in _spans(gaps, body.observed, told, ever):
            way = _from_pose(body, body.observed, ever, begin, stop)
            change[begin + 1 : stop] = self._sampled(way, begin) - self.completer.complete(way).positions[1:]
        # What is missing already in the pose that the network goes on from has no seam to leave.
        gaps = gaps.pick(np.isfinite(change[gaps.start, gaps.joint, 0]))
        change *= _fades(gaps, told.shape, body.fps)[..., None]
        change /= np.sqrt(1 + np.sum(change**2, axis=-1, keepdims=True) / ASTRAY**2)
        return np.where(covered(gaps, told.shape)[..., None], change, np.nan)

    def _sampled(self, way: Motion, begin: int) -> Array:
        """The sample after the first frame, `(frames - 1, J, 3)` metres."""
        return self.completer.sample(way, 1, (self.seed, self.variant, begin))[0].positions[1:]


def _spans(gaps: Gaps, observed: Array, told: Array, ever: Array) -> Iterator[tuple[int, int]]:
    """The pose to go on from and the frame after the last, for each stretch of frames with any of these gaps in it.

    observed, told : `(frames, J)` bool, what is seen, and what is seen or filled. ever : `(J,)` bool, whose are told.
    """
    wanted, sound = np.asarray(covered(gaps, told.shape).any(axis=1)), np.asarray(told[:, ever].all(axis=1))
    for start, stop in runs(np.asarray((ever & ~observed).any(axis=1))):
        first = max(start - 1, 0)
        begin = first + int(np.argmax(sound[first:stop]))
        if wanted[start:stop].any() and sound[begin] and begin + 1 < stop:
            yield begin, stop


def _from_pose(body: Motion, given: Array, ever: Array, begin: int, stop: int) -> Motion:
    """The body's frames `[begin, stop)`, the first of them whole and the others where they are `given (frames, J)`."""
    seen = given[begin:stop].copy()
    positions = np.where(seen[..., None], body.positions[begin:stop], np.float32(np.nan))
    positions[0], seen[0] = whole(body.positions[begin].astype(float), ever), True
    return Motion(positions, seen, body.fps, BODY)


def _fades(gaps: Gaps, shape: tuple[int, ...], fps: float) -> Array:
    """`(frames, joints)`: 1 inside gaps, and 0 with a slope of 0 at their seams."""
    out = np.zeros(shape)
    for joint, start, stop, after in zip(gaps.joint, gaps.start, gaps.stop, gaps.after):
        clock = np.arange(1, stop - start + 1)
        away = np.minimum(clock, clock[::-1]) if after else clock
        span = len(clock) + 1
        u = np.minimum(away / min(max(FADE * fps, SHARE * span), span / 2), 1)
        out[start:stop, joint] = least_jerk(u)
    return out
