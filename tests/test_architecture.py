"""The house stands as drawn: imports point down, and small commands start light."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import motionmend

PACKAGE = Path(motionmend.__file__).parent

# A module may import from its own floor and from those below it.
FLOORS = {
    "__init__": 9, "errors": 0, "motion": 0, "rotations": 0,
    "body": 0, "body_names": 0, "body_shape": 0, "metrics": 0, "metrics_sampling": 0, "metrics_rotation": 0,
    "io": 1, "damage": 1, "planting": 1, "diagnosis": 1, "symptoms": 1, "swaps": 1, "compensation": 1,
    "links": 1, "offsets": 1, "disagreement": 1, "prediction": 1,
    "ranges": 1, "report": 1, "progress": 1,
    "gaps": 1, "curves": 1, "donors": 1, "fills": 1, "rigfills": 1, "auto": 1,
    "aiming": 2, "constraints": 2, "feet": 2, "fitting": 2,
    "corpus": 2, "corpus_writer": 2, "footing": 2, "windows": 2, "rows": 2, "spaces": 2, "checkpoints": 2,
    "networks": 2, "runtimes": 2, "denoise": 2,
    "models": 2,
    "datasets": 3, "corpora": 3, "poses": 3, "benchmark": 3, "export": 3, "fused_attention": 2, "card": 3,
    "training": 4, "network_fill": 2, "varied_fill": 3, "repairs": 3, "comparison": 3, "inspection": 3, "picture": 3,
    "composing": 3, "transfer": 3, "blending": 3, "chaining": 3,
    "trajectories": 3, "puppet": 3, "control": 3, "animation": 3, "animation_report": 3, "cli_animate": 5,
    "demo": 4, "cli_options": 5, "cli_data": 5, "cli_benchmark": 5, "cli_train": 5,
    "cli_compose": 5, "cli": 5, "__main__": 6,
}  # fmt: skip
HEAVY = ("torch", "scipy", "matplotlib", "ezc3d", "pygltflib", "rich.progress")


def room(path: Path) -> str:
    """The module's name on the plan; everything in io/ is one room."""
    inside = path.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else path.stem


def imported_rooms(path: Path) -> set[str]:
    depth = len(path.relative_to(PACKAGE).parts)
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == depth:
            found |= {node.module.split(".")[0]} if node.module else {alias.name for alias in node.names}
    return found - {"__version__"}


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_down(path):
    here = FLOORS[room(path)]
    for other in imported_rooms(path):
        if other in FLOORS:
            assert FLOORS[other] <= here, f"{room(path)} (floor {here}) imports {other} (floor {FLOORS[other]})"


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_files_can_be_read_in_one_sitting(path):
    assert len(path.read_text().splitlines()) <= 400


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
