"""Fixtures shared by the suites: real captures, where they are at hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from captures import unpacked


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
