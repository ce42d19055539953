"""Where numbers come from: what a reader needs to get them again."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from .. import __version__
from ..corpora.corpus import Corpus
from .method import Method
from .results import Protocol

PACKAGES = ("numpy", "scipy", "matplotlib", "onnxruntime", "torch")


def header(
    protocol: Protocol,
    command: str,
    data: Corpus | Path,
    split: str,
    methods: Sequence[Method],
    *,
    seed: int,
    windows: int | None,
    limit: int | None,
) -> dict[str, Any]:
    """What was asked, of which data, with what, where.

    windows : how many were measured, None if the protocol does not say. limit : `--limit`, None for all windows.
    """
    return {
        "protocol": protocol.name,
        "describe": protocol.describe,
        "command": command,
        "corpus": _corpus(data),
        "split": split,
        "seed": seed,
        "windows": windows,
        "limit": limit,
        "methods": [{"name": each.name, "about": each.about, "budget": each.budget} for each in methods],
        "commit": commit(),
        "versions": versions(),
        "machine": machine(),
    }


def _corpus(data: Corpus | Path) -> dict[str, Any]:
    if isinstance(data, Corpus):
        return {
            "name": data.name, "sha256": data.sha256, "fps": data.fps, "joints": len(data.skeleton),
            "licence": data.licence, "credit": data.credit,
        }  # fmt: skip
    return {"name": data.name, "sha256": _hash(data)}


def _hash(source: Path) -> str:
    """SHA-256 of a file, or of the names and contents of a folder's files."""
    found = hashlib.sha256()
    for path in [source] if source.is_file() else sorted(each for each in source.rglob("*") if each.is_file()):
        found.update(b"" if path == source else path.relative_to(source).as_posix().encode() + b"\0")
        with path.open("rb") as file:
            hashlib.file_digest(file, lambda: found)
    return found.hexdigest()


def commit() -> str:
    """The commit of the checkout that motionmend runs from, "+" after it if files were changed; "" if installed."""
    package = Path(__file__).resolve().parents[1]

    def git(*arguments: str) -> str:
        ran = subprocess.run(["git", "-C", str(package), *arguments], capture_output=True, text=True, check=True)
        return ran.stdout.strip()

    try:
        if not git("ls-files", "__init__.py"):
            return ""  # an environment inside somebody else's checkout
        return git("rev-parse", "HEAD") + ("+" if git("status", "--porcelain", "--", ".") else "")
    except (OSError, subprocess.CalledProcessError):
        return ""


def versions() -> dict[str, str]:
    found = {"motionmend": __version__, "python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def machine() -> str:
    """Processor and cores, in words."""
    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    return f"{platform.system()} {platform.machine()}, {model or 'unknown processor'}, {os.cpu_count()} cores"
