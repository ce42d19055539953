"""A network with many answers, as a Completer that samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..body.mapping import Mapping
from ..errors import InputError
from ..motion import Motion

if TYPE_CHECKING:
    pass
from .completers import NetworkCompleter, Restart, begun, placed

Array = np.ndarray

class GenerativeCompleter(NetworkCompleter):
    """A network with many answers, one for each noise: it goes on from a whole first pose along given paths.

    Where one answer is asked for (`windows`, `complete`, `predict`) it is that for a noise of zeros, the most typical.
    `complete` and `predict` begin at the first frame in which all the network's joints are observed, and leave what is
    before as it is.
    """

    generative = True

    def windows(self, positions: Array, observed: Array) -> Array:
        """See `NetworkCompleter.windows`; all joints of the first frames must be observed."""
        return self._in_batches(positions, observed, {"noise": self._noise(None, len(positions))})[..., :3]

    def sample_windows(self, pose: Array, trajectories: Array, given: Array, count: int, seed: int) -> Array:
        """`count` raw answers to each window, `(B, count, T - 1, J, 3)` metres; the same seed gives the same bits.

        Parameters
        ----------
        pose : `(B, J, 3)`, the first frames.
        trajectories : `(B, T - 1, J, 3)`, not read where not `given (B, T - 1, J)`.
        """
        positions, observed = begun(pose, trajectories, given)
        noise = self._noise(np.random.default_rng(seed), count, len(pose))
        noise = noise.swapaxes(0, 1).reshape(-1, self.description.noise_size)
        positions, observed = np.repeat(positions, count, axis=0), np.repeat(observed, count, axis=0)
        ways = self._in_batches(positions, observed, {"noise": noise})[:, 1:]
        return ways.reshape(len(pose), count, *ways.shape[1:])

    def sample(
        self, motion: Motion, n: int, seed: int | Sequence[int], mapping: Mapping | None = None
    ) -> list[Motion]:
        """`n` ways in which a take may go on from its first frame, along whatever is observed after it.

        Observed samples come back bit for bit in all of them. A take longer than a window goes on from a pose near the
        end of the window before, see `starts`. The same seed gives the same bits.

        Raises
        ------
        InputError : if no person is found in the rig, or the first frame lacks one of the network's joints.
        """
        joints = self._joints(motion, mapping)
        names = zip(self.skeleton.names, joints)
        absent = [name for name, joint in names if joint < 0 or not motion.observed[0, joint]]
        if absent:
            few = ", ".join(absent[:4]) + (", …" if len(absent) > 4 else "")
            raise InputError(f"the first frame lacks {few}", expected=f"a whole pose, from which {self.name} goes on")
        hidden = ~motion.observed[:, joints]
        ways = self._continuations(motion, joints, n, np.random.default_rng(seed), raw=False)
        return [placed(motion, joints, values, hidden) for values in ways]

    def go_on(
        self, motion: Motion, seed: int | Sequence[int], spread: float = 1.0, restart: Restart | None = None
    ) -> Array:
        """The network's own word on every sample after the first frame, `(frames, J, 3)` metres.

        Parameters
        ----------
        motion : of the network's joints at its rate, the first frame whole.
        spread : scales the noise; 0 gives the most typical answer.
        restart : makes of the pose `(J, 3)` in which a window is to begin, and its frame, one that bones and paths
            allow; what the network gets wrong would add up over many windows.
        """
        rng = np.random.default_rng(seed) if spread else None
        return self._continuations(motion, np.arange(len(self.skeleton)), 1, rng, True, spread, restart)[0]

    def _answer(self, motion: Motion, joints: Array, raw: bool) -> Array:
        values = np.full((len(motion), len(joints), 3), np.nan, np.float32)
        whole = motion.observed[:, joints].all(axis=1) & (joints >= 0).all()
        if whole.any():
            first = int(np.argmax(whole))
            rest = replace(motion, positions=motion.positions[first:], observed=motion.observed[first:])
            values[first:] = self._continuations(rest, joints, 1, None, raw)[0]
        return values

    def starts(self, frames: int) -> range:
        """First frames of the windows of a take of `frames` at the network's rate.

        Each begins at a pose of the one before, a quarter of a window from its end, and replaces it from there on
        little by little: neither position nor velocity jumps.
        """
        return range(0, max(1, frames - 1 - self.frames // 4), self.frames - 1 - self.frames // 4)

    def _continuations(
        self,
        motion: Motion,
        joints: Array,
        n: int,
        rng: np.random.Generator | None,
        raw: bool,
        spread: float = 1.0,
        restart: Restart | None = None,
    ) -> Array:
        """`(n, frames, J, 3)` at the motion's own times from its first pose, which must be whole."""
        ours, shift = self._at_its_rate(motion, joints)
        out = np.tile(ours.positions, (n, 1, 1, 1))
        overlap = self.frames // 4
        u = np.minimum(np.arange(self.frames, dtype=np.float32) / max(1, overlap), 1)[:, None, None]
        for start in self.starts(len(ours)):
            part = slice(start, start + self.frames)
            short = self.frames - len(ours.positions[part])
            before = np.pad(out[:, part], ((0, 0), (0, short), (0, 0), (0, 0)))
            observed = np.tile(np.pad(ours.observed[part], ((0, short), (0, 0))), (n, 1, 1))
            # A raw answer stands in for what was given; the next window is to be given the same all the same.
            given = np.pad(ours.positions[part], ((0, short), (0, 0), (0, 0)))
            positions = np.where(observed[..., None], given, before)
            positions[:, 0], observed[:, 0] = before[:, 0], True  # a pose of the window before
            if start and restart:
                positions[:, 0] = [restart(pose + shift, start) - shift for pose in before[:, 0]]
            answer = self._in_batches(positions, observed, {"noise": self._noise(rng, n) * np.float32(spread)})
            values = answer if raw else np.where(observed[..., None], positions, answer)
            if start:
                values = np.where(u < 1, before + u**2 * (3 - 2 * u) * (values - before), values)
            out[:, part] = values[:, : self.frames - short]
        return np.stack([self._at_its_own(each, motion, shift) for each in out])

    def _noise(self, rng: np.random.Generator | None, *shape: int) -> Array:
        """Standard normal `(*shape, noise_size)`; zeros without `rng`."""
        size = (*shape, self.description.noise_size)
        return np.zeros(size, np.float32) if rng is None else rng.standard_normal(size, dtype=np.float32)
