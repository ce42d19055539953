"""Seed clips with gaps between them become one motion: the seed sequences of Kaufmann et al. 2020, section 5.

Each clip is turned about the vertical and moved on the floor, as one rigid whole, so that it goes on from where the
last one ended; then what lies between is a gap like any other, and is repaired.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..body.mapping import Mapping, read_map, to_body
from ..body.measures import facing
from ..constraints.ground import leg_length
from ..errors import InputError
from ..io import bvh
from ..motion import Array, Motion, Rig, Take
from ..networks.rows import hips_of
from ..progress import Stage, silent
from ..ranges import Range
from ..repairs import repairing
from ..rotations import apply, from_rotvec, inverse, multiply
from .composing import Clip, Composition, Piece, ancestors, length_of, overrides_for, person_in, same_rest
from .transfer import transferred

GAP = "1s"
PACE_SECONDS = 0.2  # of a clip's end that tell how fast the body goes and turns there
TURN_SECONDS = 0.4  # a turn that a clip ends or begins in goes on for no longer: few turns do

Seed = Take | tuple[Take, Range]


def chain(
    clips: Iterable[Seed],
    *,
    gap: int | str | Sequence[int | str] = GAP,
    fps: float | None = None,
    method: str = "auto",
    map: str | Path | dict[str, str] | None = None,
    stage: Stage = silent,
) -> Take:
    """One motion of seed clips, each going on from where the last one ended, the gaps between them filled.

    Parameters
    ----------
    clips : takes, or pairs of a take and its frames: (take, "40:80"), (take, (40, 80)). The motion has the first
        one's rig, format and units. Clips on the same skeleton keep every joint's own rotation, and their bytes in a
        BVH; of the same joints in another size, the rotations; others are fitted to where their joints are.
    gap : between two clips: frames of the result, or "1.25s". A sequence, or "50,100,75", has one for each gap.
    fps : of the result; the first clip's rate by default. Clips at other rates are resampled.
    method : of `repair`.
    map : overrides of the rig's mapping, as in `repair`, for clips that have joints of these names.

    Across a gap the body goes as fast as both clips do at its sides, each seen from where it faces: the mean of both,
    for as long as the gap is. A turn goes on likewise, but for 0.4 s at most. Feet are held still where they stand.

    Returns
    -------
    The take. Its `report` is a `composing.Composition`.

    Raises
    ------
    InputError : for fewer than two clips, gaps below one frame or not as many as there are between clips, clips in
        which no person is found or the rig of which cannot be had on the first's, and samples that are missing.
    """
    overrides = map if isinstance(map, dict) or map is None else read_map(map)
    seeds = [seed if isinstance(seed, tuple) else (seed, ":") for seed in clips]
    if len(seeds) < 2:
        found = "one clip" if seeds else "no clip"
        raise InputError(found, expected="two or more to chain", hint="name them in their order")
    rate = fps or seeds[0][0].fps
    stage("placing clips")
    first = Clip.of(*seeds[0], rate)
    gaps = gaps_of(gap, rate, len(seeds) - 1)
    mapping = person_in(first.take, overrides)
    placed: list[_Placed] = []
    for number, (take, frames) in enumerate(seeds):
        clip = Clip.of(take, frames, rate)
        theirs = person_in(take, overrides_for(take, first.take, overrides))
        told = _onto(first, mapping, clip, theirs)
        placed.append(_going_on(placed[-1], told, gaps[number - 1], mapping) if placed else told)

    assembled, spans = _assembled(placed, gaps)
    holes = list(zip([stop for _, stop in spans], [start for start, _ in spans[1:]]))
    filled = repairing.repair(assembled, gaps=holes, method=method, plant_feet=True, map=overrides, stage=stage)
    names = assembled.skeleton.names
    pieces = [
        Piece(start, stop, names, each.clip.name, (each.clip.start, each.clip.stop), each.how)
        for each, (start, stop) in zip(placed, spans)
    ]
    notes = tuple(dict.fromkeys(note for each in placed for note in (*each.clip.take.notes, *each.notes)))
    report = Composition(
        source=" + ".join(dict.fromkeys(each.clip.name for each in placed)), format=assembled.format,
        frames=len(assembled), fps=rate, units=assembled.units.why, samples=int(assembled.trusted.size),
        changed=filled.report.repaired, pieces=pieces, fills=filled.report.fills, checks=filled.report.checks,
        notes=notes,
    )  # fmt: skip
    return replace(filled, report=report)


def gaps_of(gap: int | str | Sequence[int | str], fps: float, count: int) -> list[int]:
    """The frames of `count` gaps, from one length for all of them or one for each."""
    told = gap.split(",") if isinstance(gap, str) else list(gap) if isinstance(gap, Sequence) else [gap]
    if len(told) not in (1, count):
        raise InputError(f"{len(told)} gaps for {count + 1} clips", expected=f"one length, or {count} of them")
    lengths = [length_of(length, fps, "a gap") for length in told]
    return lengths * count if len(lengths) == 1 else lengths


@dataclass(frozen=True, eq=False)
class _Placed:
    """A clip on the first one's rig: its channels or points, and how it came to stand where it does."""

    clip: Clip
    rig: Rig | None
    motion: Motion
    how: str
    notes: tuple[str, ...] = ()
    copied: bool = True


