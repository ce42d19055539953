"""What README and docs show is what happens: their commands are run and their scripts executed.

In a ```console block the lines after `$ motionmend …` must be in the command's output, in that order; `…` stands for
what was left out, and blanks between columns do not count. ```python blocks of a page run one after the other.
Every page has a folder of its own, with the walk.bvh and broken.bvh that `motionmend demo` writes.
"""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import motionmend as mm
from motionmend.cli.main import main
from motionmend.repairs.demonstration import demo

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
_BLOCK = re.compile(r"^```(console|python)\n(.*?)^```", re.M | re.S)


@pytest.fixture(scope="module")
def demo_folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    demo(folder)
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_shows_what_happens(page, demo_folder, tmp_path, monkeypatch, capsys):
    for name in ("walk.bvh", "broken.bvh"):
        shutil.copy(demo_folder / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "__main__", "mm": mm, "np": np, "take": mm.load("walk.bvh")}
    for kind, text in _BLOCK.findall(page.read_text("utf-8")):
        if kind == "python":
            exec(compile(text, str(page), "exec"), names)
        else:
            for shown in re.split(r"^\$ ", text, flags=re.M)[1:]:
                check_command(*shown.split("\n", 1), capsys)


def check_command(command: str, shown: str, capsys) -> None:
    program, *words = shlex.split(command)
    assert program == "motionmend", f"blocks called console hold commands of ours only, not {command!r}"
    capsys.readouterr()
    status = main([str(path) for word in words for path in (sorted(Path().glob(word)) if "*" in word else [word])])
    said = capsys.readouterr()
    lines = [" ".join(line.split()) for line in (said.out + said.err).splitlines()]
    assert status == int("motionmend: " in shown), f"{command!r} ended with {status}: {said.err}"
    for line in shown.splitlines():
        line = " ".join(line.split())
        if not line or line == "…":
            continue
        start, cut = line.removesuffix("…").rstrip(), line.endswith("…")
        found = [at for at, real in enumerate(lines) if real == line or (cut and real.startswith(start))]
        assert found, f"{command!r} no longer prints {line!r}"
        lines = lines[found[0] + 1 :]


def test_no_page_links_to_a_page_that_is_not_there():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text("utf-8")):
            assert target.startswith("https://") or (page.parent / target).exists(), (page.name, target)


def test_tests_that_pages_name_are_there():
    for page in PAGES:
        for file, name in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page.read_text("utf-8")):
            assert f"\ndef {name}(" in (ROOT / file).read_text("utf-8"), (page.name, file, name)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("gap_list.py", ["holes.c3d", "filled.c3d"]),
        ("repair_folder.py", ["takes", "repaired"]),
        ("own_method.py", ["walk.bvh", "filled.bvh", "120", "180"]),
        ("story.py", ["takes", "story.bvh"]),
    ],
)
def test_an_example_runs(script, words, demo_folder, tmp_path, monkeypatch, capsys):
    shutil.copy(demo_folder / "walk.bvh", tmp_path)
    (tmp_path / "takes").mkdir()
    shutil.copy(demo_folder / "broken.bvh", tmp_path / "takes")
    monkeypatch.chdir(tmp_path)
    main(["convert", "walk.bvh", "-o", "walk.c3d"])
    main(["damage", "walk.c3d", "-o", "holes.c3d", "--lost", "LeftHand:100:140"])
    monkeypatch.setattr(sys, "argv", [script, *words])
    capsys.readouterr()
    if script == "repair_folder.py":
        with pytest.raises(SystemExit) as end:
            runpy.run_path(str(ROOT / "examples" / script), run_name="__main__")
        assert end.value.code == 0 and (tmp_path / "repaired" / "summary.csv").read_text().count("\n") == 2
    else:
        runpy.run_path(str(ROOT / "examples" / script), run_name="__main__")
        assert (tmp_path / words[1]).is_file()
    if script == "gap_list.py":
        assert "100:140  0.33 s  LeftHand" in capsys.readouterr().out


def test_benchmark_tables_are_those_that_the_commands_printed():
    """Rows in docs/benchmarks.md stand in the page of results of their protocol, under the same heading."""
    text = (ROOT / "docs" / "benchmarks.md").read_text("utf-8")
    for name in ("xmae", "convae", "trajevae", "trajevae-constraints"):
        results = (ROOT / "docs" / "results" / f"{name}.md").read_text("utf-8")
        tables = dict(re.findall(r"^### (.+)\n\n((?:\|.*\n)+)", results, flags=re.M))
        section = re.search(rf"^### {name}: .*?(?=^##)", text, flags=re.M | re.S)
        assert section
        shown = re.findall(r"^\*\*(.+)\*\*\n\n((?:\|.*\n)+)", section.group(), flags=re.M)
        assert shown
        for heading, rows in shown:
            assert set(rows.splitlines()) <= set(tables[heading].splitlines()), f"{name}: {heading}"
        command = next(line.strip() for line in results.splitlines() if line.startswith("    motionmend benchmark"))
        assert command in text
