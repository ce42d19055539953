"""What a gap gets before it is compared: a curve, over many windows of one layout at once, of points and of channels.

A base is a function of windows `(windows, frames, points, 3)` and their Layout; the gap and all its neighbours go
through the same one, in one batch, and what the neighbours' truth was beyond it is what they teach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..fills.curves import CURVES
from ..rotations import from_rotvec, inverse, multiply, to_rotvec
from .descriptors import Layout, columns

Array = np.ndarray

# (windows (windows, frames, points, 3), their layout, frames a second) -> (windows, missing, lost, 3)
Base = Callable[[Array, Layout, float], Array]


def eased(windows: Array, layout: Layout, fps: float) -> Array:
    """The `eased` curve of what is lost, as seen from its anchors where it has some (`bones`)."""
    seen = columns(windows, layout)[:, :, : len(layout.lost)]
    across = _crossed(seen, layout, fps)
    if layout.anchor < 0:
        return across
    return across + windows[:, layout.missing][:, :, layout.anchors]


def _crossed(values: Array, layout: Layout, fps: float) -> Array:
    """`(windows, frames, …)` -> `(windows, missing, …)` by the curve; past a seam without a far side it settles."""
    known = np.setdiff1d(np.arange(layout.length), layout.missing)
    return np.moveaxis(np.tensordot(_weights(layout, fps), values[:, known], (1, 1)), 0, 1)


def _weights(layout: Layout, fps: float) -> Array:
    """`(missing, known)` the curve as a matrix."""
    known = np.setdiff1d(np.arange(layout.length), layout.missing)
    return CURVES["eased"].across(len(layout.missing), known - layout.before, fps)


def eased_channels(
    rotations: Array, shifts: Array, parents: Sequence[int], lost: list[int], inner: Sequence[int], layout: Layout,
    fps: float,
) -> tuple[Array, Array]:
    """The same of a rig's channels: local turns `(windows, missing, lost, 4)` and shifts `(windows, missing, lost, 3)`.

    rotations, shifts : `(windows, frames, joints, 4 or 3)`. lost : joints, parents first.
    inner : those of them whose turn is crossed as seen from the parent, because that is not known; all others in the
        world, as `fills.channels` does.
    """
    missing, world = layout.missing, {}
    found = np.empty((len(rotations), len(missing), len(lost), 4), rotations.dtype)
    for joint in _with_ancestors(lost, parents):
        parent, own = parents[joint], rotations[:, :, joint]
        turn = own.copy() if parent < 0 else multiply(world[parent], own)
        if joint in lost:
            local = joint in inner or parent < 0
            crossed = _crossed_turns(own if local else turn, layout, fps)
            turn[:, missing] = multiply(world[parent][:, missing], crossed) if local and parent >= 0 else crossed
            above = None if local else inverse(world[parent][:, missing])
            found[:, :, lost.index(joint)] = crossed if above is None else multiply(above, crossed)
        world[joint] = turn
    return found, _crossed(shifts[:, :, lost], layout, fps)


def _with_ancestors(joints: Sequence[int], parents: Sequence[int]) -> list[int]:
    """These joints and all above them, parents first."""
    wanted = set(joints)
    for joint in reversed(range(len(parents))):
        if joint in wanted and parents[joint] >= 0:
            wanted.add(parents[joint])
    return sorted(wanted)


def _crossed_turns(turns: Array, layout: Layout, fps: float) -> Array:
    """`(windows, frames, 4)` -> `(windows, missing, 4)`: the curve of rotation vectors about its seams' middle."""
    before, after = layout.before, int(layout.missing[-1]) + 1
    start, stop = turns[:, before if before >= 0 else after], turns[:, after if layout.after >= 0 else before]
    middle = multiply(start, from_rotvec(to_rotvec(multiply(inverse(start), stop)) / 2))[:, None]
    known = np.setdiff1d(np.arange(layout.length), layout.missing)
    vectors = to_rotvec(multiply(inverse(middle), turns[:, known]))
    return multiply(middle, from_rotvec(np.moveaxis(np.tensordot(_weights(layout, fps), vectors, (1, 1)), 0, 1)))