def _onto(first: Clip, ours: Mapping, clip: Clip, theirs: Mapping) -> _Placed:
    """A clip on the first one's rig, where it stands in its own file."""
    source = clip.take.source
    if clip.rig is not None and not clip.rig.trusted.all():
        raise InputError("some of its samples are not trusted", where=source, hint="repair it first")
    resampled = () if clip.exact else (f"{clip.name} was resampled from {clip.take.fps:g} to {clip.motion.fps:g} fps",)
    if first.rig is None:
        if clip.take.skeleton != first.take.skeleton:
            found = f"its joints or markers are not those of {first.name}, which has no rig to fit them to"
            raise InputError(found, where=source, hint="chain takes of the same markers, or begin with a BVH")
        if not to_body(clip.motion, theirs).observed[[0, -1], 0].all():
            raise InputError("its first or last frame lacks the hips", where=source, hint="repair it first")
        return _Placed(clip, None, clip.motion, "as it was", resampled)
    if clip.rig is not None and clip.take.skeleton == first.take.skeleton:
        if np.allclose(clip.rig.offsets, first.rig.offsets, atol=1e-4):
            return _Placed(clip, clip.rig, clip.motion, "as it was", resampled)
        if same_rest(first.rig, clip.rig):
            scale = leg_length(to_body(first.motion, ours)) / leg_length(to_body(clip.motion, theirs))
            rig = _resized(first.rig, clip.rig, scale if np.isfinite(scale) else 1.0)
            note = f"{clip.name} has bones of other lengths: its rotations were kept, its path is {scale:.2f} as long"
            return _Placed(clip, rig, rig.motion(clip.motion.fps), "rotations as they were", (note, *resampled), False)
    rig = transferred(first.take, ours, clip.motion, theirs, source)
    note = f"{clip.name} has another skeleton: the rig was fitted to its pose"
    return _Placed(clip, rig, rig.motion(clip.motion.fps), "fitted", (note, *resampled), False)


def _resized(rig: Rig, other: Rig, scale: float) -> Rig:
    """The other rig's rotations on this one's bones; roots go as far as legs of this length take them."""
    roots = np.array(rig.skeleton.parents) < 0
    bones = np.broadcast_to(rig.translations[0], other.translations.shape)
    shifts = np.where(roots[:, None], other.translations * scale, bones)
    return replace(rig, rotations=other.rotations, translations=shifts, trusted=other.trusted)


def _going_on(last: _Placed, clip: _Placed, gap: int, mapping: Mapping) -> _Placed:
    """A clip, turned and moved so that it goes on `gap` frames after the last one's end."""
    seconds = (gap + 1) / clip.motion.fps
    (root, pace, heading, spin), (its_root, its_pace, its_heading, its_spin) = (
        _end(last, mapping, at_end=True), _end(clip, mapping, at_end=False)
    )  # fmt: skip
    turned = (spin + its_spin) / 2 * min(seconds, TURN_SECONDS)
    # Half of the way at the one pace, seen from the heading there; half at the other.
    way = seconds / 2 * (pace + _turn(its_pace, heading + turned - its_heading))
    angle = heading + turned - its_heading
    shift = root + way - _turn(its_root, angle)
    angle = (angle + np.pi) % (2 * np.pi) - np.pi
    how = f"{clip.how}, turned by {np.degrees(angle):.0f}°, moved by {shift[0]:+.2f} and {shift[1]:+.2f} m"
    turn, by = from_rotvec(np.array([0.0, angle, 0.0])), np.array([shift[0], 0.0, shift[1]])
    if clip.rig is None:
        positions = (apply(turn, clip.motion.positions.astype(float)) + by).astype(np.float32)
        return replace(clip, motion=replace(clip.motion, positions=positions), how=how)
    rig = clip.rig
    rotations, translations = rig.rotations.copy(), rig.translations.copy()
    places, attitudes = rig.kinematics
    for joint in _carriers(rig, last.rig, mapping.found.get("hips", -1)):
        rotations[:, joint] = multiply(turn, attitudes[:, joint])
        translations[:, joint] = apply(turn, places[:, joint]) + by
        if (parent := rig.skeleton.parents[joint]) >= 0:
            back = inverse(attitudes[:, parent])
            rotations[:, joint] = multiply(back, rotations[:, joint])
            translations[:, joint] = apply(back, translations[:, joint] - places[:, parent])
    rig = replace(rig, rotations=rotations, translations=translations)
    return replace(clip, rig=rig, motion=rig.motion(clip.motion.fps), how=how)


