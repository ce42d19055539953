"""GLB: the file is taken apart here by other means, and by Blender where it is at hand."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import warnings
from dataclasses import replace

import numpy as np
import pytest

import motionmend as mm
from motionmend.motion import Motion, Rig, Skeleton, Take, Units

UNITS = Units(1.0, "y", "")
COMPONENTS = {5123: ("<u2", 2), 5125: ("<u4", 4), 5126: ("<f4", 4)}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def opened(path):
    """The JSON and the accessors' arrays of a GLB file, every rule of the container checked on the way."""
    raw = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", raw)
    assert (magic, version, length) == (b"glTF", 2, len(raw)) and length % 4 == 0
    size, kind = struct.unpack_from("<I4s", raw, 12)
    assert kind == b"JSON" and size % 4 == 0
    document = json.loads(raw[20 : 20 + size], parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    data_size, kind = struct.unpack_from("<I4s", raw, 20 + size)
    assert kind == b"BIN\0" and data_size % 4 == 0 and 28 + size + data_size == len(raw)
    data = raw[28 + size :]
    assert document["buffers"] == [{"byteLength": data_size}]
    arrays, used = [], 0
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        dtype, width = COMPONENTS[accessor["componentType"]]
        count = accessor["count"] * WIDTHS[accessor["type"]]
        assert view["byteOffset"] % 4 == 0 and view["byteLength"] == count * width
        assert view["byteOffset"] + view["byteLength"] <= data_size
        used += view["byteLength"]
        array = np.frombuffer(data, dtype, count, view["byteOffset"]).reshape(accessor["count"], -1)
        assert np.isfinite(array).all()
        np.testing.assert_array_equal(array.min(0), np.array(accessor["min"], array.dtype))
        np.testing.assert_array_equal(array.max(0), np.array(accessor["max"], array.dtype))
        arrays.append(array)
    assert data_size - used <= 3 * len(arrays)
    return document, arrays


def matrix(node, at):
    """A node's local matrix with the animated values `at` in place of its own."""
    x, y, z, w = at.get("rotation", node.get("rotation", [0, 0, 0, 1]))
    assert abs(x * x + y * y + z * z + w * w - 1) < 1e-5
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, :3] *= at.get("scale", node.get("scale", [1, 1, 1]))
    out[:3, 3] = at.get("translation", node.get("translation", [0, 0, 0]))
    return out


def world(document, arrays, time):
    """World matrices of all nodes by name at a time at which all sampled channels have a key, or hold one."""
    animated = [{} for _ in document["nodes"]]
    for channel in document.get("animations", [{"channels": []}])[0]["channels"]:
        sampler = document["animations"][0]["samplers"][channel["sampler"]]
        times, values = arrays[sampler["input"]][:, 0], arrays[sampler["output"]]
        assert len(times) == len(values) and (np.diff(times) > 0).all()
        if sampler["interpolation"] == "STEP":
            value = values[np.searchsorted(times, time + 1e-6, "right") - 1]
        else:
            value = [np.interp(time, times, column) for column in values.T]
        animated[channel["target"]["node"]][channel["target"]["path"]] = value
    found = {}

    def visit(index, above):
        node = document["nodes"][index]
        found[node["name"]] = here = above @ matrix(node, animated[index])
        for child in node.get("children", ()):
            visit(child, here)

    for root in document["scenes"][0]["nodes"]:
        visit(root, np.eye(4))
    return found


