"""Loose files read as takes: diagnosed, calibration poses cut off, what cannot be read left out with the reason."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ... import io
from ...body.joints import JOINT
from ...body.mapping import map_rig, to_body
from ...constraints.ground import ground
from ...diagnosis.diagnosing import diagnose
from ...diagnosis.findings import CERTAIN
from ...errors import InputError
from ...motion import Array, Motion
from ...progress import Stage
from ..corpus import Dropped
from .raw import Raw, Source


def takes(sources: Iterable[Source], stage: Stage) -> Iterator[Raw | Dropped]:
    """Read files one after the other, diagnose them, and leave out what is no motion.

    Samples that the diagnosis does not trust are unobserved. A pose at the start that the take leaves at a jump, and a
    T-pose at the start or the end, are cut off and noted. Files that cannot be read are dropped with the reason.
    """
    sources = list(sources)
    for number, source in enumerate(sources, 1):
        stage(f"take {number} of {len(sources)}, {source.file}")
        try:
            yield _read(source)
        except (InputError, OSError) as error:
            yield Dropped(source.file, reason(error, source.path))


HINTS = {
    "--fps": "name the true rate in the column fps of a table for --splits",
    "--asf": "put its skeleton beside it, with the same name",
}


def reason(error: InputError | OSError, path: Path) -> str:
    """Why a file is dropped, in words: without its name, which stands beside, nor options that `data build` lacks."""
    if not isinstance(error, InputError):
        return error.strerror or "it cannot be read"
    hint = next((better for option, better in HINTS.items() if option in error.hint), error.hint)
    said = str(InputError(error.found, where=error.where, expected=error.expected, hint=hint))
    said = said.removeprefix(f"{path}: ").replace(f"{path}:", "line ", 1)
    return said.replace(f"{path.parent}{os.sep}", "")


def _read(source: Source) -> Raw:
    asf = asf_of(source.path) if source.path.suffix.lower() == ".amc" else None
    take = io.load(source.path, fps=source.fps, unit=source.unit, up=source.up, asf=asf)
    diagnosis = diagnose(take)
    notes = list(source.notes)
    untrusted = diagnosis.untrusted
    motion = take.distrust(untrusted).motion
    poses = [f.stop for f in diagnosis.findings if f.cause == "t-pose" and f.start == 0 and f.certainty >= CERTAIN]
    first, last = max([source.skip, *poses]), len(motion)
    if first:
        pose = f"calibration pose cut off: {first} frame{'s' * (first > 1)} at the start"
        notes.append(source.skip_why if first == source.skip else pose)
    mapping = map_rig(motion.skeleton, motion.positions)
    if mapping.is_person:
        posing = t_pose(to_body(motion, mapping))
        begin, end = _ends(posing[first:])
        if begin or end:
            notes.append(f"T-pose cut off: {begin} frames at the start, {end} at the end")
        first, last = first + begin, last - end
    if first >= last:
        raise InputError("it is a T-pose throughout")
    motion = replace(motion, positions=motion.positions[first:last], observed=motion.observed[first:last])
    lost = 1 - motion.observed.mean()
    if lost:
        causes = sorted({f.cause for f in diagnosis.findings if f.certainty >= CERTAIN} - {"t-pose", "noise", "swap"})
        notes.append(f"{100 * lost:.2g} % of its samples untrusted ({', '.join(causes)})")
    floor = {"file": 0.0, "feet": ground(to_body(motion, mapping))}.get(source.ground)
    return Raw(
        source.name, source.file, source.subject, source.split, motion, mapping.rig, source.licence,
        io.sha256_of(source.path, *([asf] if asf else [])), tuple(notes), None, floor, source.figure,
    )  # fmt: skip


def _ends(mask: Array) -> tuple[int, int]:
    """How many entries are True at the start and, unless that is all of them, at the end."""
    others = np.flatnonzero(~mask)
    return (int(others[0]), int(len(mask) - 1 - others[-1])) if len(others) else (len(mask), 0)


def asf_of(path: Path) -> Path | None:
    """The skeleton of an AMC file: the only ASF beside it, or the one named as it begins (05.asf for 05_01.amc)."""
    skeletons = [other for other in sorted(path.parent.iterdir()) if other.suffix.lower() == ".asf"]
    stems = path.stem.lower(), path.stem.lower().split("_")[0]
    named = [other for stem in stems for other in skeletons if other.stem.lower() == stem]
    return named[0] if named else skeletons[0] if len(skeletons) == 1 else None


T_POSE = np.radians(12)  # how far arms may be from horizontal and legs from vertical


def t_pose(body: Motion) -> Array:
    """`(frames,)` bool: arms straight out to the sides, legs straight down; False where any of them is not observed."""
    posing = np.ones(len(body), bool)
    for side in ("left", "right"):
        for upper, lower, upright in (("upper_arm", "forearm", False), ("forearm", "hand", False),
                                      ("thigh", "shin", True), ("shin", "foot", True)):  # fmt: skip
            start, end = JOINT[f"{side}_{upper}"], JOINT[f"{side}_{lower}"]
            bone = body.positions[:, end] - body.positions[:, start]
            seen = body.observed[:, start] & body.observed[:, end]
            bone = np.where(seen[:, None], bone, 1.0)  # neither horizontal nor vertical
            slope = np.arctan2(-bone[:, 1], np.hypot(bone[:, 0], bone[:, 2]))
            posing &= slope > np.pi / 2 - T_POSE if upright else np.abs(slope) < T_POSE
    return posing
