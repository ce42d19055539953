"""Where a fill that does not see some joints would have them, and how far it errs where nothing is wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..body.links import Links, Stretch
from ..body.mapping import Mapping
from ..fills.auto import Auto
from ..motion import Array, Motion, runs

AS_GOOD = 0.15  # share below which fills explain it equally well
TRIALS = 6
UNTRIED = 0.05  # metres by which a prediction may err where the take is too short to try it


@dataclass(frozen=True, eq=False)
class Predictions:
    """Predicts joints of a motion. misfits `(frames, links)` of points `(frames, joints, 3)`: metres, or NaN."""

    motion: Motion
    points: Array
    links: Links
    misfits: Array
    mapping: Mapping

    def hidden(self, joints: tuple[int, ...], start: int, stop: int, first: int, last: int) -> Array:
        """`points` with these joints of frames `[start, stop)` predicted from frames `[first, last)`."""
        reach = round(1.5 * self.motion.fps)
        around = slice(max(first, start - reach), min(last, stop + reach))
        observed = self.motion.observed[around].copy()
        observed[start - around.start : stop - around.start, list(joints)] = False
        part = replace(self.motion, positions=self.motion.positions[around], observed=observed)
        filled = Auto(mapping=self.mapping).complete(part)
        out = np.full_like(self.points, np.nan)
        out[around] = np.where(filled.observed[..., None], filled.positions, np.nan)
        return out

    def own_error(self, joints: tuple[int, ...], start: int, stop: int) -> float:
        """Metres by which predictions of these joints err over stretches as long in which all bones fit."""
        length, frames = stop - start, len(self.points)
        near = self.links.touching(joints)
        good = ~(np.abs(self.misfits[:, near]) > self.links.weak[near]).any(axis=1)
        good &= np.isfinite(self.points[:, list(joints)]).all(axis=(1, 2))
        margin = max(3, round(0.1 * self.motion.fps))
        ends = [run for run in runs(np.asarray(good)) if run[1] - run[0] >= length + 2 * margin]
        places = [at for first, last in ends for at in range(first + margin, last - margin - length + 1)]
        errors = []
        for at in sorted({places[int(i)] for i in np.linspace(0, len(places) - 1, TRIALS)}) if places else []:
            lower, upper = 0 if start > 0 else at, frames if stop < frames else at + length
            guess = self.hidden(joints, at, at + length, lower, upper)[at : at + length, list(joints)]
            apart = np.linalg.norm(guess - self.points[at : at + length, list(joints)], axis=-1)
            if np.isfinite(apart).any():
                errors.append(apart[np.isfinite(apart)].mean())
        return float(np.median(errors)) if errors else UNTRIED

    def left(self, stretch: Stretch, joints: tuple[int, ...], guess: Array) -> float:
        """The share of the worst link's misfit that is left once these joints are where `guess` has them."""
        frames, ends = slice(stretch.start, stretch.stop), np.isin(self.links.ends, joints)
        rows = ends.any(axis=1) | np.isin(np.arange(len(self.links)), stretch.rows)
        inner = np.asarray(ends.all(axis=1))
        if not inner[list(stretch.rows)].any():
            rows &= ~inner  # they moved as one: a fill need not know the bones between them, which fit
        after = self.links.pick(rows).misfits(guess)[frames]
        return max(AS_GOOD, _worst(after) / max(_worst(self.misfits[frames, rows]), 1e-9))


def _worst(misfits: Array) -> float:
    """The mean misfit of the link that misfits most."""
    known = np.isfinite(misfits)
    return float((np.abs(np.where(known, misfits, 0)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)).max(initial=0))
