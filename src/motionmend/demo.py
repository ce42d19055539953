"""A good take, damaged and repaired before your eyes."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

from .comparison import compare
from .errors import InputError
from .inspection import inspect
from .io import load, save, write_whole
from .picture import draw_repair
from .planting import plant
from .repairs import repair

# What is planted in the bundled walk of 359 frames at 120 fps, and then found again without being told.
GAP = (128, 170)
ARM = ("LeftArm", "LeftForeArm", "LeftHand")
ARM_FRAMES = (230, 280)
JUMP = ("RightLeg", 310, 313)


def demo(folder: Path) -> None:
    """Write walk.bvh, broken.bvh, fixed.bvh, fixed.bvh.report.json and fixed.png into `folder`, and say how."""
    if folder.exists() and not folder.is_dir():
        raise InputError("this is a file", where=folder, expected="a folder for the demonstration")
    folder.mkdir(parents=True, exist_ok=True)
    truth_path, broken_path, fixed_path = (folder / name for name in ("walk.bvh", "broken.bvh", "fixed.bvh"))
    with (files("motionmend") / "examples" / "walk.bvh").open("rb") as source, truth_path.open("wb") as target:
        shutil.copyfileobj(source, target)
    truth = load(truth_path)

    joints = [truth.skeleton.index(name) for name in ARM]
    jump = [truth.skeleton.index(JUMP[0])]
    broken = plant(truth, gaps=[GAP], lost=[(joints, *ARM_FRAMES)], jump=[(jump, *JUMP[1:])], seed=1)
    save(broken, broken_path, force=True)
    step(f"damage {truth_path} -o {broken_path} --gap {GAP[0]}:{GAP[1]} --lost {','.join(ARM)}:{ARM_FRAMES[0]}:"
         f"{ARM_FRAMES[1]} --jump {JUMP[0]}:{JUMP[1]}:{JUMP[2]} --seed 1")  # fmt: skip
    broken = load(broken_path)

    step(f"inspect {broken_path}")
    print(inspect(broken))

    fixed = repair(broken)
    save(fixed, fixed_path, force=True)
    report, picture = folder / "fixed.bvh.report.json", folder / "fixed.png"
    write_whole(report, lambda temporary: temporary.write_text(fixed.report.to_json(), encoding="utf-8"))
    write_whole(picture, lambda temporary: draw_repair(broken, fixed, temporary, truth))
    step(f"repair {broken_path} -o {fixed_path} --picture {picture}")
    print(fixed.report)

    step(f"compare {truth_path} {broken_path}   (how far off it was)")
    print(f"  MPJPE over the whole take: {compare(truth, broken).mpjpe:.2f} mm")
    step(f"compare {truth_path} {fixed_path}")
    print(f"  MPJPE over the whole take: {compare(truth, load(fixed_path)).mpjpe:.2f} mm")
    print(f"\nThe repaired take: {fixed_path}\nIts report:        {report}\nA picture:         {picture}")


def step(command: str) -> None:
    print(f"\n$ motionmend {command}")
