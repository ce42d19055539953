"""The free pack: many skeletons in one table, people kept back, and takes that lie."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from motionmend.body.joints import BODY, JOINT
from motionmend.body.measures import stature
from motionmend.corpora.building import build
from motionmend.corpora.datasets import free
from motionmend.errors import InputError
from walks import WALK

LABORATORY = """HIERARCHY
ROOT Hips
{{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  {joints}
}}
MOTION
Frames: {frames}
Frame Time: 0.0333333
{rows}
"""


def chain(*joints: tuple[str, str]) -> str:
    """Nested joints of a BVH, each with its OFFSET."""
    name, offset = joints[0]
    inside = chain(*joints[1:]) if joints[1:] else "End Site { OFFSET 0 -5 0 }"
    return f"JOINT {name} {{ OFFSET {offset} CHANNELS 3 Zrotation Xrotation Yrotation {inside} }}"


def laboratory(frames: int = 60, tipped: bool = False) -> str:
    """A take on the laboratory's skeleton, which calls its collar bones by two kinds of names. tipped : it lies."""
    limbs = [chain((f"{side}UpLeg", f"{sign}9 -9 0"), (f"{side}Leg", "0 -44 1"), (f"{side}Foot", "0 -42 -1"),
                   (f"{side}Toes", "0 -4 9")) for side, sign in (("Right", "-"), ("Left", ""))]  # fmt: skip
    arms = [chain((collar, f"{sign}9 0 0"), (f"{side}Arm", f"{sign}10 0 0"), (f"{side}ForeArm", f"{sign}26 0 0"),
                  (f"{side}Hand", f"{sign}22 0 0"))
            for side, sign, collar in (("Left", "", "LeftShoulder1"), ("Right", "-", "RightShoulder"))]  # fmt: skip
    head = "JOINT Head { OFFSET 0 9 0 CHANNELS 3 Zrotation Xrotation Yrotation End Site { OFFSET 0 15 0 } }"
    trunk = ("JOINT Spine { OFFSET 0 12 0 CHANNELS 3 Zrotation Xrotation Yrotation JOINT Spine1 { OFFSET 0 26 0 "
             f"CHANNELS 3 Zrotation Xrotation Yrotation {head} {' '.join(arms)} }} }}")  # fmt: skip
    joints = " ".join([*limbs, trunk])
    names = re.findall(r"JOINT (\w+)", joints)
    down = np.zeros(3 * len(names))  # arms that hang: a T-pose is no motion
    down[3 * names.index("LeftArm")], down[3 * names.index("RightArm")] = -75, 75
    sway = np.sin(np.arange(frames) / 7)
    rows = []
    for frame in range(frames):
        angles = np.round(down + 8 * sway[frame] * np.sin(np.arange(len(down)) + frame / 9), 3)
        root = (f"{frame} 20 0 0 -90 0" if tipped else f"{frame} 98 0 0 0 0").split()
        rows.append(" ".join([*root, *map(str, angles)]))
    return LABORATORY.format(joints=joints, frames=frames, rows="\n".join(rows))


