"""LaFAN1 (Harvey et al. 2020, Ubisoft): 77 BVH takes of five people, 22 joints, centimetres, Y up, 30 fps.

In a folder or still in `lafan1.zip`; files are named theme, take and subject: `walk1_subject5.bvh`. The paper tests
on subject 5 and trains on the others. Nothing is cut off and nothing is distrusted, so that the protocol sees the
paper's frames.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ... import io
from ...body.mapping import map_rig
from ...errors import InputError
from ...progress import Stage, silent
from ..corpus import Dropped
from .raw import Raw

NAME = "lafan1"
LICENCE = "CC-BY-NC-ND-4.0"
CREDIT = "Ubisoft La Forge Animation Dataset (LAFAN1), Harvey, Yurick, Nowrouzezahrai, Pal, SIGGRAPH 2020."
ARCHIVE = "lafan1.zip"
FPS = 30.0
TEST = "subject5"
JOINTS = (
    "Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToe", "RightUpLeg", "RightLeg", "RightFoot", "RightToe",
    "Spine", "Spine1", "Spine2", "Neck", "Head",
    "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand", "RightShoulder", "RightArm", "RightForeArm", "RightHand",
)  # fmt: skip
LARGEST = 1 << 28  # bytes; the largest real take has some 10 MB
_NAME = re.compile(r".+_subject\d+\.bvh", re.IGNORECASE)


def read(source: Path, *, stage: Stage = silent) -> Iterator[Raw | Dropped]:
    """The takes by name; subject 5 is the test split, the others are the train split.

    Raises
    ------
    InputError : if there is no take named as in LaFAN1, neither in the folder nor in an archive in it.
    """
    loose = sorted(path for path in source.rglob("*.bvh") if _NAME.fullmatch(path.name)) if source.is_dir() else []
    if loose:
        for path in loose:
            stage(path.name)
            yield _take(path, path.relative_to(source).as_posix())
        return
    archive = source if source.is_file() else next(iter(sorted(source.rglob(ARCHIVE))), None)
    if archive is None:
        raise InputError("no take", where=source, expected=f"{ARCHIVE}, or files such as walk1_subject5.bvh")
    none = True
    for path, size in unpacked(archive, lambda name: bool(_NAME.fullmatch(name))):
        stage(path.name)
        none, label = False, f"{archive.name}/{path.name}"
        if size > LARGEST:
            yield Dropped(label, f"{size:,} bytes are more than a take has")
        else:
            yield _take(path, label)
    if none:
        raise InputError("no take in the archive", where=archive, expected="files such as walk1_subject5.bvh")


def unpacked(archive: Path, wanted: Callable[[str], bool]) -> Iterator[tuple[Path, int]]:
    """Those files of an archive whose names are wanted, by name, and their sizes in bytes.

    Each is there only until the next is asked for, and not at all if it is larger than LARGEST. InputError where the
    archive cannot be read.
    """
    with _opened(archive) as file, tempfile.TemporaryDirectory() as folder:
        members = {Path(info.filename).name: info for info in file.infolist()}
        for name in sorted(filter(wanted, members)):
            path, size = Path(folder) / name, members[name].file_size
            if size <= LARGEST:
                with file.open(members[name]) as packed, path.open("wb") as whole:
                    shutil.copyfileobj(packed, whole)
            yield path, size
            path.unlink(missing_ok=True)


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(path) as file:
            yield file
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        hint = "is it cut off, or a Git LFS pointer? A clone needs `git lfs pull`"
        raise InputError(f"the archive cannot be read ({error})", where=path, hint=hint) from None


def _take(path: Path, file: str) -> Raw | Dropped:
    subject = path.stem.rpartition("_")[2].lower()
    try:
        take = io.load(path, unit="cm", up="y")
        if take.skeleton.names != JOINTS:
            names = ", ".join(take.skeleton.names[:4])
            raise InputError(f"{len(take.skeleton)} joints ({names}, …)", expected=f"LaFAN1's {len(JOINTS)}")
        if abs(take.fps - FPS) > 0.1:
            raise InputError(f"{take.fps:g} fps", expected="30 fps")
    except InputError as error:
        return Dropped(file, str(error).removeprefix(f"{path}: "))
    split = "test" if subject == TEST else "train"
    rig = map_rig(take.skeleton).rig
    return Raw(path.stem, file, subject, split, take.motion, rig, LICENCE, io.sha256_of(path), take.notes, floor=0.0)
