"""BVH: a hierarchy of joints, and one row of channels a frame.

Conventions: rotations are intrinsic in the order of CHANNELS, degrees; a position channel replaces the
OFFSET on its axis; End Sites are not joints. Writing back replaces only the words of changed cells.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..body.measures import measure
from ..errors import InputError
from ..motion import Rig, Skeleton, Take, Units
from ..rotations import IDENTITY, forward_kinematics
from ..units import Hints, from_metres, resolve, rotation_to_y_up, to_metres
from . import _points
from ._bvh_text import Reader, Tree
from ._euler import follow, turns

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Document:
    """A BVH file as it was read.

    rows : `(frames, 2)` where each frame's text begins and ends in `raw`. channels : `(frames, columns)`.
    """

    raw: bytes
    rows: Array
    channels: Array
    tree: Tree
    rig: Rig


def read(path: Path, hints: Hints) -> Take:
    """A take from a BVH file. Raises InputError with the line for whatever is wrong in it."""
    raw = path.read_bytes()
    reader = Reader(raw, path)
    tree = reader.hierarchy()
    notes: list[str] = []
    fps, declared = reader.motion_header(hints, notes)
    channels, rows = reader.frames(tree, declared, notes)
    skeleton = Skeleton(tuple(_points.unique(tree.names, notes)), tuple(tree.parents))

    few = channels[sorted(set(np.linspace(0, len(channels) - 1, 50).astype(int).tolist()))]
    plain = _rig(tree, skeleton, few, Units(1.0, "y", ""))
    pose, unturned = plain.kinematics[0], np.broadcast_to(IDENTITY, (1, len(skeleton), 4))
    rest = forward_kinematics(unturned, plain.offsets[None], skeleton.parents)[0][0]
    units = resolve(hints, usual_unit="cm", **measure(skeleton, pose, rest))
    rig = _rig(tree, skeleton, channels, units)
    document = Document(raw, rows, channels, tree, rig)
    return Take(rig.motion(fps), rig, document, units, "bvh", str(path), tuple(notes))


def _rig(tree: Tree, skeleton: Skeleton, channels: Array, units: Units) -> Rig:
    """The local turns and shifts, in metres and Y up, of rows of channels."""
    frames, joints = len(channels), len(skeleton)
    offsets = np.array(tree.offsets)
    translations = np.broadcast_to(offsets, (frames, joints, 3)).copy()
    moves = np.zeros(joints, bool)
    for joint, axis, column in tree.shifts:
        translations[:, joint, axis] = channels[:, column]
        moves[joint] = True
    rotations = np.zeros((frames, joints, 4))
    rotations[..., 3] = 1
    for order in set(tree.orders) - {""}:
        alike = [joint for joint in range(joints) if tree.orders[joint] == order]
        columns = np.array([tree.turns[joint] for joint in alike])
        block = max(1, 65536 // columns.size)  # frames at once: few enough to stay small in memory
        for start in range(0, frames, block):
            angles = np.radians(channels[start : start + block, columns])
            rotations[start : start + block, alike] = turns(order, angles)
    if units.up != "y":
        # A L A^-1 as a quaternion: the axis turned by A, the angle kept.
        rotations[..., :3] = rotations[..., :3] @ rotation_to_y_up(units.up).T
    return Rig(
        skeleton=skeleton,
        rotations=rotations,
        translations=to_metres(translations, units),
        trusted=np.ones((frames, joints), bool),
        offsets=to_metres(offsets, units),
        moves=moves,
        orders=tuple(tree.orders),
        ends=tuple((joint, to_metres(np.array(offset), units)) for joint, offset in tree.ends),
    )


def write(take: Take, path: Path) -> None:
    """Write a take as BVH.

    One that was read from BVH gets its own file back, byte for byte, but for the channels of the cells (frame,
    joint) whose local turn or shift differs from what was read. Their numbers keep the column's decimals, and
    have at least six; Euler angles run on from their neighbours; a joint that cannot express a turn takes the
    nearest that it can.

    Any other take becomes a new file in its own units, Y up. Bones without a rig (points) become joints with
    position channels and no turns. InputError for marker clouds, and for points with samples missing.
    """
    document = take.document
    if isinstance(document, Document) and take.rig is not None and _same_figure(take.rig, document.rig):
        pieces = _patched(document, take.rig, take.units)
    else:
        pieces = _fresh(_rig_of_points(take) if take.rig is None else take.rig, take)
    with path.open("wb") as file:
        file.writelines(pieces)


def spliced(pieces: Sequence[tuple[Take, Array]], fps: float) -> Document | None:
    """One document of frames from several takes: what a take that is put together from them is written into.

    Every row is the text of the frame that it is from, so that `write` keeps the spelling of all that was not changed.

    pieces : takes that were read from BVH, and `(frames,)` indices into each. fps : of the result.

    None where there is no such document: takes of other formats, trees, offsets or units, and a root that cannot move.
    """
    documents = [take.document for take, _ in pieces]
    first, units = documents[0], pieces[0][0].units
    for (take, _), document in zip(pieces, documents):
        alike = isinstance(document, Document) and document.tree == first.tree
        if not alike or (take.units.metres, take.units.up) != (units.metres, units.up):
            return None
    roots = np.array(first.rig.skeleton.parents) < 0
    if not first.rig.moves[roots].all():
        return None
    rows = [document.raw[start:stop].strip() for (_, frames), document in zip(pieces, documents)
            for start, stop in document.rows[frames].tolist()]  # fmt: skip
    head = first.raw[: first.rows[0, 0]]
    at = head.upper().rfind(b"MOTION")
    motion = re.sub(rb"(?i)(Frames[ \t]*:?[ \t]*)\S+", lambda found: found[1] + b"%d" % len(rows), head[at:], count=1)
    if abs(fps - pieces[0][0].fps) > 1e-6 * fps:
        time = f"{1 / fps:.9g}".encode()
        motion = re.sub(rb"(?i)(Frame[ \t_]*Time[ \t]*:?[ \t]*)\S+", lambda found: found[1] + time, motion, count=1)
    feed = b"\r\n" if b"\r\n" in head else b"\n"
    head = head[:at] + motion
    stops = len(head) + np.cumsum([len(row) + len(feed) for row in rows]) - len(feed)
    starts = stops - [len(row) for row in rows]
    rotations, translations = (
        np.concatenate([getattr(document.rig, name)[frames] for (_, frames), document in zip(pieces, documents)])
        for name in ("rotations", "translations")
    )
    rig = replace(first.rig, rotations=rotations, translations=translations,
                  trusted=np.ones(rotations.shape[:2], bool))  # fmt: skip
    channels = np.concatenate([document.channels[frames] for (_, frames), document in zip(pieces, documents)])
    raw = head + feed.join(rows) + feed
    return Document(raw, np.column_stack([starts, stops]), channels, first.tree, rig)


def held(take: Take, frame: int, frames: int) -> Document | None:
    """The document of a take in which one frame lasts for so many, at the rate the take has now; see `spliced`."""
    reader = Reader(take.document.raw, Path(take.source))
    reader.hierarchy()
    try:
        said = reader.motion_header(Hints(), [])[0]
    except InputError:
        said = 2 * take.fps  # a rate that could not be, and another was asked for
    as_said = replace(take, motion=replace(take.motion, fps=said))
    return spliced([(as_said, np.full(frames, frame))], take.fps)


def _same_figure(rig: Rig, other: Rig) -> bool:
    return rig is other or (
        rig.rotations.shape == other.rotations.shape
        and rig.skeleton == other.skeleton
        and rig.orders == other.orders
        and np.array_equal(rig.offsets, other.offsets)
    )


def _patched(document: Document, rig: Rig, units: Units) -> Iterator[bytes]:
    """The file's bytes, with the words of changed cells replaced."""
    raw, was, tree = document.raw, document.rig, document.tree
    to_file = rotation_to_y_up(units.up)  # row vectors: file = y_up @ to_file
    channels, changed = document.channels.copy(), np.zeros(document.channels.shape, bool)

    turned = np.logical_or.reduce([rig.rotations[..., at] != was.rotations[..., at] for at in range(4)])
    # A quaternion and its negative are one rotation.
    turned[turned] = (rig.rotations[turned] != -was.rotations[turned]).any(-1)
    for joint in np.flatnonzero(turned.any(0)):
        frames, columns = turned[:, joint], tree.turns[joint]
        if columns:
            wanted = rig.rotations[frames, joint]
            if units.up != "y":
                wanted[:, :3] = wanted[:, :3] @ to_file
            angles = follow(tree.orders[joint], wanted, np.radians(channels[:, columns]), frames)
            channels[np.ix_(frames, columns)] = np.degrees(angles[frames])
            changed[np.ix_(frames, columns)] = True

    moved = (rig.translations != was.translations) @ np.abs(to_file).astype(bool)
    for joint, axis, column in tree.shifts:
        frames = moved[:, joint, axis]
        channels[frames, column] = from_metres(rig.translations[frames, joint], units)[:, axis]
        changed[:, column] = frames

    if not np.isfinite(channels).all():
        raise ValueError("a rig with NaN in it cannot be written")
    decimals = _decimals(document)
    for places in np.unique(decimals):
        alike = decimals == places
        channels[:, alike] = np.round(channels[:, alike], places) + 0.0  # no "-0.000000"
        # What would differ beyond the last place only keeps its spelling.
        changed[:, alike] &= np.abs(channels[:, alike] - document.channels[:, alike]) > 0.5 * 10.0**-places

    formats = [f"%.{places}f".encode() for places in decimals]
    done = 0
    for row in np.flatnonzero(changed.any(axis=1)):
        start, stop = document.rows[row].tolist()
        columns = np.flatnonzero(changed[row]).tolist()
        yield raw[done:start]
        yield _respelled(raw[start:stop], columns, formats) % tuple(channels[row, columns].tolist())
        done = stop
    yield raw[done:]


