"""Rigs ↔ BODY: names of every convention, shapes without names, sizes and directions."""

from __future__ import annotations

import csv
import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from captures import PACKS
from motionmend import io, rotations
from motionmend.body.joints import BODY, JOINT, LEFT_RIGHT, LIMBS
from motionmend.body.mapping import Mapping, map_rig, read_map, to_body
from motionmend.body.measures import facing, floor_height, stature, upward
from motionmend.errors import InputError
from motionmend.motion import Motion, Skeleton

# One line a joint: hips, spine, chest, neck, head; then shoulder, upper_arm, forearm, hand, thigh, shin, foot and toe
# of the left. "-" for a joint that the convention lacks; `others` are names that must stay unmapped.
ROWS = (*BODY.names[:5], *(name for name in BODY.names if name.startswith("left_")))
CONVENTIONS = {
    "CMU ASF": (
        "root upperback thorax lowerneck head lclavicle lhumerus lradius lwrist lfemur ltibia lfoot ltoes",
        "lhipjoint lowerback upperneck lhand lfingers lthumb",
    ),
    "CMU BVH (31 joints)": (
        "Hips Spine Spine1 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand LeftUpLeg LeftLeg LeftFoot "
        "LeftToeBase",
        "LHipJoint LowerBack Neck1 LeftFingerBase LeftHandIndex1 LThumb",
    ),
    "CMU BVH (31 joints, collars)": (
        "Hips Chest Chest2 lowerneck Head LeftCollar LeftShoulder LeftElbow LeftWrist LeftHip LeftKnee "
        "LeftAnkle LeftToe",
        "LHipJoint lowerback Neck lhand LFingers LThumb",
    ),
    "CMU BVH (43 joints)": (
        "hip abdomen chest neck head lCollar lShldr lForeArm lHand lThigh lShin lFoot -",
        "leftEye lThumb1 lThumb2 lIndex1 lMid1 lButtock",
    ),
    "LaFAN1": (
        "Hips Spine Spine2 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand LeftUpLeg LeftLeg LeftFoot LeftToe",
        "Spine1",
    ),
    "Mixamo": (
        "mixamorig:Hips mixamorig:Spine mixamorig:Spine2 mixamorig:Neck mixamorig:Head mixamorig:LeftShoulder "
        "mixamorig:LeftArm mixamorig:LeftForeArm mixamorig:LeftHand mixamorig:LeftUpLeg mixamorig:LeftLeg "
        "mixamorig:LeftFoot mixamorig:LeftToeBase",
        "mixamorig:Spine1 mixamorig:HeadTop_End mixamorig:LeftEye mixamorig:LeftHandThumb1 "
        "mixamorig:LeftHandPinky3",
    ),
    "HumanIK": (
        "Character1_Hips Character1_Spine Character1_Spine2 Character1_Neck Character1_Head Character1_LeftShoulder "
        "Character1_LeftArm Character1_LeftForeArm Character1_LeftHand Character1_LeftUpLeg Character1_LeftLeg "
        "Character1_LeftFoot Character1_LeftToeBase",
        "Character1_Reference Character1_Spine1 Character1_LeftHandIndex1",
    ),
    "Biovision": (
        "Hips Chest Chest4 Neck Head LeftCollar LeftShoulder LeftElbow LeftWrist LeftHip LeftKnee LeftAnkle "
        "LeftToe",
        "Chest2 Chest3",
    ),
    "MotionBuilder": (
        "Hips Spine Spine3 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand LeftUpLeg LeftLeg LeftFoot "
        "LeftForeFoot",
        "Spine1 Spine2 Neck1 LeftHandRing LeftHandThumb1",
    ),
    "Xsens MVN": (
        "Pelvis L5 T8 Neck Head LeftShoulder LeftUpperArm LeftForeArm LeftHand LeftUpperLeg LeftLowerLeg "
        "LeftFoot LeftToe",
        "L3 T12",
    ),
    "Unreal": (
        "pelvis spine_01 spine_05 neck_01 head clavicle_l upperarm_l lowerarm_l hand_l thigh_l calf_l foot_l "
        "ball_l",
        "root spine_02 spine_03 spine_04 neck_02 upperarm_twist_01_l lowerarm_twist_01_l thumb_01_l "
        "calf_twist_01_l ik_foot_root",
    ),
    "Blender": (
        "hips spine chest neck head shoulder.L upper_arm.L forearm.L hand.L thigh.L shin.L foot.L toe.L",
        "thumb.01.L heel.02.L pelvis.L",
    ),
    "3ds Max Biped": (
        "Bip01|Bip01 Pelvis|Bip01 Spine|Bip01 Spine2|Bip01 Neck|Bip01 Head|Bip01 L Clavicle|Bip01 L UpperArm|"
        "Bip01 L Forearm|Bip01 L Hand|Bip01 L Thigh|Bip01 L Calf|Bip01 L Foot|Bip01 L Toe0",
        "Bip01 Spine1|Bip01 L Finger0|Bip01 HeadNub|Bip01 L Toe0Nub",
    ),
    "MakeHuman": (
        "root spine05 spine01 neck01 head clavicle.L upperarm01.L lowerarm01.L wrist.L upperleg01.L lowerleg01.L "
        "foot.L -",
        "spine04 spine03 spine02 pelvis.L upperarm02.L lowerarm02.L upperleg02.L toe1-1.L jaw",
    ),
    "MakeHuman ": (
        "Hips Spine2 Spine3 Neck Head Clavicle_L UpArm_L LoArm_L Hand_L UpLeg_L LoLeg_L Foot_L Toe_L",
        "Root Spine1 __Jaw __Clavicle_L __UpLeg_L __UpLeg_R",
    ),
    "VRM": (
        "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_UpperChest J_Bip_C_Neck J_Bip_C_Head J_Bip_L_Shoulder J_Bip_L_UpperArm "
        "J_Bip_L_LowerArm J_Bip_L_Hand J_Bip_L_UpperLeg J_Bip_L_LowerLeg J_Bip_L_Foot J_Bip_L_ToeBase",
        "J_Bip_C_Chest J_Bip_L_Thumb1 J_Sec_L_Bust1",
    ),
    "Unity humanoid": (
        "Hips Spine UpperChest Neck Head LeftShoulder LeftUpperArm LeftLowerArm LeftHand LeftUpperLeg LeftLowerLeg "
        "LeftFoot LeftToes",
        "Chest LeftEye Jaw LeftThumbProximal",
    ),
    "Bandai-Namco": (
        "Hips Spine Chest Neck Head Shoulder_L UpperArm_L LowerArm_L Hand_L UpperLeg_L LowerLeg_L Foot_L Toes_L",
        "joint_Root",
    ),
    "SMPL": (
        "pelvis spine1 spine3 neck head left_collar left_shoulder left_elbow left_wrist left_hip left_knee "
        "left_ankle left_foot",
        "spine2 left_hand left_index1 jaw left_eye_smplhf",
    ),
    "SMPL ": (
        "Pelvis Spine1 Spine3 Neck Head L_Collar L_Shoulder L_Elbow L_Wrist L_Hip L_Knee L_Ankle L_Foot",
        "Spine2 L_Hand",
    ),
    "OptiTrack": (
        "Hip Ab Chest Neck Head LShoulder LUArm LFArm LHand LThigh LShin LFoot LToe",
        "",
    ),
    "mocopi": (
        "root torso_1 torso_7 neck_1 head l_shoulder l_up_arm l_low_arm l_hand l_up_leg l_low_leg l_foot l_toes",
        "torso_2 torso_3 torso_4 torso_5 torso_6 neck_2",
    ),
    "iPi": (
        "Hip LowerSpine Chest Neck Head LClavicle LShoulder LForearm LHand LThigh LShin LFoot LToe",
        "MiddleSpine",
    ),
    "Reallusion CC": (
        "CC_Base_Hip CC_Base_Waist CC_Base_Spine02 CC_Base_NeckTwist01 CC_Base_Head CC_Base_L_Clavicle "
        "CC_Base_L_Upperarm CC_Base_L_Forearm CC_Base_L_Hand CC_Base_L_Thigh CC_Base_L_Calf "
        "CC_Base_L_Foot CC_Base_L_ToeBase",
        "CC_Base_Spine01 CC_Base_NeckTwist02 CC_Base_L_Index1 CC_Base_L_ThighTwist01",
    ),
    "Daz Genesis": (
        "hip abdomenLower chestUpper neckLower head lCollar lShldrBend lForearmBend lHand lThighBend lShin "
        "lFoot lToe",
        "abdomenUpper chestLower neckUpper lShldrTwist lForearmTwist lThighTwist lMetatarsals lPectoral",
    ),
    "by names ": (  # ASF files of endorphin
        "root LowerSpineJoint UpperSpineJoint LowerNeckJoint UpperNeckJoint LeftClavicleJoint LeftShoulderJoint "
        "LeftElbowJoint LeftWristJoint LeftHipJoint LeftKneeJoint LeftAnkleJoint LeftToesJoint",
        "MiddleSpineJoint LeftHipJoint_dum LeftForearmTwistJoint LeftMidFootJoint",
    ),
    "by names": (  # MikuMikuDance
        "下半身 上半身 上半身2 首 頭 左肩 左腕 左ひじ 左手首 左足 左ひざ 左足首 左つま先",
        "センター 左親指1 両目",
    ),
}  # fmt: skip
WITHOUT_BONES = {
    "HALPE_26": (
        "Hip - - Neck - - LShoulder LElbow LWrist LHip LKnee LAnkle LBigToe",
        "Nose Head LSmallToe LHeel LEye LEar",
    ),
    "BODY_25": (
        "MidHip - - Neck - - LShoulder LElbow LWrist LHip LKnee LAnkle LBigToe",
        "Nose LEye LEar LSmallToe LHeel",
    ),
    "COCO": (
        "- - - - - - left_shoulder left_elbow left_wrist left_hip left_knee left_ankle -",
        "nose left_eye left_ear",
    ),
    "Human3.6M (17 joints)": (
        "Hip Spine - Thorax Neck/Nose - LShoulder LElbow LWrist LHip LKnee LFoot -",
        "Head",
    ),
    "SMPL": (
        "pelvis spine1 spine3 neck head left_collar left_shoulder left_elbow left_wrist left_hip left_knee "
        "left_ankle left_foot",
        "spine2 left_hand",
    ),
    "Kinect": (
        "HIP_CENTER SPINE - SHOULDER_CENTER HEAD - SHOULDER_LEFT ELBOW_LEFT WRIST_LEFT HIP_LEFT KNEE_LEFT "
        "ANKLE_LEFT FOOT_LEFT",
        "HAND_LEFT",
    ),
    "Plug-in Gait": (
        "PELO - - - HEDO LCLP LHUP LHUO LRAO LFEP LFEO LTIO LFOO",
        "LFHD C7 T10 CLAV STRN LSHO LELB LWRA LASI LPSI LTHI LKNE LANK LHEE LTOE PELP LFEA LTIP LHNO TRXO "
        "LHipAngles LKneeMoment",
    ),
    "by names": (  # joint centres as Visual3D and others write them
        "- - - - - - LSJC LEJC LWJC LHJC LKJC LAJC -",
        "LASI LTHI1 LSHK1",
    ),
}  # fmt: skip
PARENTS = {name: BODY.names[parent] for name, parent in zip(BODY.names, BODY.parents) if parent >= 0}


