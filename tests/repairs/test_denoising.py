"""Filters against what is known of their answer: lines and cubics kept, sinusoids lowered as they should be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from motionmend.errors import InputError
from motionmend.motion import Motion, Skeleton, Take, Units, runs
from motionmend.repairs.denoising import denoise
from rigs import as_take, random_rig

METHODS = ("butterworth", "savgol")


def cloud(positions, observed=None, fps=100.0):
    positions = np.asarray(positions, np.float32)
    observed = np.ones(positions.shape[:2], bool) if observed is None else observed
    return Motion(positions, observed, fps, Skeleton.cloud([f"m{marker}" for marker in range(positions.shape[1])]))


def tone(frequency, frames=1000, fps=100.0):
    wave = np.sin(2 * np.pi * frequency * np.arange(frames) / fps + 0.3)
    return wave[:, None, None] * np.ones((1, 2, 3))


@pytest.mark.parametrize(("frequency", "left"), [(0.5, 1.0), (6.0, np.sqrt(0.5)), (30.0, 0.0)])
def test_butterworth_passes_half_of_the_power_at_its_cutoff_without_delay(frequency, left):
    smooth = denoise(cloud(tone(frequency)), "butterworth", cutoff=6.0).positions
    np.testing.assert_allclose(smooth[200:-200], left * tone(frequency)[200:-200], atol=2e-3)


def test_butterworth_falls_off_as_a_fourth_order_filter():
    # Twice a second-order filter: gain 1 / (1 + c r^4), r the ratio of the warped frequencies, 1/sqrt 2 at r = 1.
    ratio = np.tan(np.pi * 12 / 100) / np.tan(np.pi * 6 / 100)
    gain = 1 / (1 + (np.sqrt(2) - 1) * ratio**4)
    smooth = denoise(cloud(tone(12.0)), "butterworth", cutoff=6.0).positions
    np.testing.assert_allclose(smooth[300:-300], gain * tone(12.0)[300:-300], atol=1e-3)


def test_savgol_is_scipys_and_keeps_cubics_to_the_ends():
    noisy = np.random.default_rng(0).normal(size=(80, 1, 3))
    smooth = denoise(cloud(noisy), "savgol", window=0.11).positions
    np.testing.assert_allclose(smooth, savgol_filter(noisy.astype(np.float32), 11, 3, axis=0), atol=1e-5)
    clock = np.linspace(-1, 1, 40)[:, None, None]
    cubic = clock**3 - clock * [1.0, 2.0, 3.0] + 0.5
    np.testing.assert_allclose(denoise(cloud(cubic), "savgol").positions, cubic, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_lines_are_kept_to_the_ends(method):
    line = np.arange(300)[:, None, None] * np.array([[[0.01, -0.02, 0.0]]]) + 3
    np.testing.assert_allclose(denoise(cloud(line), method).positions, line, atol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_noise_goes_and_motion_stays(method):
    truth = tone(1.0)
    noisy = truth + np.random.default_rng(0).normal(size=truth.shape) * 0.05
    smooth = denoise(cloud(noisy), method).positions
    assert np.std(smooth - truth) < 0.6 * np.std(noisy - truth)


@pytest.mark.parametrize("method", METHODS)
@given(st.integers(0, 10_000), st.sampled_from([1, 2, 3, 17, 80]))
@settings(max_examples=15, derandomize=True, deadline=None)
def test_each_run_is_filtered_by_itself(method, seed, frames):
    rng = np.random.default_rng(seed)
    observed = rng.random((frames, 3)) < 0.9
    positions = np.where(observed[..., None], rng.normal(size=(frames, 3, 3)), np.nan)
    motion = cloud(positions, observed)
    smooth = denoise(motion, method)
    assert np.array_equal(smooth.observed, observed) and np.isnan(smooth.positions[~observed]).all()
    for joint in range(3):
        for start, stop in runs(observed[:, joint]):
            alone = denoise(cloud(positions[start:stop, joint : joint + 1]), method)
            np.testing.assert_allclose(smooth.positions[start:stop, joint], alone.positions[:, 0], atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_turns_lose_noise_and_a_steady_spin_stays(method):
    rig = random_rig(0, parents=(-1, 0), frames=400)
    spin = Rotation.from_rotvec(np.linspace(0, 12, 400)[:, None] * [0.0, 0.6, 0.8])
    jitter = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(400, 3)) * 0.02)
    signs = np.where(np.arange(400) % 5 == 0, -1, 1)[:, None]
    turns = np.stack([spin.as_quat() * signs, (spin * jitter).as_quat() * signs], axis=1)
    smooth = denoise(as_take(replace(rig, rotations=turns)), method)
    off = [(spin.inv() * Rotation.from_quat(smooth.rig.rotations[:, joint])).magnitude() for joint in (0, 1)]
    assert np.max(off[0][60:-60]) < 1e-4
    assert np.mean(off[1]) < 0.6 * np.mean(jitter.magnitude())
    np.testing.assert_allclose(smooth.motion.positions, smooth.rig.kinematics[0], atol=1e-6)


def test_untrusted_channels_and_joints_that_cannot_turn_stay():
    rig = random_rig(1, parents=(-1, 0, 1), frames=60, orders=("ZXY", "", "ZXY"))
    trusted = rig.trusted.copy()
    trusted[20:30, 2] = False
    take = as_take(replace(rig, trusted=trusted))
    smooth = denoise(take, "butterworth").rig
    assert np.array_equal(smooth.rotations[20:30, 2], rig.rotations[20:30, 2])
    assert np.array_equal(smooth.rotations[:, 1], rig.rotations[:, 1])
    assert np.array_equal(smooth.translations[:, 1:], rig.translations[:, 1:])
    assert not np.array_equal(smooth.translations[:, 0], rig.translations[:, 0])


def test_a_take_of_points_keeps_its_file():
    take = Take(cloud(tone(20.0)), None, "document", Units(1.0, "y", "made up"), "trc", "made.trc")
    smooth = denoise(take)
    assert smooth.document == "document" and np.abs(smooth.motion.positions[200:-200]).max() < 0.05


@pytest.mark.parametrize(
    "wrong",
    [{"cutoff": 50.0}, {"cutoff": 0}, {"cutoff": float("nan")}, {"method": "savgol", "window": 0}, {"method": "x"}],
)
def test_what_cannot_be_is_said(wrong):
    with pytest.raises(InputError):
        denoise(cloud(tone(1.0)), **wrong)
