"""How a network sees its windows: the world as its inputs, and its output as the world again.

B = windows, T = frames, J = joints. A space is stateless: what decoding needs of a window, encoding hands over.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from .body import LEFT_RIGHT

Array = np.ndarray


class Space(Protocol):
    """A pair of maps between windows in the world and a network's inputs and output."""

    name: str

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], Any]:
        """The network's inputs by name, float32 and bool, of `positions (B, T, J, 3)` metres and `observed (B, T, J)`;
        and what `decode` wants. Unobserved samples are not read, no input is NaN.
        """
        ...

    def decode(self, output: Array, known: Any) -> Array:
        """The network's output as `(B, T, J, 3)` float32 metres in the world."""
        ...


class FloorMean:
    """Where the body is in the window does not matter, how high it is does (Björkstrand et al. 2023, section 4).

    The mean of the two floor coordinates over observed joints and frames, displaced ones included, is the origin.
    Inputs: `positions (B, T, J, 3)`, 0 where unobserved, and `observed (B, T, J)`. Output: `(B, T, J, 3)`.
    """

    name = "floor_mean"

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], Array]:
        origin = _mean(positions, observed, axes=(1, 2))
        origin[..., 1] = 0
        return {"positions": _centred(positions, observed, origin), "observed": observed}, origin

    def decode(self, output: Array, known: Array) -> Array:
        return (output + known).astype(np.float32)


class FirstPelvis:
    """The pelvis of the first frame is the origin, in height too (Kania et al. 2021, section 4).

    Where it is unobserved, the mean of what is observed in that frame takes its place. Inputs: `pose (B, J, 3)`, the
    first frame, `trajectories (B, T - 1, J, 3)`, the others, both 0 where unobserved, and `given (B, T - 1, J)`.
    Output: `(B, T - 1, J, 3)`; the first frame is put in front again, and a joint that was unobserved in it stands
    where the output begins.
    """

    name = "first_pelvis"
    pelvis = 0  # BODY's hips; H3.6M's too

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], tuple[Array, Array, Array]]:
        first, seen = positions[:, :1], observed[:, :1]
        root, rooted = first[:, :, self.pelvis, None], seen[:, :, self.pelvis, None, None]
        origin = np.where(rooted, root, _mean(first, seen, axes=(1, 2)))
        centred = _centred(positions, observed, origin)
        inputs = {"pose": centred[:, 0], "trajectories": centred[:, 1:], "given": observed[:, 1:]}
        return inputs, (origin, first, seen)

    def decode(self, output: Array, known: tuple[Array, Array, Array]) -> Array:
        origin, first, seen = known
        rest = (output + origin).astype(np.float32)
        begin = rest[:, :1] if rest.shape[1] else np.broadcast_to(origin, first.shape)
        return np.concatenate([np.where(seen[..., None], first, begin), rest], axis=1, dtype=np.float32)


SPACES: dict[str, type[Space]] = {space.name: space for space in (FloorMean, FirstPelvis)}


def turned(positions: Array, angles: Array) -> Array:
    """`positions (B, ..., 3)`, each window turned about the vertical through the origin by its `angles (B,)` radians.

    Right-handed about +Y: a quarter turn takes +Z to +X.
    """
    angles = angles.reshape(-1, *[1] * (positions.ndim - 2))
    sine, cosine = np.sin(angles).astype(positions.dtype), np.cos(angles).astype(positions.dtype)
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([x * cosine + z * sine, y, z * cosine - x * sine], axis=-1)


def mirrored(
    positions: Array, observed: Array, which: Array, pairs: Sequence[tuple[int, int]] = LEFT_RIGHT
) -> tuple[Array, Array]:
    """`positions (B, T, J, 3)` and `observed (B, T, J)`, left and right exchanged in the windows of `which (B,)` bool.

    x is negated, and the joints of each of `pairs` change places, so that a left hand becomes a right one.
    """
    other = np.arange(positions.shape[2])
    left, right = np.array(pairs).T
    other[left], other[right] = right, left
    positions, observed = positions.copy(), observed.copy()
    positions[which] = positions[which][:, :, other] * np.array([-1, 1, 1], positions.dtype)
    observed[which] = observed[which][:, :, other]
    return positions, observed


def _centred(positions: Array, observed: Array, origin: Array) -> Array:
    return (np.where(observed[..., None], positions, origin) - origin).astype(np.float32)


def _mean(positions: Array, observed: Array, axes: tuple[int, ...]) -> Array:
    """The mean over observed samples, all `axes` kept, float32; 0 where nothing is observed."""
    seen = observed[..., None]
    count = np.maximum(seen.sum(axis=axes, keepdims=True), 1)
    total = np.where(seen, positions, 0).sum(axis=axes, keepdims=True, dtype=float)
    return (total / count).astype(np.float32)
