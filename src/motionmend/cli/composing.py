"""What `blend` and `chain` share: their report and what they print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import InputError
from .common import refuse_to_overwrite


def report_of(output: Path) -> Path:
    return output.with_name(output.name + ".report.json")


def checked(output: Path, sources: Sequence[Path], force: bool) -> None:
    """Refuse what cannot be written before the work starts."""
    from ..io import format_of

    if not format_of(output).writes:
        raise InputError("this format can be read but not written", where=output, hint="write .bvh instead")
    for source in sources:
        if source.exists():
            refuse_to_overwrite([output, report_of(output)], source, force)


def written(result: Any, asked: Any) -> int:
    """Write the take and its report where a Blend or a Chain `asked` for them, and print it."""
    from ..io import save, write_whole

    save(result, asked.output, force=asked.force)
    told, report = replace(result.report, output=str(asked.output)), report_of(asked.output)
    write_whole(report, lambda temporary: temporary.write_text(told.to_json(), encoding="utf-8"))
    print(told.to_json() if asked.json else f"{told}\nwritten: {asked.output}\nreport:  {report}")
    return 0
