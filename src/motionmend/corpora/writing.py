"""Write a corpus: aside, in a temporary folder, which is renamed once it is whole."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, fields
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..body.joints import BODY
from ..constraints.contacts import standing
from ..errors import InputError
from ..motion import Array, Motion, Skeleton
from .corpus import ARRAYS, CONTACTS, ESCAPE, VERSION, Clip, ClipInfo, Corpus, Dropped, data_hash

DTYPES = ("float32", "float16")
ORIGIN_STEP = 1 / 1024  # a power of two: an origin is exact in float32 as far as 16 km from the middle of the stage


def write_corpus(
    path: str | Path,
    *,
    name: str,
    fps: float,
    skeleton: Skeleton,
    dtype: str = "float32",
    licence: str = "",
    credit: str = "",
    clips: Iterable[tuple[ClipInfo, Motion]],
    dropped: Iterable[Dropped] = (),
    contacts: bool = True,
    force: bool = False,
) -> Corpus:
    """Write clips into a new corpus, one at a time, and open it. The same clips give the same bytes.

    Parameters
    ----------
    clips : provenance and motion of each; the motions have `skeleton` and `fps`, and the floor at y = 0.
        Consumed once, so a generator keeps memory small.
    dropped : read after `clips` is exhausted, so a list that the generator fills will do.
    contacts : keep when feet stand; not where positions are other than in the world, in which feet stand.
    force : replace a corpus that is there. Nothing but a corpus is ever replaced.

    Raises
    ------
    InputError : if the target exists, if no clip comes, or if two clips have one name.
    """
    path = Path(path)
    if dtype not in DTYPES:
        raise InputError(f"unknown dtype {dtype!r}", expected=" or ".join(DTYPES))
    refuse_target(path, force)
    aside = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        hashes = [hashlib.sha256() for _ in ARRAYS]
        with contextlib.ExitStack() as stack:
            files = [stack.enter_context((aside / f"{each}.npy").open("w+b")) for each in ARRAYS]
            kinds: list[tuple[BinaryIO, str, tuple[int, ...]]] = list(
                zip(files, ("float32", dtype, "bool"), ((3,), (len(skeleton), 3), (len(skeleton),)))
            )
            if contacts and skeleton == BODY:
                kinds.append((stack.enter_context((aside / f"{CONTACTS}.npy").open("w+b")), "int8", (4,)))
            for file, kind, shape in kinds:
                _write_header(file, kind, (0, *shape))
            table: list[Clip] = []
            names: set[str] = set()
            for info, motion in clips:
                if info.name in names:
                    raise InputError(f"two clips are named {info.name}", where=path)
                if motion.skeleton != skeleton or motion.fps != fps or not len(motion):
                    raise ValueError(f"{info.name} is empty, or of another skeleton or rate than the corpus")
                names.add(info.name)
                for file, sha, values in zip(files, hashes, _arrays(motion, dtype)):
                    sha.update(values.data)
                    file.write(values.data)
                for file, _, _ in kinds[len(ARRAYS) :]:
                    file.write(_contacts(motion).data)
                start = table[-1].stop if table else 0
                known = {each.name: getattr(info, each.name) for each in fields(ClipInfo)}
                table.append(Clip(**known, start=start, frames=len(motion)))
            for file, kind, shape in kinds:
                _write_header(file, kind, (table[-1].stop if table else 0, *shape))
        if not table:
            reasons = [f"{each.file} ({each.reason})" for each in dropped]
            raise InputError("no clip to write", where=path, hint=f"dropped: {'; '.join(reasons[:3])}")
        head = {
            "name": name, "version": VERSION, "fps": fps, "dtype": dtype, "licence": licence, "credit": credit,
            "sha256": data_hash(hashes, skeleton, fps, table),
            "skeleton": {"names": list(skeleton.names), "parents": list(skeleton.parents)},
        }  # fmt: skip
        (aside / "corpus.json").write_text(_as_text(head, table, dropped), "utf-8", ESCAPE)
        aside.chmod(0o755)
        _replace(path, aside)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return Corpus.open(path)


def refuse_target(path: Path, force: bool) -> None:
    """InputError if a corpus cannot be written there: refuse before the work starts rather than after it."""
    if not path.parent.is_dir():
        raise InputError("no such folder", where=path.parent)
    there = path.exists() or path.is_symlink()  # perhaps a link to nothing
    if there and not force:
        raise InputError("it exists already", where=path, hint="choose another name, or replace it with --force")
    if there:
        known = {"corpus.json", *(f"{name}.npy" for name in (*ARRAYS, CONTACTS))}
        foreign = sorted(each.name for each in path.iterdir() if each.name not in known) if path.is_dir() else []
        if not (path / "corpus.json").is_file() or foreign:
            found = f"this holds {foreign[0]}, which is no part of a corpus" if foreign else "this is not a corpus"
            raise InputError(found, where=path, hint="only a corpus is ever replaced: choose another name")


def _arrays(motion: Motion, dtype: str) -> tuple[Array, Array, Array]:
    """What is stored of a motion: origins, offsets, observed."""
    seen = motion.observed[..., None]
    count = motion.observed.sum(axis=1)[:, None]
    positions = np.where(seen, motion.positions, 0).astype(np.float64)
    middle = positions.sum(axis=1) / np.maximum(count, 1)
    hips = motion.skeleton.names.index("hips") if "hips" in motion.skeleton.names else 0
    origins = np.where(motion.observed[:, hips, None], positions[:, hips], middle)
    origins = (np.round(origins / ORIGIN_STEP) * ORIGIN_STEP + 0.0).astype(np.float32)  # no negative zeros
    offsets = np.where(seen, positions - origins[:, None], np.nan).astype(dtype)
    return np.ascontiguousarray(origins), np.ascontiguousarray(offsets), np.ascontiguousarray(motion.observed)


def _contacts(motion: Motion) -> Array:
    """What is stored of how feet stand: `(frames, 4)` int8."""
    stands, known = standing(motion.positions[None], motion.observed[None], motion.fps)
    return np.ascontiguousarray(np.where(known, stands, -1)[0].astype(np.int8))


def _write_header(file: BinaryIO, dtype: str, shape: tuple[int, ...]) -> None:
    """The head of an npy file; NumPy pads it so that the first axis can grow in place."""
    file.seek(0)
    descr = np.lib.format.dtype_to_descr(np.dtype(dtype))
    header = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)


def _as_text(head: dict, clips: Iterable[Clip], dropped: Iterable[Dropped]) -> str:
    """JSON with one line a clip, so that it can be read, searched and compared."""

    def lines(name: str, rows: Iterable) -> str:
        inside = ",\n  ".join(json.dumps(asdict(row), ensure_ascii=False) for row in rows)
        return f' "{name}": [\n  {inside}\n ]' if inside else f' "{name}": []'

    said = [f' "{key}": {json.dumps(value, ensure_ascii=False)}' for key, value in head.items()]
    return "{\n" + ",\n".join([*said, lines("clips", clips), lines("dropped", dropped)]) + "\n}\n"


def _replace(path: Path, aside: Path) -> None:
    """Put the finished folder in its place; a corpus that was there is deleted last."""
    old = Path(tempfile.mkdtemp(prefix=f".{path.name}-old-", dir=path.parent))
    try:
        if path.exists():
            path.replace(old / path.name)
        aside.replace(path)
    finally:
        if not path.exists() and (old / path.name).exists():
            (old / path.name).replace(path)
        shutil.rmtree(old, ignore_errors=True)