def _respelled(text: bytes, columns: list[int], spellings: list[bytes]) -> bytes:
    """A row with the words of `columns` replaced, and its white space as it was."""
    words = text.split()
    plain = b" ".join(words)
    for column in columns:
        words[column] = spellings[column]
    if text.startswith(plain):
        return b" ".join(words) + text[len(plain) :]
    spaces = re.split(rb"\S+", text)
    return b"".join(part for pair in zip(spaces, words) for part in pair) + spaces[-1]


def _decimals(document: Document) -> Array:
    """Places after the point to write in each column: as many as the file uses there, and six or more."""
    places = np.full(document.channels.shape[1], 6)
    for start, stop in document.rows[:: max(1, len(document.rows) // 50)]:
        words = document.raw[start:stop].split()
        spelled = [len(word.partition(b".")[2]) if b"e" not in word.lower() else 0 for word in words]
        places = np.maximum(places, spelled)
    return np.minimum(places, 15)


def _rig_of_points(take: Take) -> Rig:
    """Joints that are only shifted, never turned, from the positions of a skeleton."""
    if not take.skeleton.has_bones:
        raise InputError(
            "a cloud of markers has no bones, and BVH holds nothing else", where=take.source,
            hint="write .c3d, .trc, .csv, .npz or .glb",
        )
    motion = take.motion
    if not motion.observed.all():
        raise InputError(
            f"{int((~motion.observed).sum())} samples are missing, and BVH has no way to say so", where=take.source,
            hint="repair them first, or write .c3d, .trc, .csv or .npz",
        )
    shifts = motion.positions.astype(float)
    for joint, parent in enumerate(take.skeleton.parents):
        if parent >= 0:
            shifts[:, joint] -= motion.positions[:, parent]
    return Rig(
        skeleton=take.skeleton,
        rotations=np.broadcast_to(IDENTITY, (*shifts.shape[:2], 4)),
        translations=shifts,
        trusted=motion.observed,
        offsets=shifts[0],
        moves=np.ones(len(take.skeleton), bool),
        orders=("",) * len(take.skeleton),
    )


def _fresh(rig: Rig, take: Take) -> Iterator[bytes]:
    """A new file: roots and joints that move have six channels, the others three."""
    units = replace(take.units, up="y")
    offsets, shifts = from_metres(rig.offsets, units), from_metres(rig.translations, units)
    moves = rig.moves | (np.array(rig.skeleton.parents) < 0) | (rig.translations != rig.offsets).any(axis=(0, 2))
    ends: dict[int, list[Array]] = {}
    for joint, offset in rig.ends:
        ends.setdefault(joint, []).append(from_metres(offset, units))

    lines, columns = ["HIERARCHY"], []
    # Depth first, as the file nests; a closing brace waits on the stack as a string.
    roots = [joint for joint, parent in enumerate(rig.skeleton.parents) if parent < 0]
    waiting: list[tuple[int | str, str]] = [(joint, "") for joint in reversed(roots)]
    while waiting:
        joint, indent = waiting.pop()
        if isinstance(joint, str):
            lines.append(joint)
            continue
        name = re.sub(r"[{}\r\n]", "_", rig.skeleton.names[joint])
        order = rig.orders[joint] if sorted(rig.orders[joint]) == ["X", "Y", "Z"] else "ZXY"
        channels = [f"{axis}position" for axis in "XYZ"] * bool(moves[joint]) + [f"{axis}rotation" for axis in order]
        lines += [
            f"{indent}{'JOINT' if indent else 'ROOT'} {name}",
            f"{indent}{{",
            f"{indent}\tOFFSET {_spelled(offsets[joint])}",
            f"{indent}\tCHANNELS {len(channels)} {' '.join(channels)}",
        ]
        children = rig.skeleton.children[joint]
        for end in ends.get(joint, [] if children else [np.zeros(3)]):
            lines += [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {_spelled(end)}", f"{indent}\t}}"]
        waiting.append((f"{indent}}}", ""))
        waiting += [(child, indent + "\t") for child in reversed(children)]

        if moves[joint]:
            columns.append(shifts[:, joint])
        everywhere = np.ones(len(shifts), bool)
        angles = follow(order, rig.rotations[:, joint], np.zeros((len(shifts), 3)), everywhere)
        columns.append(np.degrees(angles))
    lines += ["MOTION", f"Frames: {len(shifts)}", f"Frame Time: {1 / take.fps:.9g}", ""]
    yield "\n".join(lines).encode()
    table = np.round(np.concatenate(columns, axis=1), 6) + 0.0
    row = " ".join(["%.6f"] * table.shape[1]) + "\n"
    for values in table:
        yield (row % tuple(values.tolist())).encode()


def _spelled(vector: Array) -> str:
    return " ".join(f"{value:.6f}" for value in np.round(vector, 6) + 0.0)
