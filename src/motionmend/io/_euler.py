"""Euler angles → rotations, fast; and back to angles that run on from what was kept."""

from __future__ import annotations

import numpy as np

from ..motion import runs
from ..rotations import inverse, multiply

Array = np.ndarray


def turns(order: str, angles: Array) -> Array:
    """`rotations.from_euler` for long tables: quaternions `(..., 4)` of angles `(..., len(order))` in radians."""
    halves = np.moveaxis(angles, -1, 0) / 2
    sines, cosines = np.sin(halves), np.cos(halves)
    w, v = np.ones(halves.shape[1:]), [np.zeros(halves.shape[1:])] * 3
    for axis, s, c in zip(order, sines, cosines):
        # The product with a turn about one axis only.
        i = "XYZ".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        w, v[i], v[j], v[k] = w * c - v[i] * s, v[i] * c + w * s, v[j] * c + v[k] * s, v[k] * c - v[j] * s
    return np.stack([*v, w], axis=-1)


def follow(order: str, rotations: Array, angles: Array, changed: Array) -> Array:
    """New Euler angles where `changed`, chosen to run on from those that are kept.

    Every rotation has two triples of angles, each plus any full turns. Along a run of changed frames the one
    nearest to the frame before is taken; a run at the start of the take is laid out backwards from its end.
    Where the two kept ends of a run belong to different triples, the run changes over between the two frames
    where that is smallest. Full turns that are left at the run's end are in the motion itself. In gimbal lock,
    where only a sum of two angles is defined, the difference stays as it was.

    Parameters
    ----------
    order : axes, outermost first, such as "ZXY"; fewer axes take the nearest rotation that they can express.
    rotations : `(changed frames, 4)`, those to express.
    angles : `(frames, len(order))` radians, as they are now. changed : `(frames,)` bool.

    Returns
    -------
    `(frames, len(order))` radians, equal to `angles` where not `changed`.
    """
    # Only the changed frames and their neighbours matter.
    near = changed.copy()
    near[1:] |= changed[:-1]
    near[:-1] |= changed[1:]
    out = angles.copy()
    out[near] = _follow(order, rotations, angles[near], changed[near])
    return out


def _follow(order: str, rotations: Array, angles: Array, changed: Array) -> Array:
    # Neighbouring turns about one axis are one turn; a fourth axis and what follows keep their angles.
    firsts = [at for at in range(len(order)) if at == 0 or order[at] != order[at - 1]]
    axes = "".join(order[at] for at in firsts)
    sums = np.add.reduceat(angles, firsts, axis=1)
    if len(axes) > 3:
        rotations = multiply(rotations, inverse(turns(axes[3:], sums[changed, 3:])))
        axes, firsts, sums = axes[:3], firsts[:3], sums[:, :3]
    solved = _solve(axes, rotations, sums, changed)
    if len(axes) == 3:
        solved = _on_one_branch(solved, sums, changed, proper=axes[0] == axes[2])
    solved = _unwrapped(solved, sums, changed)
    out = angles.copy()
    out[:, firsts] += np.where(changed[:, None], solved - sums, 0.0)
    return out


