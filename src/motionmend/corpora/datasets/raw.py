"""What a data set yields: takes as it has them, and what it knows of its files better than they do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...motion import Array, Motion


@dataclass(frozen=True, eq=False)
class Raw:
    """One take as its data set has it, before its joints are mapped to BODY and its frames resampled.

    name : unique in the data set. file : relative to the source folder. subject, split : "" where unknown.
    motion : any skeleton, at the true rate. rig : the convention recognised. licence : SPDX, or words.
    sha256 : of the file (and of its skeleton's, appended). notes : what was done to it.
    untrusted : `(frames, joints)` bool, samples not to be trusted, besides those that `motion` has unobserved.
    floor : metres of y at which the ground is; None where that is to be judged by the feet.
    figure : takes of one figure have bones of one length, and are checked for it; "" for no check.
    """

    name: str
    file: str
    subject: str
    split: str
    motion: Motion
    rig: str
    licence: str
    sha256: str
    notes: tuple[str, ...] = ()
    untrusted: Array | None = None
    floor: float | None = None
    figure: str = ""


@dataclass(frozen=True)
class Source:
    """A file to be read as a take, and what its data set knows of it better than the file does.

    fps, unit, up : instead of what the file says or would be guessed.
    skip : first frames that are no motion, and why in `skip_why`.
    ground : "file" if y = 0 of the file is the ground, "feet" if only the feet tell, "" to see which is the case.
    """

    path: Path
    file: str
    name: str
    subject: str = ""
    split: str = ""
    licence: str = ""
    fps: float | None = None
    unit: str | None = None
    up: str | None = None
    skip: int = 0
    skip_why: str = ""
    ground: str = ""
    figure: str = ""
    notes: tuple[str, ...] = ()
