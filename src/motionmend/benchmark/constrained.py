"""A method's samples as `animate` mends them: bones as long as in the pose, given joints on their paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..animation.animating import Asked
from ..animation.subject import puppet
from ..body.joints import BODY
from ..body.mapping import map_rig
from ..errors import InputError
from ..motion import Motion, Take, Units
from .method import CONSTRAINED, Method
from .trajevae import PROTOCOL

Array = np.ndarray

MOST = 1_500


def constrained(method: Method) -> Method:
    """The method, whose every sample is posed on a rig of the start pose's bones and led onto the given paths.

    That takes an eighth of a second a sample, so there are no more than MOST in a column.

    Raises
    ------
    InputError : if the method does not sample.
    """
    if method.sample is None:
        raise InputError(f"{method.name} does not sample", hint="constraints are for generative networks")
    own = method.sample

    def sample(pose: Array, trajectories: Array, given: Array, count: int, seed: int) -> Array:
        out = own(pose, trajectories, given, count, seed)
        for window in range(len(out)):
            out[window] = mended(pose[window], trajectories[window], given[window], out[window])
        return out

    about = ("its samples with bones as long as in the pose and given joints led onto their paths, as animate does; "
             f"no column of more than {MOST:,} samples")  # fmt: skip
    name = method.name + CONSTRAINED
    return replace(method, name=name, sample=sample, most=MOST, about=about, fill=None, restore=None)


def mended(pose: Array, paths: Array, given: Array, samples: Array) -> Array:
    """`samples (K, T, J, 3)` after `pose (J, 3)`, along `paths (T, J, 3)` where `given (T, J)`, all in metres."""
    body = Motion(pose[None].astype(np.float32), np.ones((1, len(BODY)), bool), PROTOCOL.fps, BODY)
    take = Take(body, None, None, Units(1.0, "y", ""), "npz", "")
    held = puppet(take, 0, 1 + len(paths), map_rig(BODY))
    points, told = np.concatenate([pose[None], paths]).astype(float), np.concatenate([given[:1], given])
    nothing = np.zeros(len(BODY))
    asked = Asked(held, (), PROTOCOL.fps, points, told, nothing, nothing.astype(int))
    posed = [asked.mended(np.concatenate([pose[None], one]).astype(float), False, False, False) for one in samples]
    return np.stack([each.motion.positions[1:, held.joints] for each in posed]).astype(np.float32)
