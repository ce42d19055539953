"""A generative network in NumPy, for tests of what is made of such a network's answers."""

from __future__ import annotations

import numpy as np

from motionmend.body.joints import BODY
from motionmend.networks.checkpoints import Description
from motionmend.networks.generative import GenerativeCompleter


def follower(fps=50.0, frames=101, sway=0.03, late=0.9, grows=0.03, rises=0.0) -> GenerativeCompleter:
    """A body that goes along with the mean of what it is given, not far enough; its bones grow, and it sways as the
    noise says. So it has both of the faults that are mended, and others; `rises` is by how many metres in a window."""

    def run(inputs):
        pose, paths, given, noise = (inputs[name] for name in ("pose", "trajectories", "given", "noise"))
        clock = np.arange(1, frames, dtype=np.float32) / (frames - 1)
        last = np.maximum.accumulate(np.where(given, np.arange(frames - 1)[None, :, None], -1), axis=1)
        first = np.take_along_axis(paths, given.argmax(1)[:, None, :, None], 1)
        now = np.take_along_axis(paths, np.maximum(last, 0)[..., None], 1)
        ever = given.any(1)[:, None, :, None]
        gone = np.where(ever & (last >= 0)[..., None], now - first, 0).sum(2, keepdims=True)
        gone = late * gone / np.maximum(ever.sum(2, keepdims=True), 1) * [1, 0.3, 1]
        waves = np.einsum("bn,nt->bt", noise[:, :3], np.sin(np.outer([3, 5, 7], clock)))
        away = np.linspace(0, 1, len(BODY))[:, None] * [1, 0.2, -0.5]
        hips = pose[:, None, :1]
        grown = hips + (pose[:, None] - hips) * (1 + grows * clock[None, :, None, None])
        grown[..., 1] += rises * clock[None, :, None]
        return (grown + gone + sway * waves[..., None, None] * away).astype(np.float32)

    return GenerativeCompleter(Description("follower", "first_pelvis", fps, frames, BODY, True, 4), run)
