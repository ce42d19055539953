"""A sheet of poses: some clips of each split of a corpus, as stick figures on the ground."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..body.joints import BODY
from ..body.measures import facing
from ..motion import Array, Motion
from .corpus import SPLITS, Clip, Corpus

TRUNK, LEFT, RIGHT, GROUND = "#4a5568", "#2a9d8f", "#e4572e", "#cbd2d9"
CLIPS, POSES, COLUMNS = 4, 6, 2  # clips of a split, poses of a clip, clips side by side
WIDTH, ABOVE, BELOW = 1.3, 2.1, 0.25  # metres of the sheet for one pose: across, above the ground, below it
SPAN = (POSES - 0.5) * WIDTH
INCH = 13 / (COLUMNS * POSES * WIDTH)  # inches on paper for a metre
LONGEST = 40  # characters of a clip's name that there is room for
TURN = np.radians(40)  # seen from the front, and so much from the side


def draw_sheet(corpus: Corpus, path: Path) -> None:
    """Write a PNG: some clips of each split, six poses of each evenly through its time, all to one scale.

    The clips are spread evenly over their split's. Left limbs are green, right ones red, y = 0 is a line. Joints
    that are not observed are bridged.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    chosen = [_spread(corpus.in_split(split)) for split in (*SPLITS, "")]
    lines = [clips[at : at + COLUMNS] for clips in chosen for at in range(0, len(clips), COLUMNS)]
    strips = [[(clip, _poses(corpus.motion(clip))) for clip in clips] for clips in lines]
    tops = [max(ABOVE, *(_top(poses) for _, poses in strip)) for strip in strips]
    heights = [INCH * (top + BELOW) + 0.3 for top in tops]
    figure = Figure(figsize=(13, 0.5 + sum(heights)), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(lines), COLUMNS, squeeze=False, height_ratios=heights)
    for row, strip, top in zip(grid, strips, tops):
        for axes in row:
            axes.axis("off")
        for axes, (clip, poses) in zip(row, strip):
            _strip(axes, poses, clip, clip.frames / corpus.fps, top)
    figure.suptitle(f"{corpus.name}: {len(corpus.clips)} clips at {corpus.fps:g} fps", fontsize=14)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _spread(clips: tuple[Clip, ...]) -> list[Clip]:
    """A few of the clips, evenly through their order."""
    count = min(CLIPS, len(clips))
    return [clips[int((number + 0.5) * len(clips) / count)] for number in range(count)]


def _poses(motion: Motion) -> list[tuple[float, Motion]]:
    """Some frames evenly through a motion: when each is, and a motion of it alone."""
    frames = np.unique(np.linspace(0, len(motion) - 1, POSES).round().astype(int))
    return [
        (frame / motion.fps, replace(motion, positions=motion.positions[[frame]], observed=motion.observed[[frame]]))
        for frame in frames
    ]


def _top(poses: list[tuple[float, Motion]]) -> float:
    """What the highest joint needs, with the head over it."""
    return max(float(pose.positions[pose.observed][:, 1].max(initial=0)) for _, pose in poses) + 0.25


def _strip(axes, poses: list[tuple[float, Motion]], clip: Clip, seconds: float, top: float) -> None:
    """A clip's poses side by side."""
    axes.plot([-WIDTH / 2, SPAN], [0, 0], color=GROUND, lw=1.2, zorder=0)
    for place, (time, pose) in enumerate(poses):
        names, seen = pose.skeleton.names, pose.observed[0]
        points = _view(pose) + np.array([place * WIDTH, 0])
        bones = _bones(pose.skeleton.parents, seen)
        for joint, parent in bones:
            colour = _colour(names[joint])
            axes.plot(*points[[joint, parent]].T, color=colour, lw=2.4, clip_on=False, solid_capstyle="round",
                      zorder=3 if colour == TRUNK else 2)  # fmt: skip
            if names[joint] == "head":
                axes.scatter(*_beyond(points[parent], points[joint]), s=50, color=TRUNK, lw=0, clip_on=False)
        if not bones:
            axes.scatter(*points[seen].T, s=7, color=TRUNK)
        axes.annotate(f"{time:.1f} s", (place * WIDTH, 0), (0, -5), textcoords="offset points",
                      ha="center", va="top", fontsize=7.5, color=TRUNK)  # fmt: skip
    said = [clip.split or "no split", *([clip.rig] if clip.rig else []), f"{seconds:.1f} s"]
    said += [f"ground moved by {-clip.floor:+.2f} m"] * (abs(clip.floor) >= 0.005)
    name = clip.name if len(clip.name) <= LONGEST else "…" + clip.name[1 - LONGEST :]
    name = name.replace("$", r"\$").encode(errors="replace").decode()  # no formulas, and what is not UTF-8 as "?"
    axes.set_title(f"{name}   " + " · ".join(said), loc="left", fontsize=9, color=TRUNK)
    axes.set_xlim(-WIDTH / 2, SPAN)
    axes.set_ylim(-BELOW, top)
    axes.set_aspect("equal")


def _bones(parents: tuple[int, ...], seen: Array) -> list[tuple[int, int]]:
    """The bones to draw, each joint and its nearest ancestor that is observed."""
    bones = []
    for joint in np.flatnonzero(seen):
        parent = parents[joint]
        while parent >= 0 and not seen[parent]:
            parent = parents[parent]
        if parent >= 0:
            bones.append((int(joint), parent))
    return bones


def _beyond(neck: Array, head: Array) -> Array:
    """The middle of the head, 11 cm beyond its base."""
    return head + 0.11 * (head - neck) / max(float(np.linalg.norm(head - neck)), 1e-6)


def _view(pose: Motion) -> Array:
    """`(joints, 2)` of one frame in a three-quarter view: across, centred on what is observed, and height."""
    points, seen = pose.positions[0].astype(float), pose.observed[0]
    forward = facing(pose)[0] if pose.skeleton == BODY else np.full(3, np.nan)
    heading = np.arctan2(forward[2], forward[0]) if np.isfinite(forward).all() else 0.0
    across = np.array([np.cos(heading - np.pi / 2 - TURN), np.sin(heading - np.pi / 2 - TURN)])
    middle = points[seen][:, [0, 2]].mean(axis=0) if seen.any() else np.zeros(2)
    return np.stack([(points[:, [0, 2]] - middle) @ across, points[:, 1]], axis=-1)


def _colour(name: str) -> str:
    return LEFT if name.startswith("left_") else RIGHT if name.startswith("right_") else TRUNK
