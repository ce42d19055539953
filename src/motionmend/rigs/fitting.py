"""World positions → a rig's own channels, in closed form.

Down the hierarchy every joint makes the smallest turn from its first guess that brings what hangs on it
towards its targets, from where the joint really is by then: errors do not add up along a chain. One target
is aimed at; two or more pose Wahba's problem (Wahba 1965), solved by Davenport's quaternion; a chain whose
middle has no target bends at the middle until its end is as far away as the target (the law of cosines).
Everything is vectorised over frames; only joints are looped over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..motion import Rig, Take
from ..rotations import IDENTITY, apply, forward_kinematics, from_rotvec, inverse, multiply
from ..units import rotation_to_y_up
from .aiming import TINY, aimed, allowed, bending, free_axes

Array = np.ndarray

SOFT = 1e-1  # weight of a target beyond a joint that may still turn, against 1 for a rigid one
CONSTANT_FRAMES = 10  # a channel that is constant in so many known frames is taken to be constant by intent
SLIDES = 1e-3  # metres: position channels that vary less are bones, written out


def fit(take: Take, positions: Array, where: Array) -> Take:
    """The take posed so that its joints meet world positions as well as bones of fixed length can.

    Parameters
    ----------
    take : with a rig, whose channels hold a first guess wherever they may change (interpolated rotations).
        What no target decides stays as guessed: twist about a bone, fingers, the face.
    positions : `(frames, joints, 3)` target positions, metres, Y up; NaN where a joint has no target.
    where : `(frames, joints)` bool, the joints whose own channels may change. All others come back bit for bit.

    Returns
    -------
    The take with new channels, trusted where they were allowed to change. A root with position channels, and
    a joint whose position channels are in use, stands exactly on its target. Joints that turn about one or two
    axes only, cannot turn, or are constant in the frames known, stay what they are.
    """
    rig = _rig_of(take, positions, where)
    frames = np.flatnonzero(where.any(axis=1))
    build = _Build.of(rig, _free_axes(take), where)
    local, shift = _solved(build, rig, frames, positions[frames], where[frames])
    return take.with_rig(_with_frames(rig, frames, local, shift, where))


def reach(
    take: Take, joint: int, targets: Array, where: Array, limb: tuple[int, int] | None = None
) -> tuple[Take, Array]:
    """Bring the end of a limb (wrist, ankle) onto targets: two-bone inverse kinematics in closed form.

    The two joints above turn; the limb bends in the plane, and to the side, of its present pose. The end
    itself keeps its attitude in the world, so that a flat foot stays flat.

    Parameters
    ----------
    take : with a rig. joint : the index of the limb's end.
    targets : `(frames, 3)` metres, Y up. where : `(frames,)` bool, the frames that may change.
    limb : the indices of the joints that turn, upper (thigh) and middle (shin); by default the two next above.

    Returns
    -------
    The take, and `(frames,)` metres by which the end misses its target: 0 within reach and where nothing
    was asked.
    """
    if take.rig is None:
        raise TypeError("only a take that stores channels can reach; points are simply moved")
    rig, parents = take.rig, take.skeleton.parents
    turning = _upper_joints(rig, joint) if limb is None else list(limb)
    if len(turning) < 2:
        raise ValueError(f"{take.skeleton.names[joint]} ends no limb: fewer than two joints above it turn")
    may = np.zeros_like(rig.trusted)
    may[:, turning] = where[:, None]
    frames = np.flatnonzero(where)
    wanted = np.full((len(frames), len(parents), 3), np.nan)
    wanted[:, joint] = targets[frames]
    axes = _free_axes(take)
    local, shift = _solved(_Build.of(rig, axes, may), rig, frames, wanted, may[frames])
    places, attitudes = forward_kinematics(local, shift, parents)
    if axes[joint]:
        level = multiply(inverse(attitudes[:, parents[joint]]), rig.kinematics[1][frames, joint])
        local[:, joint] = allowed(level, axes[joint])
    miss = np.zeros(len(take))
    miss[frames] = np.linalg.norm(places[:, joint] - wanted[:, joint], axis=-1)
    return take.with_rig(_with_frames(rig, frames, local, shift, may)), miss


def scatter(positions: Array, joints: Sequence[int] | Array, count: int) -> Array:
    """Targets for `fit` from the positions of a mapping.

    positions : `(frames, mapped, 3)`, such as BODY's. joints : `(mapped,)` index of each in the rig, -1 for
    none (`body.map_rig(...).joints`). count : joints of the rig. Gives `(frames, count, 3)`, NaN where the
    rig's joint is not in the mapping.
    """
    joints = np.asarray(joints)
    targets = np.full((len(positions), count, 3), np.nan)
    targets[:, joints[joints >= 0]] = positions[:, joints >= 0]
    return targets


def _solved(build: _Build, rig: Rig, frames: Array, targets: Array, free: Array) -> tuple[Array, Array]:
    """Local turns and shifts of some frames that meet `targets`; `free`, the joints that may change."""
    targets = np.asarray(targets, np.float64)
    has = np.asarray(np.isfinite(targets).all(axis=-1))
    solver = _Solver(build, targets, has, free, rig.rotations[frames], rig.translations[frames])
    solver.solve()
    return solver.local, solver.shift


def _with_frames(rig: Rig, frames: Array, local: Array, shift: Array, changed: Array) -> Rig:
    rotations, translations = rig.rotations.copy(), rig.translations.copy()
    rotations[frames], translations[frames] = local, shift
    return replace(rig, rotations=rotations, translations=translations, trusted=rig.trusted | changed)


@dataclass(frozen=True, eq=False)
class _Build:
    """What a rig can do, beyond what its channel list says.

    turns : joints that may turn: with rotation channels, not constant in the frames known.
    slides : position channels that place the joint, rather than repeat its offset.
    loose : sliding joints whose direction from the parent varies too: nothing to aim at.
    """

    parents: tuple[int, ...]
    children: tuple[tuple[int, ...], ...]
    axes: tuple[str, ...]
    lengths: Array
    turns: Array
    slides: Array
    loose: Array

    @classmethod
    def of(cls, rig: Rig, axes: tuple[str, ...], where: Array) -> _Build:
        known = rig.trusted & ~where
        joints = range(len(axes))
        spread = np.array([np.ptp(_held(rig.translations, known, joint), axis=0).max() for joint in joints])
        lengths = np.linalg.norm(rig.translations, axis=-1).mean(axis=0)
        root = np.array(rig.skeleton.parents) < 0
        slides = np.asarray(rig.moves) & (root | (spread > SLIDES))

        def constant(joint: int) -> bool:
            held = rig.rotations[known[:, joint], joint]
            return len(held) >= CONSTANT_FRAMES and bool(np.all(np.abs(held - held[0]) < 1e-7))

        turns = np.array([bool(axes[joint]) and not constant(joint) for joint in joints], bool)
        loose = slides & (spread > 0.2 * lengths)
        return cls(rig.skeleton.parents, rig.skeleton.children, axes, lengths, turns, slides, loose)


def _held(values: Array, known: Array, joint: int) -> Array:
    """A joint's values in the frames known, or in all where those are too few to tell."""
    rows = known[:, joint]
    return values[rows, joint] if rows.sum() >= CONSTANT_FRAMES else values[:, joint]


