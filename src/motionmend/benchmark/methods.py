"""Methods by name, each as functions on whole batches of windows."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..corpora.corpus import Corpus
from ..errors import InputError, nearest_names
from ..motion import Motion, Skeleton

if TYPE_CHECKING:
    from ..networks.completers import NetworkCompleter
from .method import CONSTRAINED, Method, Windows

Array = np.ndarray


def find(name: str, train: Corpus | None = None) -> Method:
    """The method of this name: one of BUILTIN or NEAREST, an installed network, or the path of a checkpoint folder;
    with CONSTRAINED after it, what it samples as `animate` mends it.

    train : in whose split "train" those of NEAREST look.

    Raises
    ------
    InputError : if there is none; the hint names the nearest.
    """
    if name in BUILTIN:
        return BUILTIN[name]()
    if name.endswith(CONSTRAINED):
        from .constrained import constrained

        return constrained(find(name.removesuffix(CONSTRAINED), train))
    if name in NEAREST:
        from . import neighbours

        return getattr(neighbours, NEAREST[name])(train)
    from ..networks import checkpoints

    if not Path(name).exists() and os.sep not in name and name not in checkpoints.names():
        names = [*BUILTIN, *NEAREST, *checkpoints.names()]
        raise InputError(f"unknown method {name!r}", hint=nearest_names(name, names))
    from ..networks.loading import load_completer

    completer = load_completer(name)
    return of_completer(Path(name).name, completer)


def of_completer(name: str, completer: NetworkCompleter) -> Method:
    """A network as a method: it restores by its raw prediction, and fills with the observed samples put back.

    Windows of its own rate, length and joints go straight through it, others by way of its `predict`.
    """

    from ..networks.generative import GenerativeCompleter

    def restore(positions: Array, observed: Array, fps: float, skeleton: Skeleton) -> Array:
        fits = completer.description.any_length or completer.frames == positions.shape[1]
        if fits and completer.fps == fps and completer.skeleton.names == skeleton.names:
            return completer.windows(positions, observed)
        return _each(lambda motion: completer.predict(motion).positions, positions, observed, fps, skeleton)

    def fill(positions: Array, observed: Array, fps: float, skeleton: Skeleton) -> Array:
        return np.where(observed[..., None], positions, restore(positions, observed, fps, skeleton))

    def sample(pose: Array, trajectories: Array, given: Array, count: int, seed: int) -> Array:
        """A network's best guess, of a generative one the prior's mean decoded, where one is asked for.

        Of several a generative network draws each; another has its one answer, for every sample.
        """
        from ..networks.completers import begun

        if count > 1 and isinstance(completer, GenerativeCompleter):
            return completer.sample_windows(pose, trajectories, given, count, seed)
        once = completer.windows(*begun(pose, trajectories, given))[:, None, 1:]
        return np.broadcast_to(once, (len(once), count, *once.shape[2:])).copy()

    about = "network: raw prediction; as a fill, with the observed samples put back"
    samples = isinstance(completer, GenerativeCompleter) or completer.description.any_length
    return Method(name, fill, restore, sample if samples else None, about, completer.budget)


def fold(positions: Array, observed: Array, fps: float) -> Motion:
    """A batch of windows as one cloud of B * J points, for methods to which joints mean nothing to each other."""
    batch, frames, joints = observed.shape
    points = np.ascontiguousarray(positions.transpose(1, 0, 2, 3)).reshape(frames, batch * joints, 3)
    seen = np.ascontiguousarray(observed.transpose(1, 0, 2)).reshape(frames, batch * joints)
    return Motion(points, seen, fps, Skeleton.cloud(tuple(map(str, range(batch * joints)))))


def unfold(motion: Motion, batch: int) -> Array:
    """Positions `(B, T, J, 3)` of a motion made by `fold`, NaN where it is not observed."""
    positions = np.where(motion.observed[..., None], motion.positions, np.float32(np.nan))
    return np.ascontiguousarray(positions.reshape(len(motion), batch, -1, 3).transpose(1, 0, 2, 3))


def _curve(name: str) -> Method:
    from ..fills.points import FILLS

    def fill(positions: Array, observed: Array, fps: float, skeleton: Skeleton) -> Array:
        del skeleton
        return unfold(FILLS[name].complete(fold(positions, observed, fps)), len(positions))

    return Method(name, fill, about=_ABOUT[name])


def _donor(name: str) -> Method:
    from ..fills.points import FILLS

    return Method(name, _body_fill(FILLS[name]), about=_ABOUT[name])


def _auto() -> Method:
    from ..repairs.chooser import Chooser
    from ..repairs.network_fill import installed

    improve = {name: network.improve for name, network in installed().items()}
    about = _ABOUT["auto"] + (f"; {' and '.join(improve)} added where they won there" if improve else "")
    return Method("auto", _body_fill(Chooser(improve=improve)), about=about)


def _body_fill(completer: Any) -> Windows:
    """A fill that looks from joint to joint, so that every window is a motion of its own."""

    def fill(positions: Array, observed: Array, fps: float, skeleton: Skeleton) -> Array:
        def one(motion: Motion) -> Array:
            whole = completer.complete(motion)
            return np.where(whole.observed[..., None], whole.positions, np.float32(np.nan))

        return _each(one, positions, observed, fps, skeleton)

    return fill


def _each(
    one: Callable[[Motion], Array], positions: Array, observed: Array, fps: float, skeleton: Skeleton
) -> Array:
    out = np.empty_like(positions)
    for window in range(len(positions)):
        out[window] = one(Motion(positions[window], observed[window], fps, skeleton))
    return out


def _filter(name: str) -> Method:
    def restore(positions: Array, observed: Array, fps: float, skeleton: Skeleton) -> Array:
        from ..repairs.denoising import denoise

        del skeleton
        return unfold(denoise(fold(positions, observed, fps), name), len(positions))

    return Method(name, restore=restore, about=_ABOUT[name])


def _none() -> Method:
    def restore(positions: Array, observed: Array, fps: float, skeleton: Skeleton) -> Array:
        del fps, skeleton
        return np.where(observed[..., None], positions, np.float32(np.nan))

    return Method("none", restore=restore, about=_ABOUT["none"])


def _zero_velocity() -> Method:
    def fill(positions: Array, observed: Array, fps: float, skeleton: Skeleton) -> Array:
        del fps, skeleton
        return hold(positions, observed)

    def sample(pose: Array, trajectories: Array, given: Array, count: int, seed: int) -> Array:
        """The start pose, standing still, at every frame of every sample; what is given is not looked at."""
        del given, seed
        batch, frames, joints, _ = trajectories.shape
        return np.broadcast_to(pose[:, None, None], (batch, count, frames, joints, 3)).copy()

    return Method("zero-velocity", fill, sample=sample, about=_ABOUT["zero-velocity"])


def hold(positions: Array, observed: Array) -> Array:
    """Every joint stays where it was last observed; before its first sample, where that is; NaN if it has none."""
    frames = np.arange(observed.shape[1])[None, :, None]
    last = np.maximum.accumulate(np.where(observed, frames, -1), axis=1)
    source = np.where(last >= 0, last, np.argmax(observed, axis=1)[:, None])
    held = np.take_along_axis(positions, source[..., None], axis=1)
    return np.where(np.any(observed, axis=1)[:, None, :, None], held, np.float32(np.nan))


_ABOUT = {
    "none": "the damaged input itself",
    "linear": "straight line from seam to seam",
    "hermite": "cubic Hermite with the velocities at both seams",
    "eased": "Hermite that trusts a velocity for 0.75 s, and one from few samples less",
    "cubic": "not-a-knot cubic spline through six samples on each side",
    "pattern": "follows the joint whose distance is steadiest; eased where none is there",
    "bones": "follows the nearest joint above it that is there; eased where none is",
    "rigid": "in the frame of three or more joints that keep their distances; eased where they are not",
    "auto": "chooses for each gap, by trial beside it or by who won on validation takes",
    "savgol": "Savitzky-Golay filter, cubic over 0.15 s",
    "butterworth": "zero-lag Butterworth filter, fourth order, 6 Hz",
    "zero-velocity": "holds the last pose",
}
NEAREST = {"nearest": "nearest", "nearest-carried": "carried"}  # of neighbours, which need a training corpus
BUILTIN: dict[str, Callable[[], Method]] = {
    "none": _none,
    **{name: (lambda name=name: _curve(name)) for name in ("linear", "hermite", "eased", "cubic")},
    **{name: (lambda name=name: _donor(name)) for name in ("pattern", "rigid", "bones")},
    "auto": _auto,
    **{name: (lambda name=name: _filter(name)) for name in ("savgol", "butterworth")},
    "zero-velocity": _zero_velocity,
}


def find_all(names: Iterable[str], train: Corpus | None = None) -> list[Method]:
    """The methods of these names, in order; see `find`.

    Raises
    ------
    InputError : for an unknown or repeated name.
    """
    names = list(names)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"the method {twice!r} is named twice", hint="name each once")
    methods = [find(name, train) for name in names]
    rows = [method.name for method in methods]
    if len(set(rows)) < len(rows):
        twice = next(name for name in rows if rows.count(name) > 1)
        raise InputError(f"two networks are called {twice!r}", hint="rename one of the folders")
    return methods
