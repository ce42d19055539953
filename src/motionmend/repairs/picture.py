"""A picture of a repair: the poses before and after, and the paths of the joints that move most."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..motion import Array, Motion, Take, runs

KNOWN, REPAIRED, BROKEN, TRUTH = "#4a5568", "#e4572e", "#9aa5b1", "#2a9d8f"


def draw_repair(
    before: Take, after: Take, path: Path, truth: Take | None = None, other: Take | None = None
) -> None:
    """Write a PNG of the stretch in which most was repaired, with some context on both sides.

    Parameters
    ----------
    before, after : the damaged and the repaired take.
    truth : the undamaged take, where it is known (a demonstration): drawn as a broad line.
    other : the same damage, repaired by a spline: drawn below, and dashed; the truth then stands behind all poses.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    moved = np.linalg.norm(after.motion.positions - before.motion.positions, axis=-1)
    # A sample that was missing has moved from nowhere: count it as a limb's length.
    moved = np.where(np.isnan(moved), np.where(after.motion.observed, 0.5, 0.0), moved)
    filled = np.asarray(moved > 0)
    start, stop = max(runs(np.asarray(filled.any(axis=1))), key=lambda run: moved[run[0] : run[1]].sum())
    margin = max(stop - start, int(0.3 * after.fps))
    first, last = max(start - margin, 0), min(stop + margin, len(after))
    shown = [(before, BROKEN, "as it came"), (after, REPAIRED, "repaired")]
    shown += [(other, BROKEN, "by a spline")] if other else []
    figure = Figure(figsize=(13, 2.6 + 3 * len(shown)), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(shown) + 2, 1, height_ratios=[3] * len(shown) + [1.4, 1.4])
    frames = np.unique(np.linspace(first, last - 1, 11).round().astype(int))
    for axes, (take, colour, title) in zip(rows, shown):
        _poses(axes, take.motion, frames, filled, colour, title, truth.motion if truth and other else None)

    moving = _most_moving(after.motion, filled, first, last)
    for axes, joint in zip(rows[-2:], moving):
        time = np.arange(first, last) / after.fps
        for take, colour, width, label in (
            (truth, TRUTH, 5, "truth"),
            (before, BROKEN, 1.5, "as it came"),
            (other, BROKEN, 1.6, "by a spline"),
            (after, REPAIRED, 2, "repaired"),
        ):
            if take is not None:
                height = take.motion.positions[first:last, joint, 1] * 100
                style = "--" if take is other else "-"
                axes.plot(time, height, style, color=colour, lw=width, label=label, alpha=0.45 if width == 5 else 1)
        for begin, end in runs(filled[first:last, joint]):
            axes.axvspan((first + begin) / after.fps, (first + end - 1) / after.fps, color=REPAIRED, alpha=0.08, lw=0)
        axes.set_ylabel(f"{after.skeleton.names[joint]}\nheight (cm)")
        axes.margins(x=0)
        axes.spines[["top", "right"]].set_visible(False)
    rows[-2].legend(loc="upper right", frameon=False, ncols=4)
    rows[-1].set_xlabel("time (s)")
    figure.suptitle(
        f"{Path(after.source).name}: frames {start}:{stop} ({(stop - start) / after.fps:.2f} s) repaired", fontsize=14
    )
    figure.savefig(path, dpi=110)


def draw_filled(motion: Motion, filled: Array, path: Path, title: str, *, rows: int = 4, across: int = 16) -> None:
    """Write a PNG of poses evenly through a motion, row after row: known joints grey, those that are `filled` orange.

    filled : `(frames, joints)` bool. rows, across : how many poses below and beside one another.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 2.1 * rows + 0.5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    lines = figure.subplots(rows, 1, squeeze=False)[:, 0]
    frames = np.linspace(0, len(motion) - 1, rows * across).round().astype(int)
    for axes, some in zip(lines, np.split(frames, rows)):
        seconds = [f"{frame / motion.fps:.1f} s" for frame in some[[0, -1]]]
        _poses(axes, motion, np.unique(some), filled, REPAIRED, " to ".join(seconds))
    figure.suptitle(title, fontsize=14)
    figure.savefig(path, dpi=110)


def _poses(
    axes, motion: Motion, frames: Array, filled: Array, colour: str, title: str, truth: Motion | None = None
) -> None:
    """Stick figures side by side in time, seen a little from the side; changed joints in colour, the truth behind."""
    view = _view(motion.positions[frames])
    behind = _view(truth.positions[frames], motion.positions[frames]) if truth else None
    spacing = 1.05 * max(np.nanmax(np.ptp(view[..., 0], axis=1)), 0.35 * np.nanmax(np.ptp(view[..., 1], axis=1)))
    bones = [(joint, parent) for joint, parent in enumerate(motion.skeleton.parents) if parent >= 0]
    for place, frame in enumerate(frames):
        points = view[place] + [place * spacing, 0]
        for joint, parent in bones:
            changed = filled[frame, joint] or filled[frame, parent]
            if changed and behind is not None:
                true = behind[place] + [place * spacing, 0]
                axes.plot(*true[[joint, parent]].T, color=TRUTH, lw=6, alpha=0.4, solid_capstyle="round", zorder=1)
            axes.plot(*points[[joint, parent]].T, color=colour if changed else KNOWN, lw=2.4, solid_capstyle="round")
        if not bones:
            axes.scatter(*points.T, s=9, c=np.where(filled[frame], colour, KNOWN))
        axes.annotate(f"{frame}", (place * spacing, np.nanmin(view[..., 1])), (0, -14), textcoords="offset points",
                      ha="center", fontsize=8, color=KNOWN)
    axes.set_title(title, loc="left", fontsize=11, color=colour)
    axes.set_aspect("equal")
    axes.axis("off")


def _view(positions: Array, seen_with: Array | None = None) -> Array:
    """`(frames, joints, 2)` of a three-quarter view, each pose centred over its own feet, or as `seen_with` is."""
    middle = np.nanmean(positions if seen_with is None else seen_with, axis=1, keepdims=True)
    centred = positions - middle * [1, 0, 1]
    travel = np.nanmean(np.diff(middle[:, 0, [0, 2]], axis=0), axis=0) if len(positions) > 1 else np.zeros(2)
    angle = np.arctan2(travel[1], travel[0]) + np.radians(25) if np.linalg.norm(travel) > 0.02 else np.radians(25)
    across = np.array([np.cos(angle), 0, np.sin(angle)])
    return np.stack([centred @ across, centred[..., 1]], axis=-1)


def _most_moving(motion: Motion, filled: Array, first: int, last: int) -> list[int]:
    """The repaired joints whose height changes most, one from each side of the body where it can be told."""
    spread = np.nan_to_num(np.ptp(motion.positions[first:last, :, 1], axis=0)) * filled[first:last].any(axis=0)
    best = int(np.argmax(spread))
    path = motion.positions[first:last]
    apart = np.linalg.norm(path - path[:, best, None], axis=-1).mean(axis=0)
    return [best, int(np.argmax(spread * (np.nan_to_num(apart) > 0.3 * np.nanmax(apart))))]
