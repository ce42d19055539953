"""Some joints of one take, as another take moves them: the tertiary blending of Kaufmann et al. 2020, section 5.

Joints are compared as a body sees itself: from where it faces. So a reach forward in the source is a reach forward in
the take, wherever either of them walks. A limb begins where the take has it and keeps the lengths of its bones; what
is taken over is how each bone is turned.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..body.mapping import Mapping, read_map, to_body
from ..constraints import feet
from ..constraints.bones import reference_lengths
from ..constraints.checks import checks
from ..constraints.ground import ground
from ..constraints.seams import meet_rig_seams
from ..errors import InputError
from ..motion import Array, Rig, Take
from ..networks import checkpoints
from ..networks.rows import in_world, seen_from
from ..progress import Stage, silent
from ..ranges import Range, split_names
from ..repairs import filling, repairing
from ..repairs.report import Filled
from ..rigs.fitting import fit
from ..rotations import apply, from_rotvec, inverse, multiply, normalised
from .composing import (
    Clip,
    Composition,
    Piece,
    ancestors,
    counterparts,
    frame_of,
    frames_of,
    length_of,
    overrides_for,
    path_in,
    person_in,
    same_rest,
)

FADE = "0.4s"
ANSWERS = "convae"  # the network that fills a body around what its hands do


def blend(
    take: Take,
    source: Take,
    *,
    joints: str | Iterable[str],
    frames: Range,
    at: int | str,
    fade: int | str = FADE,
    whole: bool = False,
    method: str = "auto",
    map: str | Path | dict[str, str] | None = None,
    stage: Stage = silent,
) -> Take:
    """Put the motion that some joints have in another take into this one; all else stays bit for bit.

    Parameters
    ----------
    source : the other take, of any rate, and of any rig in which a person is found.
    joints : names in `take`, such as "RightArm,RightForeArm,RightHand". As in a repair, these are the joints' own
        channels in a take of channels, and the points themselves in a take of points.
    frames : of `source`: (40, 55), "40:55" or "0.5s:0.8s".
    at : the frame of `take` at which they begin: 120 or "2s".
    fade : before and after them, how long the joints take to go there and back: frames, or "0.4s". None is needed at
        an end of the take.
    whole : also hide the rest of the body for all this time and fill it, so that it may answer to the joints. Only a
        network knows how a body answers: `method` if it is one, else "convae" where it is installed.
    method : of `repair`.
    map : overrides of the rig's mapping, as in `repair`; for the source too, if its joints have these names.

    Returns
    -------
    The take. Its `report` is a `composing.Composition`.

    Raises
    ------
    InputError : for names or frames that the takes do not have, where there is no room for a fade, where the source's
        samples are missing, and if no person is found in one of the takes.
    """
    overrides = map if isinstance(map, dict) or map is None else read_map(map)
    ours, theirs = person_in(take, overrides), person_in(source, overrides_for(source, take, overrides))
    named = _named(take, joints, ours)
    clip = Clip.of(source, frames_of(frames, source), take.fps)
    begin, first, last, end = _room(take, clip, at, fade)
    body, notes, fills = take, take.notes, []
    if whole:
        stage("filling the body")
        body = _answering(take, clip, named, (ours, theirs), (begin, first, end), method)
        fills.append(Filled(take.skeleton.names, begin, end, (end - begin) / take.fps, method, "the whole body"))
    stage("posing")
    posed, kept = _posed(body, clip, named, (ours, theirs), first)
    if kept:
        notes += (f"nothing in {clip.name} says how these are turned, which stay as they were: {', '.join(kept)}",)
    taken = [take.skeleton.names[joint] for joint in named if take.skeleton.names[joint] not in kept]
    lost = [(taken, start, stop) for start, stop in ((begin, first), (last, end)) if start < stop]
    changed = np.zeros((len(take), len(take.skeleton)), bool)
    changed[begin:end, slice(None) if whole else [take.skeleton.index(name) for name in taken]] = True
    filled = repairing.repair(posed, lost=lost, method=method, map=overrides, stage=stage) if lost else posed
    soles = feet.soles(feet.legs(ours.joints))
    checked = checks(take, filled, changed, soles).as_dict()
    if lost:
        fills += filled.report.fills
        # Where a fade meets what was taken over there is a seam, too.
        checked |= {name: filled.report.checks[name] for name in ("seam_jump", "seam_kink")}
    piece = Piece(first, last, tuple(taken), clip.name, (clip.start, clip.stop), "turned as seen from the body")
    report = Composition(
        source=Path(take.source).name, format=take.format, frames=len(take), fps=take.fps, units=take.units.why,
        samples=int(changed.size), changed=int(changed.sum()), pieces=[piece], fills=fills, checks=checked, notes=notes,
    )  # fmt: skip
    return replace(filled, report=report)


def _named(take: Take, joints: str | Iterable[str], mapping: Mapping) -> list[int]:
    """The indices of the joints, each after its parent; none of them may carry the whole body."""
    try:
        if isinstance(joints, str):
            found, rest = split_names(joints, take)
            if rest != ":":
                hint = "the source's frames go with --frames, the take's with --at"
                raise InputError(f"{joints!r} has frames in it", expected="names only", hint=hint)
        else:
            found = [take.skeleton.index(name) for name in joints]
    except InputError as error:
        raise InputError(str(error), where=take.source) from None
    if not found:
        raise InputError("no joint was named", where=take.source, hint="name some, such as those of an arm")
    hips = mapping.found.get("hips", -1)
    carriers = {hips, *(ancestors(take.skeleton, hips) if hips >= 0 else [])} & set(found)
    if carriers:
        hint = "name joints of a limb or of the spine; --whole lets the rest of the body answer"
        raise InputError(f"{take.skeleton.names[min(carriers)]} carries the whole body", where=take.source, hint=hint)
    return sorted(set(found))


def _room(take: Take, clip: Clip, at: int | str, fade: int | str) -> tuple[int, int, int, int]:
    """Where the way there begins, where the clip does, where the way back does, and where it ends."""
    first, length = frame_of(at, take), length_of(fade, take.fps, "a fade")
    last, frames = first + len(clip), len(take)
    if last > frames:
        found = f"{len(clip)} frames from frame {first} on do not fit into a take of {frames}"
        raise InputError(found, where=take.source, hint=f"begin at {max(frames - len(clip), 0)} or before")
    begin, end = first - length if first else 0, last + length if last < frames else frames
    if begin < 1 <= first or end >= frames > last:
        room = first if begin < 1 <= first else frames - last
        side = "before" if begin < 1 <= first else "after"
        found = f"the take has {room} frames {side} the blended ones, too few for a fade of {length}"
        raise InputError(found, where=take.source, hint="say a shorter --fade, or another frame with --at")
    return begin, first, last, end


def _posed(
    take: Take, clip: Clip, named: Sequence[int], maps: tuple[Mapping, Mapping], first: int
) -> tuple[Take, list[str]]:
    """The take with the named joints turned as in the clip; and the names of those of which the clip says nothing."""
    rows = np.arange(first, first + len(clip))
    same, above = counterparts(take.skeleton, clip.take.skeleton, *maps)
    _, mine = path_in(take, maps[0])(rows / take.fps)
    _, its = path_in(clip.take, maps[1])(clip.seconds)
    turn = from_rotvec((mine - its)[:, None] * [0, 1, 0])
    alike = take.rig is not None and clip.rig is not None and same_rest(take.rig, clip.rig)
    if alike:
        assert take.rig is not None and clip.rig is not None
        take = take.with_rig(_turned_alike(take.rig, clip.rig, named, rows, turn))
    seen = np.where(clip.motion.observed[..., None], clip.motion.positions, np.nan)
    kept = []
    for joint in named:
        below = [end for end, on_the_way in _below(take, joint, above) if on_the_way and same[end] >= 0]
        if not below:
            kept += [] if alike else [take.skeleton.names[joint]]
            continue
        places = take.motion.positions if take.rig is None else take.rig.kinematics[0]
        targets = np.full((len(take), len(take.skeleton), 3), np.nan)
        for end in below:
            bone = seen[:, same[end]] - seen[:, same[above[end]]]
            start = places[rows, above[end]]
            length = np.linalg.norm(take.motion.positions[rows, end] - take.motion.positions[rows, above[end]], axis=-1)
            targets[rows, end] = start + normalised(apply(turn, bone)) * length[:, None]
            if not np.isfinite(bone + start).all():
                name = clip.take.skeleton.names[same[end]]
                raise InputError(f"samples of {name}, or of what it hangs on, are missing in the frames to blend",
                                 where=clip.take.source, hint="repair them first, or choose other frames")  # fmt: skip
        where = np.zeros(take.trusted.shape, bool)
        where[rows, joint] = True
        if take.rig is not None:
            before, take = take.rig, fit(take, targets, where)
            assert take.rig is not None
            if not alike and np.array_equal(before.rotations, take.rig.rotations):
                kept.append(take.skeleton.names[joint])  # a joint that never turns in this rig
        else:
            positions = np.where(where[..., None], targets, take.motion.positions).astype(np.float32)
            take = take.with_motion(replace(take.motion, positions=positions, observed=take.motion.observed | where))
    if len(kept) == len(named):
        found = f"nothing tells how {', '.join(kept)} should be turned"
        raise InputError(found, where=clip.take.source, hint="name joints above, such as those of the whole arm")
    return take, kept


def _below(take: Take, joint: int, above: Array) -> Iterable[tuple[int, bool]]:
    """Each joint with one above it to be seen from, and whether `joint` turns the way between (or is its end)."""
    for end in np.flatnonzero(above >= 0).tolist():
        if take.rig is None:
            yield end, end == joint
            continue
        here = take.skeleton.parents[end]
        while here >= 0 and here not in (joint, above[end]):
            here = take.skeleton.parents[here]
        yield end, here == joint


def _turned_alike(rig: Rig, other: Rig, named: Sequence[int], rows: Array, turn: Array) -> Rig:
    """The rig with the named joints in `rows` at the attitudes in the world that `other` has, turned by `turn`."""
    world, theirs = rig.kinematics[1][rows].copy(), other.kinematics[1]
    rotations = rig.rotations.copy()
    for joint, parent in enumerate(rig.skeleton.parents):
        if joint in named:
            world[:, joint] = multiply(turn, theirs[:, joint])
            rotations[rows, joint] = multiply(inverse(world[:, parent]), world[:, joint])
        elif parent >= 0:
            world[:, joint] = multiply(world[:, parent], rig.rotations[rows, joint])
    return replace(rig, rotations=rotations)


def _answering(
    take: Take, clip: Clip, named: Sequence[int], maps: tuple[Mapping, Mapping], span: tuple[int, int, int], method: str
) -> Take:
    """The take with the whole body filled over a gap, in which a network is shown where the named joints are to be."""
    (begin, first, end), (ours, theirs) = span, maps
    gap = np.zeros(take.trusted.shape, bool)
    gap[begin:end] = True
    hidden = take.distrust(gap)
    shown = [index for index, joint in enumerate(ours.joints) if joint in named and theirs.joints[index] >= 0]
    if not shown:
        raise InputError("none of the named joints is one that a body answers to", where=take.source,
                         hint="leave --whole out, or name joints of a limb")  # fmt: skip
    legs = feet.legs(ours.joints)
    filled, _ = filling.fill(hidden, method, legs=legs, mapping=ours)
    network = next((name for name in (method, ANSWERS) if name in checkpoints.names()), "")
    if not network:
        return feet.plant_feet(filled, gap, legs)[0]

    rows = np.arange(first, first + len(clip))
    ground_of = [ground(to_body(each.motion, mapping)) for each, mapping in ((take, ours), (clip.take, theirs))]
    body = to_body(clip.motion, theirs)
    root, heading = path_in(clip.take, theirs)(clip.seconds)
    local = seen_from(body.positions[None] - np.array([0, ground_of[1], 0], np.float32), root[None], heading[None])
    root, heading = path_in(take, ours)(rows / take.fps)
    places = in_world(local * _size(take, clip, maps), root[None], heading[None])[0] + [0, ground_of[0], 0]

    positions, observed = take.motion.positions.copy(), take.motion.observed & ~gap
    joints = [ours.joints[index] for index in shown]
    positions[rows[:, None], joints] = places[:, shown]
    observed[rows[:, None], joints] = np.isfinite(places[:, shown]).all(axis=-1)
    points = replace(take, rig=None, motion=replace(take.motion, positions=positions, observed=observed))
    answer, _ = filling.fill(points, network, mapping=ours)
    if take.rig is None:
        return feet.plant_feet(answer, gap, legs)[0]
    known = [joint for joint in ours.joints if joint >= 0]
    targets = np.full(positions.shape, np.nan)
    targets[:, known] = np.where(answer.motion.observed[..., None], answer.motion.positions, np.nan)[:, known]
    rig = fit(filled, targets, gap).rig
    assert rig is not None and hidden.rig is not None
    answering = filled.with_rig(replace(meet_rig_seams(rig, hidden.rig, take.fps), trusted=rig.trusted))
    return feet.plant_feet(answering, gap, legs)[0]


def _size(take: Take, clip: Clip, maps: tuple[Mapping, Mapping]) -> float:
    """How large the take's person is beside the clip's: the sum of the bones that both have."""
    lengths = np.array([reference_lengths(to_body(each.motion, of)) for each, of in zip((take, clip), maps)])
    both = np.isfinite(lengths).all(axis=0)
    return float(np.divide(*lengths[:, both].sum(axis=1)))
