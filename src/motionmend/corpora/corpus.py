"""A corpus: many clips of one skeleton at one rate, as arrays that are mapped into memory rather than read.

A folder `NAME.corpus/` holds
- `corpus.json`: name, version, fps, dtype, skeleton, licence, credit, sha256, the clips, and what was dropped and why;
- `origins.npy` `(F, 3)` float32: each frame's hips, rounded to 1/1024 m, so that what is left is small;
- `offsets.npy` `(F, J, 3)` float32 or float16: the joints less their frame's origin, NaN where unobserved;
- `observed.npy` `(F, J)` bool;
- `contacts.npy` `(F, 4)` int8, where J are BODY's joints: whether contacts.STANDING_JOINTS stand, -1 where unknown,
the clips one after the other along F. Metres, Y up, the floor at y = 0.
"""

from __future__ import annotations

import hashlib
import json
import tokenize
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..motion import Array, Motion, Skeleton

VERSION = 1
SPLITS = ("train", "validation", "test")
ARRAYS = ("origins", "offsets", "observed")
CONTACTS = "contacts"
ESCAPE = "backslashreplace"  # of file names that are not UTF-8: as JSON has it, so they come back as they were


@dataclass(frozen=True)
class Dropped:
    """A source file that is not in the corpus, and why."""

    file: str
    reason: str


@dataclass(frozen=True)
class ClipInfo:
    """Where a clip comes from.

    name : unique in the corpus ("05_01"). file : path of the source file, relative to the source folder.
    sha256 : of the source file (and of its ASF, appended, where it has one).
    subject : who was captured. split : "train", "validation", "test" or "".
    file_fps : true rate of the source. rig : the convention recognised. licence : SPDX, or words.
    floor : metres that were subtracted from y so that the floor is 0.
    notes : what was done to it, one clause each: T-pose trimmed, joints absent, untrusted samples, …
    """

    name: str
    file: str = ""
    sha256: str = ""
    subject: str = ""
    split: str = ""
    file_fps: float = 0.0
    rig: str = ""
    licence: str = ""
    floor: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Clip(ClipInfo):
    """A clip in a corpus: its provenance, and its frames `[start, start + frames)` in the corpus's arrays."""

    start: int = 0
    frames: int = 0

    @property
    def stop(self) -> int:
        return self.start + self.frames


