"""How a network sees its windows: the world as its inputs, and its output as the world again.

B = windows, T = frames, J = joints. A space is stateless: what decoding needs of a window, encoding hands over.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from ..body.joints import BODY, JOINT, LEFT_RIGHT
from ..body.standing import STANDING, UPRIGHT
from ..fills.curves import along_bones
from . import rows
from .gap_space import BesideCurves, about_y

Array = np.ndarray

ACROSS = tuple(JOINT[f"left_{part}"] for part in ("thigh", "shoulder", "upper_arm"))
LEEWAY = 8  # frames
TICK = 6  # frames, 0.1 s
SMOOTHING = 1e3


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

    # Where answers are differences from curves, `nothing(inputs)` is the output that answers with the curves; where a
    # network says how far off it expects to be, `expected(output)` is that, `(B, T, J)` metres.


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


class JointTokens(FloorMean):
    """FloorMean's coordinates, of the observed samples alone (Björkstrand et al. 2023, section 3).

    A token is one joint in one frame. Inputs, N = the most tokens that a window of the batch has, or 1: `tokens
    (B, N, 3)`, `index (B, N)` int64, which is frame · J + joint, and `there (B, N)`, False where a window has fewer.
    Output: `(B, T, J, 3)`.
    """

    name = "joint_tokens"

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], Any]:
        inputs, origin = super().encode(positions, observed)
        return packed(inputs["positions"], observed), origin


class PosesOnCurves:
    """FloorMean's coordinates, turned so that the body faces +Z in the mean, as differences from `curves.along_bones`.

    Where a network begins at a curve through what is seen, an answer of nothing is as good as the curve. The body's
    left is from its right thighs, shoulders and upper arms to its left ones, wherever both are observed.
    A token is a whole pose: of each joint where its curve is, where that is from the curve of the hips, both as
    differences from STANDING, how far it moves in TICK frames, and whether it is seen. All are scaled to vary by about
    1: a network is slow to notice what its inputs hardly show.
    Inputs: `tokens (B, N, 10 J)`, `index (B, N)` and `there (B, N)` as JointTokens', of each frame's first joint; and
    `curve (B, T, J, 14)`: at every sample the first nine of the same, what the straight line is from there, and the
    shares of a window since the last and until the next sample that is seen. Output: the difference from the curve,
    `(B, T, J, 3)`.
    """

    name = "poses_on_curves"
    most = 1_000_000  # tokens of a window

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], Any]:
        inputs, origin = FloorMean().encode(positions, observed)
        angles = -leftward(positions, observed)
        whole = turned(inputs["positions"], angles)
        curve, line = along_bones(whole, observed, BODY.parents)
        curve = self.begin(curve)
        going = TICK * np.gradient(curve, axis=1) if curve.shape[1] > 1 else np.zeros_like(curve)
        told = [3 * (curve - STANDING - UPRIGHT), 8 * (curve - curve[:, :, :1] - STANDING), 10 * going]
        before, after = away(observed)
        shares = np.stack([before, after], axis=-1, dtype=np.float32) / observed.shape[1]
        course = np.concatenate([*told, 10 * (line - curve), shares], axis=-1, dtype=np.float32)
        leeway = self.leeway(np.minimum(before, after))
        return {**self.tokens(course[..., :9], observed), "curve": course}, (origin, angles, curve, leeway)

    def decode(self, output: Array, known: Any) -> Array:
        origin, angles, curve, leeway = known
        return (turned(output * leeway + curve, -angles) + origin).astype(np.float32)

    def nothing(self, inputs: dict[str, Array]) -> Array:
        return np.zeros((*inputs["curve"].shape[:3], 3), np.float32)

    def begin(self, curve: Array) -> Array:
        """The curve `(B, T, J, 3)` that answers are differences from, made of that through what is seen."""
        return curve

    def tokens(self, told: Array, observed: Array) -> dict[str, Array]:
        """Poses of the frames that matter most."""
        rows, frames, joints = observed.shape
        poses = np.concatenate([told.reshape(rows, frames, -1), observed], axis=-1, dtype=np.float32)
        worth = self.worth(observed)
        index = np.sort(np.argsort(-worth, axis=1, kind="stable")[:, : self.most], axis=1)
        there = np.take_along_axis(worth > 0, index, axis=1)
        return {
            "tokens": np.take_along_axis(poses, index[..., None], axis=1), "index": index * joints, "there": there,
        }  # fmt: skip

    def worth(self, observed: Array) -> Array:
        """`(B, T)`, the more the more a frame's pose is needed as a token, 0 where it cannot be one."""
        return observed.any(axis=2).astype(int)

    def leeway(self, nearest: Array) -> Array:
        """`(B, T, J, 1)` float32, by which the answer is multiplied so many frames from the `nearest` sample."""
        return np.ones((*nearest.shape, 1), np.float32)