def arm(frames=30, seed=2):
    """A rig of two chains from one root, one joint of which also shifts, with turns of more than a half circle."""
    rng = np.random.default_rng(seed)
    skeleton = Skeleton(("root", "upper", "lower", "slider", "tip"), (-1, 0, 1, 0, 3))
    angles = np.cumsum(rng.normal(0, 0.5, (frames, 5, 1)), axis=0)
    axis = rng.normal(size=(5, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    rotations = np.concatenate([axis * np.sin(angles / 2), np.cos(angles / 2)], axis=-1)
    rotations *= rng.choice([-1, 1], (frames, 5, 1))  # signs that jump, as they may
    offsets = rng.normal(0, 0.3, (5, 3))
    translations = np.tile(offsets, (frames, 1, 1))
    moves = np.array([True, False, False, True, False])
    translations[:, moves] = rng.normal(0, 1, (frames, 2, 3))
    trusted = np.ones((frames, 5), bool)
    rig = Rig(skeleton, rotations, translations, trusted, offsets, moves, ("ZXY",) * 5, ((4, np.array([0, 0.1, 0])),))
    return Take(rig.motion(60.0), rig, None, UNITS, "made", "arm.made")


def test_a_rig_moves_as_it_should(tmp_path):
    take = arm()
    document, arrays = opened(mm.save(take, tmp_path / "arm.glb"))
    for frame in range(len(take)):
        nodes = world(document, arrays, np.float32(frame / 60))
        for joint, name in enumerate(take.skeleton.names):
            np.testing.assert_allclose(nodes[name][:3, 3], take.motion.positions[frame, joint], atol=2e-6)


def test_between_keys_rotations_take_the_short_way(tmp_path):
    document, arrays = opened(mm.save(arm(), tmp_path / "arm.glb"))
    turning = [c for c in document["animations"][0]["channels"] if c["target"]["path"] == "rotation"]
    assert len(turning) == 5
    for channel in turning:
        values = arrays[document["animations"][0]["samplers"][channel["sampler"]]["output"]]
        assert (np.sum(values[1:] * values[:-1], axis=1) > 0).all()


def test_the_skin_binds_the_rest_pose(tmp_path):
    take = arm()
    document, arrays = opened(mm.save(take, tmp_path / "arm.glb"))
    rest = {}
    for joint, parent in enumerate(take.skeleton.parents):
        rest[joint] = take.rig.offsets[joint] + (rest[parent] if parent >= 0 else 0)
    [skin] = document["skins"]
    assert [document["nodes"][node]["name"] for node in skin["joints"]] == list(take.skeleton.names)
    for joint, inverse in enumerate(arrays[skin["inverseBindMatrices"]].reshape(-1, 4, 4)):
        # Column by column in the file.
        np.testing.assert_allclose(inverse.T @ [*rest[joint], 1], [0, 0, 0, 1], atol=1e-6)
    [primitive] = document["meshes"][0]["primitives"]
    points = arrays[primitive["attributes"]["POSITION"]]
    owners, weights = (arrays[primitive["attributes"][key]] for key in ("JOINTS_0", "WEIGHTS_0"))
    assert arrays[primitive["indices"]].max() == len(points) - 1
    assert owners.max() < len(skin["joints"])
    np.testing.assert_array_equal(weights.sum(1), 1)
    # A bone's octahedron starts at its joint and ends at the next one.
    for start, end in ((0, 1), (1, 2), (0, 3), (3, 4)):
        own = points[owners[:, 0] == start]
        for place in (rest[start], rest[end]):
            assert np.linalg.norm(own - place, axis=1).min() < 1e-6
    assert np.linalg.norm(points[owners[:, 0] == 4] - (rest[4] + [0, 0.1, 0]), axis=1).min() < 1e-6


def test_another_parser_reads_it(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the oracle's own dependencies warn of is not ours
        import pygltflib

    path = mm.save(arm(), tmp_path / "arm.glb")
    document = pygltflib.GLTF2().load(str(path))
    assert document is not None
    assert len(document.animations) == 1 and len(document.skins) == 1 and len(document.nodes) == 7


def test_untrusted_joints_have_no_keys_there(tmp_path):
    take = arm()
    mask = np.zeros((30, 5), bool)
    mask[10:20, 1], mask[:, 2] = True, True
    document, arrays = opened(mm.save(take.distrust(mask), tmp_path / "arm.glb"))
    animation = document["animations"][0]
    assert animation["extras"]["samples_without_key"] == mask.sum()
    names = [document["nodes"][channel["target"]["node"]]["name"] for channel in animation["channels"]]
    assert "lower" not in names
    for name, channel in zip(names, animation["channels"]):
        times = arrays[animation["samplers"][channel["sampler"]]["input"]][:, 0]
        expected = [f for f in range(30) if name != "upper" or not 10 <= f < 20]
        np.testing.assert_allclose(times * 60, expected, atol=1e-4)


def cloud(observed):
    frames, points = observed.shape
    positions = np.random.default_rng(1).normal(size=(frames, points, 3)).astype(np.float32)
    positions[~observed] = np.nan
    motion = Motion(positions, observed, 100.0, Skeleton.cloud([f"m{i}" for i in range(points)]))
    return Take(motion, None, None, UNITS, "made", "cloud.made")


def test_points_are_where_they_were_seen_and_hidden_elsewhere(tmp_path):
    observed = np.ones((12, 4), bool)
    observed[3:6, 1], observed[:2, 2], observed[11, 2], observed[:, 3] = False, False, False, False
    take = cloud(observed)
    document, arrays = opened(mm.save(take, tmp_path / "cloud.glb"))
    for frame in range(12):
        nodes = world(document, arrays, np.float32(frame / 100))
        for point, name in enumerate(take.skeleton.names):
            size = np.linalg.norm(nodes[name][:3, :3], axis=0)
            np.testing.assert_allclose(size, float(observed[frame, point]), atol=1e-6)
            if observed[frame, point]:
                np.testing.assert_allclose(nodes[name][:3, 3], take.motion.positions[frame, point], atol=1e-5)


@pytest.mark.parametrize("observed", [np.ones((1, 1), bool), np.zeros((3, 2), bool)])
def test_one_frame_and_nothing_seen(tmp_path, observed):
    document, _ = opened(mm.save(cloud(observed), tmp_path / "cloud.glb"))
    assert ("animations" in document) == observed.any()


def test_a_rig_of_one_joint_and_one_frame(tmp_path):
    rig = arm(1).rig
    one = {name: getattr(rig, name)[:, :1] for name in ("rotations", "translations", "trusted")}
    rig = Rig(Skeleton(("only",), (-1,)), **one, offsets=rig.offsets[:1], moves=rig.moves[:1], orders=("",))
    take = Take(rig.motion(60.0), rig, None, UNITS, "made", "arm.made")
    document, arrays = opened(mm.save(take, tmp_path / "one.glb"))
    found = world(document, arrays, 0)["only"][:3, 3]
    np.testing.assert_allclose(found, take.motion.positions[0, 0], atol=1e-6)


def test_it_cannot_be_read(tmp_path):
    path = mm.save(arm(), tmp_path / "arm.glb")
    with pytest.raises(mm.InputError, match="written but not read"):
        mm.load(path)


def real_take(cmu):
    return mm.load(sorted((cmu / "06").glob("*.bvh"))[0])


def test_a_real_take_moves_as_it_should(cmu, tmp_path):
    take = real_take(cmu)
    document, arrays = opened(mm.save(take, tmp_path / "take.glb"))
    for frame in np.linspace(0, len(take) - 1, 5).astype(int):
        nodes = world(document, arrays, np.float32(frame / take.fps))
        found = [nodes[name][:3, 3] for name in take.skeleton.names]
        np.testing.assert_allclose(found, take.motion.positions[frame], atol=1e-5)


IN_BLENDER = """
import json, sys, bpy
path, fps, frames, out = sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3]), sys.argv[4]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.render.fps_base = round(fps), round(fps) / fps
bpy.ops.import_scene.gltf(filepath=path)
armatures = [each for each in bpy.data.objects if each.type == "ARMATURE"]
found = []
for frame in frames:
    scene.frame_set(frame)
    if armatures:
        [body] = armatures
        places = {bone.name: (body.matrix_world @ bone.matrix).translation for bone in body.pose.bones}
    else:
        shown = [each for each in bpy.data.objects if each.matrix_world.median_scale]
        places = {each.name: each.matrix_world.translation for each in shown}
    # Blender is Z up.
    found.append({name: [p.x, p.z, -p.y] for name, p in places.items()})
skinned = [each.name for each in bpy.data.objects if any(m.type == "ARMATURE" for m in each.modifiers)]
with open(out, "w") as file:
    json.dump({"armatures": len(armatures), "skinned": skinned, "found": found}, file)
"""


def in_blender(path, fps, frames, tmp_path):
    python = os.environ.get("MOTIONMEND_BPY_PYTHON")
    if not python:
        pytest.skip("no Blender: MOTIONMEND_BPY_PYTHON does not name a Python that has bpy")
    (tmp_path / "script.py").write_text(IN_BLENDER)
    frames = json.dumps([int(frame) for frame in frames])
    command = [python, str(tmp_path / "script.py"), str(path), repr(fps), frames, str(tmp_path / "out.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads((tmp_path / "out.json").read_text())


def test_blender_shows_a_real_take_as_an_armature_that_moves_right(cmu, tmp_path):
    take = real_take(cmu)
    frames = [0, 1, 2, len(take) // 2, len(take) - 1]
    said = in_blender(mm.save(take, tmp_path / "take.glb"), take.fps, frames, tmp_path)
    assert said["armatures"] == 1 and said["skinned"] == ["bones"]
    for frame, places in zip(frames, said["found"]):
        assert set(places) == set(take.skeleton.names)
        found = [places[name] for name in take.skeleton.names]
        np.testing.assert_allclose(found, take.motion.positions[frame], atol=1e-4)


def test_blender_shows_points_where_they_are(tmp_path):
    observed = np.ones((12, 3), bool)
    observed[3:6, 1] = False
    take = cloud(observed)
    said = in_blender(mm.save(take, tmp_path / "cloud.glb"), take.fps, range(12), tmp_path)
    for frame, places in enumerate(said["found"]):
        for point, name in enumerate(take.skeleton.names):
            assert (name in places) == observed[frame, point]
            if observed[frame, point]:
                np.testing.assert_allclose(places[name], take.motion.positions[frame, point], atol=1e-4)


def test_the_source_names_the_scene(tmp_path):
    document, _ = opened(mm.save(replace(arm(), source="/a/b/Ännchen läuft.bvh"), tmp_path / "arm.glb"))
    assert document["scenes"][0]["name"] == "Ännchen läuft"