@dataclass(frozen=True, eq=False)
class Corpus:
    """Clips of one skeleton at one rate, opened from a folder and never written to.

    fps : frames per second of every clip. dtype : of the stored offsets; all that comes out is float32.
    licence, credit : of the data as a whole. sha256 : of the arrays and the table of clips, the "data hash".
    """

    name: str
    path: Path
    fps: float
    dtype: str
    skeleton: Skeleton
    licence: str
    credit: str
    sha256: str
    clips: tuple[Clip, ...]
    dropped: tuple[Dropped, ...]

    @classmethod
    def open(cls, path: str | Path) -> Corpus:
        """Map a corpus into memory.

        Raises
        ------
        InputError : if there is none, if its version is another, or if its arrays and its table do not agree.
        """
        path = Path(path)
        table = _read_table(path)
        try:
            skeleton = Skeleton(tuple(table["skeleton"]["names"]), tuple(table["skeleton"]["parents"]))
            clips = tuple(Clip(**{**clip, "notes": tuple(clip["notes"])}) for clip in table["clips"])
            dropped = tuple(Dropped(**each) for each in table["dropped"])
            words = {key: str(table[key]) for key in ("name", "dtype", "licence", "credit", "sha256")}
            corpus = cls(**words, path=path, fps=float(table["fps"]), skeleton=skeleton, clips=clips, dropped=dropped)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"the table is damaged: {error}", where=path / "corpus.json", hint=_REBUILD) from None
        corpus._check_shapes()
        return corpus

    def __len__(self) -> int:
        """Frames of all clips together."""
        return self.clips[-1].stop

    def __reduce__(self):
        return Corpus.open, (self.path,)  # another process maps the same files, rather than being sent a copy

    @cached_property
    def origins(self) -> Array:
        return _mapped(self.path / "origins.npy")

    @cached_property
    def offsets(self) -> Array:
        return _mapped(self.path / "offsets.npy")

    @cached_property
    def observed(self) -> Array:
        """`(F, J)` bool, True = trust."""
        return _mapped(self.path / "observed.npy")

    @cached_property
    def contacts(self) -> Array | None:
        """`(F, 4)` int8: 1 where a joint of contacts.STANDING_JOINTS stands, 0 where not, -1 where that is unknown.

        It follows from the positions. None in a corpus of other joints or of poses without global translation,
        or made before contacts were kept.
        """
        path = self.path / f"{CONTACTS}.npy"
        return _mapped(path) if path.is_file() else None

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        """The first frame of each clip, and the one after its last."""
        return np.array([clip.start for clip in self.clips]), np.array([clip.stop for clip in self.clips])

    def in_split(self, split: str) -> tuple[Clip, ...]:
        """The clips of one split, in order."""
        return tuple(clip for clip in self.clips if clip.split == split)

    def motion(self, clip: Clip) -> Motion:
        """A clip as a Motion: float32, NaN where unobserved."""
        index = np.arange(clip.start, clip.stop)
        return Motion(self._positions(index), self.observed[index], self.fps, self.skeleton)

    def starts(self, split: str, length: int, stride: int, *, whole: bool = False, pad: bool = False) -> Array:
        """First frames `(W,)` int64, in the corpus's arrays, of windows that lie inside a clip.

        Parameters
        ----------
        length, stride : frames of a window, and from one window of a clip to its next.
        whole : only windows in which every joint that the clip ever observes is observed throughout.
        pad : a clip shorter than `length` gives one window too, whose last frame `windows` repeats.
        """
        if length < 1 or stride < 1:
            raise ValueError(f"windows of {length} frames every {stride}: both must be at least 1")
        found = []
        for clip in self.in_split(split):
            last = clip.frames - length
            if last < 0 and not pad:
                continue
            first = np.arange(0, max(last, 0) + 1, stride)
            if whole:
                observed = self.observed[clip.start : clip.stop]
                lacking = ~observed[:, observed.any(axis=0)].all(axis=1)
                before = np.concatenate([[0], np.cumsum(lacking)])
                first = first[before[np.minimum(first + length, clip.frames)] == before[first]]
            found.append(clip.start + first)
        return np.concatenate(found) if found else np.zeros(0, np.int64)

    def windows(self, starts: Array, length: int) -> tuple[Array, Array]:
        """Positions `(W, length, J, 3)` float32, NaN where unobserved, and observed `(W, length, J)` bool.

        Parameters
        ----------
        starts : `(W,)` first frames in the corpus's arrays. Frames beyond the end of the clip that a window
            begins in repeat that clip's last.

        Raises
        ------
        IndexError : for a start that is in no clip.
        """
        starts = np.asarray(starts, np.int64)
        if starts.size and not (starts.min() >= 0 and starts.max() < len(self)):
            raise IndexError(f"windows start in frames 0 to {len(self) - 1}, not {starts.min()} to {starts.max()}")
        firsts, stops = self._bounds
        last = stops[np.searchsorted(firsts, starts, side="right") - 1] - 1
        index = np.minimum(starts[:, None] + np.arange(length), last[:, None])
        return self._positions(index), np.take(self.observed, index, axis=0)

    def damaged(self) -> str:
        """In what the arrays differ from what was written, in words; "" if they do not. Reads all of them."""
        hashes = [hashlib.sha256() for _ in ARRAYS]
        for name, sha in zip(ARRAYS, hashes):
            values = getattr(self, name)
            for start in range(0, len(values), 65536):
                sha.update(np.ascontiguousarray(values[start : start + 65536]).data)
        found = data_hash(hashes, self.skeleton, self.fps, self.clips)
        return "" if found == self.sha256 else f"but the arrays and the clips have the data hash {found}"

    def _positions(self, index: Array) -> Array:
        positions = np.take(self.offsets, index, axis=0).astype(np.float32, copy=False)
        positions += np.take(self.origins, index, axis=0)[..., None, :]
        return positions

    def _check_shapes(self) -> None:
        frames, joints = (len(self) if self.clips else 0), len(self.skeleton)
        wanted = {"origins": (frames, 3), "offsets": (frames, joints, 3), "observed": (frames, joints)}
        dtypes = {"origins": "float32", "offsets": self.dtype, "observed": "bool"}
        firsts, stops = self._bounds
        if not self.clips or firsts[0] != 0 or np.any(firsts[1:] != stops[:-1]) or np.any(stops <= firsts):
            raise InputError("the clips do not follow each other", where=self.path / "corpus.json", hint=_REBUILD)
        for name in ARRAYS:
            values = getattr(self, name)
            if values.shape != wanted[name] or values.dtype != dtypes[name]:
                raise InputError(
                    f"an array of {values.shape} {values.dtype}", where=self.path / f"{name}.npy",
                    expected=f"{wanted[name]} {dtypes[name]}, as corpus.json says", hint=_REBUILD,
                )  # fmt: skip


_REBUILD = "build it again with `motionmend data build`"


def _read_table(path: Path) -> dict:
    if not path.is_dir():
        found = "no such corpus" if not path.exists() else "this is a file, not a corpus"
        raise InputError(found, where=path, expected="a folder made by `motionmend data build`")
    try:
        table = json.loads((path / "corpus.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        hint = "make one with `motionmend data build`"
        raise InputError("this folder is not a corpus: it has no corpus.json", where=path, hint=hint) from None
    except ValueError as error:
        raise InputError(f"not JSON: {error}", where=path / "corpus.json", hint=_REBUILD) from None
    if not isinstance(table, dict) or "version" not in table or "clips" not in table:
        raise InputError("this is not the table of a corpus", where=path / "corpus.json")
    if table["version"] != VERSION:
        found, expected = f"a corpus of version {table['version']}", f"version {VERSION}"
        raise InputError(found, where=path / "corpus.json", expected=expected, hint=_REBUILD)
    return table


def _mapped(path: Path) -> Array:
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False).view(np.ndarray)
    except FileNotFoundError:
        raise InputError("this array of the corpus is missing", where=path, hint=_REBUILD) from None
    except (ValueError, EOFError, SyntaxError, tokenize.TokenError) as error:  # the last two: a header that is no dict
        raise InputError(f"this array is truncated or damaged: {error}", where=path, hint=_REBUILD) from None


def data_hash(hashes: Iterable, skeleton: Skeleton, fps: float, clips: Iterable[Clip]) -> str:
    """The SHA-256 of a corpus, over those of its ARRAYS and over its table of clips."""
    said = [fps, skeleton.names, skeleton.parents, [asdict(clip) for clip in clips]]
    words = json.dumps(said, ensure_ascii=False)
    said_of_arrays = "".join(sha.hexdigest() for sha in hashes)
    return hashlib.sha256((said_of_arrays + words).encode(errors=ESCAPE)).hexdigest()
