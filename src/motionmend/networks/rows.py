"""A body's motion as rows: poses seen from where it stands and faces, and how it travels and turns; and back.

The representation of Kaufmann et al. 2020 (ConvAE), section 3.1, after Holden et al. 2016. B = windows, T = frames,
J = BODY's joints. A row is one number through time; there are ROWS = 3 + 3 J + 3 of them, each frame's in order: the
root on the floor (always 0: it is what the others are seen from), the joints, and the floor velocity along x and z and
the turn about the vertical since the frame before, in metres and radians a frame.
"""

from __future__ import annotations

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.measures import facing
from ..fills.curves import between_seen
from ..motion import Motion

Array = np.ndarray

ROWS = 3 + 3 * len(BODY) + 3
GROUPS = ROWS // 3  # rows come and go by threes: the root, each joint, the travel
ROOT_SIGMA, HEADING_SIGMA = 3.0, 20.0  # frames, of the Gaussians that smooth root path and heading (authors' code)
HIPS = JOINT["hips"]
# Where the hips are missing, they are carried by the first of these that is not.
CARRIERS = [[JOINT[name] for name in names]
            for names in (("left_thigh", "right_thigh"), ("spine",), ("chest",), ("neck",), ("head",))]  # fmt: skip


def path_of(positions: Array, observed: Array) -> tuple[Array, Array]:
    """Where a body stands and faces: the root on the floor `(B, T, 2)`, x and z in metres, and the heading `(B, T)`.

    The root is where the hips are, smoothed over time by a Gaussian of 3 frames; the heading, radians about +Y from
    +Z towards +X, is `facing`'s, smoothed by one of 20 frames. Across frames where these are not to be seen run
    curves: `hips_of`, and straight lines between the directions. Where none is to be seen in a window it faces +Z.

    positions : `(B, T, J, 3)` float32 metres of BODY's joints, not read where not `observed (B, T, J)`.
    """
    from scipy.ndimage import gaussian_filter1d

    hips = hips_of(positions, observed)[..., [0, 2]].astype(float)
    root = gaussian_filter1d(hips, ROOT_SIGMA, axis=1, mode="nearest")
    whole = Motion(np.where(observed[..., None], positions, 0).reshape(-1, len(BODY), 3),
                   observed.reshape(-1, len(BODY)), 60.0, BODY)  # fmt: skip
    ahead = facing(whole).reshape(*observed.shape[:2], 1, 3)
    told = np.asarray(np.isfinite(ahead).all(axis=-1))
    ahead = ahead if told.all() else between_seen(ahead, told)[1]
    ahead = gaussian_filter1d(ahead[:, :, 0].astype(float), HEADING_SIGMA, axis=1, mode="nearest")
    return root, np.where(ahead.any(axis=-1), np.arctan2(ahead[..., 0], ahead[..., 2]), 0.0)


def hips_of(positions: Array, observed: Array) -> Array:
    """The hips `(B, T, 3)` where they are observed, as carried by others where these are, on a curve elsewhere."""
    hips, known = positions[:, :, HIPS], observed[:, :, HIPS]
    hips = np.where(known[..., None], hips, 0)
    for carriers in CARRIERS:
        if known.all():
            break
        there = np.asarray(observed[:, :, carriers].all(axis=-1))
        if not (there & ~known).any():
            continue
        carrier = np.where(there[..., None], positions[:, :, carriers].mean(axis=2), 0)
        apart, _ = between_seen((hips - carrier)[:, :, None], (there & known)[:, :, None])
        hips = np.where((there & ~known)[..., None], carrier + apart[:, :, 0], hips)
        known = known | there
    hips = hips.astype(np.float32)
    return hips if known.all() else between_seen(hips[:, :, None], known[:, :, None])[0][:, :, 0]


def seen_from(positions: Array, root: Array, heading: Array) -> Array:
    """World positions `(B, T, J, 3)` as seen from the root along the heading, which is +Z; heights stay."""
    x, z = positions[..., 0] - root[..., None, 0], positions[..., 2] - root[..., None, 1]
    sine, cosine = np.sin(heading)[..., None], np.cos(heading)[..., None]
    return np.stack([x * cosine - z * sine, positions[..., 1], x * sine + z * cosine], axis=-1)