def _solve(axes: str, q: Array, angles: Array, changed: Array) -> Array:
    """`angles (frames, 1 to 3)` with one solution for the rotations `q` of the changed frames put in.

    Half the sum and half the difference of the outer angles fall out of the quaternion by one arctangent each
    (Bernardes & Viollet, "Quaternion to Euler angles conversion: a direct, general and computationally efficient
    method", PLoS ONE 17, 2022). With two axes the same holds for the pair that is nearest to q.
    """
    out = angles.copy()
    w, at = q[:, 3], ["XYZ".index(axis) for axis in axes]
    if len(axes) == 1:
        out[changed, 0] = 2 * np.arctan2(q[:, at[0]], w)
        return out
    third = 3 - at[0] - at[1]
    sign = 1.0 if (at[1] - at[0]) % 3 == 1 else -1.0
    i, j, k = q[:, at[0]], q[:, at[1]], sign * q[:, third]
    if len(axes) == 2:
        plus_sin, plus_cos, minus_sin, minus_cos = i + j, w - k, i - j, w + k
        last_sign = 1.0
    elif axes[0] == axes[2]:
        plus_sin, plus_cos, minus_sin, minus_cos = i, w, k, j
        last_sign = 1.0
    else:
        plus_sin, plus_cos, minus_sin, minus_cos = i + k, w + j, i - k, w - j
        last_sign = sign
    frames = np.flatnonzero(changed)
    last = out[:, -1] * last_sign
    plus = _half(plus_sin, plus_cos, (out[:, 0] + last) / 2, frames)
    minus = _half(minus_sin, minus_cos, (out[:, 0] - last) / 2, frames)
    out[frames, 0], out[frames, -1] = plus + minus, last_sign * (plus - minus)
    if len(axes) == 3:
        middle = 2 * np.arctan2(np.hypot(minus_sin, minus_cos), np.hypot(plus_sin, plus_cos))
        out[frames, 1] = middle if axes[0] == axes[2] else np.pi / 2 - middle
    return out


def _half(sine: Array, cosine: Array, halves: Array, frames: Array) -> Array:
    """The arctangents at `frames`; where both parts vanish, the value of the frame before."""
    halves = halves.copy()
    halves[frames] = np.arctan2(sine, cosine)
    undefined = np.zeros(len(halves), bool)
    undefined[frames] = np.hypot(sine, cosine) < 5e-7  # costs at most 0.001 mm a metre
    before = np.maximum.accumulate(np.where(undefined, 0, np.arange(len(halves))))
    return halves[before][frames]


def _on_one_branch(solved: Array, angles: Array, changed: Array, proper: bool) -> Array:
    """Of the two triples of each changed frame, the one that runs on."""
    half_turn = np.array([np.pi, 0.0 if proper else np.pi, np.pi])
    other = half_turn + solved * [1, -1, 1]
    # Going over to the other triple keeps distances, so what matters is whether to change over at each step.
    stay, swap = _distance(solved[1:], solved[:-1]), _distance(other[1:], solved[:-1])
    gain = np.append(0.0, stay - swap)
    steps = np.cumsum((gain > 0) & changed)
    on_other = np.zeros(len(solved), bool)
    for start, stop in runs(changed):
        flips = (steps[start:stop] - steps[start - 1] if start else steps[start:stop] - steps[0]) % 2 == 1
        if stop < len(solved):
            missed = flips[-1] != (gain[stop] > 0)
            cheapest = int(np.argmin(np.abs(gain[start : stop + 1]))) if start else 0
        else:
            first = angles[:1]  # nothing was kept at either end: stay near the file's own first frame
            missed = not start and _distance(other[:1], first)[0] < _distance(solved[:1], first)[0]
            cheapest = 0
        if missed:
            flips[cheapest:] ^= True
        on_other[start:stop] = flips
    return np.where(on_other[:, None], other, solved)


def _distance(a: Array, b: Array) -> Array:
    """Squared distances of angles `(n, 3)`, whatever their full turns."""
    apart = a - b
    apart -= 2 * np.pi * np.round(apart / (2 * np.pi))
    return np.einsum("ij,ij->i", apart, apart)


def _unwrapped(solved: Array, angles: Array, changed: Array) -> Array:
    """Full turns added to the changed frames, so that no step within a run exceeds half a turn."""
    full = np.zeros_like(solved)
    full[1:] = np.round(np.diff(solved, axis=0) / (2 * np.pi))
    added = -np.cumsum(full, axis=0)
    out = solved.copy()
    for start, stop in runs(changed):
        if start:
            base = added[start - 1]
        elif stop < len(solved):
            base = added[stop]
        else:
            base = np.round((solved[0] - angles[0]) / (2 * np.pi))
        out[start:stop] += 2 * np.pi * (added[start:stop] - base)
    return out
