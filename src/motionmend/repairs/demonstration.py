"""A good take, damaged and repaired before your eyes."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

import numpy as np

from ..damage.planting import plant
from ..errors import InputError
from ..io import load, save, write_whole
from ..motion import Take
from .comparison import compare
from .inspecting import inspect
from .picture import draw_repair
from .repairing import repair

# What is planted in the bundled walk of 359 frames at 120 fps, and then found again without being told.
GAP = (128, 170)
ARM = ("LeftArm", "LeftForeArm", "LeftHand")
ARM_FRAMES = (230, 280)
JUMP = ("RightLeg", 310, 313)
# And in a walk of somebody whom no network that ships was trained on, while that leg swings forward.
LEG, LEG_FRAMES = ("rfemur", "rtibia", "rfoot", "rtoes"), (60, 144)


def demo(folder: Path) -> None:
    """Write a damaged take, the repaired one, its report and its picture into `folder`, and say how; and the same for a
    lost leg, beside what a spline makes of it."""
    if folder.exists() and not folder.is_dir():
        raise InputError("this is a file", where=folder, expected="a folder for the demonstration")
    folder.mkdir(parents=True, exist_ok=True)
    truth_path, broken_path, fixed_path = (folder / name for name in ("walk.bvh", "broken.bvh", "fixed.bvh"))
    truth = example(truth_path)

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
    step_picture = a_step_in_between(folder)
    print(f"\nThe repaired take: {fixed_path}\nIts report:        {report}\nA picture:         {picture}\n"
          f"A lost step:       {step_picture}")  # fmt: skip


def a_step_in_between(folder: Path) -> Path:
    """Lose a leg for long enough to take a step, repair it, and draw that beside a spline; returns the picture."""
    truth_path, broken_path, fixed_path, spline_path = (
        folder / f"step{name}.bvh" for name in ("", "_broken", "_fixed", "_spline")
    )
    truth = example(truth_path)
    joints = [truth.skeleton.index(name) for name in LEG]
    save(plant(truth, lost=[(joints, *LEG_FRAMES)]), broken_path, force=True)
    lost = f"{','.join(LEG)}:{LEG_FRAMES[0]}:{LEG_FRAMES[1]}"
    step(f"damage {truth_path} -o {broken_path} --lost {lost}")
    broken = load(broken_path)
    fixed, spline = (repair(broken, lost=[lost], method=method) for method in ("auto", "cubic"))
    for take, path, method in ((fixed, fixed_path, ""), (spline, spline_path, " --method cubic")):
        save(take, path, force=True)
        step(f"repair {broken_path} -o {path} --lost {lost}{method}")
        missed = np.linalg.norm(take.motion.positions - truth.motion.positions, axis=-1)
        missed = missed[LEG_FRAMES[0] : LEG_FRAMES[1], joints[1:]].mean()
        how = ", ".join(dict.fromkeys(row.method for row in take.report.fills))
        print(f"  knee, ankle and toes in the gap, by {how}: {1e3 * missed:.0f} mm from the truth")
    picture = folder / "step.png"
    write_whole(picture, lambda temporary: draw_repair(broken, fixed, temporary, truth, spline))
    return picture


def example(path: Path) -> Take:
    """The bundled take of this name, copied there."""
    with (files("motionmend") / "examples" / path.name).open("rb") as source, path.open("wb") as target:
        shutil.copyfileobj(source, target)
    return load(path)


def step(command: str) -> None:
    print(f"\n$ motionmend {command}")
