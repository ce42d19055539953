"""One joint's turn, in closed form: aim at targets (Wahba's problem), bend to a distance, keep to its axes."""

from __future__ import annotations

import numpy as np

from ..rotations import IDENTITY, apply, between, from_rotvec, inverse, multiply, normalised

Array = np.ndarray

TINY = 1e-6  # metres: a shorter bone has no direction
PRIOR = 1e-4  # pull of the first guess, as a share of the targets' own; decides only what they leave open
PASSES = 4  # each starts at the last one's answer, so the prior's pull on what the targets do decide dies out
SWEEPS = 24  # over the axes of a joint that has two


def bending(start: Array, end: Array, distance: Array, axes: str) -> Array:
    """Rotation vectors `(frames, 3)` that turn `end` about the origin until it is `distance` from `start`.

    The turn is about the normal of the present bend, or the joint's only axis, and keeps to the side of the
    present bend. Beyond reach it straightens or folds the chain.
    """
    normal = np.cross(end, start)
    # A straight chain has no plane of its own: it takes the usual one of its neighbours in time.
    usual = normalised(normal.mean(axis=0, keepdims=True))
    if not usual.any():
        usual = normalised(np.cross(end, np.where(np.abs(end) == np.abs(end).min(axis=-1, keepdims=True), 1.0, 0.0)))
    size = np.linalg.norm(start, axis=-1, keepdims=True) * np.linalg.norm(end, axis=-1, keepdims=True)
    bent = np.divide(np.linalg.norm(normal, axis=-1, keepdims=True), size, out=np.zeros_like(size), where=size > 0)
    axis = normalised(normal + 1e-3 * np.exp(-((bent / 2e-3) ** 2)) * size * usual)
    if len(axes) == 1:
        hinge = _unit(axes)
        axis = np.broadcast_to(hinge if np.sum(normal @ hinge) >= 0 else -hinge, end.shape)
    # start . R(a) end = (|start|² + |end|² - distance²) / 2 is c + A cos a + B sin a.
    along = np.sum(axis * start, axis=-1) * np.sum(axis * end, axis=-1)
    cosine = np.sum(start * end, axis=-1) - along
    sine = np.sum(start * np.cross(axis, end), axis=-1)
    wanted = (np.sum(start**2, axis=-1) + np.sum(end**2, axis=-1) - distance**2) / 2 - along
    swing = np.hypot(cosine, sine)
    folded = np.arctan2(sine, cosine)
    ratio = np.divide(wanted, swing, out=np.ones_like(wanted), where=swing > TINY**2)
    angle = folded - np.arccos(np.clip(ratio, -1, 1))
    angle = np.where(swing > TINY**2, angle, 0.0)
    return axis * ((angle + np.pi) % (2 * np.pi) - np.pi)[:, None]


def aimed(guess: Array, axes: str, arms: Array, goals: Array, weights: Array) -> Array:
    """Local rotations `(frames, 4)` near `guess` that bring `arms` to `goals (frames, n, 3)`, both in its frame.

    axes : what the joint can turn about, from `free_axes`. weights : `(frames, n)`, 0 where there is no goal, below
        1 for arms that are not rigid: these decide only what the rigid ones leave open.
    """
    firm = np.where(weights >= 1, weights, 0.0)
    firm = np.where(firm.any(axis=1, keepdims=True), firm, weights)
    soft = [] if np.array_equal(firm, weights) else [weights] * PASSES
    if len(axes) == 2:
        return _aimed_by_two(guess, axes, arms, goals, weights, firm)
    delta = np.broadcast_to(IDENTITY, guess.shape).copy()
    if len(axes) == 1:
        for some in (*soft, *[firm] * PASSES):
            turned = apply(delta[:, None], arms)
            delta = multiply(delta, from_rotvec(_unit(axes) * _angle_about(_unit(axes), turned, goals, some)[:, None]))
        return multiply(guess, delta)
    one = (weights > 0).sum(axis=1) == 1
    only = np.argmax(weights, axis=1)
    rows = np.arange(len(guess))
    delta[one] = between(arms[rows, only][one], goals[rows, only][one])
    many = np.flatnonzero(~one)
    for some in (*soft, *[firm] * PASSES) if len(many) else ():
        turned = apply(delta[many, None], arms[many])
        delta[many] = multiply(_davenport(turned, goals[many], some[many]), delta[many])
    return multiply(guess, delta)


