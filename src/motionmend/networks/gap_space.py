"""How the house network sees a window: BODY on its curves, and what it adds to them.

B = windows, T = frames, J = BODY's joints. NumPy only: what runs a network needs no torch.
"""

from __future__ import annotations

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.standing import STANDING
from .gap_curves import FPS, eased

Array = np.ndarray

_SIDED = ("thigh", "shoulder", "upper_arm")
ACROSS = np.array([[JOINT[f"{side}_{part}"] for part in _SIDED] for side in ("left", "right")])
HIPS = 0.93  # metres, the hips of who stands
INPUTS = 7 * len(BODY) + 4  # numbers of a frame
ERRORS = slice(3 * len(BODY), 4 * len(BODY))  # of an output's last axis: log of the expected error in metres
STRANGERS = 1.15  # how much farther off it is on validation takes than it expects of those it learned from
FEET = slice(4 * len(BODY), 4 * len(BODY) + 4)  # logits: whether each of contacts.STANDING_JOINTS stands
OUTPUTS = 4 * len(BODY) + 4


class BesideCurves:
    """What is missing as a difference from the `eased` curve, in the frame of the window's middle pose.

    Turned so that the body of the curve's middle frame faces +Z, and put with that frame's hips over the origin; the
    height is kept. Inputs: `frames (B, T, INPUTS)`, of each frame the joints from the hips less the mean body, the
    hips, the velocity of all joints, whether each is observed (1 or -1), and the largest envelope; and `envelope
    (B, T, J)` metres. Output: `(B, T, OUTPUTS)`, metres beside the curve, then what ERRORS and FEET are.
    """

    name = "beside_curves"

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], tuple[Array, ...]]:
        curve, envelope = eased(positions, observed)
        turned, place = normalised(curve)
        return {"frames": told(turned, observed, envelope), "envelope": envelope}, (curve, *place)

    def nothing(self, inputs: dict[str, Array]) -> Array:
        return np.zeros((*inputs["envelope"].shape[:2], OUTPUTS), np.float32)

    def expected(self, output: Array) -> Array:
        """The median error that the network expects of its own fill, `(B, T, J)` metres."""
        return STRANGERS * np.exp(output[..., ERRORS], dtype=np.float32)

    def decode(self, output: Array, known: tuple[Array, ...]) -> Array:
        curve, cosine, sine, _ = known
        beside = output[..., : 3 * len(BODY)].reshape(curve.shape)
        return (curve + about_y(beside, cosine, -sine)).astype(np.float32)


def normalised(curve: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Curves `(B, T, J, 3)` turned and moved, and how: cosine and sine of the turn `(B,)`, and the origin `(B, 3)`."""
    middle = curve[:, curve.shape[1] // 2]
    across = (middle[:, ACROSS[0]] - middle[:, ACROSS[1]]).sum(axis=1)
    length = np.hypot(across[:, 0], across[:, 2])
    sure = length > 1e-6
    cosine = np.where(sure, across[:, 0] / np.maximum(length, 1e-6), 1).astype(np.float32)
    sine = np.where(sure, across[:, 2] / np.maximum(length, 1e-6), 0).astype(np.float32)
    origin = middle[:, 0] * np.array([1, 0, 1], np.float32)
    return about_y(curve - origin[:, None, None], cosine, sine), (cosine, sine, origin)


def about_y(vectors: Array, cosine: Array, sine: Array) -> Array:
    """Vectors `(B, …, 3)`, each window turned about the vertical, right-handed, by its angle `(B,)`."""
    cosine, sine = (each.reshape(-1, *[1] * (vectors.ndim - 2)) for each in (cosine, sine))
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x * cosine + z * sine, y, z * cosine - x * sine], axis=-1)


def told(curve: Array, observed: Array, envelope: Array) -> Array:
    """What the network is told of each frame, `(B, T, INPUTS)` float32; all of it varies by about 1."""
    rows, frames = curve.shape[:2]
    hips = curve[:, :, :1]
    out = np.empty((rows, frames, INPUTS), np.float32)
    count = 3 * len(BODY)
    out[..., :count] = (8 * (curve - hips - STANDING)).reshape(rows, frames, count)
    out[..., count : count + 3] = hips[:, :, 0] * SCALE + SHIFT
    going = np.zeros_like(curve)
    if frames > 1:
        going[:, 1:-1] = (curve[:, 2:] - curve[:, :-2]) * np.float32(FPS / 2)
        going[:, 0], going[:, -1] = (curve[:, 1] - curve[:, 0]) * FPS, (curve[:, -1] - curve[:, -2]) * FPS
    out[..., count + 3 : 2 * count + 3] = going.reshape(rows, frames, count)
    out[..., 2 * count + 3 : -1] = np.where(observed, np.float32(1), np.float32(-1))
    out[..., -1] = 3 * envelope.max(axis=2)
    return out


SCALE, SHIFT = np.array([1, 3, 1], np.float32), np.array([0, -3 * HIPS, 0], np.float32)