def mirrored(name: str) -> str:
    """The right-hand spelling of a left-hand name."""
    for left, right in (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("左", "右")):
        if left in name:
            return name.replace(left, right)
    words = name.replace(".", "_").replace(" ", "_").split("_")
    if "L" in words or "l" in words:
        at = words.index("L" if "L" in words else "l")
        start = sum(len(word) + 1 for word in words[:at])
        return name[:start] + ("R" if name[start] == "L" else "r") + name[start + 1 :]
    return name.replace("l", "r", 1) if name.startswith("l") else name.replace("L", "R", 1)


def rig_of(joints: str, others: str, bones: bool) -> tuple[Skeleton, dict[str, str]]:
    """A skeleton with these names under a plain human tree, and what each of BODY's joints should be."""
    separator = "|" if "|" in joints else None
    given = joints.split(separator)
    if separator:
        others_list, extra_root = others.split("|"), given.pop(0)
        others_list.insert(0, extra_root)
    else:
        others_list = others.split()
    expected = {name: joint for name, joint in zip(ROWS, given, strict=True) if joint != "-"}
    lefts = {name: joint for name, joint in expected.items() if name.startswith("left")}
    expected |= {name.replace("left", "right"): mirrored(joint) for name, joint in lefts.items()}
    names, parents = [], []
    for name in BODY.names:
        if name in expected:
            above = PARENTS.get(name)
            while above is not None and above not in expected:
                above = PARENTS.get(above)
            parents.append(names.index(expected[above]) if above and bones else -1)
            names.append(expected[name])
    for other in others_list:
        names.append(other)
        parents.append(0 if bones else -1)
    return Skeleton(tuple(names), tuple(parents)), expected


