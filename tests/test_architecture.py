"""The house stands as drawn: contracts hold and bite, files can be read in one sitting, small commands start light."""

from __future__ import annotations

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import motionmend

PACKAGE = Path(motionmend.__file__).parent
ROOT = PACKAGE.parents[1]
HEAVY = ("torch", "scipy", "matplotlib", "ezc3d", "pygltflib", "rich.progress")


def linted(folder: Path) -> subprocess.CompletedProcess[str]:
    """import-linter on a copy of the package, by the contracts of pyproject.toml."""
    pytest.importorskip("importlinter")
    code = "import sys; sys.path.insert(0, 'src'); from importlinter.cli import lint_imports_command as run; run()"
    return subprocess.run(
        [sys.executable, "-c", code, "--no-cache"], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.fixture
def house(tmp_path):
    """A copy of the source and of what says how it is to be."""
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("the package is installed without its pyproject.toml")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    kept = shutil.ignore_patterns("__pycache__", "weights", "examples")
    shutil.copytree(PACKAGE, tmp_path / "src" / "motionmend", ignore=kept)
    return tmp_path


# What a change adds to which file, and the contract that it breaks.
BREACHES = {
    "a room that knows one below it": ("body/names.py", "from ..fills import points", "rooms"),
    "a lazy import of one below it": ("fills/points.py", "def late():\n    from ..repairs import repairing", "rooms"),
    "two neighbours": ("io/units_of.py", "from ..metrics import positional", "rooms"),
    "animation and composition": ("animation/animating.py", "from ..composition import blending", "rooms"),
    "a room with no place in the table": ("attic/__init__.py", "", "rooms"),
    "a circle inside a room": ("fills/curves.py", "from .channels import fill_rig", "no-circles"),
    "a circle inside a room's room": ("networks/models/network.py", "from . import xmae", "no-circles"),
    "torch in a fill": ("fills/donors.py", "def late():\n    import torch", "torch"),
    "torch where networks are run": ("networks/completers.py", "import torch", "torch"),
    "the command line from a job": ("repairs/report.py", "def late():\n    from ..cli import main", "cli"),
}


def test_the_contracts_hold(house):
    done = linted(house)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


@pytest.mark.parametrize("breach", BREACHES)
def test_the_contracts_bite(house, breach):
    name, line, contract = BREACHES[breach]
    path = house / "src" / "motionmend" / name
    path.parent.mkdir(exist_ok=True)
    path.write_text((path.read_text(encoding="utf-8") if path.exists() else "") + f"\n{line}\n", encoding="utf-8")
    done = linted(house)
    config = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    title = config.split(f'id = "{contract}"\nname = "')[1].split('"')[0]
    assert done.returncode == 1, done.stdout + done.stderr
    assert f"{title} BROKEN" in " ".join(done.stdout.split()), done.stdout


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_files_can_be_read_in_one_sitting(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


@pytest.mark.parametrize("room", sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py")))
def test_a_room_says_what_it_holds_and_what_it_must_not_know(room):
    head = (PACKAGE / room / "__init__.py").read_text(encoding="utf-8").split('"""')[1]
    what, boundary = head.strip().split("\n\n")[:2]
    assert 3 <= len((what + "\n\n" + boundary).splitlines()) <= 6
    assert "must not" in boundary.replace("\n", " ") or "nothing" in boundary.lower()


def page() -> str:
    path = ROOT / "docs" / "architecture.md"
    if not path.is_file():
        pytest.skip("the docs are not at hand")
    return path.read_text(encoding="utf-8")


def test_every_room_is_on_the_page():
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    named = set(re.findall(r"^\| `(\w+)/`", page(), flags=re.MULTILINE))
    assert named == rooms


def test_every_station_exists():
    stations = re.findall(r"\[`([^`]+)`\]\(\.\./src/motionmend/([^)]+)\)((?: (?:and )?`\w+`)*)", page())
    assert len(stations) > 30
    for said, path, names in stations:
        assert said == path
        tree = ast.parse((PACKAGE / path).read_text(encoding="utf-8"))
        there = {each.name for each in tree.body if isinstance(each, ast.FunctionDef | ast.ClassDef)}
        for each in tree.body:
            targets = each.targets if isinstance(each, ast.Assign) else [getattr(each, "target", None)]
            there |= {target.id for target in targets if isinstance(target, ast.Name)}
        asked = set(re.findall(r"`(\w+)`", names))
        assert asked, f"{path}: which function?"
        assert asked <= there, f"{path} has no {asked - there}"


def test_the_picture_is_drawn_from_the_contract_as_it_is():
    pytest.importorskip("grimp")
    page()
    script = ROOT / "docs" / "draw_architecture.py"
    spec = importlib.util.spec_from_file_location("draw_architecture", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PICTURE.read_text(encoding="utf-8") == module.drawn(), "run python docs/draw_architecture.py"


def loaded_by(*arguments: str) -> list[str]:
    code = (
        "import sys, runpy; sys.argv = ['motionmend', *sys.argv[1:]]\n"
        "try:\n    runpy.run_module('motionmend', run_name='__main__')\n"
        "except SystemExit as stop:\n    assert not stop.code, stop.code\n"
        f"print('HEAVY', *[name for name in {HEAVY} if name in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    return ran.stdout.splitlines()[-1].split()[1:]


@pytest.mark.parametrize("arguments", ["--help", "repair --help", "animate --help", "--version"])
def test_help_loads_nothing_heavy(arguments):
    assert loaded_by(*arguments.split()) == []


def test_inspect_loads_nothing_heavy():
    example = next((PACKAGE / "examples").glob("*.bvh"))
    assert loaded_by("inspect", str(example)) == []
