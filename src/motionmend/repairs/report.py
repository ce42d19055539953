"""What a repair found, did and checked: numbers for machines, tables for people."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..body.mapping import Mapping, to_body
from ..metrics import positional
from ..motion import Motion

MOST = 40  # rows of a table that a person reads
WORSE = 1.02  # what denoising may raise by this factor without a word


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
    expected: float | None = None  # mm, the median error that the method expects over these joints


@dataclass(frozen=True)
class Denoised:
    """What denoising did to a whole take.

    limb_sigma, jitter : before and after; mm (`limb_sigma`, over the whole take) and m/s³ (`jitter`).
        Of the 21 joints of a person's body where one is recognised, else of the take's own; NaN without bones.
    moved, farthest : mm by which the take's own joints or markers moved, the mean and the 99th percentile.
    """

    method: str
    limb_sigma: tuple[float, float]
    jitter: tuple[float, float]
    moved: float
    farthest: float

    @classmethod
    def of(cls, method: str, before: Motion, after: Motion, mapping: Mapping) -> Denoised:
        bodies = [to_body(each, mapping) if mapping.is_person else each for each in (before, after)]
        seen = [np.where(body.observed[..., None], body.positions, np.nan) for body in bodies]
        parents = bodies[0].skeleton.parents
        sigma = positional.limb_sigma(seen[0], parents), positional.limb_sigma(seen[1], parents)
        jitter = positional.jitter(seen[0], before.fps), positional.jitter(seen[1], before.fps)
        apart = 1000 * positional.distances(before.positions, after.positions)[before.observed & after.observed]
        moved = (float(apart.mean()), float(np.percentile(apart, 99))) if len(apart) else (float("nan"),) * 2
        return cls(method, sigma, jitter, *moved)

    def __str__(self) -> str:
        """A table. LOOK: bones vary more than before, or everything shakes more."""
        measured = (("limb σ", "mm", 2, self.limb_sigma), ("jitter", "m/s³", 0, self.jitter))
        rows = []
        for name, unit, digits, (before, after) in measured:
            if np.isfinite(before) and np.isfinite(after):
                worse = after > WORSE * before + 0.1**digits
                told = (f"{value:.{digits}f} {unit}" for value in (before, after))
                rows.append((name, *told, "LOOK" if worse else "ok"))
        moved = f"  joints moved by {self.moved:.1f} mm on average, 99 of 100 by less than {self.farthest:.1f} mm"
        return "\n".join([table(("", "before", "after", ""), rows), moved] if rows else [moved])


@dataclass(frozen=True)
class Report:
    """What one repair found, filled, left and checked. `to_json` is for machines, `str()` for people.

    findings : what diagnosis found (cause, joints, frames, certainty, detail), as dicts.
    fills : what was filled, and by which method and why; left : what was not, and why.
    checks : name → {value, unit, ok, …}: samples changed outside, seams, bone lengths, feet; before denoising.
    denoised : what denoising did to every sample afterwards, if it was asked for.
    seed, variant : which of the ways to fill this is, for a method that knows several.
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
    denoised: Denoised | None = None
    output: str = ""
    seed: int | None = None
    variant: int | None = None

    def to_json(self) -> str:
        return to_json(asdict(self))

    def __str__(self) -> str:
        share = 100 * self.repaired / max(self.samples, 1)
        lines = [
            f"{self.source}: {self.format.upper()}, {self.frames} frames at {self.fps:g} fps",
            f"  units: {self.units}",
            *(f"  note: {note}" for note in self.notes),
            *([f"  variant {self.variant} of seed {self.seed}"] if self.variant else []),
        ]
        if self.findings:
            lines += ["", "found", findings_table(self.findings)]
        if self.fills:
            rows = [(*_where(fill), fill.method, _off(fill), fill.why) for fill in _longest(self.fills)]
            head = ("frames", "length", "joints", "method", "expected", "why")
            if not any(fill.expected for fill in self.fills):
                rows, head = [(*row[:4], row[5]) for row in rows], (*head[:4], head[5])
            lines += ["", "repaired", table(head, rows)]
            lines += _shorter(self.fills)
        if self.left:
            rows = [(*_where(fill), fill.why) for fill in _longest(self.left)]
            lines += ["", "left as it was", table(("frames", "length", "joints", "why"), rows)]
            lines += _shorter(self.left)
        if self.checks:
            rows = [(name, check["text"], "ok" if check["ok"] else "LOOK") for name, check in self.checks.items()]
            lines += ["", "checks", table(("check", "value", ""), rows)]
        rest = "the rest untouched"
        if self.denoised:
            lines += ["", "denoised", str(self.denoised)]
            rest = f"then the whole take denoised by {self.denoised.method}, as asked"
        lines += ["", f"{self.repaired} of {self.samples} samples repaired ({share:.2f} %), {rest}"]
        return "\n".join(lines)


@dataclass(frozen=True)
class Variants:
    """The reports of several ways in which one take was repaired."""

    reports: tuple[Report, ...]

    def to_json(self) -> str:
        return to_json({"source": self.reports[0].source, "variants": [asdict(each) for each in self.reports]})

    def __str__(self) -> str:
        """The first one's tables, and the checks of each; what was found and filled is the same in all of them."""
        first = self.reports[0]
        told = [(str(each.variant), *_checked(each.checks)) for each in self.reports]
        head = ("variant", *first.checks, "")
        lines = [str(replace(first, variant=None, checks={}))]
        lines += ["", f"checks of {len(told)} variants, seed {first.seed}", table(head, told)] if first.checks else []
        return "\n".join(lines)


def _checked(checks: dict[str, Any]) -> list[str]:
    values = [
        "–" if check["value"] is None else f"{check['value']:.3g} {check['unit']}" for check in checks.values()
    ]
    return [*values, "ok" if all(check["ok"] for check in checks.values()) else "LOOK"]


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


def _off(fill: Filled) -> str:
    """The error that the method expects; nothing where it does not say."""
    return "" if fill.expected is None else f"{fill.expected:.0f} mm"


def _longest(fills: Sequence[Filled]) -> list[Filled]:
    longest = sorted(fills, key=lambda fill: fill.start - fill.stop)[:MOST]
    return sorted(longest, key=lambda fill: (fill.start, fill.stop))


def _shorter(fills: Sequence[Filled]) -> list[str]:
    return [f"  … and {len(fills) - MOST} shorter ones (all of them in the JSON)"] if len(fills) > MOST else []


def _where(fill: Filled) -> tuple[str, str, str]:
    return f"{fill.start}:{fill.stop}", f"{fill.seconds:.2f} s", _some(fill.joints)


def _some(names: Sequence[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
