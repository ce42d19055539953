"""AMC and its ASF: joint angles a frame, and the skeleton they turn (Acclaim's formats, as CMU publishes them).

Each bone has its own axes C in the rest pose, which has every bone in world-aligned frames; its angles make
M; its local turn is C M C^-1. "rx ry rz" turns about x first, so M = Rz Ry Rx. The joint called after a
bone stands where the bone begins, which is its parent's end.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..body.measures import measure
from ..errors import InputError, nearest_names
from ..motion import Rig, Skeleton, Take, Units
from ..rotations import IDENTITY, from_euler, inverse, multiply
from ..units import Hints, resolve, rotation_to_y_up, to_metres
from ._text import decoded, is_numeric, number, numbers

Array = np.ndarray


@dataclass
class Bone:
    """A bone of an ASF, in file units and radians; the root is one too.

    vector : from where it begins to where it ends. axes : its C. dofs : such as ("rx", "ry", "rz").
    """

    name: str
    vector: Array
    axes: Array
    dofs: tuple[str, ...]


@dataclass
class Figure:
    """An ASF: its bones with the root first and parents before children."""

    bones: list[Bone]
    parents: list[int]
    position: Array
    length: float | None
    radians: bool


def read(path: Path, hints: Hints) -> Take:
    """A take from an AMC file and its skeleton. Raises InputError with the line for whatever is wrong."""
    figure = read_asf(_asf_beside(path, hints))
    values = _frames(path, figure)
    notes = []
    if not hints.fps:
        notes.append("AMC has no rate; 120 fps assumed; set --fps if you know it")

    few = values[sorted(set(np.linspace(0, len(values) - 1, 50).astype(int).tolist()))]
    rig = _rig(figure, few, Units(1.0, "y", ""))
    pose = rig.kinematics[0]
    units = resolve(
        hints,
        said_unit="asf" if figure.length is not None and abs(figure.length - 0.45) < 1e-3 else None,
        usual_unit="asf",
        **measure(rig.skeleton, pose),
    )
    rig = _rig(figure, values, units)
    return Take(rig.motion(hints.fps or 120.0), rig, None, units, "amc", str(path), tuple(notes))


def _asf_beside(path: Path, hints: Hints) -> Path:
    if hints.asf:
        if not Path(hints.asf).is_file():
            raise InputError("no such file", where=hints.asf, expected="the ASF skeleton of this take")
        return Path(hints.asf)
    siblings = [other for other in sorted(path.parent.iterdir()) if other.suffix.lower() == ".asf"]
    for stem in (path.stem, path.stem.split("_")[0]):
        for other in siblings:
            if other.stem.lower() == stem.lower():
                return other
    if len(siblings) == 1:
        return siblings[0]
    found = "several ASF skeletons beside it, none of its name" if siblings else "no ASF skeleton beside it"
    raise InputError(found, where=path, hint="name the skeleton with --asf")


def read_asf(path: Path) -> Figure:
    """The skeleton in an ASF file."""
    return _AsfReader(path).figure()


class _AsfReader:
    def __init__(self, path: Path):
        self.path = path
        self.line = 0
        self.bones: dict[str, Bone] = {}
        self.root_order: list[str] = []
        self.root_axis, self.position, self.orientation = "XYZ", np.zeros(3), np.zeros(3)
        self.length: float | None = None
        self.radians = False
        self.above: dict[str, str] = {}  # child → parent

    @property
    def where(self) -> str:
        return f"{self.path}:{self.line}"

    def number(self, words: list[bytes], index: int = 1) -> float:
        if len(words) <= index:
            raise InputError("the line ends too early", where=self.where, expected="a number")
        return number(words[index], lambda: self.where)

    def three(self, words: list[bytes]) -> Array:
        return np.array([self.number(words, index) for index in (1, 2, 3)])

    def figure(self) -> Figure:
        section, block = b"", None
        for text in self.path.read_bytes().splitlines():
            self.line += 1
            words = text.split(b"#")[0].replace(b"(", b" ").replace(b")", b" ").split()
            if not words:
                continue
            key = words[0].lower()
            if key.startswith(b":"):
                section, block = key, None
            elif section == b":units":
                if key == b"length":
                    self.length = self.number(words)
                elif key == b"angle":
                    self.radians = words[-1].lower().startswith(b"rad")
            elif section == b":root":
                self.root(key, words)
            elif section == b":bonedata":
                if key == b"begin":
                    block = {"line": self.line}
                elif key == b"end" and block is not None:
                    self.finish(block)
                    block = None
                elif block is None:
                    raise InputError(f"{decoded(words[0])!r} outside of a bone", where=self.where, expected="begin")
                else:
                    self.bone(block, key, words)
            elif section == b":hierarchy" and key not in (b"begin", b"end"):
                self.children(words)
        if not self.bones:
            raise InputError("there are no bones in this ASF", where=self.path)
        return self.in_order()

    def root(self, key: bytes, words: list[bytes]) -> None:
        if key == b"order":
            self.root_order = [self.dof(word, b"tr") for word in words[1:]]
        elif key == b"axis":
            self.root_axis = self.axis_order(words[-1])
        elif key == b"position":
            self.position = self.three(words)
        elif key == b"orientation":
            self.orientation = self.three(words)

    def bone(self, block: dict, key: bytes, words: list[bytes]) -> None:
        if key == b"name" and len(words) > 1:
            block["name"] = decoded(words[1])
        elif key == b"direction":
            block["direction"] = self.three(words)
        elif key == b"length":
            block["length"] = self.number(words)
        elif key == b"axis":
            block["axis"] = self.three(words)
            block["order"] = self.axis_order(words[4] if len(words) > 4 else b"XYZ")
        elif key == b"dof":
            block["dofs"] = tuple(self.dof(word, b"r") for word in words[1:])

    def dof(self, word: bytes, kinds: bytes) -> str:
        lower = word.lower()
        if len(lower) != 2 or lower[:1] not in kinds or lower[1:] not in b"xyz":
            raise InputError(
                f"cannot read the freedom {decoded(word)!r}", where=self.where, expected="rx, ry or rz for a bone"
            )
        return lower.decode()

    def axis_order(self, word: bytes) -> str:
        if sorted(word.upper()) != sorted(b"XYZ"):
            raise InputError(f"axis order {decoded(word)!r}", where=self.where, expected="such as XYZ")
        return word.upper().decode()

    def finish(self, block: dict) -> None:
        missing = [key for key in ("name", "direction", "length") if key not in block]
        if missing:
            raise InputError(f"a bone without {missing[0]}", where=f"{self.path}:{block['line']}")
        if block["name"] in self.bones or block["name"] == "root":
            raise InputError(f"a second bone is called {block['name']!r}", where=self.where)
        axes = self.axes(block.get("axis", np.zeros(3)), block.get("order", "XYZ"))
        length = np.linalg.norm(block["direction"])
        vector = block["direction"] * (block["length"] / length if length else 0.0)
        self.bones[block["name"]] = Bone(block["name"], vector, axes, block.get("dofs", ()))

    def axes(self, angles: Array, order: str) -> Array:
        return from_euler(order[::-1], (angles if self.radians else np.radians(angles))[::-1])

    def children(self, words: list[bytes]) -> None:
        parent, *children = map(decoded, words)
        for name in (parent, *children):
            if name != "root" and name not in self.bones:
                raise InputError(f"no bone is called {name!r}", where=self.where, hint=nearest_names(name, self.bones))
        for child in children:
            if child == "root" or self.above.get(child, parent) != parent:
                raise InputError(f"{child!r} has two parents", where=self.where)
            self.above[child] = parent

    def in_order(self) -> Figure:
        below: dict[str, list[str]] = {}
        for child, parent in self.above.items():
            below.setdefault(parent, []).append(child)
        root = Bone("root", np.zeros(3), self.axes(self.orientation, self.root_axis), tuple(self.root_order))
        if not root.dofs:
            raise InputError("the root has no 'order' of its freedoms", where=self.path)
        bones, parents, waiting = [root], [-1], [(child, 0) for child in reversed(below.get("root", []))]
        while waiting:
            name, parent = waiting.pop()
            waiting += [(child, len(bones)) for child in reversed(below.get(name, []))]
            bones.append(self.bones[name])
            parents.append(parent)
        lost = set(self.bones) - {bone.name for bone in bones}
        if lost:
            raise InputError(
                f"bone {sorted(lost)[0]!r} does not hang on the root", where=self.path,
                expected="a :hierarchy that is one tree",
            )
        return Figure(bones, parents, self.position, self.length, self.radians)


def _frames(path: Path, figure: Figure) -> Array:
    """All numbers `(frames, freedoms)`, in the order of the figure's bones; angles in radians."""
    raw = path.read_bytes()
    lines = raw.splitlines()
    first, radians = 0, figure.radians
    for first, text in enumerate(lines):  # noqa: B007 (first is where the header ends)
        word = text.strip()
        if word.upper() in (b":DEGREES", b":RADIANS"):
            radians = word.upper() == b":RADIANS"
        elif word and not word.startswith((b"#", b":")) and not text.startswith(b"\xef\xbb\xbf"):
            break
    else:
        raise InputError("there are no frames", where=f"{path}:{max(len(lines), 1)}")
    moving = [bone for bone in figure.bones if bone.dofs]
    values = _regular(lines[first:], moving)
    if values is None:
        values = _careful(lines, first, path, figure, moving)
    if not radians:
        turns = [dof[0] == "r" for bone in moving for dof in bone.dofs]
        values[:, turns] = np.radians(values[:, turns])
    return values