def pack(folder: Path, takes: dict[str, tuple[str, str]]) -> Path:
    """A pack of takes: file → (subject, BVH text), or no file where the text is empty."""
    rows = []
    for file, (subject, text) in takes.items():
        rows.append({"file": file, "subject": subject, "fps": "30.0", "licence": "Apache-2.0", "carrier": "a/b"})
        if text:
            path = folder / "free-motion" / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    with (folder / "free-motion.csv").open("w", newline="") as table:
        writer = csv.DictWriter(table, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    return folder


def test_people_kind_licence_and_what_is_not_there(tmp_path):
    source = pack(tmp_path, {
        "tiling/hys/multi-hys_dance.bvh": ("tiling:hys", laboratory()),
        "ys2010/woody2/Motion/Walking/wd2_u-turn.bvh": ("ys2010:unknown", laboratory()),
        "vsports/gone.bvh": ("vsports:session004-actor1", ""),
    })  # fmt: skip
    corpus = build("free", source, tmp_path / "x.corpus", fps=30)
    dance, walk = corpus.clips
    assert (dance.split, dance.subject, dance.licence) == ("validation", "tiling:hys", "Apache-2.0")
    assert (walk.split, walk.name) == ("train", "ys2010/woody2/Motion/Walking/wd2_u-turn")
    assert dance.notes[:2] == ("kind: dance", "carried by a/b") and walk.notes[0] == "kind: walking, turns"
    assert [each.file for each in corpus.dropped] == ["vsports/gone.bvh"]


def test_both_collar_bones_are_found(tmp_path):
    source = pack(tmp_path, {"ys2010/a.bvh": ("ys2010:unknown", laboratory())})
    corpus = build("free", source, tmp_path / "x.corpus", fps=30)
    assert corpus.observed[:, [JOINT["left_shoulder"], JOINT["right_shoulder"]]].all()


def test_who_lies_is_left_lying(tmp_path):
    source = pack(tmp_path, {"tiling/wd2/2-crawl.bvh": ("tiling:wd2 lab actor(s)", laboratory(tipped=True))})
    corpus = build("free", source, tmp_path / "x.corpus", fps=30)
    motion = corpus.motion(corpus.clips[0])
    rise = motion.positions[:, JOINT["head"], 1] - motion.positions[:, JOINT["hips"], 1]
    assert np.abs(rise).max() < 0.2


def test_meshes_are_no_joints(tmp_path):
    text = WALK.read_text()
    mesh = (
        "JOINT L_Humerus_RIGMESH { OFFSET 900 0 0 CHANNELS 3 Zrotation Xrotation Yrotation End Site { OFFSET 1 0 0 } }"
    )
    head, _, motion = text.partition("MOTION")
    brace = head.rstrip().rfind("}")
    lines = motion.strip().splitlines()
    rows = [line + " 0 0 0" for line in lines[2:]]
    changed = f"{head[:brace]} {mesh} }}\nMOTION\n" + "\n".join([*lines[:2], *rows]) + "\n"
    source = pack(tmp_path, {"mass/walk.bvh": ("mass:unknown", changed), "mass/plain.bvh": ("mass:unknown", text)})
    corpus = build("free", source, tmp_path / "x.corpus", fps=30)
    with_mesh, plain = (corpus.motion(clip).positions for clip in corpus.clips)
    np.testing.assert_allclose(with_mesh, plain, atol=1e-3)


def test_a_bad_or_missing_table_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no free-motion\.csv"):
        build("free", tmp_path, tmp_path / "x.corpus")
    (tmp_path / "free-motion.csv").write_text("file,subject\na,b\n")
    with pytest.raises(InputError, match=r"free-motion\.csv.*not a table of takes"):
        build("free", tmp_path, tmp_path / "x.corpus")


def test_the_people_held_out_are_told_why():
    with free.HELD_OUT.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(row["what"] for row in rows)
    assert {"tiling:hys", "interactive:cmu69"} <= free.held_out()
    assert 35 < sum(float(row["minutes"]) for row in rows) < 60
    assert not any("cmu05" in person or "cmu13" in person or "cmu49" in person for person in free.held_out())


def test_the_pack_itself(free_motion, tmp_path):
    """One take of each laboratory, as they are."""
    folder, table = free_motion
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    first = {row["file"].split("/")[0]: row for row in reversed(rows)}
    for row in first.values():
        path = tmp_path / "free-motion" / row["file"]
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / row["file"], path)
        for skeleton in (folder / row["file"]).parent.glob("*.asf"):
            shutil.copy(skeleton, path.parent)
    with (tmp_path / "free-motion.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(first.values())
    corpus = build("free", tmp_path, tmp_path / "x.corpus", fps=30)
    assert {each.file.split("/")[0] for each in corpus.dropped} <= {"encadyma"}
    assert len(corpus.clips) == len(first) - len(corpus.dropped) and corpus.skeleton == BODY
    for clip in corpus.clips:
        legs = stature(corpus.skeleton, corpus.motion(clip).positions)
        assert legs is None or 1.5 < legs < 2.0
