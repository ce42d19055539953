"""What joints are called: from any tool's spelling to the place a name means on a body.

A name is cut into words ("CC_Base_L_Upperarm" → l, upperarm), a prefix that the whole file shares is dropped,
and the rest is a side and a stem. A stem alone does not say which joint it is: MotionBuilder's `LeftShoulder`
is where the collar bone starts, a keypoint detector's is the shoulder joint; `LeftLeg` is a shin, unless
there is a `LeftKnee`. So stems are ranked by how sure they are, and the doubtful ones look at their siblings.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache

SIDES = ("left", "right")

# Per part of a limb, the stems that mean it, surest first. Stems in DOUBTFUL wait for their siblings.
LIMB_STEMS = {
    "shoulder": "clavicle collar collarbone clp 肩",
    "upper_arm": "upperarm uparm humerus shldr shldrbend uarm hup sjc shoulderjoint upperarm01 腕",
    "forearm": "forearm lowerarm lowarm loarm elbow radius farm forearmbend huo ejc elbowjoint lowerarm01 ひじ",
    "hand": "wrist wjc rao wristjoint hand 手首",
    "thigh": "thigh upleg upperleg femur thighbend uleg fep hjc upperleg01 足",
    "shin": "shin lowerleg lowleg loleg calf tibia knee feo kjc lowerleg01 ひざ",
    "foot": "ankle ajc tio anklejoint foot 足首",
    "toe": "foo toe toes toebase ball toe0 forefoot bigtoe foottoe つま先",
}
DOUBTFUL = ("shoulder", "arm", "leg", "hip")
SURE = {stem: part for part, stems in LIMB_STEMS.items() for stem in stems.split()}
RANK = {stem: rank for stems in LIMB_STEMS.values() for rank, stem in enumerate(stems.split())}

MIDDLE_STEMS = {
    "hips": "hips hip pelvis midhip hipcenter hipscenter centerhip spinebase lowertorso pelo 下半身",
    "spine": "spine spinemid spinenaval spinelower lowerspine middlespine abdomen abdomenlower abdomenupper ab torso "
    "lowerback upperback waist l5 l3 t12 t8 上半身",
    "chest": "chest upperchest chestlower chestupper thorax spinechest spineupper upperspine ribcage 上半身2",
    "neck": "lowerneck necklower neckbase necktwist01 spineshoulder shouldercenter shoulderscenter midshoulder neck 首",
    "head": "head hedo 頭",
    "nose": "nose necknose",
}
MIDDLE = {stem: part for part, stems in MIDDLE_STEMS.items() for stem in stems.split()}
_NUMBERED = re.compile(r"(spine|chest|torso|abdomen|neck|head)\d+$")
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+|[^\W\d_A-Za-z]+")
_SIDE_WORDS = {"l": "left", "left": "left", "lft": "left", "左": "left", "r": "right", "right": "right", "rgt": "right",
               "右": "right"}


@lru_cache(maxsize=16)
def parsed(names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Each name as `(side, stem)`: side "left", "right" or ""; a stem that means nothing here is ""."""
    words = [_words(name) for name in names]
    # The numbers of glTF's nodes: "Bip001 L Thigh_179".
    if len({each[-1] for each in words if len(each) > 1 and each[-1].isdigit()}) > 0.8 * len(words):
        words = [each[:-1] for each in words]
    # What most names start or end with says nothing: mixamorig, Bip01, CC_Base, DEF, a skeleton's name; Joint, dup.
    for end, rest in ((0, slice(1, None)), (-1, slice(None, -1))):
        while word := _shared(words, end):
            words = [each[rest] if len(each) > 1 and each[end] == word else each for each in words]
    return tuple(_side_and_stem(each) for each in words)


def _shared(words: Sequence[list[str]], end: int) -> str:
    """The word at this end (0 or -1) of most names that have more than one, or ""."""
    ends = Counter(each[end] for each in words if len(each) > 1 and each[end] not in _SIDE_WORDS)
    word, count = ends.most_common(1)[0] if ends else ("", 0)
    rare = count < 3 or count < 0.6 * sum(len(each) > 1 for each in words)
    return "" if rare or _known(word) or word in MIDDLE else word


