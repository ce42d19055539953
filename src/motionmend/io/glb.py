"""GLB, the binary form of glTF 2.0: written only, as an animated skeleton that Blender and game engines open.

A rig becomes a node for each joint with its rest offset, a skin with a thin octahedron for each bone, and an
animation of the joints' turns, and of the shifts of those that move. Points become small octahedra that move
on their own. Metres, Y up, right-handed: as glTF has it. Keys are one a frame, at `frame / fps` seconds.

What is not trusted has no key. A point is then hidden (its scale is 0); a joint is carried from key to key by
whatever plays the file, and `extras` of the animation says how many such samples there are.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..motion import Motion, Rig, Take, runs
from ..rotations import apply, between, continuous, normalised

Array = np.ndarray

FLOAT, USHORT, UINT = 5126, 5123, 5125  # glTF's numbers for types
VERTICES, INDICES = 34962, 34963  # and for what a buffer is bound to
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_NUMBERS = {"f": (FLOAT, "<f4"), "u": (USHORT, "<u2"), "i": (UINT, "<u4")}
_MARKER = 0.012  # metres from a marker's middle to its corners
_UP = np.array([0, 0.05, 0])

_OCTAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
_FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1], [5, 2, 1], [5, 3, 2], [5, 4, 3], [5, 1, 4]])


class _Scene:
    """A glTF document under construction: its JSON, and the one buffer that all arrays go to."""

    def __init__(self, name: str):
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "motionmend"},
            "scene": 0,
            "scenes": [{"name": name, "nodes": []}],
            **{key: [] for key in ("nodes", "meshes", "materials", "accessors", "bufferViews")},
            "animations": [{"name": name, "samplers": [], "channels": [], "extras": {}}],
        }
        self.json["materials"].append({"pbrMetallicRoughness": {"baseColorFactor": [0.35, 0.55, 0.8, 1.0]}})
        self._data: list[bytes] = []
        self._size = 0
        self._stored_times: dict[bytes, int] = {}

    def add(self, key: str, value: dict[str, Any]) -> int:
        """Append to one of the document's lists; returns the index."""
        self.json[key].append(value)
        return len(self.json[key]) - 1

    def array(self, values: Array, target: int | None = None) -> int:
        """Store `(count, ...)` numbers; returns the accessor's index."""
        component, dtype = _NUMBERS[values.dtype.kind]
        stored = np.ascontiguousarray(values, dtype)
        flat = stored.reshape(len(stored), -1)
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": stored.nbytes}
        accessor = {
            "bufferView": self.add("bufferViews", view if target is None else {**view, "target": target}),
            "componentType": component,
            "count": len(stored),
            "type": _KINDS[stored.shape[1:]],
            "min": flat.min(axis=0).tolist(),
            "max": flat.max(axis=0).tolist(),
        }
        data = stored.tobytes() + b"\0" * (-stored.nbytes % 4)
        self._data.append(data)
        self._size += len(data)
        return self.add("accessors", accessor)

    def animate(self, node: int, path: str, times: Array, values: Array, step: bool = False) -> None:
        """Keys `values (keys, 3 or 4)` at `times (keys,)` seconds for a node's translation, rotation or scale."""
        if (values == values[0]).all():
            times, values = times[:1], values[:1]
        [animation] = self.json["animations"]
        sampler = {
            "input": self._times(times),
            "output": self.array(values.astype(np.float32)),
            "interpolation": "STEP" if step else "LINEAR",
        }
        animation["samplers"].append(sampler)
        target = {"node": node, "path": path}
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})

    def _times(self, times: Array) -> int:
        # Nearly all channels have the same keys: those are stored once.
        key = times.tobytes()
        if key not in self._stored_times:
            self._stored_times[key] = self.array(times.astype(np.float32))
        return self._stored_times[key]

    def mesh(self, name: str, vertices: Array, faces: Array, **attributes: int) -> int:
        primitive = {
            "attributes": {"POSITION": self.array(vertices.astype(np.float32), VERTICES), **attributes},
            "indices": self.array(faces.ravel().astype(np.int64), INDICES),
            "material": 0,
        }
        return self.add("meshes", {"name": name, "primitives": [primitive]})

    def bytes(self) -> bytes:
        """The file: a header of 12 bytes, a chunk of JSON and a chunk of numbers, each padded to 4 bytes."""
        document = {key: value for key, value in self.json.items() if value}
        if not self.json["animations"][0]["channels"]:
            del document["animations"]
        document["buffers"] = [{"byteLength": self._size}]
        text = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
        text += b" " * (-len(text) % 4)
        data = b"".join(self._data)
        header = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(data))
        return b"".join(
            [header, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(data), b"BIN\0"), data]
        )


def write(take: Take, path: Path) -> None:
    """Write a take: its rig if it has one, else its points."""
    scene = _Scene(Path(take.source).stem or "take")
    if take.rig is not None:
        _add_rig(scene, take.rig, take.fps)
    else:
        _add_points(scene, take.motion)
    path.write_bytes(scene.bytes())


