"""Packs of real captures, unpacked once and kept between runs."""

from __future__ import annotations

import fcntl
import os
import tarfile
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKS = ROOT.parent / "shared" / "data"


def unpacked(pack: str) -> Path:
    """The folder of one pack of real captures, unpacked once and kept between runs; skips where it is absent."""
    archive = PACKS / f"{pack}.tar.xz"
    if not archive.is_file():
        pytest.skip(f"real captures are not at hand: no {archive}")
    cache = Path(os.environ.get("MOTIONMEND_TEST_DATA", Path(tempfile.gettempdir()) / "motionmend-test-data"))
    cache.mkdir(parents=True, exist_ok=True)
    # Several workers start at once: one unpacks, the others wait.
    with (cache / f"{pack}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = cache / f"{pack}.done"
        if not done.exists():
            with tarfile.open(archive) as tar:
                tar.extractall(cache, filter="data")
            done.touch()
    return cache / pack
