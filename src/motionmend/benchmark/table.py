"""Results as Markdown: one table per task and metric, methods down, settings across, the best in bold."""

from __future__ import annotations

import math
from collections.abc import Sequence

from . import quality
from .results import TRUTH, Cell, Protocol, Results

DASH = "–"


def as_markdown(results: Results, figures: Sequence[str] = ()) -> str:
    """The whole page: where the numbers come from, the protocol's tables, then those of quality."""
    main = [cell for cell in results.cells if cell.metric not in quality.UNITS]
    beside = [cell for cell in results.cells if cell.metric in quality.UNITS]
    rows = [method["name"] for method in results.header["methods"]]
    title = f"# {results.protocol.name}: {results.header['corpus']['name']}, {results.header['split']}"
    parts = [title, _head(results)]
    for title, cells in (("Errors", main), ("Seams, jitter, feet and bones", beside)):
        if cells:
            parts += [f"## {title}", *tables(cells, rows, results.protocol)]
    if figures:
        parts += ["## Figures", *(f"![{name.removesuffix('.png')}]({name})" for name in figures)]
    return "\n\n".join(parts) + "\n"


def tables(cells: Sequence[Cell], rows: Sequence[str], protocol: Protocol) -> list[str]:
    """One table for each task and metric, in the order in which they come."""
    found = []
    for task, metric in dict.fromkeys((cell.task, cell.metric) for cell in cells):
        here = [cell for cell in cells if (cell.task, cell.metric) == (task, metric)]
        unit = f", {here[0].unit}" if here[0].unit else ""
        found.append(f"### {task}: {metric}{unit}\n\n{table(here, rows, protocol)}")
    return found


def table(cells: Sequence[Cell], rows: Sequence[str], protocol: Protocol) -> str:
    """One table. A method that cannot do the task has dashes; rows not asked for come first, the truth last."""
    by_place = {(cell.method, cell.setting): cell for cell in cells}
    settings = list(dict.fromkeys(cell.setting for cell in cells))
    own = dict.fromkeys(cell.method for cell in cells if cell.method not in rows)
    names = [*(name for name in own if name != TRUTH), *rows, *(name for name in own if name == TRUTH)]
    decimals = max(decimals_for([cell.value for cell in cells]), int(cells[0].unit == "%"))  # those are all near 100
    bold = {each: best([cell for cell in cells if cell.setting == each], protocol, decimals) for each in settings}

    def said(name: str, setting: str) -> str:
        cell = by_place.get((name, setting))
        if cell is None or not math.isfinite(cell.value):
            return DASH
        text = f"{cell.value:.{decimals}f}"
        if protocol.spread and cell.spread is not None:
            text += f" ± {cell.spread:.{decimals}f}"
        return f"**{text}**" if name in bold[setting] else text

    lines = [["", *settings], ["---", *["---:"] * len(settings)]]
    lines += [[name, *(said(name, setting) for setting in settings)] for name in names]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def best(cells: Sequence[Cell], protocol: Protocol, decimals: int) -> set[str]:
    """The methods with the lowest value of one column, all that read the same; none if there is only one.

    The highest for metrics that the protocol names so. None for those of quality: a fill is not good for being
    smoother than people are, and its measure is the row of the truth.
    """
    metric = cells[0].metric
    sign = -1 if metric in protocol.highest else 1
    judged = {
        cell.method: round(sign * cell.value, decimals)
        for cell in cells
        if math.isfinite(cell.value) and cell.method != TRUTH
    }
    if metric in quality.UNITS or metric in protocol.unjudged or len(judged) < 2:
        return set()
    return {name for name, value in judged.items() if value == min(judged.values())}


def decimals_for(values: Sequence[float]) -> int:
    """Three significant digits of a typical value, at most three decimals."""
    sizes = sorted(abs(value) for value in values if math.isfinite(value) and value)
    if not sizes:
        return 1
    return min(max(2 - math.floor(math.log10(sizes[len(sizes) // 2])), 0), 3)


def _head(results: Results) -> str:
    header = results.header
    corpus, methods = header["corpus"], header["methods"]
    many = f"{header['windows']} windows" if header["windows"] is not None else ""
    if header["limit"] is not None:
        chosen = f"**a quick look: --limit {header['limit']}, windows spread evenly over the split**"
        many = f"{many}, {chosen}" if many else chosen
    rate = f"{corpus['fps']:g} fps" if "fps" in corpus else ""
    data = ", ".join(filter(None, (corpus["name"], rate, f"split {header['split']}", many)))
    lines = [
        header["describe"],
        "",
        f"    {header['command']}",
        "",
        f"- data: {data}; sha256 {corpus['sha256']}",
        *([f"- credit: {corpus['credit']}"] if corpus.get("credit") else []),
        *([f"- licence: {corpus['licence']}"] if corpus.get("licence") else []),
        f"- seed: {header['seed']}",
        f"- commit: {header['commit'] or 'none, an installed package'}",
        "- versions: " + ", ".join(f"{name} {version}" for name, version in header["versions"].items()),
        f"- machine: {header['machine']}",
        "- methods:",
        *(f"  - {each['name']}: " + "; ".join(filter(None, (each["about"], each["budget"]))) for each in methods),
        "",
        "The best of each column of errors is bold. Seams, jitter, feet and bones are to be judged by the row of the "
        "truth, the undamaged motion. A dash: the method cannot do the task.",
    ]
    return "\n".join(lines)


def runtime_lines(results: Results) -> str:
    """The runtime of each method, for the terminal."""
    lines = [f"{'method':16} {'does':8} {'µs/frame':>10} {'of linear':>10}"]
    for name, kinds in results.runtime.items():
        for kind, values in kinds.items():
            seconds, ratio = values["seconds_per_frame"] or 0.0, values["ratio"]
            lines.append(f"{name:16} {kind:8} {seconds * 1e6:10.2f} {f'{ratio:10.1f}' if ratio else DASH:>10}")
    return "\n".join(lines)