class PosesOffCurves(PosesOnCurves):
    """PosesOnCurves for what is seen being true: the answer counts for nothing there, and for little close by.

    (d / LEEWAY)², at most 1, for a sample that is d frames from the nearest one of its joint that is observed: as the
    error of a curve grows. So a fill leaves its seams as smoothly as the curve does.
    As poses also say how they move, those of every TICK-th frame and those beside a gap say it all.
    """

    name = "poses_off_curves"
    most = 24

    def worth(self, observed: Array) -> Array:
        frames = observed.shape[1]
        changes = np.diff(observed, axis=1).any(axis=2)
        seams = np.pad(changes, ((0, 0), (1, 0))) | np.pad(changes, ((0, 0), (0, 1)))
        ticks = np.arange(frames) % TICK == 0
        return np.where(observed.any(axis=2), 2 * ticks + seams, 0)

    def leeway(self, nearest: Array) -> Array:
        return np.minimum(nearest / LEEWAY, 1)[..., None].astype(np.float32) ** 2


class PosesOffCurvesAsked(PosesOffCurves):
    """PosesOffCurves for a network that answers what it is asked: that is what is not observed, nothing else counts.

    One more input: `asked (B, Q)` int64, the tokens, frame · J + joint, that are not observed, Q the most that a window
    of the batch has, or 1; -1 where a window has fewer.
    """

    name = "poses_off_curves_asked"

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], Any]:
        inputs, known = super().encode(positions, observed)
        seen = observed.reshape(len(observed), -1)
        count = np.maximum((~seen).sum(axis=1), 1)  # attention among none is not a number
        most = int(count.max(initial=1))
        hidden = np.argsort(seen, axis=1, kind="stable")[:, :most]
        return {**inputs, "asked": np.where(np.arange(most) < count[:, None], hidden, -1)}, known


class PosesSmoothCurves(PosesOnCurves):
    """PosesOnCurves for noisy samples: the curve is smoothed before answers are differences from it.

    By Whittaker 1923: least squares, and SMOOTHING times the sum of squared third differences. On CMU's training takes
    that leaves 6.6 of 16 mm of noise and 26.7 of 80, and moves clean samples by 2.9.
    """

    name = "poses_smooth_curves"

    def begin(self, curve: Array) -> Array:
        return np.einsum("st,btjc->bsjc", smoother(curve.shape[1]), curve, dtype=np.float32)


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


class BodyRows:
    """Poses seen from where the body stands and faces, and how it travels: `rows` (Kaufmann et al. 2020).

    Inputs: `rows (B, T, ROWS)`, where they are not known those of a curve: the joints carried as `curves.along_bones`
    does, as differences from STANDING, and the root's path as `rows.path_of` has it; `known (B, T, ROWS / 3)`, whether
    a joint is observed, and for the travel whether anything was in this frame and the one before; and `leeway`, of
    `known`'s shape, from 0 where a row is known to 1 some frames away from there. Output: rows. Where anything of a
    frame is observed the body stands and faces as it did there, elsewhere it goes as its travel leads
    (`rows.travelled`).
    """

    name = "body_rows"

    def encode(self, positions: Array, observed: Array) -> tuple[dict[str, Array], tuple[Array, Array, Array]]:
        root, heading = rows.path_of(positions, observed)
        standing = STANDING + UPRIGHT
        poses = np.where(observed[..., None], rows.seen_from(positions, root, heading) - standing, 0)
        poses = self.between(poses.astype(np.float32), observed) + standing
        there = np.asarray(observed.any(axis=2))
        onward = there & np.roll(there, 1, axis=1)
        onward[:, :1] = onward[:, 1:2] if there.shape[1] > 1 else there
        known = np.concatenate([there[..., None], observed, onward[..., None]], axis=2)
        leeway = (np.minimum(np.minimum(*away(known)) / LEEWAY, 1) ** 2).astype(np.float32)
        return {"rows": _as_rows(poses, rows.travel_of(root, heading)), "known": known, "leeway": leeway}, (
            root, heading, there
        )  # fmt: skip

    def between(self, poses: Array, observed: Array) -> Array:
        """Poses `(B, T, J, 3)`, 0 where not observed, with what stands there instead."""
        return along_bones(poses, observed, BODY.parents)[0]

    def decode(self, output: Array, known: tuple[Array, Array, Array]) -> Array:
        poses = output[..., 3:-3].reshape(*output.shape[:2], -1, 3)
        root, heading = rows.travelled(output[..., -3:], *known)
        return rows.in_world(poses, root, heading).astype(np.float32)


