"""How far one take is from another."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..body.joints import BODY
from ..body.mapping import map_rig
from ..errors import InputError
from ..metrics import positional
from ..motion import Skeleton, Take
from ..ranges import Range, parse_range
from .report import table, to_json


@dataclass(frozen=True)
class Comparison:
    """Errors in mm over samples that both takes have, on the joints they share by name.

    mpjpe : mean distance of joints in the world; mpjpe_root : with the root of each pose at the origin
        (None where no root is shared). worst : the joint and frame furthest apart.
    differing : samples further apart than a micrometre, and the frames that hold them.
    bones : per take the mean over bones of the standard deviation of their length over time.
    """

    reference: str
    other: str
    frames: tuple[int, int]
    joints: int
    samples: int
    mpjpe: float
    mpjpe_root: float | None
    worst: dict
    per_joint: dict[str, float]
    differing_samples: int
    differing_frames: int
    missing: tuple[int, int]
    bones: tuple[float, float] | None
    bone_change: float | None
    jitter: tuple[float, float]
    only_in_reference: list[str]
    only_in_other: list[str]

    def to_json(self) -> str:
        return to_json(asdict(self))

    def __str__(self) -> str:
        def both(pair: tuple[float, float] | None, unit: str) -> str:
            return "no bones in common" if pair is None else f"{pair[0]:.3g} → {pair[1]:.3g} {unit}"

        rows = [
            ("MPJPE, global", f"{self.mpjpe:.3f} mm"),
            ("MPJPE, root-relative", "no root in common" if self.mpjpe_root is None else f"{self.mpjpe_root:.3f} mm"),
            ("worst", f"{self.worst['mm']:.3f} mm: {self.worst['joint']}, frame {self.worst['frame']}"),
            ("samples that differ", f"{self.differing_samples} of {self.samples}, in {self.differing_frames} frames"),
            ("samples missing", f"{self.missing[0]} → {self.missing[1]}"),
            ("limb length σ", both(self.bones, "mm")),
            ("bone length change, most", "–" if self.bone_change is None else f"{self.bone_change:.3f} mm"),
            ("jitter (mean jerk)", both(self.jitter, "m/s³")),
        ]
        furthest = sorted(self.per_joint.items(), key=lambda item: -item[1])[:8]
        lines = [
            f"{self.reference} against {self.other}, frames {self.frames[0]}:{self.frames[1]}, {self.joints} joints",
            table(("measure", "value"), rows),
            "",
            table(("joint", "mean mm"), [(name, f"{error:.3f}") for name, error in furthest]),
        ]
        for names, where in ((self.only_in_reference, self.reference), (self.only_in_other, self.other)):
            if names:
                lines.append(f"  only in {where}: {', '.join(names)}")
        return "\n".join(lines)


def compare(reference: Take, other: Take, frames: Range | None = None) -> Comparison:
    """Measure `other` against `reference` on the joints they share by name, whatever their formats.

    frames : a range such as "120:180" or (120, 180); otherwise all. InputError if the takes differ in length or
    rate, or share no name.
    """
    where = f"{reference.source} and {other.source}"
    if len(reference) != len(other):
        found = f"the takes have {len(reference)} and {len(other)} frames"
        raise InputError(found, where=where, expected="as many in both")
    if abs(reference.fps - other.fps) > 0.01 * reference.fps:
        raise InputError(f"the takes run at {reference.fps:g} and {other.fps:g} fps", where=where, hint="set --fps")
    names = [name for name in reference.skeleton.names if name in other.skeleton.names]
    if not names:
        raise InputError("the takes share no joint or marker by name", where=where)
    start, stop = parse_range(":" if frames is None else frames, len(reference), reference.fps)

    columns = [[take.skeleton.index(name) for name in names] for take in (reference, other)]
    truth, guess = (take.motion.positions[start:stop, columns[i]] for i, take in enumerate((reference, other)))
    seen = [take.motion.observed[start:stop, columns[i]] for i, take in enumerate((reference, other))]
    mask = seen[0] & seen[1]
    if not mask.any():
        raise InputError("the takes share no sample that is present in both", where=where)
    apart = np.where(mask, np.linalg.norm(truth.astype(float) - guess, axis=-1) * 1000, np.nan)
    frame, joint = np.unravel_index(np.nanargmax(apart), apart.shape)
    differing = np.nan_to_num(apart) > 1e-3
    counts = mask.sum(axis=0)
    sums = np.nansum(apart, axis=0)

    root = _root(reference.skeleton, reference.motion.positions, names)
    skeleton = _shared_bones(reference.skeleton, names)
    first, second = (np.where(mask[..., None], points, np.nan) for points in (truth, guess))
    bones, change = None, None
    if skeleton.has_bones:
        bones = positional.limb_sigma(first, skeleton.parents), positional.limb_sigma(second, skeleton.parents)
        change = positional.bone_length_change(first, second, skeleton.parents)
    return Comparison(
        reference=Path(reference.source).name,
        other=Path(other.source).name,
        frames=(start, stop),
        joints=len(names),
        samples=int(mask.sum()),
        mpjpe=float(np.nanmean(apart)),
        mpjpe_root=None if root is None else positional.mpjpe(truth, guess, mask & mask[:, root, None], root=root),
        worst={"mm": float(apart[frame, joint]), "joint": names[joint], "frame": int(start + frame)},
        per_joint={name: float(sums[i] / counts[i]) for i, name in enumerate(names) if counts[i]},
        differing_samples=int(differing.sum()),
        differing_frames=int(differing.any(axis=1).sum()),
        missing=(int((~seen[0]).sum()), int((~seen[1]).sum())),
        bones=bones,
        bone_change=change,
        jitter=(positional.jitter(first, reference.fps), positional.jitter(second, reference.fps)),
        only_in_reference=[name for name in reference.skeleton.names if name not in names],
        only_in_other=[name for name in other.skeleton.names if name not in names],
    )


def _root(skeleton: Skeleton, positions: np.ndarray, names: list[str]) -> int | None:
    """The place in `names` of the pelvis, or of the skeleton's first joint where there is no body."""
    hips = map_rig(skeleton, positions).joints[BODY.index("hips")]
    if hips < 0 and skeleton.has_bones:
        hips = 0
    return names.index(skeleton.names[hips]) if hips >= 0 and skeleton.names[hips] in names else None


def _shared_bones(skeleton: Skeleton, names: list[str]) -> Skeleton:
    """The skeleton over `names` only: a bone goes to the nearest ancestor that is shared."""
    parents = []
    for name in names:
        parent = skeleton.parents[skeleton.index(name)]
        while parent >= 0 and skeleton.names[parent] not in names:
            parent = skeleton.parents[parent]
        parents.append(names.index(skeleton.names[parent]) if parent >= 0 else -1)
    return Skeleton(tuple(names), tuple(parents))
