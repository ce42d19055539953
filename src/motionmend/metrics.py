"""What the papers measure, as pure functions on arrays. Metres in, millimetres out; NaN where a sample is missing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .motion import runs

Array = np.ndarray

STANCE_SPEED = 0.3  # m/s: a standing foot is slower
STANCE_HEIGHT = 0.06  # metres: and no higher above its own lowest than this
STANCE_SECONDS = 0.1


def mpjpe(truth: Array, guess: Array, mask: Array, root: int | None = None) -> float:
    """Mean per-joint position error in mm over the samples where `mask (frames, joints)` is True.

    truth, guess : `(frames, joints, 3)` metres. root : the joint that is put at the origin in every pose of both
    first (root-relative MPJPE); None measures in the world (global). Björkstrand et al. 2023, section 4; there
    the mask holds the removed or displaced joints only. NaN for an empty mask.
    """
    error = guess.astype(float) - truth
    if root is not None:
        error = error - error[:, root, None]
    distances = np.linalg.norm(error, axis=-1)[mask]
    return float(distances.mean() * 1000) if len(distances) else float("nan")


def bone_lengths(positions: Array, parents: Sequence[int]) -> Array:
    """`(frames, joints)` metres from each joint of `positions (frames, joints, 3)` to its parent, NaN for roots."""
    above = np.asarray(parents)
    lengths = np.linalg.norm(positions.astype(float) - positions[:, above], axis=-1)
    lengths[:, above < 0] = np.nan
    return lengths


def limb_sigma(positions: Array, parents: Sequence[int]) -> float:
    """Limb sigma in mm: each bone's standard deviation of length over time, averaged over the bones.

    positions : `(frames, joints, 3)` metres. Björkstrand et al. 2023, section 4. 0 for rigid bones; NaN
    without bones.
    """
    columns = _known(bone_lengths(positions, parents))
    return float(np.mean([column.std() for column in columns]) * 1000) if columns else float("nan")


def bone_length_change(before: Array, after: Array, parents: Sequence[int]) -> float:
    """The greatest departure in mm of a bone's length in any frame of `after` from its median in `before`.

    Both `(frames, joints, 3)` metres, not necessarily as many frames. NaN if they have no bone in common.
    """
    old, new = bone_lengths(before, parents), bone_lengths(after, parents)
    common = np.isfinite(old).any(axis=0) & np.isfinite(new).any(axis=0)
    if not common.any():
        return float("nan")
    return float(np.nanmax(np.abs(new[:, common] - np.nanmedian(old[:, common], axis=0))) * 1000)


def jitter(positions: Array, fps: float) -> float:
    """Mean magnitude of the jerk, the third derivative of `positions (frames, joints, 3)`, in m/s³."""
    jerk = np.linalg.norm(np.diff(positions.astype(float), n=3, axis=0), axis=-1) * fps**3
    jerk = jerk[np.isfinite(jerk)]
    return float(jerk.mean()) if len(jerk) else float("nan")


def steps(positions: Array) -> tuple[Array, Array]:
    """How much each step departs from its neighbours: what shows a pop, and what shows a kink.

    With v_t = p_t - p_(t-1), the first is |v_t - (v_(t-1) + v_(t+1)) / 2| in mm, the size of a jump from t - 1 to t
    that the motion's own velocity on both sides does not explain; the second is |v_(t+1) - v_(t-1)| in mm per
    frame, the change of velocity across that step. Both `(frames, joints)`, NaN where one of the four samples
    from t - 2 to t + 1 is missing.
    """
    jumps, kinks = np.full((2, *positions.shape[:2]), np.nan)
    if len(positions) >= 4:
        step = np.diff(positions.astype(float), axis=0)
        jumps[2:-1] = np.linalg.norm(step[1:-1] - (step[:-2] + step[2:]) / 2, axis=-1) * 1000
        kinks[2:-1] = np.linalg.norm(step[2:] - step[:-2], axis=-1) * 1000
    return jumps, kinks


def foot_skate(positions: Array, contact: Array, fps: float) -> float:
    """Mean horizontal speed in mm/s of feet while they stand.

    positions : `(frames, feet, 3)` metres, Y up. contact : `(frames, feet)` bool; a step counts if the foot stands
    at both its ends. NaN if no foot ever stands.
    """
    speed = np.linalg.norm(np.diff(positions[..., [0, 2]].astype(float), axis=0), axis=-1) * fps * 1000
    speed = speed[contact[1:] & contact[:-1] & np.isfinite(speed)]
    return float(speed.mean()) if len(speed) else float("nan")


def stances(points: Array, fps: float) -> Array:
    """`(frames, feet)` bool: when each of `points (frames, feet, 3)` stands, by its speed and its height.

    Slower than 0.3 m/s and within 6 cm of the height that it has in its lowest twentieth of frames, for at least 0.1 s.
    """
    if len(points) < 3:
        return np.zeros(points.shape[:2], bool)
    speed = np.linalg.norm(np.gradient(points.astype(float), 1 / fps, axis=0), axis=-1)
    heights = [y[np.isfinite(y)] for y in points[..., 1].T]
    floor = np.array([np.percentile(y, 5) if len(y) else 0.0 for y in heights])
    stands = (speed < STANCE_SPEED) & (points[..., 1] < floor + STANCE_HEIGHT)
    for foot in range(stands.shape[1]):
        for start, stop in runs(stands[:, foot]):
            if stop - start < STANCE_SECONDS * fps:
                stands[start:stop, foot] = False
    return stands


def _known(values: Array) -> list[Array]:
    columns = (column[np.isfinite(column)] for column in values.T)
    return [column for column in columns if len(column)]
