"""Bodies put back on the ground, by hand-made heights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionmend.body.joints import JOINT
from motionmend.body.standing import STANDING, UPRIGHT
from motionmend.constraints.ground import BALL, SUNK, above_ground, grounded

FPS = 60.0


def lifted(heights) -> np.ndarray:
    """A standing body, its feet so high over where they would stand on a ground at 0.2 m."""
    positions = np.tile(STANDING.astype(float) + UPRIGHT, (len(heights), 1, 1))
    positions[..., 1] += 0.2 - above_ground(positions[:1], 0.0)[0] + np.asarray(heights)[:, None]
    return positions


def put_back(person: np.ndarray) -> np.ndarray:
    return grounded(person, above_ground(person, 0.2), FPS, 0.5)


def test_standing_is_nothing_above_the_ground():
    person = lifted([0, 0.1, -0.1])
    np.testing.assert_allclose(above_ground(person, 0.2), [0, 0.1, -0.1], atol=1e-6)
    thigh, shin, foot, toe = (person[0, JOINT[f"left_{part}"]] for part in ("thigh", "shin", "foot", "toe"))
    leg = np.linalg.norm(thigh - shin) + np.linalg.norm(shin - foot)
    assert toe[1] - 0.2 == pytest.approx(BALL * leg, abs=0.01)


def test_a_jump_stays_and_a_float_comes_down():
    t = np.arange(240) / FPS
    jump = np.where(abs(t - 2) < 0.25, 0.3 * (1 - ((t - 2) / 0.25) ** 2), 0)
    np.testing.assert_allclose(put_back(lifted(jump)), lifted(jump), atol=0.01)
    float_up = put_back(lifted(np.minimum(t, 1) * 0.4))
    assert above_ground(float_up, 0.2)[-60:].max() < 0.01
    assert above_ground(float_up, 0.2).max() < 0.15


@given(st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=8), st.integers(0, 2**31))
def test_nothing_is_below_the_ground_and_frame_0_stays(knots, seed):
    frames = 30 * len(knots) + 1
    heights = np.interp(np.arange(frames), np.arange(len(knots) + 1) * 30, [0, *knots])
    heights += np.random.default_rng(seed).normal(0, 0.01, frames)
    person = lifted(heights)
    put = put_back(person)
    assert np.array_equal(put[0], person[0])
    assert above_ground(put, 0.2)[round(SUNK * FPS) + 1 :].min(initial=0) > -1e-6
    shift = put - person
    assert np.ptp(shift, axis=1).max() < 1e-9 and not shift[..., [0, 2]].any()  # as a whole, up or down