def _words(name: str) -> list[str]:
    if name.startswith("__"):
        return []  # MakeHuman's links from a joint to the next, which lie on the former and are called as the latter
    bare = re.split(r"[:|]", name)[-1] or name
    bare = re.sub(r"^(DEF|ORG|MCH|J_(Bip|Sec|Adj)(_C)?|joint|jnt)[-_](?=.)", "", bare)
    bare = re.sub(r"([左右])", r"_\1_", bare)
    return [word.lower() for word in _WORDS.findall(bare)]


def _side_and_stem(words: list[str]) -> tuple[str, str]:
    whole = "".join(words)
    if _middle(whole):
        return "", whole
    for place, word in enumerate(words):
        stem = "".join(words[:place] + words[place + 1 :])
        if word in _SIDE_WORDS and _known(stem):
            return _SIDE_WORDS[word], stem
    for letter, side in (("left", "left"), ("right", "right"), ("l", "left"), ("r", "right")):
        if whole.startswith(letter) and _known(whole[len(letter) :]):
            return side, whole[len(letter) :]
    return "", ""


def _known(stem: str) -> bool:
    return stem in SURE or stem in DOUBTFUL


def _middle(stem: str) -> str:
    """The part of the trunk that an unsided stem means, or ""."""
    if stem in MIDDLE:
        return MIDDLE[stem]
    numbered = _NUMBERED.match(stem)
    return MIDDLE[numbered[1]] if numbered else ""


def limbs(names: Sequence[tuple[str, str]]) -> dict[str, int]:
    """From parsed names: BODY's limb joints ("left_forearm") and the index of the name that means each."""
    found = {}
    for side in SIDES:
        stems: dict[str, int] = {}
        for joint, (its_side, stem) in enumerate(names):
            if its_side == side:
                stems.setdefault(stem, joint)
        for part, joint in _limb(stems).items():
            found[f"{side}_{part}"] = joint
    return found


def _limb(stems: dict[str, int]) -> dict[str, int]:
    """The parts of one side's arm and leg, given the joint that has each stem."""
    found: dict[str, int] = {}
    for stem in sorted(set(stems) - set(DOUBTFUL), key=RANK.__getitem__):
        found.setdefault(SURE[stem], stems[stem])
    if "ankle" in stems and "foot" in stems:
        found.setdefault("toe", stems["foot"])  # SMPL, Kinect: the foot comes after the ankle
    if "hip" in stems:
        found.setdefault("thigh", stems["hip"])
    if "leg" in stems:
        found.setdefault("shin" if "thigh" in found else "thigh", stems["leg"])
    if "arm" in stems:
        found.setdefault("forearm" if "upper_arm" in found else "upper_arm", stems["arm"])
    if "shoulder" in stems:
        # Where no other joint can be the shoulder joint, this is it: keypoints, SMPL, Kinect.
        found.setdefault("shoulder" if "upper_arm" in found else "upper_arm", stems["shoulder"])
    return found


def middles(names: Sequence[tuple[str, str]], part: str) -> list[int]:
    """The indices of the names that mean this part of the trunk ("hips", "spine", …), surest first."""
    order = MIDDLE_STEMS[part].split()
    found = [j for j, (side, stem) in enumerate(names) if not side and stem and _middle(stem) == part]
    return sorted(found, key=lambda j: order.index(names[j][1]) if names[j][1] in order else len(order))


def upwards(names: Sequence[tuple[str, str]], joints: Sequence[int]) -> list[int]:
    """Spine and chest joints from the lowest to the highest, as their names say: chests last, then by number."""

    def place(joint: int) -> tuple[bool, int, int]:
        stem = names[joint][1]
        numbered = re.search(r"\d+$", stem) if _NUMBERED.match(stem) else None
        return _middle(stem) == "chest", int(numbered[0]) if numbered else 0, joint

    return sorted(joints, key=place)


def same_words(name: str) -> str:
    """A name without its namespace, case and punctuation, to compare spellings."""
    return re.sub(r"[\W_]", "", re.split(r"[:|]", name)[-1]).lower()


# Skin markers, for the size and the way up of a body: what the names of Plug-in Gait and similar sets stand for.
_MARKERS = {
    "head markers": "fhd bhd head headtop tophead headfront headback headl headr vertex",
    "neck marker": "c7",
    "pelvis markers": "asi psi asis psis sacr sacrum vsacral",
    "knee marker": "kne knee kneelat lknee kneelateral fle lek",
    "ankle marker": "ank ankle anklelat anklelateral fal lm latmal",
    "heel marker": "hee heel cal fcc calc",
}
SIDED_MARKERS = tuple(name for name in _MARKERS if name.endswith("marker") and name != "neck marker")
_MARKER = {stem: name for name, stems in _MARKERS.items() for stem in stems.split()}


