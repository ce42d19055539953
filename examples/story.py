"""Chain short seed clips from a folder of takes into one motion, and draw it: known poses grey, filled ones orange.

    python examples/story.py takes story.bvh

After Kaufmann et al. 2020, figure 1: 16 seed clips of two thirds of a second and gaps of 50 to 100 frames between them,
at 60 frames a second. Writes story.bvh and story.png. Curves glide through such gaps; it takes a network to step.
"""

import sys
from pathlib import Path

import numpy as np

import motionmend as mm
from motionmend.repairs.picture import draw_filled

CLIPS, FPS, SEED_SECONDS = 16, 60.0, 0.65


def seeds(folder: Path) -> list:
    """The middle of takes evenly through the folder, as pairs of a take and its frames."""
    paths = sorted(folder.rglob("*.bvh"))
    chosen = [paths[index] for index in np.linspace(0, len(paths) - 1, CLIPS).round().astype(int)] if paths else []
    clips = []
    for take in map(mm.load, chosen):
        length = round(SEED_SECONDS * take.fps)
        start = max(len(take) - length, 0) // 2
        clips.append((take, (start, start + length)))
    return clips


def main(source: str, target: str) -> None:
    gaps = np.random.default_rng(0).integers(50, 101, CLIPS - 1).tolist()
    story = mm.chain(seeds(Path(source)), gap=gaps, fps=FPS)
    print(story.report)
    mm.save(story, target)

    filled = np.zeros(story.trusted.shape, bool)
    for fill in story.report.fills:
        filled[fill.start : fill.stop] = True
    share = 100 * filled.mean()
    title = f"{len(story)} frames from {CLIPS} clips, {share:.0f} % of them filled"
    draw_filled(story.motion, filled, Path(target).with_suffix(".png"), title)


if __name__ == "__main__":
    main(*sys.argv[1:])
