"""AMASS (Mahmood et al. 2019): the angles of a SMPL body in NPZ files, made into joints by a body model that the user
supplies.

Layout: `SUBSET/SUBJECT/NAME_poses.npz` (SMPL+H) or `NAME_stageii.npz` (SMPL-X) with trans (frames, 3), poses (frames,
156 or 165; 72 for plain SMPL), betas, gender and mocap_framerate; metres, z up. The body models lie in `body_models/`
beside the subsets, as the package smplx wants them: `body_models/smplh/SMPLH_MALE.npz`. The 22 joints are the pelvis
and the 21 that SMPL's body pose turns. XMAE's text says 21 SMPL joints and not which; mapped to BODY they are 21,
without spine2, and with the pelvis as hips. As in XMAE, only takes at 60 and 120 fps are used. Splits are AMASS's
own, by subset.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ...body.mapping import map_rig
from ...errors import InputError
from ...io import sha256_of
from ...io.npz_archive import Archive
from ...motion import Array, Motion, Skeleton, Units
from ...progress import Stage, silent
from ...units import to_metres
from ..corpus import Dropped
from ._objects import archive_of
from .raw import Raw

NAME = "amass"
LICENCE = "AMASS licence: non-commercial research, not to be passed on"
CREDIT = "AMASS, Mahmood, Ghorbani, Troje, Pons-Moll, Black, ICCV 2019."
MODELS = "body_models"
RATES = (60.0, 120.0)
BLOCK = 256  # frames that go through a body model together: some 200 MB of its vertices
# The recommended split (AMASS's own repository), each subset under its names of 2019 and of today, without underscores.
SPLITS = {
    **dict.fromkeys(("humaneva", "mpihdm05", "hdm05", "sfu", "mpimosh", "mosh"), "validation"),
    **dict.fromkeys(("transitionsmocap", "transitions", "ssmsynced", "ssm"), "test"),
    **dict.fromkeys(
        ("cmu", "mpilimits", "poseprior", "totalcapture", "eyesjapandataset", "kit", "bml", "biomotionlabntroje",
         "bmlrub", "ekut", "tcdhandmocap", "tcdhands", "accad"),
        "train",
    ),
}  # fmt: skip
KINDS = {72: "smpl", 156: "smplh", 165: "smplx"}  # by the width of poses
SKELETON = Skeleton(
    ("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
     "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
     "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
    (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19),
)  # fmt: skip


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The takes at 60 and 120 fps, by path; subsets that AMASS's split does not name are in no split.

    Raises
    ------
    InputError : if there are no takes, no body models, or no package smplx.
    """
    paths = [path for pattern in ("*_poses.npz", "*_stageii.npz") for path in source.glob(f"*/*/{pattern}")]
    paths = sorted(path for path in paths if path.parents[1].name != MODELS)
    if not paths:
        raise InputError("no take", where=source, expected="SUBSET/SUBJECT/NAME_poses.npz, as AMASS unpacks")
    models = source / MODELS
    if not models.is_dir():
        hint = "register with the makers of SMPL and unpack it there"
        raise InputError("no body models", where=models, expected="smplh/SMPLH_MALE.npz and so on", hint=hint)
    _imported()  # now, not with every take
    body_model = cache(lambda *which: _body_model(models, *which))
    rig = map_rig(SKELETON).rig
    for path in paths:
        file = path.relative_to(source).as_posix()
        stage(file)
        try:
            yield _take(path, file, rig, body_model)
        except InputError as error:
            yield Dropped(file, str(error).removeprefix(f"{path}: "))