def markers(names: Sequence[str]) -> dict[str, list[int]]:
    """The markers that show a landmark: "head markers", "left_knee marker", … → their indices."""
    found: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        bare = same_words(name)
        sided = _MARKER.get(bare[1:]) if bare[:1] in ("l", "r") else None
        landmark = _MARKER.get(bare) or sided
        if landmark in SIDED_MARKERS:
            if not sided:
                continue
            landmark = f"{'left' if bare[0] == 'l' else 'right'}_{sided}"
        if landmark:
            found.setdefault(landmark, []).append(index)
    return found


# A convention, and either names that only its files have together (without namespace, case and punctuation) or a
# pattern that most of its names match as they stand.
_CONVENTIONS: tuple[tuple[str, str | re.Pattern], ...] = (
    ("CMU ASF", "lhipjoint lfemur ltibia lhumerus lradius"),
    ("CMU BVH (31 joints)", "lhipjoint leftupleg lowerback leftfingerbase"),
    ("CMU BVH (31 joints, collars)", "lhipjoint lefthip lowerback leftcollar"),
    ("CMU BVH (43 joints)", "hip abdomen lbuttock lshldr lthigh"),
    ("Mixamo", re.compile(r"mixamorig\d*[:_]")),
    ("HumanIK", re.compile(r"Character\d*_")),
    ("3ds Max Biped", re.compile(r"(ValveBiped\.)?Bip\d+[ _]")),
    ("Reallusion CC", re.compile("CC_Base_")),
    ("VRM", re.compile("J_(Bip|Sec|Adj)_")),
    ("Rigify", re.compile("(DEF|ORG)-")),
    ("Bandai-Namco", "jointroot upperarml lowerarml upperlegl lowerlegl"),
    ("mocopi", "torso7 luparm llowarm lupleg llowleg"),
    ("Xsens MVN", "l5 l3 t12 t8 rightupperleg rightlowerleg"),
    ("Unreal", "pelvis spine01 claviclel upperarml lowerarml thighl calfl"),
    ("Daz Genesis", "lshldrbend lforearmbend lthighbend lshin"),
    ("OptiTrack", "luarm lfarm lthigh lshin"),
    ("iPi", "lowerspine middlespine lclavicle lshin"),
    ("MakeHuman", "upperarm01l lowerarm01l upperleg01l lowerleg01l"),
    ("MakeHuman", "uparml loarml uplegl lolegl"),
    ("Blender", "upperarml forearml thighl shinl"),
    ("Unity humanoid", "leftupperarm leftlowerarm leftupperleg leftlowerleg"),
    ("Plug-in Gait", "lfep lfeo ltio"),
    ("SMPL", "leftcollar lefthip leftknee spine3"),
    ("SMPL", "lcollar lhip lknee spine3"),
    ("Kinect", "hipcenter shouldercenter elbowleft"),
    ("Kinect", "spinebase spinemid elbowleft"),
    ("Kinect", "spinenaval spinechest elbowleft"),
    ("Human3.6M (17 joints)", "hip spine thorax head lknee lelbow"),
    ("HALPE_26", "hip head neck lbigtoe lknee lelbow"),
    ("BODY_25", "midhip neck lbigtoe lknee lelbow"),
    ("BODY_25", "chip neck lbigtoe lknee lelbow"),
    ("COCO", "nose lknee lelbow lwrist lankle"),
    ("COCO", "nose leftknee leftelbow leftwrist leftankle"),
    ("LaFAN1", "hips leftupleg lefttoe spine2 leftforearm"),
    ("Biovision", "hips leftcollar leftelbow leftwrist lefthip leftknee leftankle"),
    ("MotionBuilder", "hips leftupleg leftleg leftarm leftforearm"),
)


def convention(names: Sequence[str]) -> str:
    """The convention whose names these are, or ""."""
    have = {same_words(name) for name in names}
    for rig, sign in _CONVENTIONS:
        if isinstance(sign, str) and have.issuperset(sign.split()):
            return rig
        if isinstance(sign, re.Pattern) and 2 * sum(bool(sign.match(name)) for name in names) > len(names):
            return rig
    return ""