def _carriers(rig: Rig, last: Rig | None, hips: int) -> list[int]:
    """The joints that carry the body through the world: the roots, or the hips below a root that stands still.

    Such a root is the same in all clips, and left where it is: a body that turns about it would go in an arc.
    """
    roots = [joint for joint, parent in enumerate(rig.skeleton.parents) if parent < 0]
    above = ancestors(rig.skeleton, hips) if hips >= 0 else []
    if not above or not rig.moves[hips] or len(roots) > 1 or last is None:
        return roots
    for mine, its in ((rig.rotations, last.rotations), (rig.translations, last.translations)):
        if np.ptp(np.concatenate([mine[:, above], its[:, above]]), axis=0).max() > 1e-6:
            return roots
    return [hips]


def _end(clip: _Placed, mapping: Mapping, at_end: bool) -> tuple[Array, Array, float, float]:
    """At a clip's end, or its start: the hips on the floor, m and m/s `(2,)` each, and the heading, rad and rad/s."""
    body = to_body(clip.motion, mapping)
    count = min(len(body), max(3, round(PACE_SECONDS * body.fps)))
    part = slice(len(body) - count, None) if at_end else slice(0, count)
    body = replace(body, positions=body.positions[part], observed=body.observed[part])
    ahead = facing(body)
    known = np.isfinite(ahead).all(axis=1)
    if not known.any():
        side = "end" if at_end else "start"
        raise InputError(f"it cannot be told where the body faces at its {side}", where=clip.clip.take.source,
                         hint="choose other frames, or repair it first")  # fmt: skip
    times = np.arange(count) / body.fps
    hips = hips_of(body.positions[None], body.observed[None])[0][:, [0, 2]]
    headings = np.unwrap(np.arctan2(ahead[known, 0], ahead[known, 2]).astype(float))
    here = -1 if at_end else 0
    return hips[here].astype(float), _slope(times, hips), float(headings[here]), float(_slope(times[known], headings))


def _slope(times: Array, values: Array) -> Array:
    """Of the straight line through `values (n, ...)` at `times (n,)`, a second; 0 for a single one."""
    apart = times - times.mean()
    values = values - values.mean(axis=0)
    return np.tensordot(apart, values, axes=1) / max(float(apart @ apart), 1e-12)


def _turn(vector: Array, angle: float) -> Array:
    """`(2,)` x and z turned about +Y by `angle` radians; a quarter turn takes +Z to +X."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([vector[0] * cosine + vector[1] * sine, vector[1] * cosine - vector[0] * sine])


def _assembled(placed: Sequence[_Placed], gaps: Sequence[int]) -> tuple[Take, list[tuple[int, int]]]:
    """All clips in one take, in the gaps the frame before them, untrusted; and the frames of each clip."""
    first, spans, order, begin = placed[0], [], [], 0
    for number, (each, gap) in enumerate(zip(placed, [*gaps, 0])):
        spans.append((begin, begin + len(each.motion)))
        order += [(number, frame) for frame in range(len(each.motion))] + [(number, len(each.motion) - 1)] * gap
        begin += len(each.motion) + gap
    which, frames = np.array(order).T
    starts = np.cumsum([0, *(len(each.motion) for each in placed)])[:-1]
    index = starts[which] + frames
    hole = np.ones(len(index), bool)
    for start, stop in spans:
        hole[start:stop] = False

    def joined(name: str, of: str) -> Array:
        return np.concatenate([getattr(getattr(each, of), name) for each in placed])[index]

    take = replace(first.clip.take, document=None, report=None)
    if first.rig is None:
        motion = replace(first.motion, positions=joined("positions", "motion"), observed=joined("observed", "motion"))
        take = replace(take, motion=motion)
    else:
        rig = replace(first.rig, rotations=joined("rotations", "rig"), translations=joined("translations", "rig"),
                      trusted=joined("trusted", "rig"))  # fmt: skip
        take = replace(take, rig=rig, motion=rig.motion(first.motion.fps), document=_document(placed, which, frames))
    return take.distrust(np.broadcast_to(hole[:, None], take.trusted.shape)), spans


def _document(placed: Sequence[_Placed], which: Array, frames: Array) -> bvh.Document | None:
    """What the motion is written into: the text of the clips that are copied, and of the first one for the rest."""
    pieces, first = [], placed[0].clip
    for number, each in enumerate(placed):
        own = frames[which == number]
        copied = (each.clip.take, each.clip.frames[own])
        pieces.append(copied if each.copied else (first.take, np.repeat(first.frames[:1], len(own))))
    return bvh.spliced(pieces, first.motion.fps)