def _take(path: Path, file: str, rig: str, body_model: Callable[..., Callable[..., Array]]) -> Raw:
    archive = archive_of(path)
    fps = float(_array(archive, ("mocap_framerate", "mocap_frame_rate"), 0).item())
    rate = min(RATES, key=lambda rate: abs(rate - fps))
    if not abs(rate - fps) < 0.5:
        raise InputError(f"{fps:g} fps", expected="60 or 120 fps, as in the papers")
    poses, shifts = _array(archive, ("poses",), 2), _array(archive, ("trans",), 2)
    frames = len(poses)
    if poses.shape[1] not in KINDS or shifts.shape != (frames, 3) or not frames:
        found = f"poses {poses.shape} and trans {shifts.shape}"
        raise InputError(found, where=path, expected="(frames, 156) and (frames, 3), or 165 or 72 columns")
    betas = _array(archive, ("betas",), 1)
    gender = archive.array("gender")
    if gender is None or gender.size != 1 or gender.dtype.kind not in "US":
        raise InputError("no gender", where=path, expected="male, female or neutral")
    word = gender.item()
    word = (word.decode("ascii", "replace") if isinstance(word, bytes) else word).strip("b'\"").lower()
    joints = body_model(KINDS[poses.shape[1]], word, len(betas))
    parts = [joints(poses[at : at + BLOCK], betas, shifts[at : at + BLOCK]) for at in range(0, frames, BLOCK)]
    positions = to_metres(np.concatenate(parts).astype(np.float32), Units(1.0, "z", ""))
    motion = Motion(positions, np.asarray(np.isfinite(positions).all(axis=-1)), rate, SKELETON)
    subset, subject = path.parts[-3], path.parts[-2]
    split = SPLITS.get(subset.replace("_", "").lower(), "")
    notes = () if split else (f"{subset} is in none of AMASS's recommended splits",)
    name = f"{subset}_{subject}_{path.stem.rpartition('_')[0]}"
    return Raw(name, file, f"{subset}_{subject}", split, motion, rig, LICENCE, sha256_of(path), notes)


def _array(archive: Archive, keys: tuple[str, ...], axes: int) -> Array:
    """The first array there is of `keys`, of numbers along so many axes; InputError if there is none."""
    found = next((archive.array(key) for key in keys if key in archive.keys), None)
    if found is None or found.dtype.kind not in "fiu" or found.ndim != axes:
        said = "no array" if found is None else f"{found.dtype} {found.shape} in"
        raise InputError(f"{said} {keys[0]}", where=archive.path, expected="a take of AMASS")
    return found


def _imported() -> tuple[Any, Any]:
    try:
        return importlib.import_module("smplx"), importlib.import_module("torch")
    except ModuleNotFoundError as error:
        raise InputError(f"AMASS needs the package {error.name}", hint="say: pip install smplx torch") from None


def _body_model(folder: Path, kind: str, gender: str, shapes: int) -> Callable[[Array, Array, Array], Array]:
    """A function from poses, betas and shifts to the 22 joints `(frames, 22, 3)`, by the package smplx."""
    smplx, torch = _imported()
    stem = folder / kind / f"{kind}_{gender}".upper()
    suffix = next((suffix for suffix in ("npz", "pkl") if stem.with_suffix(f".{suffix}").is_file()), None)
    if suffix is None:
        raise InputError(f"no body model {stem.name}.npz", where=folder / kind, hint="its makers' site has it")
    options = {} if kind == "smpl" else {"use_pca": False, "ext": suffix}
    model = smplx.create(str(folder), model_type=kind, gender=gender, num_betas=shapes, **options)

    def joints(poses: Array, betas: Array, shifts: Array) -> Array:
        frames = len(poses)
        # Fingers and face move none of the 22 joints, but the models want them for every frame.
        still = {"smpl": {}, "smplh": {"left_hand_pose": 45, "right_hand_pose": 45}}
        still["smplx"] = still["smplh"] | {"jaw_pose": 3, "leye_pose": 3, "reye_pose": 3, "expression": 10}
        width = 69 if kind == "smpl" else 63
        given = {
            "global_orient": poses[:, :3], "body_pose": poses[:, 3 : 3 + width], "transl": shifts,
            "betas": np.broadcast_to(betas, (frames, shapes)),
        } | {part: np.zeros((frames, columns)) for part, columns in still[kind].items()}  # fmt: skip
        with torch.no_grad():
            tensors = {part: torch.from_numpy(np.array(values, np.float32)) for part, values in given.items()}
            return model(**tensors).joints[:, : len(SKELETON)].numpy()

    return joints