def found_names(skeleton: Skeleton, mapping: Mapping) -> dict[str, str]:
    return {name: skeleton.names[joint] for name, joint in mapping.found.items()}


def test_body_is_a_person_in_order():
    assert len(BODY) == 21
    assert BODY.names[:5] == ("hips", "spine", "chest", "neck", "head")
    for left, right in LEFT_RIGHT:
        assert BODY.names[left].replace("left", "right") == BODY.names[right]
    assert PARENTS["left_upper_arm"] == "left_shoulder" and PARENTS["right_thigh"] == "hips"
    limbs = {limb: " ".join(BODY.names[joint] for joint in joints) for limb, joints in LIMBS.items()}
    assert limbs["right_arm"] == "right_upper_arm right_forearm right_hand"
    assert limbs["left_leg"] == "left_thigh left_shin left_foot left_toe"


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_rigs_names_are_understood(convention):
    skeleton, expected = rig_of(*CONVENTIONS[convention], bones=True)
    mapping = map_rig(skeleton)
    assert found_names(skeleton, mapping) == expected
    assert mapping.rig == convention.strip()
    assert mapping.is_person
    assert set(mapping.unmapped) == set(skeleton.names) - set(expected.values())


@pytest.mark.parametrize("convention", WITHOUT_BONES)
def test_points_names_are_understood(convention):
    skeleton, expected = rig_of(*WITHOUT_BONES[convention], bones=False)
    mapping = map_rig(skeleton)
    assert found_names(skeleton, mapping) == expected
    assert mapping.rig == convention
    assert mapping.is_person


