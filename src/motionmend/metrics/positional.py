"""What the papers measure, as pure functions on arrays. Metres in, millimetres out; NaN where a sample is missing.

Positions are `(..., frames, joints, 3)`: one take, or a batch of windows along any leading axes, which are pooled
unless it is said otherwise. docs/metrics.md has every formula with its paper, section and trap.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..motion import runs

Array = np.ndarray

STANCE_SPEED = 0.3  # m/s: a standing foot is slower
STANCE_HEIGHT = 0.06  # metres: and no higher above its own lowest than this
STANCE_SECONDS = 0.1


class Moments:
    """Mean and standard deviation of rows that come block by block (Chan, Golub and LeVeque 1983)."""

    def __init__(self):
        self.count = 0
        self._mean: Array | float = 0.0
        self._squares: Array | float = 0.0

    def add(self, rows: Array) -> None:
        """More rows `(n, ...)`; what follows the first axis is kept apart."""
        if not len(rows):
            return
        mean = rows.mean(axis=0, dtype=float)
        apart, total = mean - self._mean, self.count + len(rows)
        self._squares = self._squares + ((rows - mean) ** 2).sum(axis=0) + apart**2 * (self.count * len(rows) / total)
        self._mean = self._mean + apart * (len(rows) / total)
        self.count = total

    @property
    def mean(self) -> Array:
        """NaN before the first row."""
        return np.asarray(self._mean if self.count else np.nan)

    @property
    def std(self) -> Array:
        """Of the rows themselves, as a population: divided by their number."""
        return np.sqrt(np.asarray(self._squares) / self.count) if self.count else np.array(np.nan)


def distances(truth: Array, guess: Array, root: int | None = None) -> Array:
    """`(..., frames, joints)` metres between the joints of two motions `(..., frames, joints, 3)`.

    root : the joint that is put at the origin in every pose of both first; None measures in the world.
    """
    error = guess.astype(float) - truth
    if root is not None:
        error = error - error[..., root, None, :]
    return np.linalg.norm(error, axis=-1)


def mpjpe(truth: Array, guess: Array, mask: Array, root: int | None = None) -> float:
    """Mean per-joint position error in mm over the samples where `mask (..., frames, joints)` is True.

    truth, guess : `(..., frames, joints, 3)` metres. root : the joint that is put at the origin in every pose of
    both first (root-relative MPJPE); None measures in the world (global). Björkstrand et al. 2023, section 4; there
    the mask holds the removed or displaced joints only. NaN for an empty mask.
    """
    errors = distances(truth, guess, root)[mask]
    return float(errors.mean() * 1000) if len(errors) else float("nan")


def joint_error(truth: Array, guess: Array, mask: Array) -> tuple[float, float]:
    """Mean 3D joint error in cm and its standard deviation over all samples where `mask` is True.

    truth, guess : `(..., frames, joints, 3)` metres, mask : `(..., frames, joints)`. Kaufmann et al. 2020, tables 1
    and 2; there both share the root's position and turn, and the mask is the gap. NaN for an empty mask.
    """
    errors = distances(truth, guess)[mask] * 100
    return (float(errors.mean()), float(errors.std())) if len(errors) else (float("nan"), float("nan"))


def bone_lengths(positions: Array, parents: Sequence[int]) -> Array:
    """`(..., frames, joints)` metres from each joint of `positions` to its parent, NaN for roots."""
    above = np.asarray(parents, int)
    lengths = np.linalg.norm(positions.astype(float) - positions[..., above, :], axis=-1)
    lengths[..., above < 0] = np.nan
    return lengths


def limb_sigma(positions: Array, parents: Sequence[int]) -> float:
    """Limb sigma in mm: each bone's standard deviation of length over time, averaged over bones and windows.

    positions : `(..., frames, joints, 3)` metres. Björkstrand et al. 2023, section 4. 0 for rigid bones; NaN
    without bones.
    """
    lengths = bone_lengths(positions, parents)
    known = np.isfinite(lengths)
    count = known.sum(axis=-2)
    mean = _over(np.where(known, lengths, 0).sum(axis=-2), count)
    squares = np.where(known, lengths - mean[..., None, :], 0) ** 2
    sigmas = np.sqrt(_over(squares.sum(axis=-2), count))[count > 0]
    return float(sigmas.mean() * 1000) if len(sigmas) else float("nan")


def _over(total: Array, count: Array) -> Array:
    return total / np.maximum(count, 1)


def bone_length_changes(before: Array, after: Array, parents: Sequence[int]) -> Array:
    """`(..., frames, joints)` mm by which each bone of `after` departs from its median length in `before`.

    Both `(..., frames, joints, 3)` metres, not necessarily as many frames; each window by its own median.
    NaN where a bone is not known in both.
    """
    old, new = bone_lengths(before, parents), bone_lengths(after, parents)
    known = np.isfinite(old).any(axis=-2)
    usual = np.full(known.shape, np.nan)
    # Only columns with something in them: nanmedian warns of the others.
    usual[known] = np.nanmedian(np.swapaxes(old, -1, -2)[known], axis=-1)
    return np.abs(new - usual[..., None, :]) * 1000


def bone_length_change(before: Array, after: Array, parents: Sequence[int]) -> float:
    """The greatest of `bone_length_changes`, in mm. NaN if the two have no bone in common."""
    changes = bone_length_changes(before, after, parents)
    changes = changes[np.isfinite(changes)]
    return float(changes.max()) if len(changes) else float("nan")


def jitter(positions: Array, fps: float) -> float:
    """Mean magnitude of the jerk, the third derivative of `positions (..., frames, joints, 3)`, in m/s³."""
    jerk = np.linalg.norm(np.diff(positions.astype(float), n=3, axis=-3), axis=-1) * fps**3
    jerk = jerk[np.isfinite(jerk)]
    return float(jerk.mean()) if len(jerk) else float("nan")


def steps(positions: Array) -> tuple[Array, Array]:
    """How much each step departs from its neighbours: what shows a pop, and what shows a kink.

    With v_t = p_t - p_(t-1), the first is |v_t - (v_(t-1) + v_(t+1)) / 2| in mm, the size of a jump from t - 1 to t
    that the motion's own velocity on both sides does not explain; the second is |v_(t+1) - v_(t-1)| in mm per
    frame, the change of velocity across that step. Both `(..., frames, joints)`, NaN where one of the four samples
    from t - 2 to t + 1 is missing.
    """
    jumps, kinks = np.full((2, *positions.shape[:-1]), np.nan)
    if positions.shape[-3] >= 4:
        step = np.diff(positions.astype(float), axis=-3)
        first, middle, last = step[..., :-2, :, :], step[..., 1:-1, :, :], step[..., 2:, :, :]
        jumps[..., 2:-1, :] = np.linalg.norm(middle - (first + last) / 2, axis=-1) * 1000
        kinks[..., 2:-1, :] = np.linalg.norm(last - first, axis=-1) * 1000
    return jumps, kinks


def seams(hidden: Array) -> Array:
    """`(..., frames, joints)` bool: the steps into and out of the gaps of `hidden`, each at its later frame."""
    found = np.zeros_like(hidden)
    found[..., 1:, :] = hidden[..., 1:, :] != hidden[..., :-1, :]
    return found


def seam_jump(positions: Array, hidden: Array) -> tuple[float, float]:
    """Mean pop in mm and mean kink in mm per frame at both ends of the gaps that were filled, by `steps`.

    positions : `(..., frames, joints, 3)` metres, whole. hidden : `(..., frames, joints)` bool, True where filled.
    A motion has steps of its own: compare with the truth's at the same seams. NaN where no gap has an end.
    """
    at = seams(hidden)
    means = (values[at & np.isfinite(values)] for values in steps(positions))
    jump, kink = (float(values.mean()) if len(values) else float("nan") for values in means)
    return jump, kink


def foot_skate(positions: Array, contact: Array, fps: float) -> float:
    """Mean horizontal speed in mm/s of feet while they stand.

    positions : `(..., frames, feet, 3)` metres, Y up. contact : `(..., frames, feet)` bool; a step counts if the
    foot stands at both its ends. NaN if no foot ever stands.
    """
    speed = np.linalg.norm(np.diff(positions[..., [0, 2]].astype(float), axis=-3), axis=-1) * fps * 1000
    speed = speed[contact[..., 1:, :] & contact[..., :-1, :] & np.isfinite(speed)]
    return float(speed.mean()) if len(speed) else float("nan")


def stances(points: Array, fps: float) -> Array:
    """`(..., frames, feet)` bool: when each of `points (..., frames, feet, 3)` stands, by its speed and its height.

    Slower than 0.3 m/s and within 6 cm of the height that it has in its lowest twentieth of the window's frames, for
    at least 0.1 s.
    """
    frames, feet = points.shape[-3:-1]
    if frames < 3 or not points.size:
        return np.zeros(points.shape[:-1], bool)
    windows = points.reshape(-1, frames, feet, 3).astype(float)
    speed = np.linalg.norm(np.gradient(windows, 1 / fps, axis=1), axis=-1)
    heights = windows[..., 1]
    floor = np.zeros((len(windows), 1, feet))
    for window, foot in zip(*np.nonzero(np.isfinite(heights).any(axis=1))):
        column = heights[window, :, foot]
        floor[window, 0, foot] = np.percentile(column[np.isfinite(column)], 5)
    stands = (speed < STANCE_SPEED) & (heights < floor + STANCE_HEIGHT)
    for window, foot in zip(*np.nonzero(stands.any(axis=1))):
        for start, stop in runs(stands[window, :, foot]):
            if stop - start < STANCE_SECONDS * fps:
                stands[window, start:stop, foot] = False
    return stands.reshape(points.shape[:-1])
