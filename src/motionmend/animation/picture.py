"""Animations drawn over each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..body.joints import BODY, JOINT
from ..body.mapping import map_rig, to_body
from ..motion import Take
from ..repairs.picture import KNOWN, REPAIRED, TRUTH


def draw_animation(takes: Sequence[Take], path: Path) -> None:
    """Write a PNG of variants of one animation over each other, at six instants from the pose on.

    takes : with the reports that `animating.animate` gives them. The paths of joints that were given one are drawn
        from a quarter of a second before to as long after each instant, as the first variant has them.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    bodies = [to_body(each.motion, map_rig(each.skeleton, each.motion.positions)) for each in takes]
    places = np.stack([body.positions for body in bodies]).astype(float)
    paths = takes[0].report.variants[0].control
    frames = np.unique(np.linspace(0, places.shape[1] - 1, 6).round().astype(int))
    figure = Figure(figsize=(13, 4), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    angle = np.radians(25)
    view = np.stack([places @ [np.cos(angle), 0, np.sin(angle)], places[..., 1]], axis=-1)
    middles = np.nanmean(view[:, :, JOINT["hips"], 0], axis=0)
    spacing = 1.1 * max(np.nanmax(np.ptp(view[:, frame, :, 0])) for frame in frames)
    half = round(takes[0].fps / 4)
    for column, frame in enumerate(frames):
        shift = np.array([column * spacing - middles[frame], 0])
        for points in view[:, frame] + shift:
            for joint, parent in enumerate(BODY.parents):
                if parent >= 0:
                    colour = KNOWN if frame == 0 else REPAIRED
                    alpha = 1 if frame == 0 else max(0.2, 1 / len(takes))
                    axes.plot(*points[[joint, parent]].T, color=colour, lw=2, alpha=alpha, solid_capstyle="round")
        for told in paths:
            joint, first = JOINT[told.part], told.start if told.start > 1 else 0
            near = view[0, max(first, frame - half) : min(told.stop, frame + half), joint] + shift
            axes.plot(*near.T, color=TRUTH, lw=2.4)
            if first <= frame < told.stop:
                axes.scatter(*(view[0, frame, joint] + shift), s=26, color=TRUTH, zorder=3)
        axes.annotate(f"{frame / takes[0].fps:.1f} s", (column * spacing, np.nanmin(view[..., 1])), (0, -14),
                      textcoords="offset points", ha="center", fontsize=8, color=KNOWN)  # fmt: skip
    axes.set_aspect("equal")
    axes.axis("off")
    given = f", along {len(paths)} given path{'s' * (len(paths) > 1)}" if paths else ""
    count = f"{len(takes)} animations" if len(takes) > 1 else "an animation"
    figure.suptitle(f"{Path(takes[0].source).name}: {count} of one pose{given}", fontsize=13)
    figure.savefig(path, dpi=110)