def _regular(lines: list[bytes], moving: list[Bone]) -> Array | None:
    """The numbers of a file in which every frame lists the same bones in the same order; None if it does not."""
    words = b" ".join(lines).split()
    width = 1 + sum(1 + len(bone.dofs) for bone in moving)
    frames = len(words) // width
    if not frames or len(words) % width or len(lines) < frames * (1 + len(moving)):
        return None
    sizes = {bone.name.encode(): len(bone.dofs) for bone in moving}
    keep, columns, at = np.zeros(width, bool), {}, 1
    keep[0] = True  # the frame's number, checked as a number
    while at < width:
        name = words[at]
        if name not in sizes or name in columns or words[at::width] != [name] * frames:
            return None
        columns[name] = np.arange(at + 1, at + 1 + sizes[name])
        keep[columns[name]] = True
        at += 1 + sizes[name]
    block = b" ".join(np.array(words, object).reshape(frames, width)[:, keep].ravel().tolist())
    values = numbers(block, frames * int(keep.sum())) if is_numeric(block) else None
    if values is None:
        return None
    table = np.empty((frames, width))
    table[:, keep] = values.reshape(frames, -1)
    if not np.array_equal(table[:, 0], table[0, 0] + np.arange(frames)):
        return None
    return table[:, np.concatenate([columns[bone.name.encode()] for bone in moving])]


