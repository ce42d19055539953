"""The fill `local`: a marker's place in the frame of three others that ride on the same part of the body.

What marker tools call a rigid body of three, and Tits, Tilmanne & Dutoit 2018 "local interpolation": of the markers
seen throughout the gap the three that keep their distances to the lost one best, for how near they are, span a frame,
and in it the way from the gap's one end to its other is a straight line.
"""

from __future__ import annotations

import numpy as np

from .donors import Chart
from .lessons import LEAST, Lesson, view

Array = np.ndarray

TRIED = 8  # of the steadiest, if the first three lie on a line


def local_chart(one: Lesson) -> Chart | None:
    """The frame of the three steadiest donors that do not lie on one line."""
    for third in range(LEAST - 1, len(one.donors)):
        three = one.only([0, 1, third])
        seen = view(three)
        if seen is not None:
            return three.chart(seen.outward(np.zeros((len(seen.asked), 3))), seen.turn)
    return None
