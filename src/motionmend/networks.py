"""A network as a Completer: any take of a person in, its windows through the network, the same take whole out.

The network itself is a `runtimes.Run`. B = windows, T = frames of a window, J = the network's joints.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from . import checkpoints, rows, windows
from .body import BODY, JOINT, Mapping, floor_height, map_rig
from .checkpoints import Description
from .errors import InputError
from .footing import ground
from .motion import Motion, Skeleton
from .runtimes import Graph, Module, Run
from .spaces import SPACES, BodyRows

if TYPE_CHECKING:
    from .models.network import Network

Array = np.ndarray
Restart = Callable[[Array, int], Array]

MOST = 4_800  # frames given at once to a network that takes any number
TOKENS = 8_192  # joints × frames, or frames of a generative one, given to a network at once: attention's memory grows
FEET = [joint for name, joint in JOINT.items() if name.endswith(("foot", "toe"))]


class NetworkCompleter:
    """See `motion.Completer`. A take of any length, rate and rig in which `body.map_rig` finds a person.

    Joints that are none of the network's stay as they are. A take with nothing to go by, and one with nothing
    missing, comes back as it is. `name` and `budget` are what tables say of it.
    """

    generative = False

    def __init__(self, description: Description, run: Run, *, name: str = "", budget: str = ""):
        self.description, self.run = description, run
        self.name, self.budget = name or description.network, budget
        self.fps, self.frames, self.skeleton = description.fps, description.frames, description.skeleton
        self.space = SPACES[description.space]()

    # Windows: the network's own joints and rate

    def windows(self, positions: Array, observed: Array) -> Array:
        """The network's raw answer `(B, T, J, 3)`, metres, at every sample, in batches of bounded memory.

        Parameters
        ----------
        positions : `(B, T, J, 3)` metres, Y up, the floor at 0; not read where unobserved.
        observed : `(B, T, J)` bool.

        Raises
        ------
        InputError : if the windows have another number of joints or frames than the network's.
        """
        return self._in_batches(positions, observed, {})

    def _in_batches(self, positions: Array, observed: Array, more: dict[str, Array]) -> Array:
        """`windows`, with `more` inputs that have a row for each window."""
        self._must_fit(positions.shape)
        out = np.empty(positions.shape, np.float32)
        tokens = positions.shape[1] * (1 if self.description.generative else positions.shape[2])
        many = max(1, TOKENS // max(1, tokens))
        for start in range(0, len(out), many):
            part = slice(start, start + many)
            inputs, known = self.space.encode(positions[part], observed[part])
            inputs = {**inputs, **{name: values[part] for name, values in more.items()}}
            out[part] = self.space.decode(self.run(inputs), known)
        return out

    def _must_fit(self, shape: tuple[int, ...]) -> None:
        frames, joints = shape[1:3]
        if joints != len(self.skeleton):
            raise InputError(f"{self.name} knows {len(self.skeleton)} joints, the windows have {joints}")
        if frames != self.frames and not self.description.any_length:
            raise InputError(f"{self.name} takes windows of {self.frames} frames, not of {frames}")

    # Takes: any joints, rate and length

    def complete(self, motion: Motion, mapping: Mapping | None = None) -> Motion:
        """The motion with the network's joints filled wherever they are unobserved; observed samples bit for bit.

        Parameters
        ----------
        mapping : which joint is which, where the caller knows; `body.map_rig`'s answer otherwise.

        Raises
        ------
        InputError : if no person is found in the rig.
        """
        if motion.observed.all() or not motion.observed.any():
            return motion
        joints = self._joints(motion, mapping)
        hidden = ~motion.observed[:, joints] & (joints >= 0)
        if not hidden.any() or not motion.observed[:, joints[joints >= 0]].any():
            return motion
        return placed(motion, joints, self._answer(motion, joints, raw=False), hidden)

    def predict(self, motion: Motion, mapping: Mapping | None = None) -> Motion:
        """The network's raw answer: every sample of its joints is rewritten, the observed ones too.

        Raises InputError as `complete` does.
        """
        if not motion.observed.any():
            return motion
        joints = self._joints(motion, mapping)
        if not motion.observed[:, joints[joints >= 0]].any():
            return motion
        everywhere = np.ones((len(motion), len(joints)), bool)
        return placed(motion, joints, self._answer(motion, joints, raw=True), everywhere)

    def _answer(self, motion: Motion, joints: Array, raw: bool) -> Array:
        """Positions `(frames, J, 3)` at the motion's own times; observed ones are the network's too if `raw`."""
        ours, shift = self._at_its_rate(motion, joints)
        length, overlap, batch = self.frames, self.frames // 4, max(1, TOKENS // (self.frames * len(joints)))
        most = MOST if self.description.any_length else 0
        # Windows are laid by the joints that the rig has: one that it lacks is missing in every frame.
        there = np.flatnonzero(joints >= 0)

        def of_those_there(positions: Array, observed: Array) -> Array:
            whole = np.full((*observed.shape[:2], len(joints), 3), np.nan, np.float32)
            seen = np.zeros(whole.shape[:3], bool)
            whole[:, :, there], seen[:, :, there] = positions, observed
            return self.windows(whole, seen)[:, :, there]

        values = ours.positions.copy()
        values[:, there] = windows.complete(
            of_those_there, values[:, there], ours.observed[:, there], length, overlap=overlap, batch=batch, most=most
        )
        if most and isinstance(self.space, BodyRows):
            self._pose_at_once(values, ours, there)
        if raw:
            length = max(1, min(most, len(ours))) if most else length
            first = windows.starts(len(ours), length, overlap)
            cut = [windows.cut(each, first, length) for each in (ours.positions, ours.observed)]
            rewritten = windows.stitch(self.windows(*cut), first, len(ours), overlap)
            values = np.where(ours.observed[..., None], rewritten, values)
        return self._at_its_own(values, motion, shift)

    def _pose_at_once(self, values: Array, ours: Motion, there: Array) -> None:
        """In `values (frames, J, 3)`, keep the way through gaps that were crossed coarsely first; pose them at once.

        Fewer frames a second tell better where a body goes in long gaps, and worse how it holds itself. What does not
        fit in MOST frames stays as it is.
        """
        for start, stop in windows.too_long(ours.observed[:, there], self.frames):
            near = slice(max(0, start - self.frames // 2), stop + self.frames // 2)
            if near.stop - near.start > MOST:
                continue
            once = self.windows(ours.positions[None, near], ours.observed[None, near])
            posed = rows.on_path_of(once, values[None, near])[0, start - near.start : stop - near.start]
            hidden = ~ours.observed[start:stop]
            values[start:stop][hidden] = posed[hidden]

    def _joints(self, motion: Motion, mapping: Mapping | None) -> Array:
        """For each of the network's joints the motion's, or -1."""
        names = self.skeleton.names
        if motion.skeleton.names == names:
            return np.arange(len(names))
        if names == BODY.names:
            seen = np.where(motion.observed[..., None], motion.positions, np.nan)
            mapping = mapping or map_rig(motion.skeleton, seen)
            if not mapping.is_person:
                hint = "say in a map file which joint is which" if mapping.found else "is it a take of a person?"
                raise InputError("no human body was found among the joints", hint=hint)
            return np.array(mapping.joints)
        index = {name: joint for joint, name in enumerate(motion.skeleton.names)}
        joints = np.array([index.get(name, -1) for name in names])
        if (joints < 0).all():
            raise InputError(f"no joint is named as {self.name} knows them", expected=f"{', '.join(names[:4])}, …")
        return joints

    def _at_its_rate(self, motion: Motion, joints: Array) -> tuple[Motion, Array]:
        """The network's joints at its rate with the floor at 0, to the take's end or beyond; and the shift `(3,)`."""
        observed = motion.observed[:, joints] & (joints >= 0)
        inside = Motion(motion.positions[:, joints], observed, motion.fps, self.skeleton)
        shift = np.array([0, _floor(inside), 0], np.float32)
        inside = replace(inside, positions=inside.positions - shift)
        try:
            ours = windows.resample(inside, self.fps)
        except ValueError as error:
            raise InputError(str(error)) from None
        if (len(ours) - 1) * motion.fps < (len(motion) - 1.001) * self.fps:  # the last frame lies between two of ours
            more = int(np.ceil(motion.fps / self.fps))
            positions = np.pad(inside.positions, ((0, more), (0, 0), (0, 0)), constant_values=np.nan)
            inside = replace(inside, positions=positions, observed=np.pad(observed, ((0, more), (0, 0))))
            ours = windows.resample(inside, self.fps)
        return ours, shift

    def _at_its_own(self, values: Array, motion: Motion, shift: Array) -> Array:
        """Positions `(frames, J, 3)` at the network's rate, back at the motion's times and place."""
        whole = Motion(values, np.ones(values.shape[:2], bool), self.fps, self.skeleton)
        return windows.resample(whole, motion.fps).positions[: len(motion)] + shift


class GenerativeCompleter(NetworkCompleter):
    """A network with many answers, one for each noise: it goes on from a whole first pose along given paths.

    Where one answer is asked for (`windows`, `complete`, `predict`) it is that for a noise of zeros, the most typical.
    `complete` and `predict` begin at the first frame in which all the network's joints are observed, and leave what is
    before as it is.
    """

    generative = True

    def windows(self, positions: Array, observed: Array) -> Array:
        """See `NetworkCompleter.windows`; all joints of the first frames must be observed."""
        return self._in_batches(positions, observed, {"noise": self._noise(None, len(positions))})

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


def completer(description: Description, run: Run, *, name: str = "", budget: str = "") -> NetworkCompleter:
    """The Completer that fits a network: a GenerativeCompleter for a generative one."""
    kind = GenerativeCompleter if description.generative else NetworkCompleter
    return kind(description, run, name=name, budget=budget)


def module_completer(network: Network, skeleton: Skeleton = BODY) -> NetworkCompleter:
    """The Completer of a torch network: as its weights are when it is asked, for validation during training."""
    return completer(Description.of(network, skeleton), Module(network))


def load_completer(name_or_path: str | os.PathLike) -> NetworkCompleter:
    """The installed network of this name, or that of a checkpoint's folder, ready for takes. Needs no torch.

    Raises
    ------
    InputError : if there is none, or its files are damaged.
    """
    found = checkpoints.load(name_or_path)
    return completer(found.description, Graph(found.path / checkpoints.GRAPH), name=found.name, budget=found.summary)


def begun(pose: Array, trajectories: Array, given: Array) -> tuple[Array, Array]:
    """Windows `(B, T, J, 3)` and what is observed in them: a first pose, all of it, and what is given after it."""
    positions = np.concatenate([pose[:, None], trajectories], axis=1)
    return positions, np.concatenate([np.ones_like(given[:, :1]), given], axis=1)


def placed(motion: Motion, joints: Array, values: Array, where: Array) -> Motion:
    """The motion with `values (frames, J, 3)` of its `joints`, where `where (frames, J)` and they are numbers."""
    positions, observed = motion.positions.copy(), motion.observed.copy()
    frames, ours = np.nonzero(where & (joints >= 0) & np.isfinite(values).all(axis=-1))
    positions[frames, joints[ours]] = values[frames, ours]
    observed[frames, joints[ours]] = True
    return replace(motion, positions=positions, observed=observed)


def _floor(motion: Motion) -> float:
    """The height that corpora have as 0. The file's own 0 without feet: the lowest joint may be the hips."""
    if motion.skeleton.names != BODY.names:
        return floor_height(motion)
    return ground(motion) if motion.observed[:, FEET].any() else 0.0