def _careful(lines: list[bytes], first: int, path: Path, figure: Figure, moving: list[Bone]) -> Array:
    """The same line by line, for files in other orders; raises InputError where something is wrong."""
    sizes = {bone.name: len(bone.dofs) for bone in figure.bones}
    rows: list[list[float]] = []
    frame: dict[str, list[float]] = {}
    numbered: int | None = None

    def close(where: str) -> None:
        for bone in moving:
            if bone.name not in frame:
                raise InputError(f"frame {numbered} has no line for {bone.name!r}", where=where)
        rows.append([value for bone in moving for value in frame[bone.name]])
        frame.clear()

    for at, text in enumerate(lines[first:], first + 1):
        where, words = f"{path}:{at}", text.split()
        if not words or words[0].startswith(b"#"):
            continue
        if len(words) == 1 and words[0].isdigit():
            if numbered is not None:
                close(where)
                if int(words[0]) != numbered + 1:
                    raise InputError(f"frame {int(words[0])} follows frame {numbered}", where=where)
            numbered = int(words[0])
            continue
        name = decoded(words[0])
        if numbered is None:
            raise InputError(f"found {name!r} before the first frame", where=where, expected="a frame's number")
        if name not in sizes:
            hint = nearest_names(name, sizes)
            raise InputError(f"no bone is called {name!r} in the ASF", where=where, hint=hint)
        if name in frame:
            raise InputError(f"a second line for {name!r} in frame {numbered}", where=where)
        frame[name] = [number(word, lambda: where) for word in words[1:]]  # noqa: B023 (called at once)
        if len(frame[name]) != sizes[name]:
            count = f"{sizes[name]}, as in the ASF"
            raise InputError(f"{len(words) - 1} numbers for {name!r}", where=where, expected=count)
    close(f"{path}:{len(lines)}")
    return np.array(rows)


def _rig(figure: Figure, values: Array, units: Units) -> Rig:
    """Local turns and shifts in metres and Y up, from `values (frames, freedoms)` in radians and file units."""
    frames, bones = len(values), figure.bones
    offsets = np.array([np.zeros(3) if up < 0 else bones[up].vector for up in figure.parents])
    offsets[0] = figure.position
    translations = np.broadcast_to(offsets, (frames, len(bones), 3)).copy()
    rotations = np.broadcast_to(IDENTITY, (frames, len(bones), 4)).copy()
    column = 0
    for joint, bone in enumerate(bones):
        order, turns = "", []
        for dof in bone.dofs:
            if dof[0] == "t":
                translations[:, joint, "xyz".index(dof[1])] += values[:, column]
            else:
                order, turns = dof[1].upper() + order, [column, *turns]
            column += 1
        if order:
            turn = from_euler(order, values[:, turns])
            rotations[:, joint] = multiply(multiply(bone.axes, turn), inverse(bone.axes))
    if units.up != "y":
        rotations[..., :3] = rotations[..., :3] @ rotation_to_y_up(units.up).T
    has_child = set(figure.parents)
    return Rig(
        skeleton=Skeleton(tuple(bone.name for bone in bones), tuple(figure.parents)),
        rotations=rotations,
        translations=to_metres(translations, units),
        trusted=np.ones((frames, len(bones)), bool),
        offsets=to_metres(offsets, units),
        moves=np.array([any(dof[0] == "t" for dof in bone.dofs) for bone in bones]),
        orders=tuple("XYZ" if any(dof[0] == "r" for dof in bone.dofs) else "" for bone in bones),
        ends=tuple(
            (joint, to_metres(bone.vector, units)) for joint, bone in enumerate(bones) if joint not in has_child
        ),
    )
