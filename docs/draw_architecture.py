"""Draw docs/images/architecture.svg from the contract in pyproject.toml: the rooms in their layers, and who knows whom.

    python docs/draw_architecture.py            # needs the extra [check]

Rooms and layers come from the contract "rooms", what a room holds from the first line of its docstring, arrows from the
imports themselves. An arrow that others already imply is left out, as are those to the nouns, which every room knows.
"""

from __future__ import annotations

import ast
import re
import textwrap
import tomllib
from pathlib import Path
from xml.sax.saxutils import escape

import grimp

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "motionmend"
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
WIDTH, HEIGHT, GAP, MARGIN = 1180, 88, 36, 24  # of the picture, of a box, between layers, around all
LETTERS = 7.0  # width of a letter of the small text


def layers() -> list[list[str]]:
    """The contract's layers from the top down, each a list of rooms; the nouns are the last, in one layer."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    rows = next(each["layers"] for each in contracts if each["id"] == "rooms")
    found = [re.split(r"\s*[|:]\s*", row) for row in rows]
    rooms = [[name for name in row if (SOURCE / name).is_dir()] for row in found]
    nouns = [name for row in found for name in row if (SOURCE / f"{name}.py").is_file() and name != "__main__"]
    return [row for row in rooms if row] + [nouns]


def held(room: str) -> str:
    """The first line of a room's docstring."""
    tree = ast.parse((SOURCE / room / "__init__.py").read_text(encoding="utf-8"))
    return (ast.get_docstring(tree) or "").splitlines()[0]


def arrows(rooms: list[str]) -> list[tuple[str, str]]:
    """Which room imports which, without those pairs that lead there by way of another room too."""
    graph = grimp.build_graph("motionmend", cache_dir=None)
    knows = {room: set() for room in rooms}
    for room in rooms:
        for module in {f"motionmend.{room}", *graph.find_descendants(f"motionmend.{room}")}:
            for other in graph.find_modules_directly_imported_by(module):
                top = other.split(".")[1] if "." in other else ""
                if top in knows and top != room:
                    knows[room].add(top)

    def reached(room: str) -> set[str]:
        return knows[room].union(*(reached(other) for other in knows[room]))

    return [
        (room, other)
        for room in rooms
        for other in sorted(knows[room])
        if not any(other in reached(between) for between in knows[room] - {other})
    ]


def drawn() -> str:
    """The picture as SVG."""
    rows = layers()
    boxes: dict[str, tuple[float, float, float]] = {}
    parts = []
    for number, row in enumerate(rows):
        top = MARGIN + number * (HEIGHT + GAP)
        last = number == len(rows) - 1
        across = 1 if last else len(row)
        wide = min(520 if across == 1 else 560, (WIDTH - 2 * MARGIN - 16 * (across - 1)) / across)
        wide = WIDTH - 2 * MARGIN if last else wide
        left = (WIDTH - across * wide - 16 * (across - 1)) / 2
        for at, room in enumerate(["nouns"] if last else row):
            x = left + at * (wide + 16)
            boxes[room] = (x, top, wide)
            title = ", ".join(row) if last else f"{room}/"
            told = "The nouns: arrays only, no files, no torch. Every room knows them." if last else held(room)
            lines = textwrap.wrap(told, int((wide - 20) / LETTERS))[:4]
            parts.append(f'<rect x="{x:.0f}" y="{top}" width="{wide:.0f}" height="{HEIGHT}" rx="6"/>')
            parts.append(f'<text class="name" x="{x + 10:.0f}" y="{top + 20}">{escape(title)}</text>')
            for line, words in enumerate(lines):
                parts.append(f'<text x="{x + 10:.0f}" y="{top + 37 + 14 * line}">{escape(words)}</text>')
    rooms = [room for row in rows[:-1] for room in row]
    lines = []
    pairs = arrows(rooms)
    for room, other in pairs:
        (x, y, wide), (u, v, far) = boxes[room], boxes[other]
        out = [pair for pair in pairs if pair[0] == room]
        come = [pair for pair in pairs if pair[1] == other]
        start = x + wide * (out.index((room, other)) + 1) / (len(out) + 1)
        end = u + far * (come.index((room, other)) + 1) / (len(come) + 1)
        bend = min(60.0, (v - y - HEIGHT) / 2 + 10)
        lines.append(
            f'<path d="M {start:.0f} {y + HEIGHT} C {start:.0f} {y + HEIGHT + bend:.0f}, {end:.0f} {v - bend:.0f}, '
            f'{end:.0f} {v - 5}"/>'
        )
    height = MARGIN * 2 + len(rows) * (HEIGHT + GAP) - GAP
    style = (
        "rect{fill:#f7f4ee;stroke:#4a5568;stroke-width:1.2}text{font:12px sans-serif;fill:#2d3748}"
        ".name{font:bold 14px sans-serif;fill:#1a202c}path{fill:none;stroke:#e4572e;stroke-width:1.3;opacity:.75;"
        "marker-end:url(#head)}"
    )
    head = (
        '<defs><marker id="head" viewBox="0 0 8 8" refX="4" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M 0 0 L 8 4 L 0 8 z" style="fill:#e4572e;stroke:none;opacity:1;marker-end:none"/></marker></defs>'
    )
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}">',
        f"<style>{style}</style>", head, f'<path d="M 0 0 H {WIDTH} V {height} H 0 Z" style="fill:#fff;stroke:none;'
        'opacity:1;marker-end:none"/>', *lines, *parts, "</svg>", "",
    ])  # fmt: skip


if __name__ == "__main__":
    PICTURE.write_text(drawn(), encoding="utf-8")
    print(f"written: {PICTURE.relative_to(ROOT)}")
