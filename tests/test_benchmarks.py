"""The scripts in benchmarks/ take a command line, say what they do, and stand on a page of the docs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted(path.name for path in (ROOT / "benchmarks").glob("*.py") if path.name != "shared.py")
PAGES = [*(ROOT / "docs").glob("*.md"), ROOT / "CONTRIBUTING.md"]


def test_every_script_is_on_a_page():
    told = "".join(path.read_text(encoding="utf-8") for path in PAGES)
    assert SCRIPTS and [name for name in SCRIPTS if f"benchmarks/{name}" not in told] == []


def test_every_script_says_what_it_does():
    """All of them in one process, so that what they import is imported once."""
    for needed in ("torch", "pybvh"):
        pytest.importorskip(needed)
    code = (
        "import runpy, sys\n"
        "for name in sys.argv[1:]:\n"
        "    sys.argv[1:] = ['--help']\n"
        "    try:\n        runpy.run_path(name, run_name='__main__')\n"
        "    except SystemExit as stop:\n        assert not stop.code, (name, stop.code)\n"
        "    else:\n        raise AssertionError(name)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *SCRIPTS], cwd=ROOT / "benchmarks", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert [name for name in SCRIPTS if f"benchmarks/{name}" not in done.stdout] == []