@pytest.mark.parametrize("prefix", ["mixamorig1:", "mixamorig_", "Armature|mixamorig:", "Actor 3:", "Model_", "DEF-"])
def test_a_prefix_that_all_names_share_says_nothing(prefix):
    skeleton, _ = rig_of(*CONVENTIONS["LaFAN1"], bones=True)
    renamed = replace(skeleton, names=tuple(prefix + name for name in skeleton.names))
    assert map_rig(renamed).joints == map_rig(skeleton).joints


@pytest.mark.parametrize("suffix", ["Joint", "_dup", ".bone", "_{}"])
def test_an_ending_that_all_names_share_says_nothing(suffix):
    skeleton, _ = rig_of(*CONVENTIONS["LaFAN1"], bones=True)
    names = tuple(name + suffix.format(7 * joint) for joint, name in enumerate(skeleton.names))
    assert map_rig(replace(skeleton, names=names)).joints == map_rig(skeleton).joints


def test_rigify_without_a_named_hips_or_neck():
    names = "spine spine.001 spine.002 spine.003 spine.004 spine.006 shoulder.L upper_arm.L forearm.L hand.L "
    names += "shoulder.R upper_arm.R forearm.R hand.R thigh.L shin.L foot.L toe.L thigh.R "
    names += "shin.R foot.R toe.R upper_arm.L.001"
    skeleton = Skeleton(
        tuple(f"DEF-{name}" for name in names.split()),
        (-1, 0, 1, 2, 3, 4, 3, 6, 7, 8, 3, 10, 11, 12, 0, 14, 15, 16, 0, 18, 19, 20, 7),
    )
    found = found_names(skeleton, map_rig(skeleton))
    middle = {"hips": "spine", "spine": "spine.001", "chest": "spine.003", "neck": "spine.004", "head": "spine.006"}
    assert {name: found[name] for name in middle} == {name: f"DEF-{joint}" for name, joint in middle.items()}
    assert found["left_forearm"] == "DEF-forearm.L" and found["right_toe"] == "DEF-toe.R"


# What is no person.


Offsets = dict[str, tuple[str, tuple[float, float, float]]]


def standing(offsets: Offsets, frames: int = 40) -> tuple[Skeleton, np.ndarray]:
    """A rig from name → (parent, offset), and positions that sway a little."""
    listed = list(offsets)
    parents = tuple(listed.index(parent) if parent else -1 for parent, _ in offsets.values())
    rest = np.zeros((len(listed), 3))
    for joint, (parent, offset) in enumerate(offsets.values()):
        rest[joint] = np.add(offset, rest[listed.index(parent)] if parent else 0)
    sway = 0.02 * np.sin(np.linspace(0, 6, frames))[:, None, None] * rest[None, :, 1:2] * [1, 0, 1]
    return Skeleton(tuple(listed), parents), rest + sway


def quadruped(tail: bool = True) -> tuple[Skeleton, np.ndarray]:
    """A dog with a person's names, as the dog captures of Zhang et al. 2018 have them; made-up lengths."""
    offsets: Offsets = {
        "Hips": ("", (0, 0.5, 0)), "Spine": ("Hips", (0, 0.02, 0.12)), "Spine1": ("Spine", (0, 0.02, 0.3)),
        "Neck": ("Spine1", (0, 0.08, 0.12)), "Head": ("Neck", (0, 0.12, 0.1)),
    }  # fmt: skip
    for side, x in (("Left", 0.06), ("Right", -0.06)):
        offsets |= {
            f"{side}Shoulder": ("Spine1", (x, 0, 0.05)), f"{side}Arm": (f"{side}Shoulder", (0, -0.1, 0.05)),
            f"{side}ForeArm": (f"{side}Arm", (0, -0.17, -0.05)), f"{side}Hand": (f"{side}ForeArm", (0, -0.18, 0.02)),
            f"{side}UpLeg": ("Hips", (x, -0.02, 0)), f"{side}Leg": (f"{side}UpLeg", (0, -0.19, 0.05)),
            f"{side}Foot": (f"{side}Leg", (0, -0.17, -0.1)),
        }  # fmt: skip
    if tail:
        offsets |= {"Tail": ("Hips", (0, 0.02, -0.1)), "Tail1": ("Tail", (0, 0, -0.15))}
    return standing(offsets)


@pytest.mark.parametrize("tail", [True, False])
def test_a_dog_with_a_persons_names_is_not_a_person(tail):
    skeleton, positions = quadruped(tail=tail)
    assert not map_rig(skeleton, positions).is_person
    assert upward(skeleton, positions) is None
    assert stature(skeleton, positions) is None


def test_a_dog_by_any_other_name_is_not_a_person():
    skeleton, positions = quadruped()
    assert not map_rig(replace(skeleton, names=tuple(f"J{j}" for j in range(len(skeleton)))), positions).is_person
    assert not map_rig(skeleton).is_person  # the tail alone must do, where there are no positions


