"""Any length, rate and gap to windows and back: planted truths, slow twins, and ten minutes without a seam."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionmend as mm
from motionmend.metrics.positional import steps
from motionmend.motion import Motion, Skeleton, runs
from motionmend.networks import windows

QUICK = settings(max_examples=40, deadline=None, derandomize=True)


def a_motion(positions: np.ndarray, observed: np.ndarray | None = None, fps: float = 60.0) -> Motion:
    observed = np.ones(positions.shape[:2], bool) if observed is None else observed
    skeleton = Skeleton.cloud([str(joint) for joint in range(positions.shape[1])])
    return Motion(positions.astype(np.float32), observed, fps, skeleton)


def a_take(frames: int, joints: int = 3, seed: int = 0) -> np.ndarray:
    """A smooth random path of each joint, metres."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None, None] / 60
    size, phase = rng.normal(0, 0.3, (1, joints, 3, 4)), rng.uniform(0, 6, (1, joints, 3, 4))
    return (size * np.sin(time * rng.uniform(1, 6, (1, joints, 3, 4)) + phase)).sum(axis=-1).astype(np.float32)


def straight(positions: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """The slow twin: a straight line between the observed samples around, held at the ends, 0 where there are none."""
    out = np.zeros_like(positions)
    for joint in range(positions.shape[1]):
        known = np.flatnonzero(observed[:, joint])
        for axis in range(3):
            if len(known):
                values = positions[known, joint, axis]
                out[:, joint, axis] = np.interp(np.arange(len(positions)), known, values)
    return out


def by_lines(positions: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """A network that draws straight lines inside each of its windows."""
    assert np.isnan(positions[~observed]).all() and np.isfinite(positions[observed]).all()
    return np.stack([straight(*window) for window in zip(positions, observed)])


class Constants:
    """A network that puts everything where its window's number says: as many seams as there are windows."""

    def __init__(self):
        self.rng = np.random.default_rng(1)
        self.batches = []

    def __call__(self, positions: np.ndarray, _: np.ndarray) -> np.ndarray:
        self.batches.append(len(positions))
        said = self.rng.uniform(-0.5, 0.5, (len(positions), 1, 1, 1))
        return np.broadcast_to(said, positions.shape).astype(np.float32)


# Resampling.


@pytest.mark.parametrize("old, new", [(120, 60), (120, 30), (60, 60), (100.0, 50.0), (1 / 0.008333, 60)])
def test_whole_ratios_are_decimation_bit_for_bit(old, new):
    motion = a_motion(a_take(101), np.random.default_rng(2).random((101, 3)) < 0.7, old)
    step = round(old / new)
    out = windows.resample(motion, new)
    assert out.fps == new
    assert out.positions.tobytes() == motion.positions[::step].tobytes()
    assert np.array_equal(out.observed, motion.observed[::step])


RATES = [(24, 60), (30, 60), (120, 50), (59.94, 60), (60000 / 1001, 60), (60, 120), (25, 24)]


@pytest.mark.parametrize("old, new", RATES)
def test_parabolas_come_out_exactly_and_nothing_runs_away(old, new):
    frames = 2001
    seconds = np.arange(frames)[:, None] / old
    coefficients = np.random.default_rng(3).normal(0, [[[0.5]], [[0.1]], [[0.01]]], (3, 3, 1))

    def path(t):
        return sum(each[:, 0] * t[..., None] ** power for power, each in enumerate(coefficients))

    out = windows.resample(a_motion(path(seconds), fps=old), new)
    assert abs(len(out) - ((frames - 1) * new / old + 1)) < 1
    assert out.observed.all()
    np.testing.assert_allclose(out.positions, path(np.arange(len(out))[:, None] / new), atol=2e-4)


@given(
    old=st.sampled_from([24.0, 30.0, 50.0, 59.94, 60.0, 120.0]),
    new=st.sampled_from([24.0, 50.0, 60.0, 100.0]),
    frames=st.integers(1, 90),
    seed=st.integers(0, 99),
)
@QUICK
def test_resampling_reads_what_is_observed_and_nothing_else(old, new, frames, seed):
    observed = np.random.default_rng(seed).random((frames, 3)) < 0.7
    positions = a_take(frames, seed=seed)
    out = windows.resample(a_motion(positions, observed, old), new)
    rubbish = np.where(observed[..., None], positions, np.float32(3e38))
    again = windows.resample(a_motion(rubbish, observed, old), new)
    seen = out.observed
    assert np.array_equal(seen, again.observed)
    assert np.array_equal(out.positions[seen], again.positions[seen])
    assert np.array_equal(out.positions[0][observed[0]], positions[0][observed[0]])
    for frame in range(len(out)):
        time = frame * old / new
        before = round(time) if abs(time - round(time)) < 1e-6 else int(time)
        exact = abs(time - before) < 1e-6
        for joint in range(3):
            assert seen[frame, joint] == (observed[before, joint] and (exact or observed[before + 1, joint]))
            if exact and seen[frame, joint]:
                assert np.array_equal(out.positions[frame, joint], positions[before, joint])


def test_no_overshoot_beyond_what_neighbours_can_explain():
    positions = np.zeros((40, 1, 3), np.float32)
    positions[20:] = 1
    out = windows.resample(a_motion(positions, fps=30), 120)
    assert out.positions.min() > -0.1 and out.positions.max() < 1.1
    assert np.abs(out.positions[: 18 * 4]).max() == 0


@pytest.mark.parametrize("fps", [0, -60, np.nan, np.inf, 1e9])
def test_a_rate_that_is_none_is_refused(fps):
    with pytest.raises(ValueError, match="frames per second"):
        windows.resample(a_motion(a_take(5)), fps)


def test_an_empty_motion_stays_empty():
    assert len(windows.resample(a_motion(np.zeros((0, 3, 3))), 50)) == 0


@pytest.mark.parametrize("fps, most", [(60, 0.93), (30, 0.9)])
def test_real_takes_come_back_closer_than_straight_lines_bring_them(cmu, fps, most):
    """Halved or quartered and brought back to 120 fps, on a subject that is for validation."""
    errors = []
    for trial in ("16_01.amc", "16_15.amc", "16_35.amc"):
        motion = mm.load(cmu / "16" / trial).motion
        low = windows.resample(motion, fps)
        times = np.arange((len(low) - 1) * round(120 / fps) + 1)
        back = windows.resample(low, 120).positions
        known = np.isin(times, times[:: round(120 / fps)])[:, None].repeat(low.positions.shape[1], axis=1)
        line = straight(motion.positions[: len(times)], known)
        errors.append([np.linalg.norm(each - motion.positions[: len(times)], axis=-1).mean() for each in (back, line)])
    curve, line = np.mean(errors, axis=0)
    assert curve < most * line


# Windows and their stitching.


@given(st.integers(1, 1000), st.integers(1, 80), st.data())
@QUICK
def test_windows_cover_the_take_and_their_weights_sum_to_one(frames, length, data):
    overlap = data.draw(st.integers(0, length - 1))
    first = windows.starts(frames, length, overlap)
    assert first[0] == 0 and first[-1] == max(0, frames - length)
    assert (np.diff(first) > 0).all() and (np.diff(first) <= length - overlap).all()
    # The stitch is linear in its windows: the weight of one is what it gives for that one alone.
    alone = np.eye(len(first)).repeat(length, axis=1).reshape(len(first), len(first), length).transpose(1, 2, 0)
    weights = windows.stitch(alone, first, frames, overlap)
    assert weights.shape == (frames, len(first)) and (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    ones = windows.stitch(np.full((len(first), length, 2), 0.1, np.float32), first, frames, overlap)
    assert (ones == np.float32(0.1)).all()  # exactly
    if 0 < overlap <= length / 3:
        assert np.abs(np.diff(weights, axis=0)).max(initial=0) <= 1 / overlap


@given(st.integers(1, 300), st.integers(1, 60), st.data())
@QUICK
def test_cut_and_stitched_again_it_is_the_same(frames, length, data):
    overlap = data.draw(st.integers(0, length - 1))
    values = np.random.default_rng(frames).normal(size=(frames, 2, 3)).astype(np.float32)
    first = windows.starts(frames, length, overlap)
    cut = windows.cut(values, first, length)
    assert cut.shape == (len(first), length, 2, 3)
    for window, start in zip(cut, first):
        for offset in range(length):
            assert np.array_equal(window[offset], values[min(start + offset, frames - 1)])
    assert np.array_equal(windows.stitch(cut, first, frames, overlap), values)


def test_the_ramp_lies_in_the_middle_of_what_two_windows_share():
    out = windows.stitch(np.repeat([[0.0], [1.0]], 60, axis=1), np.array([0, 40]), 100, 4)
    np.testing.assert_allclose(out, [0] * 48 + [0.2, 0.4, 0.6, 0.8] + [1] * 48, atol=1e-6)


def test_windows_that_cannot_overlap_so_are_refused():
    with pytest.raises(ValueError, match="overlap by 60"):
        windows.starts(100, 60, 60)
    with pytest.raises(ValueError, match="0 to 15 frames, not 16"):
        windows.complete(by_lines, a_take(9), np.zeros((9, 3), bool), 60, overlap=16, batch=4)


# A take of any length by a network of one length.


@given(
    frames=st.integers(1, 1000),
    length=st.sampled_from([1, 2, 3, 8, 16, 31, 60, 240]),
    batch=st.integers(1, 9),
    seed=st.integers(0, 10_000),
)
@QUICK
def test_any_take_comes_back_whole_with_what_was_observed_bit_for_bit(frames, length, batch, seed):
    rng = np.random.default_rng(seed)
    observed = rng.random((frames, 4)) >= rng.choice([0, 0.01, 0.2, 0.9, 1])
    for _ in range(rng.integers(4)):
        start, joint = rng.integers(frames), rng.integers(5)
        observed[start : start + rng.integers(1, 400), joint if joint < 4 else slice(None)] = False
    positions = a_take(frames, 4, seed)
    positions[~observed] = np.nan

    def network(some, seen):
        assert some.shape == (len(some), length, 4, 3) and seen.shape == some.shape[:3]
        assert 1 <= len(some) <= batch and some.dtype == np.float32 and seen.dtype == bool
        assert np.isnan(some[~seen]).all() and np.isfinite(some[seen]).all()
        return np.full(some.shape, 7.0)

    before = positions.tobytes()
    overlap = int(rng.integers(length // 4 + 1))
    out = windows.complete(network, positions, observed, length, overlap=overlap, batch=batch)
    assert positions.tobytes() == before
    assert out.shape == positions.shape and out.dtype == np.float32
    assert out[observed].tobytes() == positions[observed].tobytes()
    assert np.isfinite(out).all()
    others = positions[observed]  # between which and the network's a sample may lie
    low, high = min(7, others.min(initial=7)), max(7, others.max(initial=7))
    assert low - 1e-4 <= out.min() and out.max() <= high + 1e-4
    assert np.abs(out[~observed] - 7).max(initial=0) < 1e-4 or np.mean(np.abs(out[~observed] - 7) < 1e-4) > 0.8


@pytest.mark.parametrize("length, overlap", [(16, 2), (24, 6), (60, 10), (60, 15), (101, 25), (240, 30)])
@pytest.mark.parametrize("gap", [1, 36, 37, 60, 333, 1000])
def test_a_gap_of_any_length_is_crossed_by_the_line_between_its_ends(length, overlap, gap):
    rng = np.random.default_rng(gap)
    positions = np.cumsum(rng.normal(0, 0.05, (gap + 300, 3, 3)), axis=0).astype(np.float32)
    for hole in (slice(137, 137 + gap), slice(0, gap), slice(300, None)):
        observed = np.ones((gap + 300, 3), bool)
        observed[hole] = False
        out = windows.complete(by_lines, positions, observed, length, overlap=overlap, batch=8)
        np.testing.assert_allclose(out, straight(positions, observed), atol=1e-5)


def test_what_a_network_says_of_samples_that_it_was_shown_is_not_used():
    """XMAE is trained on what is masked or displaced: its answer for a clean sample means nothing."""

    def network(some, known):
        return np.where(known[..., None], 99, by_lines(some, known))

    positions, observed = a_take(700), np.ones((700, 3), bool)
    observed[200:500] = observed[650:] = False
    out = windows.complete(network, positions, observed, 60, overlap=8, batch=8)
    np.testing.assert_allclose(out, straight(positions, observed), atol=1e-4)


def test_several_long_gaps_beside_a_joint_that_is_never_seen():
    positions, observed = a_take(900), np.ones((900, 3), bool)
    observed[100:250] = observed[252:400] = observed[700:] = False
    observed[:, 2] = False

    def network(some, known):
        assert not known[..., 2].any()
        return by_lines(some, known)

    out = windows.complete(network, positions, observed, 60, overlap=10, batch=8)
    np.testing.assert_allclose(out, straight(positions, observed), atol=1e-5)


def test_a_joint_seen_through_a_long_gap_of_the_others_is_shown_at_every_rate():
    positions, observed = a_take(600, 4), np.ones((600, 4), bool)
    observed[100:500, 1:] = False
    seen = []

    def network(some, known):
        # Only frames beyond the end of the take hide it.
        seen.append(known[:, 0, 0].all() and (np.diff(known[..., 0].astype(int), axis=1) <= 0).all())
        return by_lines(some, known)

    out = windows.complete(network, positions, observed, 60, overlap=10, batch=8)
    np.testing.assert_allclose(out, straight(positions, observed), atol=1e-5)
    assert all(seen)


@pytest.mark.parametrize("overlap", [0, 6, 15])
def test_a_gap_that_fits_is_predicted_once_by_a_window_with_context_on_both_sides(overlap):
    """Also beside others, and while another joint is lost for the whole take."""
    rng = np.random.default_rng(5)
    for lost in (False, True):
        observed = np.ones((4000, 6), bool)
        observed[:, 5] = not lost
        starts = 40 + np.cumsum(rng.integers(60, 200, 25))
        for start in starts:
            observed[start : start + rng.integers(1, 36), :5] = False
        told = []

        def network(positions, _, told=told):
            told += [int(first[np.isfinite(first)][0]) for first in positions[..., 0, 0] - np.arange(60)]
            number = np.arange(len(told) - len(positions), len(told))
            return np.broadcast_to(number.reshape(-1, 1, 1, 1), positions.shape)

        clock = np.arange(4000, dtype=np.float32)[:, None, None] * np.ones((1, 6, 3), np.float32)
        out = windows.complete(network, clock, observed, 60, overlap=overlap, batch=4)
        for start, stop in runs(~observed[:, 0]):
            said = out[start:stop, 0, 0]
            begin = told[int(said[0])]
            assert begin <= start - 7 and stop + 7 <= begin + 60
            assert (said == said[0]).all()


def test_a_short_take_is_padded_with_nothing_known():
    seen = []

    def network(some, known):
        seen.append(known)
        return by_lines(some, known)

    positions, observed = a_take(20), np.ones((20, 3), bool)
    observed[5:9] = False
    out = windows.complete(network, positions, observed, 60, overlap=10, batch=8)
    np.testing.assert_allclose(out, straight(positions, observed), atol=1e-6)
    assert np.array_equal(seen, [np.concatenate([observed, np.zeros((40, 3), bool)])[None]])


def test_a_gap_alone_lies_in_the_middle_of_its_window():
    told = []

    def network(some, known):
        told.extend(known[..., 0])
        return by_lines(some, known)

    observed = np.ones((500, 3), bool)
    observed[200:220] = False
    windows.complete(network, a_take(500), observed, 60, overlap=10, batch=8)
    assert [runs(~seen) for seen in told] == [[(20, 40)]]


def test_windows_lie_only_where_something_is_missing():
    observed = np.ones((36_000, 3), bool)
    observed[5000:5010] = observed[20_000:20_010, 1] = False
    network = Constants()
    windows.complete(network, a_take(36_000), observed, 60, overlap=10, batch=8)
    assert network.batches == [2]
    network = Constants()
    whole = windows.complete(network, a_take(100), np.ones((100, 3), bool), 60, overlap=10, batch=8)
    assert network.batches == [] and np.array_equal(whole, a_take(100))


def test_ten_minutes_have_no_seam():
    """A network whose windows disagree by a constant each, asked for one joint through the whole take."""
    frames, overlap = 36_000, 12
    positions = np.zeros((frames, 3, 3), np.float32)
    observed = np.ones((frames, 3), bool)
    observed[:, 1] = False
    network = Constants()
    out = windows.complete(network, positions, observed, 60, overlap=overlap, batch=32)
    assert sum(network.batches) < 36_000 / 60 * 2.2
    said = np.abs(np.diff(out[:, 1].astype(float), axis=0)).max()
    assert said <= 1 / overlap  # windows lie within half a metre of 0
    jumps, _ = steps(out)
    assert np.nanmax(jumps[:, 1]) <= 1000 * np.sqrt(3) / overlap
    # Untreated, the same windows side by side jump by their whole difference.
    hard = windows.complete(Constants(), positions, observed, 60, overlap=0, batch=32)
    assert np.nanmax(steps(hard)[0][:, 1]) > 8 * np.nanmax(jumps[:, 1])
    assert np.array_equal(out[:, [0, 2]], positions[:, [0, 2]])


def test_ten_minutes_take_a_small_multiple_of_their_own_memory():
    observed = np.random.default_rng(6).random((36_000, 21)) < 0.5
    observed[3000:9000] = False
    positions = np.zeros((36_000, 21, 3), np.float32)
    network = Constants()
    tracemalloc.start()
    windows.complete(network, positions, observed, 60, overlap=10, batch=32)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert max(network.batches) == 32
    assert peak < 12 * positions.nbytes


def test_work_grows_with_the_take():
    def asked(frames):
        observed = np.random.default_rng(7).random((frames, 5)) < 0.8
        observed[: frames // 2] = False
        network = Constants()
        windows.complete(network, a_take(frames, 5), observed, 60, overlap=10, batch=32)
        return sum(network.batches)

    assert asked(16_000) < 2.1 * asked(8000)
    assert asked(8000) < 3 * 8000 / 60


@pytest.mark.parametrize("gap, expected", [(20, 0.03), (120, 0.05)])
def test_what_more_is_said_of_a_sample_comes_along(gap, expected):
    """A fourth number: as said in a gap that fits, and with what was said of the coarse frames in one that does not."""
    said = iter([0.04, 0.03] if gap > 60 else [0.03])  # coarse first
    told = {}

    def predict(positions, observed):
        depth = told.setdefault(len(told), next(said))
        more = np.full((*observed.shape, 1), depth, np.float32)
        return np.concatenate([by_lines(positions, observed), more], axis=-1)

    positions, observed = a_take(400), np.ones((400, 3), bool)
    observed[100 : 100 + gap] = False
    out = windows.complete(predict, positions, observed, 100, overlap=25, batch=64)
    assert out.shape == (400, 3, 4) and np.array_equal(out[observed][:, :3], positions[observed])
    assert not out[observed][:, 3].any()
    np.testing.assert_allclose(out[102 : 98 + gap, :, 3], expected, atol=1e-6)  # beside what is seen less is open