def in_world(poses: Array, root: Array, heading: Array) -> Array:
    """The inverse of `seen_from`."""
    sine, cosine = np.sin(heading)[..., None], np.cos(heading)[..., None]
    x, z = poses[..., 0] * cosine + poses[..., 2] * sine, poses[..., 2] * cosine - poses[..., 0] * sine
    return np.stack([x + root[..., None, 0], poses[..., 1], z + root[..., None, 1]], axis=-1)


def on_path_of(poses: Array, path: Array) -> Array:
    """The poses of one motion where another stands and faces, joint by joint where that has any.

    Both `(B, T, J, 3)` metres of BODY's joints; `path` may have NaN. float32, NaN where it has.
    """
    there = np.asarray(np.isfinite(path).all(axis=-1))
    seen = seen_from(poses.astype(float), *path_of(poses, there))
    return np.where(there[..., None], in_world(seen, *path_of(path, there)), np.nan).astype(np.float32)


def travel_of(root: Array, heading: Array) -> Array:
    """`(B, T, 3)`: x and z of the step since the frame before as seen along the heading, and the turn since then.

    Of the first frame, which has none before it, as of the second.
    """
    step, turn = np.diff(root, axis=1, prepend=root[:, :1]), _wrapped(np.diff(heading, axis=1, prepend=heading[:, :1]))
    sine, cosine = np.sin(heading), np.cos(heading)
    x, z = step[..., 0] * cosine - step[..., 1] * sine, step[..., 0] * sine + step[..., 1] * cosine
    travel = np.stack([x, z, turn], axis=-1)
    travel[:, :1] = travel[:, 1:2] if travel.shape[1] > 1 else 0
    return travel


def travelled(travel: Array, root: Array, heading: Array, known: Array) -> tuple[Array, Array]:
    """Root paths and headings that are as given where `known (B, T)`, and go as `travel (B, T, 3)` says elsewhere.

    Integration alone ends where it ends (the paper leaves it there). Here what remains of the turn, and then of the
    way, to the pose after a gap is spread over the gap, slowly at both ends, so that there is no step at them. Before
    the first known frame a path is integrated backwards from it, after the last forwards; with none known, from where
    the root and heading of the first frame are.
    """
    known = known.copy()
    known[~known.any(axis=1), 0] = True
    heading = _closed(travel[..., 2:], heading[..., None], known, _wrapped)[..., 0]
    sine, cosine = np.sin(heading), np.cos(heading)
    x, z = travel[..., 0], travel[..., 1]
    step = np.stack([x * cosine + z * sine, z * cosine - x * sine], axis=-1)
    return _closed(step, root, known, lambda rest: rest), heading


def _closed(step: Array, values: Array, known: Array, shortest) -> Array:
    """`values (B, T, n)` where known; between, the sums of `step` from the known before, led to the known after."""
    frames = known.shape[1]
    clock = np.arange(frames)[None, :]
    before = np.maximum.accumulate(np.where(known, clock, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, clock, frames)[:, ::-1], axis=1)[:, ::-1]
    first, last = np.where(before < 0, after, before), np.where(after >= frames, before, after)
    went = np.cumsum(step, axis=1, dtype=float)

    def at(values: Array, index: Array) -> Array:
        return np.take_along_axis(values, index[..., None], axis=1)

    start = at(values, first)
    rest = shortest(at(values, last) - start - (at(went, last) - at(went, first)))
    u = ((clock - first) / np.maximum(last - first, 1))[..., None]
    between = ((before >= 0) & (after < frames))[..., None]
    way = start + went - at(went, first) + np.where(between, rest * u**2 * (3 - 2 * u), 0)
    return np.where(known[..., None], values, way)


def _wrapped(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def body_local(positions: Array) -> Array:
    """Poses `(B, T, J, 3)` as seen from each motion's own root and heading: float64.

    positions : metres of BODY's joints. NaN for a joint that is NaN, and for all where no heading is known.
    """
    known = np.asarray(np.isfinite(positions).all(axis=-1))
    sides = [JOINT[f"{side}_{part}"] for side in ("left", "right") for part in ("thigh", "upper_arm")]
    told = known[:, :, sides]
    poses = seen_from(positions.astype(float), *path_of(positions, known))
    headed = np.asarray(((told[..., 0] & told[..., 2]) | (told[..., 1] & told[..., 3])).any(axis=1))
    return np.where(headed[:, None, None, None], poses, np.nan)
