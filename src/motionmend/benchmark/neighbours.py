"""Nearest neighbours from a training corpus: the classical row beside networks that animate a pose.

Windows are compared, and put back, by a turn about the vertical and a shift on the floor: hips over the origin and
facing +z in the start pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..body.joints import BODY
from ..body.measures import facing
from ..corpora.corpus import Corpus
from ..errors import InputError
from ..motion import Motion
from .method import Method
from .trials import no_window, whole_windows

Array = np.ndarray

STRIDE = 10  # frames from one training window of a clip to its next
STEP = 4  # every so many frames of the trajectories are compared: 12.5 a second at 50 fps, the last among them
# Of the start pose's mean squared distance, against that of the given samples: of 0.03, 0.1, 0.3, 1, 3 and 10 the one
# with the least ADE, K = 50 and K = 1, over k = 1 to 4 on CMU's validation subjects.
POSE_WEIGHT = 3.0
FADE_SECONDS = 2.0  # of 0.2, 0.5, 1, 2 and never, chosen likewise
BLOCK = 1024  # windows read at once


def nearest(train: Corpus | None) -> Method:
    """The method of this name, from the split "train" of a corpus, which is read when first asked for a sample."""
    about = f"nearest training windows by start pose and given trajectories, turned and shifted; every {STRIDE} frames"
    return _method("nearest", train, 0.0, about)


def carried(train: Corpus | None) -> Method:
    """The method `nearest-carried`: `nearest`, begun at the start pose; from there what it is off by dies away."""
    about = f"nearest, with its start pose's difference from the given one added and fading over {FADE_SECONDS:g} s"
    return _method("nearest-carried", train, FADE_SECONDS, about)


def _method(name: str, train: Corpus | None, fade: float, about: str) -> Method:
    kept: list[Neighbours] = []

    def sample(pose: Array, trajectories: Array, given: Array, count: int, seed: int) -> Array:
        if train is None:
            raise InputError("nearest neighbours have no corpus to be taken from", hint="say --train-corpus")
        frames = trajectories.shape[1] + 1
        if not kept or kept[0].frames != frames:
            kept[:] = [Neighbours.of(train, frames)]
        del seed
        return kept[0].sample(pose, trajectories, given, count, fade)

    return Method(name, sample=sample, about=about)


@dataclass(frozen=True, eq=False)
class Stand:
    """Where bodies stand and face: `place (B, 2)` metres and `forward (B, 2)` unit vectors, both x and z."""

    place: Array
    forward: Array

    @classmethod
    def of(cls, pose: Array) -> Stand:
        """By the hips, and by `measures.facing`, of BODY poses `(B, J, 3)`; facing +z where that is not known."""
        pose = np.asarray(pose, np.float32)
        known = np.asarray(np.isfinite(pose).all(axis=-1))
        forward = facing(Motion(pose, known, 1.0, BODY))[:, [0, 2]]
        return cls(pose[:, 0, [0, 2]], np.where(np.isfinite(forward), forward, np.array([0, 1], np.float32)))

    def __getitem__(self, rows: Array) -> Stand:
        return Stand(self.place[rows], self.forward[rows])

    def inward(self, positions: Array) -> Array:
        """Positions `(B, ..., 3)` in the world as seen from here: hips over the origin, facing +z."""
        (place_x, place_z), (forward_x, forward_z) = self._along(positions)
        x, z = positions[..., 0] - place_x, positions[..., 2] - place_z
        return np.stack([x * forward_z - z * forward_x, positions[..., 1], x * forward_x + z * forward_z], axis=-1)

    def outward(self, positions: Array) -> Array:
        """The inverse of `inward`."""
        (place_x, place_z), (forward_x, forward_z) = self._along(positions)
        x, z = positions[..., 0], positions[..., 2]
        out_x, out_z = x * forward_z + z * forward_x + place_x, z * forward_z - x * forward_x + place_z
        return np.stack([out_x, positions[..., 1], out_z], axis=-1)

    def _along(self, positions: Array) -> tuple[Array, Array]:
        shape = (2, -1, *[1] * (positions.ndim - 2))
        return self.place.T.reshape(shape), self.forward.T.reshape(shape)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Training windows of 1 + T frames, to be looked up.

    starts `(N,)` : their first frames in the corpus. stand : where each stands at its start.
    poses `(N, J * 3)` : start poses, and paths `(N, T // STEP, J * 3)` : what follows, thinned out; both float32, as
        seen from where the window stands. For 20,000 windows of 100 frames they take 131 MB.
    """

    corpus: Corpus
    frames: int
    starts: Array
    stand: Stand
    poses: Array
    paths: Array

    @classmethod
    def of(cls, corpus: Corpus, frames: int, *, split: str = "train", stride: int = STRIDE) -> Neighbours:
        """All whole windows of one split.

        Raises
        ------
        InputError : if the corpus has other joints than BODY's, or no whole window.
        """
        every = whole_windows(corpus, split, frames, stride)
        starts, places, forwards, poses, paths = [], [], [], [], []
        for first in range(0, len(every), BLOCK):
            some = every[first : first + BLOCK]
            positions, observed = corpus.windows(some, frames)
            whole = observed.all(axis=(1, 2))
            positions, stand = positions[whole], Stand.of(positions[whole, 0])
            seen = stand.inward(positions).reshape(len(positions), frames, -1)
            starts.append(some[whole])
            places.append(stand.place)
            forwards.append(stand.forward)
            poses.append(seen[:, 0].copy())
            paths.append(seen[:, STEP::STEP].copy())
        if not sum(map(len, starts)):
            raise no_window(corpus, split, frames)
        starts, places, forwards, poses, paths = map(np.concatenate, (starts, places, forwards, poses, paths))
        return cls(corpus, frames, starts, Stand(places, forwards), poses, paths)

    def __len__(self) -> int:
        return len(self.starts)

    def costs(self, pose: Array, trajectories: Array, given: Array) -> Array:
        """`(B, N)` square metres: POSE_WEIGHT times the mean squared distance of the start pose's joints, and that of
        the given samples. By |a|² + |b|² - 2ab, so that they are matrix products."""
        stand = Stand.of(pose)
        start = stand.inward(pose).reshape(len(pose), -1)
        costs = POSE_WEIGHT / pose.shape[1] * _squares(start, self.poses)
        mask = np.repeat(given[:, STEP - 1 :: STEP], 3, axis=-1).reshape(len(pose), -1)
        used = np.flatnonzero(mask.any(axis=0))
        if len(used):
            asked = stand.inward(trajectories[:, STEP - 1 :: STEP]).reshape(mask.shape)[:, used]
            weights = mask[:, used].astype(np.float32)
            asked = np.where(mask[:, used], asked, np.float32(0))
            paths = self.paths.reshape(len(self), -1)[:, used]
            apart = weights @ (paths**2).T - 2 * asked @ paths.T + (asked**2).sum(axis=1, keepdims=True)
            costs += apart / np.maximum(weights.sum(axis=1, keepdims=True) / 3, 1)
        return costs

    def find(self, pose: Array, trajectories: Array, given: Array, count: int) -> Array:
        """`(B, count)` windows of least cost, the nearest first; all of them over again if there are fewer."""
        costs = self.costs(pose, trajectories, given)
        some = min(count, len(self))
        rows = np.sort(np.argpartition(costs, some - 1, axis=1)[:, :some], axis=1)
        order = np.argsort(np.take_along_axis(costs, rows, axis=1), axis=1, kind="stable")
        return np.take_along_axis(rows, order, axis=1)[:, np.arange(count) % some]

    def sample(self, pose: Array, trajectories: Array, given: Array, count: int, fade: float = 0.0) -> Array:
        """As `Method.sample`: `(B, count, T, J, 3)`, the neighbours as they went on, given joints not overwritten.

        fade : seconds in which the difference between the start poses, added to them, falls to 1/e; 0 adds nothing.
        """
        if trajectories.shape[1] != self.frames - 1:
            raise ValueError(f"trajectories of {trajectories.shape[1]} frames, not {self.frames - 1}")
        rows = self.find(pose, trajectories, given, count).ravel()
        positions, _ = self.corpus.windows(self.starts[rows], self.frames)
        here = Stand.of(pose)[np.repeat(np.arange(len(pose)), count)]
        out = here.outward(self.stand[rows].inward(positions))
        if fade:
            weights = np.exp(-np.arange(self.frames) / (fade * self.corpus.fps)).astype(np.float32)
            out += weights[:, None, None] * (np.repeat(pose, count, axis=0) - out[:, 0])[:, None]
        return out[:, 1:].reshape(len(pose), count, *out[:, 1:].shape[1:])


def _squares(some: Array, others: Array) -> Array:
    """`(B, N)` squared distances between the rows of `some (B, D)` and `others (N, D)`."""
    square = (some**2).sum(axis=1)[:, None] + (others**2).sum(axis=1)[None]
    return square - 2 * some @ others.T
