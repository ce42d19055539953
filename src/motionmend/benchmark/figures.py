"""Results as PNGs: one for each task, a panel for each metric. The same results give the same bytes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .results import TRUTH, Cell, Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 4
TRUTH_COLOUR = "#8a94a0"
DPI = 100
MOST_TIMES = 4  # a line may leave the panel if it is so many times higher than the middle one


def draw(results: Results, folder: Path) -> list[str]:
    """Write a PNG for each task with more than one setting, then the protocol's own; their names."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    names = [method["name"] for method in results.header["methods"]]
    figures = {}
    for task in dict.fromkeys(cell.task for cell in results.cells):
        cells = [cell for cell in results.cells if cell.task == task]
        if len({cell.setting for cell in cells}) > 1:
            figures[stem(task)] = task_figure(task, cells, names)
    figures |= results.extra
    for name, figure in figures.items():
        FigureCanvasAgg(figure)
        # Without "Software" the bytes do not hang on matplotlib's version number.
        figure.savefig(folder / f"{name}.png", dpi=DPI, metadata={"Software": None})
    return [f"{name}.png" for name in figures]


def task_figure(task: str, cells: Sequence[Cell], names: Sequence[str]) -> Figure:
    """Lines over the settings, one a method, a panel a metric. A line far above the others leaves the panel."""
    import matplotlib
    from matplotlib.figure import Figure

    settings = list(dict.fromkeys(cell.setting for cell in cells))
    metrics = list(dict.fromkeys((cell.metric, cell.unit) for cell in cells))
    rows = -(-len(metrics) // COLUMNS)
    columns = min(COLUMNS, len(metrics))
    wide, high = 3.4 * columns + 1.7, 2.8 * rows + 0.5
    figure = Figure(figsize=(wide, high), facecolor="white")
    # Laid out by hand: matplotlib's constrained layout takes longer than all else here.
    figure.subplots_adjust(0.5 / wide, 0.35 / high, 1 - 1.9 / wide, 1 - 0.7 / high, wspace=0.22, hspace=0.32)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    colours = matplotlib.colormaps["tab10" if len(names) <= 10 else "tab20"]
    own = [name for name in dict.fromkeys(cell.method for cell in cells) if name not in names and name != TRUTH]
    styles = {TRUTH: {"color": TRUTH_COLOUR, "lw": 4, "alpha": 0.5}}
    styles |= {name: {"color": colours(place % colours.N), "lw": 1.5} for place, name in enumerate([*names, *own])}
    handles = {}
    for panel, (metric, unit) in zip(panels, metrics):
        tops = []
        for name, style in styles.items():
            line = {c.setting: c.value for c in cells if c.method == name and c.metric == metric}
            if line:
                places = [settings.index(setting) for setting in line]
                (handles[name],) = panel.plot(places, list(line.values()), marker="o", ms=3, label=name, **style)
                tops.append(max((value for value in line.values() if math.isfinite(value)), default=0))
        panel.set_xticks(range(len(settings)), settings, fontsize=8)
        panel.set_title(f"{metric} ({unit})" if unit else metric, fontsize=9, loc="left")
        panel.tick_params(axis="y", labelsize=8)
        usual = sorted(tops)[len(tops) // 2]
        panel.set_ylim(0, 1.05 * min(max(tops), MOST_TIMES * usual) or 1)
        panel.spines[["top", "right"]].set_visible(False)
    for panel in panels[len(metrics) :]:
        panel.axis("off")
    figure.legend(handles.values(), handles.keys(), loc="upper right", frameon=False, fontsize=8)
    figure.suptitle(task, fontsize=11, y=1 - 0.12 / high, va="top")
    return figure


def box_figure(
    title: str, rows: Mapping[str, Sequence[Sequence[float]]], columns: Sequence[str], label: str, level: float
) -> Figure:
    """Boxes over the columns, one a method: `rows` has whisker, quartile, median, quartile, whisker of each column.

    label : of the y axis. level : where a line is drawn across.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.5), layout="constrained")
    axes = figure.subplots()
    handles, width = [], 0.8 / len(rows)
    parts = "whislo", "q1", "med", "q3", "whishi"
    for number, row in enumerate(rows.values()):
        boxes = [dict(zip(parts, box)) | {"fliers": []} for box in row]
        places = np.arange(len(columns)) + (number - (len(rows) - 1) / 2) * width
        plot = axes.bxp(boxes, positions=places, widths=0.8 * width, patch_artist=True, showfliers=False,
                        boxprops={"facecolor": f"C{number}"}, medianprops={"color": "black"})  # fmt: skip
        handles.append(plot["boxes"][0])
    axes.axhline(level, color="gray", linewidth=0.8, zorder=0)
    axes.set_xticks(range(len(columns)), columns)
    axes.set_ylabel(label)
    axes.set_title(title)
    axes.legend(handles, rows, ncols=min(len(rows), 7), fontsize="small")
    return figure


def stem(task: str) -> str:
    """The name of a task's figure."""
    return re.sub(r"[^a-z0-9]+", "_", task.lower()).strip("_")