@dataclass(frozen=True, eq=False)
class _Arm:
    """A target that hangs on a joint, as seen from it.

    path : the joints from the child down to the target's. at : `(frames, 3)` its place in the joint's frame.
    seen : `(frames,)` whether this joint is to aim at it. rigid : whether nothing between them may turn.
    """

    path: tuple[int, ...]
    at: Array
    seen: Array
    rigid: Array


class _Solver:
    """One walk down the hierarchy; every array has the frames that may change on its first axis."""

    def __init__(self, build: _Build, targets: Array, has: Array, free: Array, local: Array, shift: Array):
        self.build, self.targets, self.has, self.free, self.local, self.shift = build, targets, has, free, local, shift
        self.pending = np.asarray(has.any(axis=0))  # a target here or below
        for joint in reversed(range(len(build.parents))):
            if build.parents[joint] >= 0:
                self.pending[build.parents[joint]] |= self.pending[joint]

    def solve(self) -> None:
        place, world = np.empty_like(self.shift), np.empty_like(self.local)
        for joint, parent in enumerate(self.build.parents):
            if parent < 0:
                above, origin = np.broadcast_to(IDENTITY, world[:, joint].shape), np.zeros_like(place[:, joint])
            else:
                above, origin = world[:, parent], place[:, parent]
            if self.build.slides[joint]:
                go = self.free[:, joint] & self.has[:, joint]
                self.shift[go, joint] = apply(inverse(above[go]), self.targets[go, joint] - origin[go])
            place[:, joint] = origin + apply(above, self.shift[:, joint])
            world[:, joint] = multiply(above, self.local[:, joint])
            if self.build.turns[joint] and self.free[:, joint].any():
                self._turn(joint, place[:, joint], world[:, joint])
                world[:, joint] = multiply(above, self.local[:, joint])

    def _turn(self, joint: int, place: Array, world: Array) -> None:
        arms = self._arms(joint)
        if not arms:
            return
        goals = [apply(inverse(world), self.targets[:, arm.path[-1]] - place) for arm in arms]
        seen = np.stack([arm.seen for arm in arms], axis=1) & self.free[:, joint, None]
        alone = seen.sum(axis=1) == 1
        at = np.stack([arm.at for arm in arms], axis=1)
        for index, arm in enumerate(arms):
            elbow = self._elbow(arm)
            hinge = elbow is not None and len(self.build.axes[elbow]) == 1
            bent = (alone | hinge) & seen[:, index] & ~arm.rigid
            if elbow is not None and np.any(bent & self.free[:, elbow]):
                rows = np.flatnonzero(bent & self.free[:, elbow])
                at[rows, index] = self._bend(arm.path, elbow, rows, np.linalg.norm(goals[index][rows], axis=-1))
        rows = np.flatnonzero(seen.any(axis=1))
        rigid = np.stack([arm.rigid for arm in arms], axis=1)[rows]
        weights = np.where(rigid, 1.0, SOFT) * seen[rows]
        wanted = np.where(seen[rows, :, None], np.stack(goals, axis=1)[rows], 0.0)
        self.local[rows, joint] = aimed(self.local[rows, joint], self.build.axes[joint], at[rows], wanted, weights)

    def _arms(self, joint: int) -> list[_Arm]:
        """The nearest targets below a joint, looking through joints that have none, or no length, or no turn.

        And through those that cannot turn freely: a hinge needs this joint's twist to meet what lies beyond.
        """
        found: list[_Arm] = []
        frames = len(self.local)

        def walk(path: tuple[int, ...], origin: Array, turn: Array, looking: Array, rigid: Array) -> None:
            here = path[-1]
            at = origin + apply(turn, self.shift[:, here])
            can_turn = self.free[:, here] & self.build.turns[here]
            seen = looking & self.has[:, here] & (np.linalg.norm(at, axis=-1) > TINY) & ~self.build.loose[here]
            if np.any(seen):
                found.append(_Arm(path, at, seen, rigid))
            looking = looking & ~(seen & can_turn & (len(self.build.axes[here]) >= 3))
            for child in self.build.children[here]:
                if self.pending[child] and np.any(looking):
                    below = multiply(turn, self.local[:, here])
                    walk((*path, child), at, below, looking, rigid & ~can_turn)

        everywhere = np.ones(frames, bool)
        for child in self.build.children[joint]:
            if self.pending[child]:
                still = np.broadcast_to(IDENTITY, (frames, 4))
                walk((child,), np.zeros((frames, 3)), still, everywhere, everywhere)
        return found

    def _elbow(self, arm: _Arm) -> int | None:
        """The joint where a chain bends best: the longer its shorter half."""
        lengths = self.build.lengths[list(arm.path)]
        halves = {
            here: min(lengths[: index + 1].sum(), lengths[index + 1 :].sum())
            for index, here in enumerate(arm.path[:-1])
            if self.build.turns[here] and self.free[:, here].any()
        }
        best = max(halves, key=lambda here: halves[here], default=None)
        return best if best is not None and halves[best] > TINY else None

    def _bend(self, path: tuple[int, ...], elbow: int, rows: Array, distance: Array) -> Array:
        """Turn the elbow until the chain's end is `distance (rows,)` from its start; the end's place there."""
        at, turn = np.zeros((len(rows), 3)), np.broadcast_to(IDENTITY, (len(rows), 4))
        middle, attitude = at, turn
        for here in path:
            at = at + apply(turn, self.shift[rows, here])
            turn = multiply(turn, self.local[rows, here])
            if here == elbow:
                middle, attitude = at, turn
        # In the elbow's own frame: where the chain starts and where it ends.
        start, end = apply(inverse(attitude), -middle), apply(inverse(attitude), at - middle)
        axes = self.build.axes[elbow]
        delta = from_rotvec(bending(start, end, distance, axes))
        bent = allowed(multiply(self.local[rows, elbow], delta), axes)
        delta = multiply(inverse(self.local[rows, elbow]), bent)
        self.local[rows, elbow] = bent
        return middle + apply(attitude, apply(delta, end))


