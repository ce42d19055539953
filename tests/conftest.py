"""Fixtures shared by the suites: real captures, where they are at hand."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from captures import PACKS, unpacked

# One thread a worker: several would wait for each other, and sums of several may differ in their last bits.
for library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(library, "1")


@pytest.fixture(scope="session")
def cmu() -> Path:
    """The CMU trials, one folder a subject: 01/01_01.bvh, 05/05_01.amc with 05/05.asf, …"""
    return unpacked("cmu")


@pytest.fixture(scope="session")
def reactidle() -> Path:
    """ReActIdle's 22 BVH takes, in acted/ and genuine/."""
    return unpacked("reactidle")


@pytest.fixture(scope="session")
def bandai() -> Path:
    """Bandai-Namco's clips, BVH, in data/."""
    return unpacked("bandai-namco-2")


@pytest.fixture(scope="session")
def free_motion() -> tuple[Path, Path]:
    """The folder of the free pack, and its table."""
    return unpacked("free-motion"), PACKS / "free-motion.csv"


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """A folder of the user's with walk.bvh in it, and the user in the folder."""
    from walks import WALK

    monkeypatch.chdir(tmp_path)
    shutil.copy(WALK, "walk.bvh")
    return tmp_path