def _add_rig(scene: _Scene, rig: Rig, fps: float) -> None:
    names, parents, offsets = rig.skeleton.names, rig.skeleton.parents, rig.offsets
    nodes = [
        scene.add("nodes", {"name": name, "translation": offset.tolist()}) for name, offset in zip(names, offsets)
    ]
    for joint, children in enumerate(rig.skeleton.children):
        if children:
            scene.json["nodes"][nodes[joint]]["children"] = [nodes[child] for child in children]
    roots = [nodes[joint] for joint, parent in enumerate(parents) if parent < 0]
    holder = scene.add("nodes", {"name": scene.json["scenes"][0]["name"], "children": roots})

    rest = offsets.astype(float).copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            rest[joint] += rest[parent]
    # Columns first, as glTF stores matrices: the shift stands in the last row here.
    binding = np.tile(np.eye(4), (len(nodes), 1, 1))
    binding[:, 3, :3] = -rest
    skin = {"joints": nodes, "inverseBindMatrices": scene.array(binding), "skeleton": holder}
    scene.json["skins"] = [skin]
    vertices, faces, owners = _bones(rig, rest)
    weights = np.zeros((len(vertices), 4))
    weights[:, 0] = 1
    bound = np.zeros((len(vertices), 4), np.uint16)
    bound[:, 0] = owners
    mesh = scene.mesh(
        "bones", vertices, faces, JOINTS_0=scene.array(bound, VERTICES), WEIGHTS_0=scene.array(weights, VERTICES)
    )
    body = scene.add("nodes", {"name": "bones", "mesh": mesh, "skin": 0})
    scene.json["scenes"][0]["nodes"] += [holder, body]

    times = np.arange(len(rig.rotations)) / fps
    untrusted = 0
    for joint, node in enumerate(nodes):
        keys = rig.trusted[:, joint]
        untrusted += int((~keys).sum())
        if not keys.any():
            continue
        turns = continuous(normalised(rig.rotations[keys, joint]))
        if rig.orders[joint] or not np.allclose(turns, [0, 0, 0, 1], atol=1e-9):
            scene.animate(node, "rotation", times[keys], turns)
        shifts = rig.translations[keys, joint]
        if rig.moves[joint] or not np.allclose(shifts, offsets[joint], atol=1e-9):
            scene.animate(node, "translation", times[keys], shifts)
    _say_untrusted(scene, untrusted)


def _bones(rig: Rig, rest: Array) -> tuple[Array, Array, Array]:
    """An octahedron from each joint to each of its children and ends, in the rest pose: vertices, faces, owners."""
    bones = [(parent, rest[joint]) for joint, parent in enumerate(rig.skeleton.parents) if parent >= 0]
    bones += [(joint, rest[joint] + offset) for joint, offset in rig.ends]
    bones = [(joint, tip) for joint, tip in bones if np.linalg.norm(tip - rest[joint]) > 1e-6]
    # A rig of single joints still needs something to see.
    bones = bones or [(joint, place + _UP) for joint, place in enumerate(rest)]
    owners = np.array([joint for joint, _ in bones])
    along = np.array([tip for _, tip in bones]) - rest[owners]
    length = np.linalg.norm(along, axis=-1)
    shape = _OCTAHEDRON * [0.08, 1, 0.08] + (_OCTAHEDRON[:, 1:2] == 0) * [0, 0.15, 0]
    shape[0] = 0
    upright = np.broadcast_to([0.0, 1.0, 0.0], along.shape)
    turned = apply(between(upright, along)[:, None], np.broadcast_to(shape, (len(bones), *shape.shape)))
    vertices = rest[owners][:, None] + turned * length[:, None, None]
    faces = _FACES + len(shape) * np.arange(len(bones))[:, None, None]
    return vertices.reshape(-1, 3), faces, np.repeat(owners, len(shape))


def _add_points(scene: _Scene, motion: Motion) -> None:
    shape = (_OCTAHEDRON * [1, 2, 1] + (_OCTAHEDRON[:, 1:2] == 0) * [0, 1, 0] - [0, 1, 0]) * _MARKER
    shape[0] = [0, -_MARKER, 0]
    mesh = scene.mesh("marker", shape, _FACES)
    times = np.arange(len(motion)) / motion.fps
    nodes = []
    for point, name in enumerate(motion.skeleton.names):
        seen = motion.observed[:, point]
        node: dict[str, Any] = {"name": name, "mesh": mesh}
        if not seen.any():
            node["scale"] = [0.0, 0.0, 0.0]
        nodes.append(scene.add("nodes", node))
        if not seen.any():
            continue
        scene.animate(nodes[-1], "translation", times[seen], motion.positions[seen, point])
        if not seen.all():
            edges = np.unique([0, *(frame for run in runs(seen) for frame in run if frame < len(motion))])
            shown = np.repeat(seen[edges, None].astype(float), 3, axis=1)
            scene.animate(nodes[-1], "scale", times[edges], shown, step=True)
    scene.json["scenes"][0]["nodes"].append(
        scene.add("nodes", {"name": scene.json["scenes"][0]["name"], "children": nodes})
    )
    _say_untrusted(scene, int((~motion.observed).sum()))


def _say_untrusted(scene: _Scene, count: int) -> None:
    scene.json["animations"][0]["extras"] = {"samples_without_key": count}