def _aimed_by_two(guess: Array, axes: str, arms: Array, goals: Array, weights: Array, firm: Array) -> Array:
    """The same for a joint of two axes: each in turn takes its best angle, which never makes the fit worse."""
    outer, inner = _unit(axes[0]), _unit(axes[1])
    goals = apply(guess[:, None], goals)
    turn = allowed(guess, axes)
    for sweep in range(SWEEPS):
        some = weights if sweep == 0 else firm
        back = apply(inverse(turn)[:, None], goals)
        turn = multiply(turn, from_rotvec(inner * _angle_about(inner, arms, back, some)[:, None]))
        out = apply(turn[:, None], arms)
        turn = multiply(from_rotvec(outer * _angle_about(outer, out, goals, some)[:, None]), turn)
    return turn


def _angle_about(axis: Array, arms: Array, goals: Array, weights: Array) -> Array:
    """The angles `(frames,)` about one axis that bring `arms` nearest to `goals`, `(frames, n, 3)`."""
    # A zero arm or goal drops out by itself.
    sine = np.sum(weights * (np.cross(arms, goals) @ axis), axis=1)
    cosine = np.sum(weights * (np.sum(arms * goals, axis=-1) - (arms @ axis) * (goals @ axis)), axis=1)
    return np.arctan2(sine, cosine + PRIOR * _strength(arms, goals, weights))


def _davenport(arms: Array, goals: Array, weights: Array) -> Array:
    """Turns `(frames, 4)` that bring `arms` nearest to `goals` in weighted squares, with a pull to no turn.

    Davenport's q-method: the eigenvector of the greatest eigenvalue of a symmetric 4 x 4 matrix (Keat 1977).
    """
    moment = np.einsum("fn,fni,fnj->fij", weights, goals, arms)
    moment += PRIOR * _strength(arms, goals, weights)[:, None, None] * np.eye(3)
    trace = np.trace(moment, axis1=1, axis2=2)
    k = np.empty((len(arms), 4, 4))
    k[:, :3, :3] = moment + np.swapaxes(moment, 1, 2) - trace[:, None, None] * np.eye(3)
    skew = moment - np.swapaxes(moment, 1, 2)
    k[:, 3, :3] = k[:, :3, 3] = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)
    k[:, 3, 3] = trace
    q = np.linalg.eigh(k)[1][:, :, -1]
    return np.where(q[:, 3:] < 0, -q, q)


def _strength(arms: Array, goals: Array, weights: Array) -> Array:
    return np.sum(weights * np.linalg.norm(arms, axis=-1) * np.linalg.norm(goals, axis=-1), axis=1)


def allowed(q: Array, axes: str) -> Array:
    """The rotations nearest to `q (frames, 4)` that a joint of two axes can make; other joints make them all.

    R_i(a) R_j(b) has the quaternion of components u_0 v_0 (w), u_1 v_0 (i), u_0 v_1 (j), ± u_1 v_1 (k), with
    u, v the half angles' cosine and sine: the nearest one is the best rank-one matrix u vᵀ.
    """
    if len(axes) != 2:
        return q
    i, j = ("XYZ".index(axis) for axis in axes)
    k = 3 - i - j
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    table = np.stack([np.stack([q[:, 3], q[:, j]], -1), np.stack([q[:, i], sign * q[:, k]], -1)], axis=-2)
    left, _, right = np.linalg.svd(table)
    table = left[:, :, :1] * right[:, :1, :]
    out = np.empty_like(q)
    out[:, 3], out[:, j], out[:, i], out[:, k] = table[:, 0, 0], table[:, 0, 1], table[:, 1, 0], sign * table[:, 1, 1]
    return np.where(np.sum(out * q, axis=-1, keepdims=True) < 0, -out, out)


def free_axes(order: str) -> str:
    """The axes of a channel list, without immediate repeats: three or more of them make any rotation."""
    return "".join(axis for axis, last in zip(order, " " + order) if axis != last)


def _unit(axis: str) -> Array:
    return np.eye(3)["XYZ".index(axis)]