def _free_axes(take: Take) -> tuple[str, ...]:
    """The axes each joint can turn about, in our frame: a file's Z is our Y if its Z is up. Signs do not matter."""
    up = np.abs(rotation_to_y_up(take.units.up)).argmax(axis=0)
    letters = str.maketrans("XYZ", "".join("XYZ"[axis] for axis in up))
    return tuple(free_axes(order.upper()).translate(letters) for order in (take.rig.orders if take.rig else ()))


def _upper_joints(rig: Rig, joint: int) -> list[int]:
    """The two joints above, nearest first, that can turn and stand apart from one another."""
    limb: list[int] = []
    here, apart = joint, False
    while (above := rig.skeleton.parents[here]) >= 0 and len(limb) < 2:
        apart = apart or bool(np.linalg.norm(rig.translations[:, here], axis=-1).max(initial=0) > TINY)
        if apart and rig.orders[above]:
            limb.append(above)
            apart = False
        here = above
    return limb


def _rig_of(take: Take, positions: Array, where: Array) -> Rig:
    if take.rig is None:
        raise TypeError("this take stores points, not channels: use take.with_motion")
    shape = take.rig.trusted.shape
    if positions.shape != (*shape, 3) or where.shape != shape:
        raise ValueError(f"positions {positions.shape} and where {where.shape} do not fit a rig of {shape}")
    return take.rig
