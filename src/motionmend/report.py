"""What a repair found, did and checked: numbers for machines, tables for people."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

MOST = 40  # rows of a table that a person reads


@dataclass(frozen=True)
class Filled:
    """One stretch that was repaired, or left: these joints, in frames `[start, stop)`, and how."""

    joints: tuple[str, ...]
    start: int
    stop: int
    seconds: float
    method: str
    why: str
    donors: tuple[str, ...] = ()  # the joints or markers that carried it


@dataclass(frozen=True)
class Report:
    """What one repair found, filled, left and checked. `to_json` is for machines, `str()` for people.

    findings : what diagnosis found (cause, joints, frames, certainty, detail), as dicts.
    fills : what was filled, and by which method and why; left : what was not, and why.
    checks : name → {value, unit, ok, …}: samples changed outside, seams, bone lengths, feet; before denoising.
    denoised : the filter that changed every sample afterwards, if one was asked for.
    """

    source: str
    format: str
    frames: int
    fps: float
    units: str
    samples: int
    repaired: int
    findings: list[dict[str, Any]] = field(default_factory=list)
    fills: list[Filled] = field(default_factory=list)
    left: list[Filled] = field(default_factory=list)
    checks: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    denoised: str = ""
    output: str = ""

    def to_json(self) -> str:
        return to_json(asdict(self))

    def __str__(self) -> str:
        share = 100 * self.repaired / max(self.samples, 1)
        lines = [
            f"{self.source}: {self.format.upper()}, {self.frames} frames at {self.fps:g} fps",
            f"  units: {self.units}",
            *(f"  note: {note}" for note in self.notes),
        ]
        if self.findings:
            lines += ["", "found", findings_table(self.findings)]
        if self.fills:
            rows = [(*_where(fill), fill.method, fill.why) for fill in _longest(self.fills)]
            lines += ["", "repaired", table(("frames", "length", "joints", "method", "why"), rows)]
            lines += _shorter(self.fills)
        if self.left:
            rows = [(*_where(fill), fill.why) for fill in _longest(self.left)]
            lines += ["", "left as it was", table(("frames", "length", "joints", "why"), rows)]
            lines += _shorter(self.left)
        if self.checks:
            rows = [(name, check["text"], "ok" if check["ok"] else "LOOK") for name, check in self.checks.items()]
            lines += ["", "checks", table(("check", "value", ""), rows)]
        rest = f"then the whole take denoised by {self.denoised}, as asked" if self.denoised else "the rest untouched"
        lines += ["", f"{self.repaired} of {self.samples} samples repaired ({share:.2f} %), {rest}"]
        return "\n".join(lines)


def to_json(value: Any) -> str:
    """JSON with NumPy numbers as numbers and not-a-number as null: every parser reads it."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {str(key): plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        if isinstance(value, np.ndarray | np.generic):
            return plain(value.tolist())
        if isinstance(value, float) and not np.isfinite(value):
            return None
        return str(value) if isinstance(value, Path) else value

    return json.dumps(plain(value), indent=2, ensure_ascii=False)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], indent: str = "  ") -> str:
    """Aligned plain-text columns."""
    shown = [tuple(head), *(tuple(map(str, row)) for row in rows)]
    widths = [max(len(row[column]) for row in shown) for column in range(len(head))]
    lines = [indent + "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in shown]
    lines.insert(1, indent + "  ".join("─" * width for width in widths))
    return "\n".join(lines)


def findings_table(findings: Sequence[dict[str, Any]]) -> str:
    """The findings, the surest and longest first to be shown where there are too many; in order of frames."""
    surest = sorted(findings, key=lambda f: (-f["certainty"], f["start"] - f["stop"]))[:MOST]
    rows = (
        (f"{f['start']}:{f['stop']}", f["cause"], _some(f["joints"]), f"{f['certainty']:.2f}", f["detail"])
        for f in sorted(surest, key=lambda f: (f["start"], f["stop"]))
    )
    lines = [table(("frames", "cause", "joints", "certainty", "what was seen"), rows)]
    if len(findings) > MOST:
        lines.append(f"  … and {len(findings) - MOST} less certain or shorter (all of them in the JSON)")
    return "\n".join(lines)


def _longest(fills: Sequence[Filled]) -> list[Filled]:
    longest = sorted(fills, key=lambda fill: fill.start - fill.stop)[:MOST]
    return sorted(longest, key=lambda fill: (fill.start, fill.stop))


def _shorter(fills: Sequence[Filled]) -> list[str]:
    return [f"  … and {len(fills) - MOST} shorter ones (all of them in the JSON)"] if len(fills) > MOST else []


def _where(fill: Filled) -> tuple[str, str, str]:
    return f"{fill.start}:{fill.stop}", f"{fill.seconds:.2f} s", _some(fill.joints)


def _some(names: Sequence[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
