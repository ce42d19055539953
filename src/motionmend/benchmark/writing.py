"""Results into a folder: JSON, table, times and figures, finished aside before the first appears."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import InputError
from .figures import draw
from .results import Results
from .table import as_markdown


def write(results: Results, out: Path, force: bool = False) -> list[Path]:
    """Write results.json, table.md, runtime.json and figures into the folder `out`; the paths, in that order.

    All are finished aside before the first appears. In a folder that is there only the files of such a call
    are replaced, and figures that it no longer has are removed.

    Raises
    ------
    InputError : if the folder exists and `force` is not given, or if it cannot be made.
    """
    refuse_folder(out, force)
    aside = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.absolute().parent))
    try:
        figures = draw(results, aside)
        names = ["results.json", "table.md", "runtime.json", *figures]
        table = as_markdown(results, figures)
        said = {"header": results.header, "figures": figures, "cells": [asdict(cell) for cell in results.cells]}
        timed = {"header": results.header, "runtime": results.runtime}
        for name, text in zip(names, (_as_json(said), table, _as_json(timed))):
            (aside / name).write_text(text, encoding="utf-8")
        out.mkdir(exist_ok=True)
        for stale in _figures_in(out) - set(figures):
            (out / stale).unlink(missing_ok=True)
        for name in names:
            (aside / name).replace(out / name)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return [out / name for name in names]


def refuse_folder(out: Path, force: bool) -> None:
    """InputError if results cannot go there: refuse before the work starts rather than after it."""
    if not out.absolute().parent.is_dir():
        raise InputError("no such folder", where=out.absolute().parent)
    if out.exists() and not out.is_dir():
        raise InputError("this is a file", where=out, expected="a folder for the results")
    if out.exists() and not force:
        raise InputError("the folder exists", where=out, hint="choose another, or replace its results with --force")


def _figures_in(out: Path) -> set[str]:
    """The figures that an earlier call wrote there."""
    try:
        names = json.loads((out / "results.json").read_text(encoding="utf-8"))["figures"]
        return {name for name in names if Path(name).name == name and name.endswith(".png")}
    except (OSError, ValueError, TypeError, KeyError):
        return set()


def _as_json(value: Any) -> str:
    """JSON with one line a cell, and null where a number is NaN."""

    def line(each: Any) -> str:
        return json.dumps(_finite(each), ensure_ascii=False, allow_nan=False)

    def lines(key: str, each: Any) -> str:
        rows: Iterable[str] = ()
        if isinstance(each, dict) and each:
            rows, ends = (f"  {json.dumps(name)}: {line(row)}" for name, row in each.items()), "{}"
        elif isinstance(each, list) and each:
            rows, ends = (f"  {line(row)}" for row in each), "[]"
        else:
            return f' "{key}": {line(each)}'
        return f' "{key}": {ends[0]}\n' + ",\n".join(rows) + f"\n {ends[1]}"

    return "{\n" + ",\n".join(lines(key, each) for key, each in value.items()) + "\n}\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
