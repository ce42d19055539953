"""What is in a take: for a person as text, for a machine as JSON."""

from __future__ import annotations

from pathlib import Path

from ..body.joints import BODY
from ..body.mapping import map_rig, read_map
from ..diagnosis.diagnosing import diagnose
from ..diagnosis.findings import told
from ..motion import Take
from .fragments import fragments
from .report import findings_table, to_json


def inspect(take: Take, map_file: Path | None = None, *, as_json: bool = False) -> str:
    """A description of a take: format, length, units, rig and its mapping, and what is untrusted and why."""
    motion = take.motion
    mapping = map_rig(take.skeleton, motion.positions, read_map(map_file) if map_file else None)
    found = {body: take.skeleton.names[joint] for body, joint in zip(BODY.names, mapping.joints) if joint >= 0}
    diagnosis = diagnose(take)
    untrusted = diagnosis.untrusted
    joins = fragments(take.distrust(untrusted).motion) if take.rig is None else []
    facts = {
        "file": take.source,
        "format": take.format,
        "frames": len(take),
        "fps": take.fps,
        "seconds": motion.seconds,
        "units": take.units.why,
        "points": len(take.skeleton),
        "kind": "channels" if take.rig else "joints" if take.skeleton.has_bones else "markers",
        "notes": list(take.notes),
        "person": mapping.is_person,
        "rig": mapping.rig,
        "mapping": found,
        "unmapped": list(mapping.unmapped),
        "findings": [told(finding) for finding in diagnosis.findings],
        "fragments": [
            {
                "track": take.skeleton.names[one.track],
                "marker": take.skeleton.names[one.marker],
                "start": one.start,
                "stop": one.stop,
                "mm": round(1000 * one.metres, 1),
            }
            for one in joins
        ],
        "samples": int(untrusted.size),
        "untrusted": int(untrusted.sum()),
    }
    return to_json(facts) if as_json else _as_text(facts)


def _as_text(facts: dict) -> str:
    lines = [
        f"{facts['file']}",
        f"  {facts['format'].upper()}, {facts['frames']} frames at {facts['fps']:g} fps ({facts['seconds']:.2f} s), "
        f"{facts['points']} {'markers' if facts['kind'] == 'markers' else 'joints'}",
        f"  units: {facts['units']}",
        *(f"  note: {note}" for note in facts["notes"]),
        "",
    ]
    if facts["person"]:
        lines.append(f"rig: {facts['rig']}, {len(facts['mapping'])} of {len(BODY)} body joints found")
        pairs = list(facts["mapping"].items())
        width = max(len(body) for body in facts["mapping"])
        half = (len(pairs) + 1) // 2
        for index in range(half):
            cells = [f"{body:{width}} ← {name}" for body, name in pairs[index::half]]
            lines.append("  " + "    ".join(cell.ljust(42) for cell in cells).rstrip())
        if missing := [name for name in BODY.names if name not in facts["mapping"]]:
            lines.append(f"  not in this rig: {', '.join(missing)}")
        if facts["unmapped"]:
            lines.append(f"  not mapped: {', '.join(facts['unmapped'])}")
    else:
        lines.append("rig: no human body recognised; every repair that needs none still works (see --map)")
    lines.append("")
    if facts["findings"]:
        lines += ["found", findings_table(facts["findings"])]
    else:
        lines.append("found: nothing wrong")
    if facts["fragments"]:
        lines.append("tracks without a label that go on where a marker was lost; repair --join joins them")
        for one in facts["fragments"]:
            off = f"{one['mm']:.0f} mm from where the others put it"
            lines.append(f"  {one['start']}:{one['stop']}  {one['track']} is {one['marker']}, {off}")
    share = 100 * facts["untrusted"] / max(facts["samples"], 1)
    lines.append(f"{facts['untrusted']} of {facts['samples']} samples untrusted ({share:.2f} %)")
    return "\n".join(lines)
