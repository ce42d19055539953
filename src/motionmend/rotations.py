"""Rotations as unit quaternions `(..., 4)` in xyzw order, and forward kinematics.

Only NumPy: SciPy's `Rotation` takes 0.4 s to import, which every small command would pay. SciPy is the
oracle in the tests. All functions broadcast over leading axes; angles are radians; frames right-handed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Array = np.ndarray

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def multiply(p: Array, q: Array) -> Array:
    """The product `p q`: turn by q first, then by p. `(..., 4)` each, broadcast."""
    px, py, pz, pw = np.moveaxis(p, -1, 0)
    qx, qy, qz, qw = np.moveaxis(q, -1, 0)
    out = np.empty((*np.broadcast_shapes(px.shape, qx.shape), 4), np.result_type(p, q))
    out[..., 0] = pw * qx + px * qw + py * qz - pz * qy
    out[..., 1] = pw * qy - px * qz + py * qw + pz * qx
    out[..., 2] = pw * qz + px * qy - py * qx + pz * qw
    out[..., 3] = pw * qw - px * qx - py * qy - pz * qz
    return out


def inverse(q: Array) -> Array:
    """The opposite turn of unit quaternions `(..., 4)`."""
    return q * np.array([-1, -1, -1, 1], q.dtype)


def apply(q: Array, v: Array) -> Array:
    """Turn vectors `v (..., 3)` by `q (..., 4)`."""
    axis, w = q[..., :3], q[..., 3:]
    twice = 2 * _cross(axis, v)
    return v + w * twice + _cross(axis, twice)


def _cross(a: Array, b: Array) -> Array:
    # np.cross is several times slower on long arrays of 3-vectors.
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def normalised(v: Array) -> Array:
    """Vectors scaled to length one; a zero vector stays zero."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, length, out=np.zeros_like(v), where=length > 0)


def from_rotvec(rotvec: Array) -> Array:
    """Quaternions of rotation vectors `(..., 3)` (axis times angle): the exponential map."""
    angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
    # sin(a/2)/a, by NumPy's sinc, has no division by zero: sinc(x) = sin(pi x)/(pi x).
    return np.concatenate([rotvec * 0.5 * np.sinc(angle / (2 * np.pi)), np.cos(angle / 2)], axis=-1)


def to_rotvec(q: Array) -> Array:
    """Rotation vectors `(..., 3)` of at most pi of quaternions: the logarithm."""
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., 3:])
    scale = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 1e-12)
    return q[..., :3] * scale


def from_axis(axis: str, angle: Array) -> Array:
    """Quaternions of turns by `angle (...)` radians about `axis`: "x", "y" or "z"."""
    q = np.zeros((*np.shape(angle), 4))
    q[..., "xyz".index(axis.lower())] = np.sin(np.asarray(angle) / 2)
    q[..., 3] = np.cos(np.asarray(angle) / 2)
    return q


def from_euler(order: str, angles: Array) -> Array:
    """Quaternions of intrinsic Euler angles: `order` such as "ZXY", `angles (..., len(order))` radians.

    The first letter is the outermost turn, as in BVH's CHANNELS and in SciPy's upper-case sequences;
    any number of axes, repeated ones too.
    """
    q = np.broadcast_to(IDENTITY, (*angles.shape[:-1], 4))
    for axis, angle in zip(order, np.moveaxis(angles, -1, 0)):
        q = multiply(q, from_axis(axis, angle))
    return q


def between(a: Array, b: Array) -> Array:
    """The smallest turns that bring directions `a (..., 3)` to `b (..., 3)`.

    Lengths do not matter; a zero vector gives the identity; opposite vectors turn about some
    perpendicular axis.
    """
    a, b = normalised(a), normalised(b)
    a, b = np.broadcast_arrays(a, b)
    w = 1 + np.sum(a * b, axis=-1, keepdims=True)
    q = np.concatenate([_cross(a, b), w], axis=-1)
    opposite = (w[..., 0] < 1e-9) & np.any(a != 0, axis=-1)
    if np.any(opposite):
        away = a[opposite]
        other = np.where(np.abs(away[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        q[opposite] = np.concatenate([_cross(away, other), np.zeros_like(away[..., :1])], axis=-1)
    return normalised(q)


def continuous(q: Array) -> Array:
    """The same rotations along axis 0 with signs chosen so that neighbours lie in one hemisphere."""
    dots = np.sum(q[1:] * q[:-1], axis=-1)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([q[:1], q[1:] * signs[..., None]]) if len(q) else q


def forward_kinematics(rotations: Array, translations: Array, parents: Sequence[int]) -> tuple[Array, Array]:
    """World positions and rotations of a hierarchy.

    Parameters
    ----------
    rotations : `(frames, joints, 4)` local, xyzw.
    translations : `(frames, joints, 3)` of each joint in its parent's frame.
    parents : index of each joint's parent, before it in order; -1 for a root.

    Returns
    -------
    positions `(frames, joints, 3)` and world rotations `(frames, joints, 4)`.
    """
    positions, world = np.empty_like(translations), np.empty_like(rotations)
    if not len(parents):
        return positions, world
    depths: list[int] = []
    for parent in parents:
        depths.append(0 if parent < 0 else depths[parent] + 1)
    levels = np.split(np.argsort(depths, kind="stable"), np.cumsum(np.bincount(depths))[:-1])
    ups = np.asarray(parents)
    # A block of frames at a time, which stays in the processor's cache; all joints of one depth together, and
    # each component in a stretch of its own: several times faster than joint by joint on vectors.
    for start in range(0, len(rotations), 256):
        block = slice(start, start + 256)
        turns, shifts = (np.moveaxis(a[block], 0, -1).copy(order="C") for a in (rotations, translations))
        for level in levels[1:]:
            above, turn, shift = turns[ups[level]], turns[level], shifts[level]
            ax, ay, az, aw = above[:, 0], above[:, 1], above[:, 2], above[:, 3]
            x, y, z, w = turn[:, 0], turn[:, 1], turn[:, 2], turn[:, 3]
            turns[level, 0] = aw * x + ax * w + ay * z - az * y
            turns[level, 1] = aw * y - ax * z + ay * w + az * x
            turns[level, 2] = aw * z + ax * y - ay * x + az * w
            turns[level, 3] = aw * w - ax * x - ay * y - az * z
            x, y, z = shift[:, 0], shift[:, 1], shift[:, 2]
            tx, ty, tz = 2 * (ay * z - az * y), 2 * (az * x - ax * z), 2 * (ax * y - ay * x)
            shift[:, 0] = x + aw * tx + (ay * tz - az * ty)
            shift[:, 1] = y + aw * ty + (az * tx - ax * tz)
            shift[:, 2] = z + aw * tz + (ax * ty - ay * tx)
            shifts[level] = shifts[ups[level]] + shift
        world[block], positions[block] = np.moveaxis(turns, -1, 0), np.moveaxis(shifts, -1, 0)
    return positions, world
