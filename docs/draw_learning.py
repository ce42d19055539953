"""Draw how the house network learned: docs/images/learning.svg, of docs/results/mend-learning.csv.

    python docs/draw_learning.py

The table has a row for each time that the averaged weights were measured while it trained: after how many windows, on
which people, what was lost, for how long, and the share of the classical fill's error in the world and from the hips,
on 96 windows each.
"""

from __future__ import annotations

import csv
from pathlib import Path

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

HERE = Path(__file__).parent
PANELS = {"0.3 s": ("body", "0.3"), "0.5 s": ("body", "0.5"), "0.9 s": ("body", "0.9"), "2 s": ("body", "2"),
          "leg, 0.9 s": ("leg", "0.9"), "arm, 0.9 s": ("arm", "0.9")}  # fmt: skip
PEOPLE = {"cmu": "CMU 06 and 16", "cmu69": "CMU 69", "hys": "hys, who dances"}


def main() -> None:
    with (HERE / "results" / "mend-learning.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey=True)
    for axis, (title, (lost, seconds)) in zip(axes.flat, PANELS.items()):
        for people, label in PEOPLE.items():
            mine = [row for row in rows if (row["people"], row["lost"], row["seconds"]) == (people, lost, seconds)]
            windows = [int(row["windows"]) / 1000 for row in mine]
            axis.plot(windows, [float(row["world"]) for row in mine], label=label)
        axis.axhline(1, color="0.6", linewidth=0.8)
        axis.set_title(title, fontsize=10)
    for axis in axes[1]:
        axis.set_xlabel("thousand windows")
    for axis in axes[:, 0]:
        axis.set_ylabel("share of the curve's error")
    axes[0, 0].legend(fontsize=8)
    FigureCanvasSVG(figure).print_svg(str(HERE / "images" / "learning.svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
