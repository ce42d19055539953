"""A file's units and axes ↔ metres, Y up. The readers and writers convert here, and nothing else does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import InputError
from .motion import Units

Array = np.ndarray

METRES = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "in": 0.0254,
    "ft": 0.3048,
    "asf": 0.0254 / 0.45,  # CMU's ASF/AMC files: inches over 0.45
}
SPELLINGS = {
    **{unit: unit for unit in METRES},
    **{"meter": "m", "meters": "m", "metre": "m", "metres": "m", "meter(s)": "m"},
    **{"centimeter": "cm", "centimeters": "cm", "centimetre": "cm", "centimetres": "cm"},
    **{"millimeter": "mm", "millimeters": "mm", "millimetre": "mm", "millimetres": "mm"},
    **{"inch": "in", "inches": "in", "feet": "ft", "foot": "ft", "decimeter": "dm", "decimetre": "dm"},
}

# Rows are the file's axes that become x, y and z; each matrix is a proper rotation.
_TO_Y_UP = {
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "-y": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "-x": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]],
}


@dataclass(frozen=True)
class Hints:
    """What the user says of a file, and so is not guessed.

    unit : one of METRES, or a spelled-out name. up : "y", "z", "x", "-y", …
    fps : frames per second. asf : the skeleton file of an AMC take.
    """

    unit: str | None = None
    up: str | None = None
    fps: float | None = None
    asf: str | None = None

    def __post_init__(self):
        if self.unit is not None and self.unit.lower() not in SPELLINGS:
            raise InputError(f"unknown unit {self.unit!r}", expected="one of " + ", ".join(METRES))
        if self.up is not None and self.up.lower() not in _TO_Y_UP:
            raise InputError(f"unknown up axis {self.up!r}", expected="one of " + ", ".join(_TO_Y_UP))
        if self.fps is not None and not 0 < self.fps <= 100_000:
            raise InputError(f"impossible rate {self.fps} fps", expected="frames per second above 0")


def rotation_to_y_up(up: str) -> Array:
    """The `(3, 3)` rotation that brings file vectors to Y up."""
    return np.array(_TO_Y_UP[up], float)


def to_metres(points: Array, units: Units) -> Array:
    """File coordinates `(..., 3)` as metres, Y up, in the dtype of `points`."""
    turn = rotation_to_y_up(units.up).astype(points.dtype)
    return (points @ turn.T) * points.dtype.type(units.metres)


def from_metres(points: Array, units: Units) -> Array:
    """The way back: metres, Y up `(..., 3)` as file coordinates, float64."""
    return (points.astype(np.float64) / units.metres) @ rotation_to_y_up(units.up)


def resolve(
    hints: Hints,
    *,
    said_unit: str | None = None,
    said_up: str | None = None,
    stature: float | None = None,
    upward: Array | None = None,
    usual_unit: str = "m",
    usual_up: str = "y",
) -> Units:
    """Decide a file's units and up axis, and say why: the user's word, the file's, the body's, the format's.

    Parameters
    ----------
    said_unit, said_up : what the file itself states, if anything.
    stature : the person's height in file units, where a body was found (`body.measures.stature`).
    upward : `(3,)` mean direction from hips to head in file axes, where a body was found.
    usual_unit, usual_up : the format's habit, used when nothing else decides.
    """
    if hints.unit:
        unit, unit_why = SPELLINGS[hints.unit.lower()], "as you said"
    elif said_unit and said_unit.strip().lower() in SPELLINGS:
        unit, unit_why = SPELLINGS[said_unit.strip().lower()], "as the file says"
        if stature and not 0.8 <= stature * METRES[unit] <= 2.6:
            unit_why += f", though that makes the body {stature * METRES[unit]:.3g} m tall; set --unit if it is wrong"
    elif stature:
        # A person is 1 to 2.2 m tall; of the units that make one, the likeliest is nearest to 1.7 m, and
        # a unit in common use is preferred to a rarer one that fits about as well.
        def misfit(unit: str) -> float:
            rarity = {"m": 0.0, "cm": 0.0, "mm": 0.0, "asf": 0.05, "in": 0.1, "ft": 0.3, "dm": 0.3}[unit]
            return abs(np.log(stature * METRES[unit] / 1.7)) + rarity

        unit = min(METRES, key=misfit)
        height = stature * METRES[unit]
        unit_why = f"guessed: it makes the body {height:.2f} m tall"
        if not 1.0 <= height <= 2.2:
            unit_why += ", which is unusual; set --unit if you know it"
    else:
        unit, unit_why = usual_unit, "assumed: nothing in the file tells; set --unit if you know it"

    if hints.up:
        up, up_why = hints.up.lower(), "as you said"
    elif said_up and said_up.lower().lstrip("+") in _TO_Y_UP:
        up, up_why = said_up.lower().lstrip("+"), "as the file says"
    elif upward is not None and np.all(np.isfinite(upward)) and np.any(upward):
        axis = int(np.argmax(np.abs(upward)))
        up, up_why = ("" if upward[axis] > 0 else "-") + "xyz"[axis], "guessed from where the head is"
    else:
        up, up_why = usual_up, "assumed, as usual for the format"
    return Units(METRES[unit], up, f"{unit} ({unit_why}), {up} up ({up_why})")