def test_an_actor_on_all_fours_stays_a_person(reactidle):
    take = io.load(sorted(reactidle.glob("*/*.bvh"))[0])
    positions = take.motion.positions[::20].copy()
    # Arms straight ahead of a trunk bent by 90°: bend the trunk by turning it about the hips.
    found = map_rig(take.skeleton, positions).found
    hips = positions[:, [found["hips"]]]
    upper = [j for name, j in found.items() if name in ("chest", "neck", "head") or "arm" in name or "shoulder" in name]
    bent = positions - hips
    x, y, z = np.moveaxis(bent[:, upper].copy(), -1, 0)
    bent[:, upper] = np.stack([x, -z, y], axis=-1)
    for side in ("left", "right"):
        at = bent[:, found[f"{side}_upper_arm"]]
        bent[:, found[f"{side}_forearm"]] = at - [0, 0.25, 0]
    assert map_rig(take.skeleton, bent + hips).is_person
    across = np.median(bent[:, found["neck"]] / np.linalg.norm(bent[:, found["neck"]], axis=-1, keepdims=True), axis=0)
    assert abs(across[1]) < 0.4  # the trunk does lie across the legs


def test_a_hand_a_prop_and_a_cloud_are_no_persons():
    fingers: Offsets = {"Hand": ("", (0, 1, 0))}
    for k, finger in enumerate(("Thumb", "Index", "Middle", "Ring", "Pinky")):
        for bone in range(1, 4):
            fingers[f"Left{finger}{bone}"] = (f"Left{finger}{bone - 1}" if bone > 1 else "Hand", (0.02 * k, -0.03, 0))
    prop: Offsets = {f"Bone{k}": (f"Bone{k - 1}" if k else "", (0, 0.1, 0)) for k in range(12)}
    for offsets in (fingers, prop):
        skeleton, positions = standing(offsets)
        assert not map_rig(skeleton, positions).is_person
        assert stature(skeleton, positions) is None and upward(skeleton, positions) is None
    for names in ([f"*{k}" for k in range(40)], [f"M{k:03d}" for k in range(40)], ["Cup1", "Cup2", "Cup3"]):
        cloud = Skeleton.cloud(names)
        positions = np.random.default_rng(0).normal(size=(20, len(names), 3))
        mapping = map_rig(cloud, positions)
        assert not mapping.is_person and mapping.rig == "" and set(mapping.joints) == {-1}
        assert stature(cloud, positions) is None and upward(cloud, positions) is None


def test_nothing_at_all_is_no_person():
    assert not map_rig(Skeleton((), ())).is_person
    assert stature(Skeleton((), ()), np.zeros((0, 0, 3))) is None
    skeleton, _ = rig_of(*CONVENTIONS["LaFAN1"], bones=True)
    for positions in (np.zeros((0, len(skeleton), 3)), np.full((5, len(skeleton), 3), np.nan)):
        assert map_rig(skeleton, positions).is_person
        assert stature(skeleton, positions) is None
        assert upward(skeleton, positions) is None


def test_a_line_of_a_thousand_joints_is_no_recursion():
    line = Skeleton(tuple(f"b{k}" for k in range(3000)), tuple(range(-1, 2999)))
    assert not map_rig(line, np.cumsum(np.ones((2, 3000, 3)), axis=1)).is_person


# The user's own word.


def test_overrides_win_and_wrong_names_are_answered(tmp_path):
    skeleton, _ = rig_of(*CONVENTIONS["LaFAN1"], bones=True)
    mapping = map_rig(skeleton, overrides={"chest": "Spine1", "left_toe": ""})
    assert found_names(skeleton, mapping)["chest"] == "Spine1"
    assert "left_toe" not in mapping.found and "LeftToe" in mapping.unmapped
    with pytest.raises(InputError, match="left_forearm"):
        map_rig(skeleton, overrides={"left_forarm": "LeftForeArm"})
    with pytest.raises(InputError, match="LeftForeArm"):
        map_rig(skeleton, overrides={"left_forearm": "LeftForArm"})

    path = tmp_path / "rig.toml"
    path.write_text('chest = "Spine1"\nleft_toe = ""\n')
    assert map_rig(skeleton, overrides=read_map(path)) == mapping
    wrongs = {"chset = 'Spine1'": "chest", "chest = 3": "quotes", "chest": "TOML", "[chest]": "quotes"}
    for wrong, word in wrongs.items():
        path.write_text(wrong)
        with pytest.raises(InputError, match=word):
            read_map(path)
    with pytest.raises(InputError, match="No such file"):
        read_map(tmp_path / "none.toml")


