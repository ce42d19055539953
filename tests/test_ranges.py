"""Ranges, names and lengths as people write them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionmend import InputError, Motion, Skeleton, Take
from motionmend.motion import Units
from motionmend.ranges import mask_of, parse_frames, parse_length, parse_lost, parse_range


def take_of(*names: str, frames: int = 100) -> Take:
    positions = np.zeros((frames, len(names), 3), np.float32)
    motion = Motion(positions, np.ones(positions.shape[:2], bool), 50.0, Skeleton.cloud(names))
    return Take(motion, None, None, Units(1.0, "y", ""), "npz", "made.npz")


@given(st.none() | st.integers(-150, 150), st.none() | st.integers(-150, 150))
def test_a_range_means_what_a_python_slice_means(start, stop):
    meant = list(range(100))[slice(start, stop)]
    text = f"{'' if start is None else start}:{'' if stop is None else stop}"
    if not meant:
        with pytest.raises(InputError, match="no frame"):
            parse_range(text, 100, 50)
    else:
        assert parse_range(text, 100, 50) == parse_range((start, stop), 100, 50) == (meant[0], meant[-1] + 1)


def test_times_are_nearest_frames():
    assert parse_range("0.5s:0.8s", 100, 50) == (25, 40)
    assert parse_range("0.5s:", 100, 50) == (25, 100)
    assert parse_range(":1s", 200, 59.94) == (0, 60)
    assert parse_frames("0.5s", 120) == 60 == parse_frames("60", 120)


@pytest.mark.parametrize("bad", ["", "12", "a:b", "1:2:3", "1.5:3", "1s5:2s", "nan:3", "infs:3"])
def test_what_is_no_range_is_refused(bad):
    with pytest.raises(InputError):
        parse_range(bad, 100, 50)


def test_lengths_have_units():
    assert parse_length("5mm") == parse_length("0.5 cm") == pytest.approx(parse_length("0.005"))
    with pytest.raises(InputError):
        parse_length("5 inches")


def test_names_may_hold_colons_and_commas():
    take = take_of("mixamorig:Hips", "mixamorig:LeftArm", "a,b", "Hand L")
    assert parse_lost("mixamorig:LeftArm:3:9", take) == ([1], 3, 9)
    assert parse_lost("mixamorig:Hips,Hand L:0.1s:", take) == ([0, 3], 5, 100)
    assert parse_lost("a,b:1:2", take) == ([2], 1, 2)
    assert parse_lost("mixamorig:LeftArm", take) == ([1], 0, 100)
    assert parse_lost((["Hand L", "a,b"], 3, None), take) == ([3, 2], 3, 100)


def test_a_wrong_name_is_answered_with_the_nearest():
    take = take_of("LeftForeArm", "LeftHand", "Head")
    with pytest.raises(InputError, match="LeftForeArm"):
        parse_lost("leftforearm:3:9", take)
    with pytest.raises(InputError, match="Did you mean LeftHand"):
        parse_lost("LeftHand,LeftHnad:3:9", take)


def test_the_mask_is_the_union():
    take = take_of("a", "b", "c", frames=10)
    expected = np.zeros((10, 3), bool)
    expected[2:4] = True
    expected[7:, 1] = True
    np.testing.assert_array_equal(mask_of(take, [(2, 4)], ["b:7:"]), expected)
