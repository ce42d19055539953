"""A network as a Completer: any take of a person in, its windows through the network, the same take whole out.

The network itself is a `runtimes.Run`. B = windows, T = frames of a window, J = the network's joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.mapping import Mapping, map_rig
from ..body.measures import floor_height
from ..constraints.ground import ground
from ..errors import InputError
from ..motion import Motion
from . import rows, windows
from .checkpoints import Description
from .runtimes import Run
from .spaces import SPACES, BodyRows

if TYPE_CHECKING:
    pass


Array = np.ndarray
Restart = Callable[[Array, int], Array]
MOST = 4_800  # frames given at once to a network that takes any number
TOKENS = 8_192  # joints × frames, or frames of a generative one, given to a network at once: attention's memory grows
FEET = [joint for name, joint in JOINT.items() if name.endswith(("foot", "toe"))]


class NetworkCompleter:
    """See `motion.Completer`. A take of any length, rate and rig in which `mapping.map_rig` finds a person.

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
        return self._in_batches(positions, observed, {})[..., :3]

    def _in_batches(self, positions: Array, observed: Array, more: dict[str, Array]) -> Array:
        """`windows`, with `more` inputs that have a row for each window; a fourth number is the error it expects."""
        self._must_fit(positions.shape)
        expected = getattr(self.space, "expected", None)
        out = np.empty((*positions.shape[:3], 4 if expected else 3), np.float32)
        tokens = positions.shape[1] * (1 if self.description.generative else positions.shape[2])
        many = max(1, TOKENS // max(1, tokens))
        for start in range(0, len(out), many):
            part = slice(start, start + many)
            inputs, known = self.space.encode(positions[part], observed[part])
            inputs = {**inputs, **{name: values[part] for name, values in more.items()}}
            output = self.run(inputs)
            out[part, ..., :3] = self.space.decode(output, known)
            if expected:
                out[part, ..., 3] = expected(output)
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
        mapping : which joint is which, where the caller knows; `mapping.map_rig`'s answer otherwise.

        Raises
        ------
        InputError : if no person is found in the rig.
        """
        values = self.answered(motion, mapping)[..., :3]
        if np.isnan(values).all():
            return motion
        return placed(motion, np.arange(len(motion.skeleton)), values, ~motion.observed)

    def answered(self, motion: Motion, mapping: Mapping | None = None) -> Array:
        """What the network says of its joints, `(frames, joints, 4)` metres; NaN for others, and where it says nothing.

        Positions at the motion's own times: where a sample is observed, what the rates leave of it. Fourth, how far off
        the network expects a missing sample to be: a median, NaN for networks that do not say.
        """
        values = np.full((*motion.observed.shape, 4), np.nan, np.float32)
        if motion.observed.all() or not motion.observed.any():
            return values
        joints = self._joints(motion, mapping)
        there = np.flatnonzero(joints >= 0)
        observed = motion.observed[:, joints[there]]
        if observed.all() or not observed.any():
            return values
        answer = self._answer(motion, joints, raw=False)[:, there]
        values[:, joints[there], : answer.shape[-1]] = answer
        return values

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
        return placed(motion, joints, self._answer(motion, joints, raw=True)[..., :3], everywhere)

    def _answer(self, motion: Motion, joints: Array, raw: bool) -> Array:
        """Positions, and the error it expects where it says one, `(frames, J, 3 or 4)` at the motion's own times.

        Observed positions are the network's too if `raw`.
        """
        ours, shift = self._at_its_rate(motion, joints)
        length, overlap, batch = self.frames, self.frames // 4, max(1, TOKENS // (self.frames * len(joints)))
        most = MOST if self.description.any_length else 0
        # Windows are laid by the joints that the rig has: one that it lacks is missing in every frame.
        there = np.flatnonzero(joints >= 0)

        def of_those_there(positions: Array, observed: Array) -> Array:
            whole = np.full((*observed.shape[:2], len(joints), 3), np.nan, np.float32)
            seen = np.zeros(whole.shape[:3], bool)
            whole[:, :, there], seen[:, :, there] = positions, observed
            return self._in_batches(whole, seen, {})[:, :, there]

        filled = windows.complete(
            of_those_there, ours.positions[:, there], ours.observed[:, there], length, overlap=overlap, batch=batch,
            most=most, longest=self.description.longest,
        )  # fmt: skip
        values = np.full((*ours.observed.shape, filled.shape[-1]), np.nan, np.float32)
        values[..., :3] = ours.positions
        values[:, there] = filled
        if most and isinstance(self.space, BodyRows):
            self._pose_at_once(values, ours, there)
        if raw:
            length = max(1, min(most, len(ours))) if most else length
            first = windows.starts(len(ours), length, overlap)
            cut = [windows.cut(each, first, length) for each in (ours.positions, ours.observed)]
            rewritten = windows.stitch(self.windows(*cut), first, len(ours), overlap)
            values[..., :3] = np.where(ours.observed[..., None], rewritten, values[..., :3])
        own = self._at_its_own(values[..., :3], motion, shift)
        nearest = np.minimum(np.round(np.arange(len(motion)) * self.fps / motion.fps).astype(int), len(values) - 1)
        return np.concatenate([own, values[nearest, :, 3:]], axis=-1)

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
