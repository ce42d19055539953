"""NPZ archives of NumPy arrays, read and written.

`positions (frames, joints, 3)` and `fps` are needed; `observed (frames, joints)`, `names (joints,)`,
`parents (joints,)` (-1 or itself for a root), `unit` ("cm") and `up` ("z") are used where they are there. NaN
is missing too. Writing back keeps every key, dtype and array; only the samples that changed are replaced. What
stays missing is False in `observed`, or NaN in a file without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..body.measures import measure
from ..errors import InputError
from ..motion import Motion, Skeleton, Take, Units
from ..units import Hints, from_metres, resolve, to_metres
from .npz_archive import Archive

Array = np.ndarray

_FPS = ("fps", "framerate", "frame_rate", "mocap_framerate", "mocap_frame_rate")
_NAMES = ("names", "joint_names", "marker_names", "labels")
_WANTED = "arrays positions (frames, joints, 3) and fps, and if known observed, names and parents"


@dataclass(frozen=True, eq=False)
class Document:
    """A file as read: `positions` and `observed` as they are stored, and the motion that they made."""

    archive: Archive
    positions: Array
    observed: Array | None
    motion: Motion


def read(path: Path, hints: Hints) -> Take:
    """The take in an archive; InputError for anything else that an archive may hold, or hide."""
    archive = Archive(path.read_bytes(), path)
    stored = archive.array("positions")
    if stored is None:
        raise _not_ours(archive)
    positions = _positions(stored, path)
    frames, joints = positions.shape[:2]
    # NaN, infinities and what would overflow on the way are all not below it.
    observed = np.asarray((np.abs(positions) < 1e20).all(axis=-1))
    notes = []
    if not observed.all():
        notes.append(f"{(~observed).sum()} of {observed.size} samples are not finite and taken as missing")
    seen = archive.array("observed")
    if seen is not None:
        observed &= _trust(seen, frames, joints, path)
    positions[~observed] = np.nan
    parents = _parents(archive, joints)
    if parents is None:
        parents = (-1,) * joints
        notes.append("some parents come after their children, or in a circle: the bones are not used")
    skeleton = Skeleton(_names(archive, joints), parents)
    units = resolve(
        hints, said_unit=_word(archive, "unit"), said_up=_word(archive, "up"),
        **measure(skeleton, positions),
    )  # fmt: skip
    fps = hints.fps or _fps(archive)
    motion = Motion(to_metres(positions, units).astype(np.float32), observed, fps, skeleton)
    return Take(motion, None, Document(archive, stored, seen, motion), units, "npz", str(path), tuple(notes))


def _not_ours(archive: Archive) -> InputError:
    """What to say of an archive without positions: well-known ones are recognised by their keys."""
    keys, path = archive.keys, archive.path
    amass = keys >= {"poses", "trans"} or keys >= {"root_orient", "pose_body", "trans"}
    if amass or keys >= {"global_orient", "body_pose"}:
        shape = archive.shape(next(key for key in ("poses", "pose_body", "body_pose") if key in keys))
        width = shape[-1] if len(shape) == 2 else 0
        model = {72: "SMPL", 69: "SMPL", 156: "SMPL-H", 165: "SMPL-X", 63: "SMPL-X"}.get(width, "SMPL")
        return InputError(
            f"{'an AMASS archive' if amass else 'the parameters of a body model'}: "
            f"the angles of a {model} body in {shape[0] if shape else 0} frames, and no positions",
            where=path, expected=_WANTED,
            hint=f"get the {model} body model from its makers, run the package smplx on these poses, betas and trans, "
            "and save its joints: np.savez('take.npz', positions=joints, fps=float(mocap_framerate), names=names, "
            "parents=parents, unit='m', up='z')",
        )  # fmt: skip
    if keys & {"positions_3d", "positions_2d"}:
        return InputError(
            "a Human3.6M archive: many takes in one Python object, which could run code when opened", where=path,
            expected=_WANTED,
            hint="`motionmend data build h36m --source FOLDER -o h36m.corpus` reads it without running anything",
        )  # fmt: skip
    held = ", ".join(sorted(keys)[:12]) or "nothing"
    return InputError(f"no array 'positions'; the archive holds {held}", where=path, expected=_WANTED)


def _positions(stored: Array, path: Path) -> Array:
    if stored.dtype.kind not in "fiu":
        raise InputError(f"positions are {stored.dtype}", where=path, expected="floats or integers")
    if stored.ndim != 3 or stored.shape[2] != 3 or 0 in stored.shape:
        flat = stored.ndim == 2 and stored.shape[1] % 3 == 0
        raise InputError(
            f"positions have the shape {stored.shape}", where=path, expected="(frames, joints, 3), none of them 0",
            hint="make it of (frames, 3 * joints) with np.reshape" if flat else "",
        )  # fmt: skip
    single = stored.dtype.kind == "f" and stored.dtype.itemsize <= 4
    return stored.astype(np.float32 if single else np.float64, order="C")


def _trust(seen: Array, frames: int, joints: int, path: Path) -> Array:
    if seen.dtype.kind not in "bfiu" or seen.shape not in ((frames, joints), (frames, joints, 1)):
        found = f"'observed' is {seen.dtype} {seen.shape}"
        raise InputError(found, where=path, expected=f"({frames}, {joints}) of True and False")
    return seen.reshape(frames, joints) > 0


def _fps(archive: Archive) -> float:
    key = next((key for key in _FPS if key in archive.keys), "fps")
    value = archive.array(key)
    if value is None:
        raise InputError("no array 'fps'", where=archive.path, hint="give the frames per second with --fps")
    if value.size != 1 or value.dtype.kind not in "fiu":
        raise InputError(f"{key!r} is {value.dtype} {value.shape}", where=archive.path, expected="one number")
    fps = float(value.item())
    if not 0 < fps <= 100_000:
        raise InputError(f"impossible rate {fps:g} fps", where=archive.path, hint="give the true one with --fps")
    return fps


def _names(archive: Archive, joints: int) -> tuple[str, ...]:
    key = next((key for key in _NAMES if key in archive.keys), "names")
    names = archive.array(key)
    if names is None:
        digits = max(2, len(str(joints - 1)))
        return tuple(f"joint_{joint:0{digits}d}" for joint in range(joints))
    if names.dtype.kind not in "US" or names.shape != (joints,):
        found = f"{key!r} is {names.dtype} {names.shape}"
        raise InputError(found, where=archive.path, expected=f"{joints} names as text")
    return tuple(map(_text, names.tolist()))


def _parents(archive: Archive, joints: int) -> tuple[int, ...] | None:
    """Parents, none of them after its child; None if that is not so in the file."""
    given = archive.array("parents")
    if given is None:
        return (-1,) * joints
    if given.dtype.kind not in "fiu" or given.shape != (joints,) or not np.array_equal(given, np.round(given)):
        found = f"'parents' is {given.dtype} {given.shape}"
        raise InputError(found, where=archive.path, expected=f"{joints} indices")
    # SMPL's tables spell -1 as the largest unsigned number.
    parents = [-1 if p < 0 or p in (joint, 2**32 - 1) else int(p) for joint, p in enumerate(given.tolist())]
    if max(parents) >= joints:
        found = f"{max(parents)} as the parent of a joint"
        raise InputError(found, where=archive.path, expected=f"indices below {joints}, and -1 for a root")
    return None if any(parent > joint for joint, parent in enumerate(parents)) else tuple(parents)


def _word(archive: Archive, key: str) -> str | None:
    value = archive.array(key)
    return _text(value.item()) if value is not None and value.dtype.kind in "US" and value.size == 1 else None


def _text(word: str | bytes) -> str:
    return word.decode("utf-8", "replace") if isinstance(word, bytes) else word


def write(take: Take, path: Path) -> None:
    """Write a take: into the archive that it was read from, or as a new one in metres, Y up."""
    old, now = take.document, take.motion
    if isinstance(old, Document):
        was = old.motion
        if (was.skeleton, was.fps, len(was)) == (now.skeleton, now.fps, len(now)):
            old.archive.rewritten(path, _changed(old, take))
            return
    positions = np.where(now.observed[..., None], now.positions, np.float32(np.nan))
    names, parents = np.array(now.skeleton.names), np.array(now.skeleton.parents, np.int32)
    with path.open("wb") as file:
        np.savez_compressed(
            file, positions=positions, observed=now.observed, fps=np.float64(now.fps), names=names, parents=parents,
            unit=np.array("m"), up=np.array("y"),
        )  # fmt: skip


def _changed(old: Document, take: Take) -> dict[str, Array]:
    """The arrays of a file with the samples replaced that are not what was read."""
    was, now = old.motion, take.motion
    changed = now.observed & (~was.observed | (now.positions != was.positions).any(axis=-1))
    lost = was.observed & ~now.observed
    positions = old.positions.copy(order="K")
    positions[changed] = _as_stored(now.positions[changed], positions.dtype, take.units, take.source)
    if old.observed is not None:
        observed = old.observed.copy(order="K")
        at = (..., 0) if observed.ndim == 3 else ...
        observed[at][changed & ~was.observed] = 1
        observed[at][lost] = 0
        return {"positions": positions, "observed": observed}
    if positions.dtype.kind == "f":
        positions[lost] = np.nan
    elif lost.any():
        raise InputError(
            f"positions are {positions.dtype}, which cannot say that a sample is missing", where=take.source,
            hint="fill everything, or add an array 'observed' to the file",
        )  # fmt: skip
    return {"positions": positions}


def _as_stored(points: Array, dtype: np.dtype, units: Units, source: str) -> Array:
    """Positions in the file's unit and number type; InputError if that type cannot hold them well."""
    values = from_metres(points, units)
    if dtype.kind in "iu":
        bounds = np.iinfo(dtype)
        fits = values.size == 0 or (values.min() >= bounds.min and values.max() <= bounds.max)
        if not fits or (values.size and units.metres > 0.0011):
            raise InputError(
                f"positions are stored as {dtype}, too coarse or too small for what was filled", where=source,
                hint="store them as floats first",
            )  # fmt: skip
        return np.rint(values).astype(dtype)
    with np.errstate(over="ignore"):
        stored = values.astype(dtype)
    if not np.isfinite(stored).all():
        raise InputError(f"positions are stored as {dtype}, too small for what was filled", where=source)
    return stored
