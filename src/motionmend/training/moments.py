"""Windows anywhere in the takes, at any pace, instead of whole windows of clips.

B = windows, T = frames, J = joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..corpora.corpus import Corpus

Array = np.ndarray

LONGEST = 60.0  # seconds: a take that is longer is not drawn more often
PACES = 0.8, 1.25  # of frames taken for frames made
STRETCHED = 1 / 3  # of all windows
MARGIN = 8  # frames by which a window may reach beyond a take


class Moments:
    """All clips of the split "train", in memory.

    A clip is drawn in proportion to its length, a place in it uniformly. Frames before and after a clip are
    unobserved, so that windows begin and end with takes now and then, and short clips are not left out.
    """

    def __init__(self, corpora: Sequence[Corpus], frames: int, split: str = "train"):
        self.frames = frames
        clips = [(corpus, clip) for corpus in corpora for clip in corpus.in_split(split)]
        motions = [corpus.motion(clip) for corpus, clip in clips]
        self.positions = np.concatenate([np.nan_to_num(each.positions) for each in motions])
        self.observed = np.concatenate([each.observed for each in motions])
        self.lengths = np.array([len(each) for each in motions])
        self.firsts = np.cumsum(self.lengths) - self.lengths
        shares = np.minimum(self.lengths / np.array([corpus.fps for corpus, _ in clips]), LONGEST)
        self.upto = np.cumsum(shares / shares.sum())

    def drawn(self, chance: Array) -> tuple[Array, Array]:
        """Positions `(B, T, J, 3)` float32, NaN where unobserved, and observed `(B, T, J)`.

        chance : `(4, B)`, uniform in [0, 1).
        """
        clip = np.minimum(np.searchsorted(self.upto, chance[0], side="right"), len(self.upto) - 1)
        pace = np.where(chance[1] < STRETCHED, PACES[0] + chance[2] * (PACES[1] - PACES[0]), 1.0)
        span = (self.frames - 1) * pace + 1
        room = self.lengths[clip] - span
        low, high = np.minimum(room, -MARGIN), np.maximum(room + MARGIN, 0)
        start = low + chance[3] * (high - low)
        start = np.where(pace == 1, np.round(start), start)
        times = start[:, None] + pace[:, None] * np.arange(self.frames)
        return self.at(clip, times)

    def at(self, clip: Array, times: Array) -> tuple[Array, Array]:
        """Samples of clips `(B,)` at `times (B, T)` in frames: on the cubic through the four samples around them."""
        last = (self.lengths[clip] - 1)[:, None]
        inside = (times >= 0) & (times <= last)
        frame = np.floor(times).astype(np.int64)
        beyond = (times - frame).astype(np.float32)
        first = self.firsts[clip][:, None]
        where = [first + np.clip(frame + step, 0, last) for step in (-1, 0, 1, 2)]
        positions, observed = self.positions[where[1]], self.observed[where[1]] & inside[..., None]
        moved = np.flatnonzero(beyond.any(axis=1))
        if len(moved):
            points = [self.positions[each[moved]] for each in where]
            seen = [self.observed[each[moved]] for each in where]
            u = beyond[moved][..., None, None]
            slopes = [np.where((seen[k - 1] & seen[k + 1])[..., None], (points[k + 1] - points[k - 1]) / 2,
                               points[2] - points[1]) for k in (1, 2)]  # fmt: skip
            positions[moved] = (
                (1 + 2 * u) * (1 - u) ** 2 * points[1] + u**2 * (3 - 2 * u) * points[2]
                + u * (1 - u) ** 2 * slopes[0] + u**2 * (u - 1) * slopes[1]
            )  # fmt: skip
            observed[moved] &= seen[2]
        positions[~observed] = np.nan
        return positions, observed
