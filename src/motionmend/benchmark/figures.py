"""Results as PNGs: one for each task, a panel for each metric. The same results give the same bytes."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from .results import TRUTH, Cell, Results

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
            figures[_stem(task)] = task_figure(task, cells, names)
    figures |= results.extra
    for stem, figure in figures.items():
        FigureCanvasAgg(figure)
        # Without "Software" the bytes do not hang on matplotlib's version number.
        figure.savefig(folder / f"{stem}.png", dpi=DPI, metadata={"Software": None})
    return [f"{stem}.png" for stem in figures]


def task_figure(task: str, cells: Sequence[Cell], names: Sequence[str]):
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


def _stem(task: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", task.lower()).strip("_")