def test_overrides_make_a_person_of_foreign_names():
    skeleton, expected = rig_of(*CONVENTIONS["LaFAN1"], bones=True)
    foreign = replace(skeleton, names=tuple(f"bone {j}" for j in range(len(skeleton))))
    overrides = {name: f"bone {skeleton.names.index(joint)}" for name, joint in expected.items()}
    assert not map_rig(foreign).is_person
    mapping = map_rig(foreign, overrides=overrides)
    assert mapping.is_person and mapping.joints == map_rig(skeleton).joints


# Real captures.

TEST_SUBJECTS = ("05", "13", "49")


def real_takes(pack: Path) -> list[Path]:
    """Some takes of a pack, the same ones each time; none of CMU's test subjects."""
    paths = sorted(path for path in pack.rglob("*") if path.suffix in (".bvh", ".amc"))
    paths = [path for path in paths if path.parent.name not in TEST_SUBJECTS]
    return random.Random(0).sample(paths, 12)


@pytest.fixture(params=["cmu", "reactidle", "bandai"], scope="module")
def takes(request):
    return [io.load(path) for path in real_takes(request.getfixturevalue(request.param))]


def test_real_bodies_have_a_bodys_geometry(takes):
    for take in takes:
        mapping = map_rig(take.skeleton, take.motion.positions)
        assert mapping.is_person and mapping.rig
        bodied = to_body(take.motion, mapping)
        frames = slice(1, None, max(1, len(take) // 50))
        at = {name: bodied.positions[frames, JOINT[name]].astype(float) for name in mapping.found}

        def length(one: str, other: str, at=at) -> float:
            return float(np.median(np.linalg.norm(at[one] - at[other], axis=-1)))

        for bone in (("thigh", "shin"), ("shin", "foot"), ("upper_arm", "forearm")):
            left, right = (length(f"{side}_{bone[0]}", f"{side}_{bone[1]}") for side in ("left", "right"))
            assert left == pytest.approx(right, rel=0.15), (take.source, bone)
        assert 0.6 < length("left_thigh", "left_shin") / length("left_shin", "left_foot") < 1.6
        assert length("hips", "neck") > 1.5 * length("neck", "head")
        if "left_toe" in at:
            assert length("left_foot", "left_toe") < 0.5 * length("left_shin", "left_foot")

        up = np.median(at["neck"] - at["hips"], axis=0)
        assert up[1] > 0.5 * np.linalg.norm(up), take.source
        # Left is left: the feet point where up and left say is forward.
        forward = facing(bodied)[frames].astype(float)
        assert np.allclose(np.linalg.norm(forward, axis=-1), 1, atol=1e-5) and not forward[:, 1].any()
        if "left_toe" in at:
            pointing = sum(at[f"{side}_toe"] - at[f"{side}_foot"] for side in ("left", "right"))
        else:
            ends, world = dict(take.rig.ends), take.rig.kinematics[1][frames]
            feet = [mapping.found[f"{side}_foot"] for side in ("left", "right")]
            pointing = sum(rotations.apply(world[:, foot], ends[foot]) for foot in feet)
        assert np.mean(np.sum(pointing * forward, axis=-1) > 0) > 0.8, take.source


def test_real_statures_are_a_persons(takes):
    # Adults, in whatever units: the readers choose the unit by this number, so its value is checked in
    # metres for AMC (inches / 0.45), Bandai-Namco (cm) and ReActIdle (m) through the readers' own guess.
    for take in takes:
        metres = stature(take.skeleton, take.motion.positions)
        assert metres is not None and 1.4 < metres < 2.05, (take.source, metres, take.units.why)
        other = stature(take.skeleton, take.motion.positions[:, :, [2, 0, 1]] * 1000)
        assert other == pytest.approx(1000 * metres, rel=1e-4)


def test_bandai_statures_agree_with_the_standing_height(bandai):
    # An oracle that shares nothing with the estimate: how high the base of the neck stands above the toes,
    # which is a little above the shoulders' 0.818 of the stature.
    path = sorted((bandai / "data").glob("*walk*normal*"))[0]
    take = io.load(path)
    height = take.motion.positions[:, take.skeleton.index("Neck"), 1].astype(float)
    floor = take.motion.positions[:, take.skeleton.index("Toes_L"), 1].astype(float).min()
    estimate = stature(take.skeleton, take.motion.positions)
    assert estimate == pytest.approx((np.percentile(height, 90) - floor) / 0.84, rel=0.1)


def test_upward_is_found_in_any_axes(takes):
    for take in takes:
        up = upward(take.skeleton, take.motion.positions)
        assert up is not None and up[1] > 0.85, take.source
        turned = upward(take.skeleton, take.motion.positions[:, :, [2, 0, 1]])
        assert turned is not None and np.allclose(turned, up[[2, 0, 1]], atol=1e-6)


def test_names_are_not_needed(takes):
    """The same joints are found in the same rigs when every name is a number."""
    same = 0
    for take in takes:
        positions = take.motion.positions
        numbered = replace(take.skeleton, names=tuple(f"J{j}" for j in range(len(take.skeleton))))
        by_names, by_shape = map_rig(take.skeleton, positions), map_rig(numbered, positions)
        if by_shape.is_person:
            assert by_shape.rig == "by topology"
            both = set(by_names.found) & set(by_shape.found)
            assert {n: by_names.found[n] for n in both} == {n: by_shape.found[n] for n in both}, take.source
            same += 1
    # ReActIdle's arms end at the elbow: without names it is left alone rather than guessed.
    if "reactidle" in takes[0].source:
        assert same == 0
    else:
        assert same >= 10


def test_a_few_known_names_do_not_hide_the_shape(bandai):
    take = io.load(sorted((bandai / "data").glob("*.bvh"))[0])
    known = {"LowerArm_L", "LowerArm_R", "LowerLeg_L", "LowerLeg_R"}
    names = tuple(name if name in known else f"J{j}" for j, name in enumerate(take.skeleton.names))
    mapping = map_rig(replace(take.skeleton, names=names), take.motion.positions)
    assert mapping.rig == "by topology" and len(mapping.found) > 16
    assert mapping.found["left_forearm"] == take.skeleton.index("LowerArm_L")


def test_sides_that_cannot_be_told_stay_open(bandai):
    take = io.load(sorted((bandai / "data").glob("*.bvh"))[0])
    positions = take.motion.positions.copy()
    for side in "LR":  # straight legs on points: nothing says where forward is
        thigh = take.skeleton.index(f"UpperLeg_{side}")
        for part, down in (("LowerLeg", 0.4), ("Foot", 0.8), ("Toes", 0.9)):
            below = np.array([0, -down, 0], np.float32)
            positions[:, take.skeleton.index(f"{part}_{side}")] = positions[:, thigh] + below
    numbered = replace(take.skeleton, names=tuple(f"J{j}" for j in range(len(take.skeleton))))
    mapping = map_rig(numbered, positions)
    assert mapping.rig == "by topology, left and right unknown" and not mapping.is_person
    assert set(mapping.found) <= set(BODY.names[:5]) and "hips" in mapping.found


def test_recorded_facts_of_the_packs_hold():
    """The split file knows the subjects that must not be looked at here."""
    table = PACKS / "cmu.csv"
    if not table.is_file():
        pytest.skip("real captures are not at hand")
    with table.open() as file:
        assert {row["subject"] for row in csv.DictReader(file) if row["split"] == "test"} == set(TEST_SUBJECTS)


# Markers, and the small things.

PERSON = {  # a person of 1.75 m, Z up, metres; marker places by anatomical shares of the stature
    "FHD": (0.07, 0.09, 1.64), "BHD": (0.07, -0.08, 1.62), "ASI": (0.12, 0.1, 0.99), "PSI": (0.05, -0.1, 1.02),
    "KNE": (0.16, 0.0, 0.5), "ANK": (0.12, 0.0, 0.075), "HEE": (0.1, -0.05, 0.05), "TOE": (0.12, 0.15, 0.04),
}  # fmt: skip


def marker_cloud(subject: str = "", unit: float = 1000.0) -> tuple[Skeleton, np.ndarray]:
    names, points = [f"{subject}C7", f"{subject}T10", "*12"], [(0, -0.08, 1.5), (0, -0.1, 1.3), (9, 9, 0)]
    for name, (x, y, z) in PERSON.items():
        names += [f"{subject}L{name}", f"{subject}R{name}"]
        points += [(-x, y, z), (x, y, z)]
    return Skeleton.cloud(names), np.tile(np.array(points) * unit, (30, 1, 1))


def crawling(along: Sequence[float], up: Sequence[float]) -> tuple[Skeleton, np.ndarray, np.ndarray]:
    """A figure of sticks that lies face down and moves 4 m on head first, and the same standing with y up."""
    at = {"Hips": (0, 1), "Spine": (0, 1.3), "Neck": (0, 1.5), "Head": (0, 1.6), "LeftUpLeg": (0.1, 0.9),
          "LeftLeg": (0.1, 0.5), "LeftFoot": (0.1, 0.1), "RightUpLeg": (-0.1, 0.9), "RightLeg": (-0.1, 0.5),
          "RightFoot": (-0.1, 0.1)}  # fmt: skip
    parents = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8)
    across, height = np.array(list(at.values())).T
    side = np.cross(along, up)
    lying = across[:, None] * side + height[:, None] * np.array(along)
    moving = lying + np.linspace(0, 4, 20)[:, None, None] * np.array(along)
    moving += 0.1 * np.sin(np.linspace(0, 9, 20))[:, None, None] * side  # it sways
    standing = np.stack([across, height, np.zeros_like(across)], axis=1)
    return Skeleton(tuple(at), parents), moving, standing


@pytest.mark.parametrize("along", [(-1, 0, 0), (0, 0, 1)])
def test_a_body_that_crawls_does_not_tip_the_world(along):
    skeleton, positions, rest = crawling(along, up=(0, 1, 0))
    alone = upward(skeleton, positions)
    assert alone is not None and alone @ along > 0.99  # all that the take alone tells
    up = upward(skeleton, positions, rest)
    assert up is not None and up[1] == 1


def test_a_rest_pose_that_lies_does_not_tip_the_world():
    skeleton, _, rest = crawling((0, 0, 1), up=(0, 1, 0))
    walking = rest[:, [0, 2, 1]] + np.linspace(0, 4, 20)[:, None, None] * [1, 0, 0]  # a file with z up
    up = upward(skeleton, walking, rest)
    assert up is not None and up[2] > 0.999



@pytest.mark.parametrize("subject", ["", "Anna:"])
def test_markers_tell_size_and_up_but_are_no_joints(subject):
    skeleton, positions = marker_cloud(subject)
    positions[:10, ::3] = np.nan
    assert not map_rig(skeleton, positions).is_person
    assert stature(skeleton, positions) == pytest.approx(1750, rel=0.1)
    up = upward(skeleton, positions)
    assert up is not None and up[2] > 0.95


def test_lower_limbs_alone_will_do():
    keep = [name for name in marker_cloud()[0].names if name[1:] in ("ASI", "PSI", "KNE", "ANK", "HEE", "TOE")]
    skeleton, positions = marker_cloud()
    positions = positions[:, [skeleton.names.index(name) for name in keep]]
    assert stature(Skeleton.cloud(keep), positions) == pytest.approx(1750, rel=0.12)
    up = upward(Skeleton.cloud(keep), positions)
    assert up is not None and up[2] > 0.95


def test_a_fall_and_a_handstand_do_not_turn_the_world(bandai):
    take = io.load(sorted((bandai / "data").glob("*walk*normal*"))[0])
    positions = take.motion.positions.copy()
    third = len(positions) // 3
    x, y, z = np.moveaxis(positions[:third].copy(), -1, 0)
    positions[:third] = np.stack([x, z, y], axis=-1)  # lies
    positions[third : third + third // 2, :, 1] *= -1  # stands on the head
    up = upward(take.skeleton, positions)
    assert up is not None and int(np.argmax(np.abs(up))) == 1 and up[1] > 0


def made_up_body(frames: int = 6) -> Motion:
    positions = np.zeros((frames, 21, 3), np.float32)
    for name, at in {"left_thigh": (0.1, 0.9, 0), "right_thigh": (-0.1, 0.9, 0), "left_upper_arm": (0.2, 1.4, 0),
                     "right_upper_arm": (-0.2, 1.4, 0)}.items():  # fmt: skip
        positions[:, JOINT[name]] = at
    positions[:, :, 1] += 0.02
    return Motion(positions, np.ones((frames, 21), bool), 30.0, BODY)


@pytest.mark.parametrize("degrees", [0, 30, 90, 200])
def test_facing_turns_with_the_body(degrees):
    motion = made_up_body()
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], np.float32)  # about Y: z goes to (s, 0, c)
    turned = replace(motion, positions=motion.positions @ turn.T)
    np.testing.assert_allclose(facing(turned), np.tile([s, 0, c], (len(motion), 1)), atol=1e-6)


