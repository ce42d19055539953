"""A real take to hide samples of, for the tests of networks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import motionmend as mm
from motionmend.body.mapping import map_rig, to_body
from motionmend.motion import Motion
from motionmend.networks import windows

WALK = Path(mm.__file__).parent / "examples" / "walk.bvh"


def walk(fps: float) -> Motion:
    """A real take, whole: 21 joints at a network's rate."""
    take = mm.load(WALK)
    body = to_body(take.motion, map_rig(take.skeleton, take.motion.positions))
    assert body.observed.all()
    return windows.resample(body, fps)


def hidden(motion: Motion, observed) -> Motion:
    """With these samples observed, and NaN in all others."""
    positions = np.where(observed[..., None], motion.positions, np.float32(np.nan))
    return replace(motion, positions=positions, observed=observed)


def spy(run, inputs, seen):
    """Run, and note how many windows were run."""
    seen.append(len(next(iter(inputs.values()))))
    return run(inputs)