class SeenRows(BodyRows):
    """BodyRows for a network that does not look at what is not known: no curves run there, joints stand as STANDING."""

    name = "seen_rows"

    def between(self, poses: Array, observed: Array) -> Array:
        del observed
        return poses


_ALL: tuple[type[Space], ...] = (FloorMean, JointTokens, PosesOnCurves, PosesOffCurves, PosesOffCurvesAsked,
                               PosesSmoothCurves, FirstPelvis, BodyRows, SeenRows, BesideCurves)  # fmt: skip
SPACES: dict[str, type[Space]] = {space.name: space for space in _ALL}


@lru_cache(maxsize=8)
def smoother(frames: int) -> Array:
    """The matrix `(T, T)` float32 of the smoothing of PosesSmoothCurves."""
    order = min(3, frames - 1)
    bends = np.diff(np.eye(frames), n=order, axis=0)
    return np.linalg.inv(np.eye(frames) + SMOOTHING * bends.T @ bends * (order == 3)).astype(np.float32)


def turned(positions: Array, angles: Array) -> Array:
    """`positions (B, ..., 3)`, each window turned about the vertical through the origin by its `angles (B,)` radians.

    Right-handed about +Y: a quarter turn takes +Z to +X.
    """
    return about_y(positions, np.cos(angles).astype(positions.dtype), np.sin(angles).astype(positions.dtype))


def leftward(positions: Array, observed: Array) -> Array:
    """`(B,)` radians about the vertical, from +X to the body's left in the mean over a window; 0 where it is unseen.

    In the sense of `turned`: turning by minus this angle makes the body face +Z.
    """
    left, right = np.array([pair for pair in LEFT_RIGHT if pair[0] in ACROSS]).T
    both = observed[:, :, left] & observed[:, :, right]
    across = np.where(both[..., None], positions[:, :, left] - positions[:, :, right], 0).sum(axis=(1, 2), dtype=float)
    return -np.arctan2(across[:, 2], across[:, 0])


def away(observed: Array) -> tuple[Array, Array]:
    """Frames since a joint's last observed sample and until its next, `(B, T, J)` each; T where there is none."""
    frames = observed.shape[1]
    clock = np.arange(frames)[None, :, None]
    before = clock - np.maximum.accumulate(np.where(observed, clock, -frames), axis=1)
    after = np.minimum.accumulate(np.where(observed, clock, 2 * frames)[:, ::-1], axis=1)[:, ::-1] - clock
    return np.minimum(before, frames), np.minimum(after, frames)


def packed(positions: Array, observed: Array) -> dict[str, Array]:
    """The observed ones of `positions (B, T, J, 3)` in the order of frames and joints: JointTokens' inputs."""
    rows = len(positions)
    seen = observed.reshape(rows, -1)
    count = seen.sum(axis=1)
    most = max(1, int(count.max(initial=0)))
    index = np.argsort(~seen, axis=1, kind="stable")[:, :most]
    tokens = np.take_along_axis(positions.reshape(rows, -1, 3), index[..., None], axis=1)
    return {"tokens": tokens, "index": index, "there": np.arange(most) < count[:, None]}


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


def _as_rows(poses: Array, travel: Array) -> Array:
    """Rows `(B, T, ROWS)` float32 of poses `(B, T, J, 3)` and travel `(B, T, 3)`."""
    root = np.zeros_like(travel)
    return np.concatenate([root, poses.reshape(*travel.shape[:2], -1), travel], axis=2, dtype=np.float32)


def _mean(positions: Array, observed: Array, axes: tuple[int, ...]) -> Array:
    """The mean over observed samples, all `axes` kept, float32; 0 where nothing is observed."""
    seen = observed[..., None]
    count = np.maximum(seen.sum(axis=axes, keepdims=True), 1)
    total = np.where(seen, positions, 0).sum(axis=axes, keepdims=True, dtype=float)
    return (total / count).astype(np.float32)
