"""What a gap gets before it is compared: a curve, over many windows of one layout at once, of points and of channels.

A base is a function of windows `(windows, frames, points, 3)` and their Layout; the gap and all its neighbours go
through the same one, in one batch, and what the neighbours' truth was beyond it is what they teach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..fills.curves import CURVES
from ..rotations import forward_kinematics, from_rotvec, inverse, multiply, to_rotvec
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
    weights = CURVES["eased"].across(len(layout.missing), known - layout.before, fps)
    return np.moveaxis(np.tensordot(weights, values[:, known], (1, 1)), 0, 1)


def eased_channels(
    rotations: Array, shifts: Array, parents: Sequence[int], lost: Sequence[int], inner: Sequence[int], layout: Layout,
    fps: float,
) -> tuple[Array, Array]:
    """The same of a rig's channels: local turns `(windows, missing, lost, 4)` and shifts `(windows, missing, lost, 3)`.

    rotations, shifts : `(windows, frames, joints, 4 or 3)`. lost : joints, parents first.
    inner : those of them whose turn is crossed as seen from the parent, because that is not known; all others in the
        world, as `fills.channels` does.
    """
    count, frames, joints = rotations.shape[:3]
    turns = rotations.reshape(-1, joints, 4).astype(float)
    world = forward_kinematics(turns, np.zeros((len(turns), joints, 3)), parents)[1].reshape(count, frames, joints, 4)
    turns = turns.reshape(count, frames, joints, 4)
    missing, found = layout.missing, np.empty((count, len(layout.missing), len(lost), 4))
    for place, joint in enumerate(lost):
        parent = parents[joint]
        local = joint in inner or parent < 0
        crossed = _crossed_turns(turns[:, :, joint] if local else world[:, :, joint], layout, fps)
        found[:, :, place] = crossed if local else multiply(inverse(world[:, missing, parent]), crossed)
        above = found[:, :, place] if parent < 0 else multiply(world[:, missing, parent], found[:, :, place])
        world[:, missing, joint] = above
    return found, _crossed(shifts[:, :, lost].astype(float), layout, fps)


def _crossed_turns(turns: Array, layout: Layout, fps: float) -> Array:
    """`(windows, frames, 4)` -> `(windows, missing, 4)`: the curve of rotation vectors about its seams' middle."""
    before, after = layout.before, int(layout.missing[-1]) + 1
    start, stop = turns[:, before if before >= 0 else after], turns[:, after if layout.after >= 0 else before]
    middle = multiply(start, from_rotvec(to_rotvec(multiply(inverse(start), stop)) / 2))[:, None]
    vectors = to_rotvec(multiply(inverse(middle), turns))
    return multiply(middle, from_rotvec(_crossed(vectors, layout, fps)))
