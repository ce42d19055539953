"""Human3.6M (Ionescu et al. 2014) as VideoPose3D prepares it: `data_3d_h36m.npz`, 32 joints in metres, z up, at 50
Hz.

The archive's one array `positions_3d` is a dict of subjects, each a dict of actions, each `(frames, 32, 3)`. Of the
32 joints 17 are kept, as in the papers: the others are doubles, feet's ends and fingers. XMAE and TrajeVAE train on
S1, S5, S6, S7 and S8 and test on S9 and S11, so there is no validation split. VideoPose3D has left out the broken
`Directions` of S11 already.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...body.mapping import map_rig
from ...errors import InputError
from ...io import sha256_of
from ...motion import Motion, Skeleton, Units
from ...progress import Stage, silent
from ...units import to_metres
from ..corpus import Dropped
from ._objects import archive_of, numbers, objects
from .raw import Raw

NAME = "h36m"
LICENCE = "Human3.6M licence: academic use only, not to be passed on"
CREDIT = "Human3.6M, Ionescu, Papava, Olaru, Sminchisescu, TPAMI 2014."
FILE = "data_3d_h36m.npz"
FPS = 50.0
SPLITS = {"S1": "train", "S5": "train", "S6": "train", "S7": "train", "S8": "train", "S9": "test", "S11": "test"}
KEPT = (0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27)
SKELETON = Skeleton(
    ("Hip", "RHip", "RKnee", "RFoot", "LHip", "LKnee", "LFoot", "Spine", "Thorax", "Neck/Nose", "Head",
     "LShoulder", "LElbow", "LWrist", "RShoulder", "RElbow", "RWrist"),
    (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 9, 8, 11, 12, 8, 14, 15),
)  # fmt: skip


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The takes of the seven subjects, 17 joints, named such as S9_Walking_1.

    Raises
    ------
    InputError : if the archive is not in the folder, or is not of this layout.
    """
    path = source if source.is_file() else next(iter(sorted(source.rglob(FILE))), None)
    if path is None:
        raise InputError("no such archive", where=source / FILE, hint="VideoPose3D's DATASETS.md says how to make it")
    archive = archive_of(path)
    if "positions_3d" not in archive.keys:
        held = ", ".join(sorted(archive.keys)[:6]) or "nothing"
        hint = "that is the file of 2D keypoints" if "positions_2d" in archive.keys else ""
        raise InputError(f"it holds {held}", where=path, expected="the array positions_3d", hint=hint)
    subjects = objects(archive, "positions_3d")
    if not (isinstance(subjects, dict) and subjects and all(isinstance(each, dict) for each in subjects.values())):
        expected = "subject → action → (frames, 32, 3)"
        raise InputError("positions_3d is no dict of subjects", where=path, expected=expected)
    sha256 = sha256_of(path)
    rig = map_rig(SKELETON).rig
    for subject in sorted(set(subjects) - set(SPLITS), key=str):
        yield Dropped(f"{path.name}/{subject}", f"no such subject in Human3.6M; they are {', '.join(SPLITS)}")
    for subject in (each for each in SPLITS if each in subjects):
        for action, stored in sorted(subjects[subject].items(), key=lambda item: str(item[0])):
            file = f"{path.name}/{subject}/{action}"
            stage(file)
            points = numbers(stored, f"{path}:{subject}/{action}")
            if points.ndim != 3 or points.shape[1:] != (32, 3) or points.dtype.kind != "f":
                found = f"{points.dtype} {points.shape}"
                raise InputError(found, where=f"{path}:{subject}/{action}", expected="floats (frames, 32, 3)")
            if not len(points):
                yield Dropped(file, "no frames")
                continue
            positions = to_metres(points[:, KEPT].astype(np.float32), Units(1.0, "z", ""))
            motion = Motion(positions, np.asarray(np.isfinite(positions).all(axis=-1)), FPS, SKELETON)
            name = f"{subject}_{str(action).replace(' ', '_')}"
            yield Raw(name, file, subject, SPLITS[subject], motion, rig, LICENCE, sha256)