def test_facing_reads_only_what_is_observed():
    motion = made_up_body()
    observed = motion.observed.copy()
    positions = motion.positions.copy()
    observed[0, JOINT["left_thigh"]] = False
    positions[0, JOINT["left_thigh"]] = np.nan
    observed[1] = False
    positions[1] = np.nan
    found = facing(replace(motion, positions=positions, observed=observed))
    np.testing.assert_allclose(found[[0, 2]], [[0, 0, 1]] * 2, atol=1e-6)
    assert np.isnan(found[1]).all()


def test_floor_is_where_the_feet_are_and_not_where_noise_is():
    motion = made_up_body(200)
    positions, observed = motion.positions.copy(), motion.observed.copy()
    positions[3, 7, 1] = -5
    observed[4, 7], positions[4, 7, 1] = False, np.nan
    positions[100:140, :, 1] += 0.5  # a jump
    assert floor_height(replace(motion, positions=positions, observed=observed)) == pytest.approx(0.02, abs=1e-3)
    assert floor_height(replace(motion, observed=np.zeros_like(observed))) == 0.0


def test_to_body_leaves_absent_joints_unobserved(reactidle):
    take = io.load(sorted(reactidle.glob("*/*.bvh"))[0])
    bodied = to_body(take.motion, map_rig(take.skeleton, take.motion.positions))
    for name in ("left_hand", "right_toe"):
        assert not bodied.observed[:, JOINT[name]].any() and np.isnan(bodied.positions[:, JOINT[name]]).all()
    elbow = take.skeleton.index("forearm.L")
    np.testing.assert_array_equal(bodied.positions[:, JOINT["left_forearm"]], take.motion.positions[:, elbow])
    assert bodied.skeleton is BODY and bodied.fps == take.fps
