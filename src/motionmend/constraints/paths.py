"""Given paths met by the whole limb: inverse kinematics on a rig, all frames at once, from where a network put it.

Every turn that leads to a joint with a goal takes its share: a limb's own joints first, then the trunk, then the
body's place. Damped least squares (Wampler 1986) in as many small steps for every frame: what is decided in one frame
and not in the next, such as when to stop, would be seen. Where a goal is out of reach, a limb is stretched out towards
it and does not shake. Feet for which nothing is given stay where they were, as far as the goals allow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..body.joints import BODY, JOINT, LIMBS
from ..fills.curves import least_jerk
from ..motion import Rig, Take
from ..rigs.aiming import allowed
from ..rigs.puppet import Puppet
from ..rotations import apply, forward_kinematics, from_rotvec, inverse, multiply, normalised
from .seams import meet_seams

Array = np.ndarray

FADE = 0.3  # seconds over which a correction comes before a path begins and goes after it has ended
SLACK = 0.15  # metres by which a network may be off a path before the whole body goes along
TOLERANCE = 0.005  # metres: what is farther from its path has not reached it
# How readily a joint turns, against a limb's own joints; and the body's place moves, in m²/rad².
READY = {"hips": 0.02, "spine": 0.05, "chest": 0.05, "neck": 0.3, "left_shoulder": 0.1, "right_shoulder": 0.1}
SPINE, PLACE, LED = 0.05, 0.002, 0.2  # LED: the body's place where hips, trunk or feet are given
RISE, SINK = 0.1, 0.5  # metres by which the body is lifted, on its toes, and lowered, to meet a path
STEPS, DAMPING = 60, 1e-2  # and m²/rad²: the greater, the calmer beyond reach and the more steps within
LONGEST, WIDEST = 0.03, 0.3  # metres towards a goal and radians of a joint, in a step
LEAST = 1e-2  # of the damping is left at a goal
CLOSE = 5e-5  # metres from every goal: no more steps
FEET_FIRST, FEET_LAST = 0.05, 1e-3  # weights of feet that stay in the first two thirds of the steps, and in the last
FEET = [JOINT[f"{side}_{part}"] for side in ("left", "right") for part in ("foot", "toe")]
LEADING = ["hips", "spine", "chest", *(f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "foot"))]


def carried(positions: Array, real: Array, paths: Array, given: Array, fps: float) -> Array:
    """A network's `positions (frames, J, 3)`, the whole body moved over the floor where given joints are far away.

    Bones of which both ends are given are where these say.

    real : `(frames, J, 3)`, the same with bones as long as they are: how far away the joints really are. paths, given :
        `(frames, J, 3)` and `(frames, J)` bool, what they were to do.
    """
    joints = np.flatnonzero(given.any(axis=0))
    if not len(joints):
        return positions
    off = _goals(real, paths, given, fps)[:, joints] - real[:, joints]
    off[..., 1] = 0
    size = np.linalg.norm(off, axis=-1, keepdims=True)
    mean = (size * off).sum(axis=1) / np.maximum(size.sum(axis=1), 1e-9)
    far = np.linalg.norm(mean, axis=-1, keepdims=True)
    moved = positions + (mean * (1 - SLACK / np.hypot(SLACK, far)))[:, None]
    lower = [joint for joint in joints.tolist() if BODY.parents[joint] in joints]
    ends = sorted({*lower, *(BODY.parents[joint] for joint in lower)})
    moved[:, ends] = _goals(moved, paths, given, fps)[:, ends]
    return moved


def meet(
    puppet: Puppet, posed: Take, own: Array, paths: Array, given: Array, fps: float, steps: int = STEPS
) -> Take:
    """The posed rig with every given joint on its path, as near as it can be; frame 0 and all bones stay.

    own : `(frames, J, 3)` metres, where the network has BODY's joints: there feet for which nothing is given go back,
        now that bones have their lengths. paths, given : `(frames, J, 3)` and `(frames, J)` bool. Corrections come and
        go within FADE seconds where a path begins and ends.
    """
    rig, there = posed.rig, puppet.joints >= 0
    asked = np.flatnonzero(given.any(axis=0) & there)
    feet = [joint for joint in FEET if there[joint] and joint not in asked]
    if rig is None or len(posed) < 2 or not (len(asked) or feet):
        return posed
    before = np.full(paths.shape, np.nan)
    before[:, there] = rig.kinematics[0][:, puppet.joints[there]]
    goals = _goals(before, paths, given, fps)
    firm = _firmness(given, FADE * fps)
    goals[firm == 0] = np.nan
    kept = own[:, feet].copy()
    for at, joint in enumerate(feet):
        if BODY.parents[joint] in asked:  # a foot that is led stays level
            kept[:, at] += np.nan_to_num(goals[:, BODY.parents[joint]] - own[:, BODY.parents[joint]])
    wanted = np.concatenate([goals[:, asked], kept], axis=1)[1:]
    solver = _Solver(puppet, rig, puppet.joints[[*asked, *feet]], wanted, firm[1:, asked], leads(given))
    solver.solve(steps)
    rotations, translations = rig.rotations.copy(), rig.translations.copy()
    rotations[1:], translations[1:] = solver.local, solver.shift
    return posed.with_rig(replace(rig, rotations=rotations, translations=translations))


def leads(given: Array) -> bool:
    """Whether paths that are `given (frames, J)` say where the body is, and not only where a hand or the head is."""
    return bool(given[:, [JOINT[name] for name in LEADING]].any())


def _goals(positions: Array, paths: Array, given: Array, fps: float) -> Array:
    """The paths where given, and `positions` elsewhere, changing from one to the other without a pop."""
    out = positions.astype(float)
    joints = np.flatnonzero(given.any(axis=0))
    own, known = out[:, joints], given[:, joints].copy()
    # The pose is as certain as a path. A trace of a misfit says that it is all: velocities need not be judged.
    before = np.where(known[..., None], paths[:, joints], own)
    before[0], known[0] = own[0] + 1e-12, True
    out[:, joints] = meet_seams(own, before, known, fps, FADE)
    return out


def _firmness(given: Array, fade: float) -> Array:
    """1 where `given (frames, J)`, and less and less over `fade` frames beside it: a joint is not let go at once."""
    clock = np.arange(len(given))[:, None]
    since = clock - np.maximum.accumulate(np.where(given, clock, -len(given)), axis=0)
    until = np.minimum.accumulate(np.where(given, clock, 2 * len(given))[::-1], axis=0)[::-1] - clock
    u = np.clip(np.minimum(since, until) / max(1.0, fade), 0, 1)
    return 1 - least_jerk(u)


def weights_of(puppet: Puppet) -> Array:
    """How readily each joint of the rig turns, `(rig's joints,)`; 0 for those that may not."""
    ready = np.full(len(puppet.axes), SPINE)
    limbs = {joint for limb in LIMBS.values() for joint in limb}
    for name, ours in JOINT.items():
        if puppet.joints[ours] >= 0:
            ready[puppet.joints[ours]] = READY.get(name, 1.0 if ours in limbs else SPINE)
    return np.where(puppet.free, ready, 0.0)


class _Solver:
    """All frames of a rig but the first, and what is wanted in them.

    targets : joints of the rig, those that have goals and then feet. wanted : `(frames, targets, 3)`, NaN for nothing.
    firm : `(frames, asked)` from 0 to 1, how much each goal counts. led : whether the goals say where the body is, so
        that nothing else keeps it down or up.
    """

    def __init__(self, puppet: Puppet, rig: Rig, targets: Array, wanted: Array, firm: Array, led: bool):
        self.parents, self.mover, self.axes = rig.skeleton.parents, puppet.mover, puppet.axes
        self.targets, self.wanted, self.firm, self.led = targets, wanted, firm, led
        self.asked = firm.shape[1]
        self.has = np.asarray(np.isfinite(wanted).all(axis=-1))
        ready = weights_of(puppet)
        above = [self._above(int(target)) for target in targets]
        self.turning = sorted({joint for path in above for joint in path if ready[joint] > 0})
        self.scale = np.sqrt(np.append(ready[self.turning], LED if led else PLACE))[:, None]
        self.leads = np.array([[joint in path for joint in self.turning] for path in above])
        self.moved = np.array([puppet.mover in path or puppet.mover == target for path, target in zip(above, targets)])
        self.local, self.shift = rig.rotations[1:].copy(), rig.translations[1:].copy()
        self.gone = np.zeros((len(wanted), 3))  # of the body's place

    def solve(self, steps: int) -> None:
        """Turn and shift all frames towards their goals."""
        for step in range(steps):
            self.place, self.world = forward_kinematics(self.local, self.shift, self.parents)
            error = np.where(self.has[..., None], self.wanted - self.place[:, self.targets], 0.0)
            last = step >= 2 * steps // 3
            if np.abs(error[:, : self.asked] * self.firm[..., None] if last else error).max(initial=0) < CLOSE:
                break
            self._move(self._step(error, FEET_LAST if last else FEET_FIRST))

    def _above(self, joint: int) -> list[int]:
        path = []
        while (joint := self.parents[joint]) >= 0:
            path.append(joint)
        return path

    def _step(self, error: Array, feet: float) -> Array:
        """World turns and a shift of the body, `(frames, turning + 1, 3)`, against `error (frames, targets, 3)`."""
        frames, size = len(error), 3 * len(self.targets)
        arms = self.place[:, self.targets, None] - self.place[:, None, self.turning]
        leads = (self.leads[None] & self.has[..., None])[..., None, None]
        # A turn w moves a target by w x arm: the matrix of that, in which only turns the joint can make count.
        arms = -_cross(arms) * (leads * self.scale[:-1, None])
        for at, span in self._spans():
            arms[:, :, at] = arms[:, :, at] @ span[:, None]
        moves = np.moveaxis(arms, 2, 3).reshape(frames, size, -1)  # (frames, targets' x y z, turns' x y z)
        place = np.where(self.moved[None] & self.has, self.scale[-1], 0.0)[..., None, None] * self._room()[:, None]
        moves = np.concatenate([moves, place.reshape(frames, size, 3)], axis=2)
        pull = moves @ np.swapaxes(moves, 1, 2)
        far = np.linalg.norm(error, axis=-1, keepdims=True)
        # The nearer the goals, the longer the steps: the last millimetres take turns of a pelvis, whose lever is short.
        near = np.minimum(1, ((far[:, : self.asked, 0] * self.firm).max(axis=1, initial=0) / LONGEST) ** 2)
        damping = np.tile(DAMPING / feet, (frames, size))
        damping[:, : 3 * self.asked] = DAMPING * np.maximum(near, LEAST)[:, None]
        damping[:, : 3 * self.asked] /= np.repeat(np.maximum(self.firm, 1e-3) ** 2, 3, axis=1)
        pull[:, np.arange(size), np.arange(size)] += damping
        error = (error * np.minimum(1, LONGEST / np.maximum(far, 1e-9))).reshape(frames, size, 1)
        steps = (np.swapaxes(moves, 1, 2) @ np.linalg.solve(pull, error)).reshape(frames, -1, 3) * self.scale
        steps[:, -1] = np.einsum("fab,fb->fa", self._room(), steps[:, -1])
        widest = np.linalg.norm(steps[:, :-1], axis=-1).max(axis=1, initial=0)
        return steps * np.minimum(1, WIDEST / np.maximum(widest, 1e-9))[:, None, None]

    def _room(self) -> Array:
        """How freely the body's place moves, `(frames, 3, 3)` diagonal: up and down the less, the nearer the limits."""
        height = np.clip(self.gone[:, 1], -SINK, RISE)
        share = np.where(height > 0, height / RISE, -height / SINK)
        room = np.ones_like(self.gone)
        room[:, 1] = 1.0 if self.led else np.sqrt(1 - share**2)
        return room[:, :, None] * np.eye(3)

    def _move(self, steps: Array) -> None:
        for at, joint in enumerate(self.turning):
            turn = from_rotvec(self._from_world(joint, steps[:, at]))
            self.local[:, joint] = allowed(multiply(turn, self.local[:, joint]), self.axes[joint])
        if not self.led:
            steps[:, -1, 1] = np.clip(self.gone[:, 1] + steps[:, -1, 1], -SINK, RISE) - self.gone[:, 1]
        self.gone += steps[:, -1]
        self.shift[:, self.mover] += self._from_world(self.mover, steps[:, -1])

    def _from_world(self, joint: int, vectors: Array) -> Array:
        """World vectors `(frames, 3)` in the frame of a joint's parent."""
        above = self.parents[joint]
        return vectors if above < 0 else apply(inverse(self.world[:, above]), vectors)

    def _spans(self) -> Iterator[tuple[int, Array]]:
        """For joints that turn about one or two axes the projections `(frames, 3, 3)` onto these in the world."""
        for at, joint in enumerate(self.turning):
            axes, above = self.axes[joint], self.parents[joint]
            if len(axes) >= 3:
                continue
            units = [np.eye(3)["XYZ".index(axis)] for axis in axes]
            outer = np.tile(units[0], (len(self.wanted), 1))
            outer = outer if above < 0 else apply(self.world[:, above], outer)
            span = outer[:, :, None] * outer[:, None]
            if len(axes) == 2:
                aside = normalised(np.cross(outer, apply(self.world[:, joint], units[1])))
                span = np.eye(3) - aside[:, :, None] * aside[:, None]
            yield at, span


def _cross(v: Array) -> Array:
    """The matrices `(..., 3, 3)` that take w to v x w."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)
