"""The published fills for markers: planted bodies and relations that they must find, formulas by others, properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import gaussian_kde

from motionmend.fills.auto import Auto
from motionmend.fills.average import SURE_SHARE, likelihoods
from motionmend.fills.lessons import lesson
from motionmend.fills.points import FILLS
from motionmend.motion import Motion, Skeleton

LEARNED = ("local", "regression", "pca", "average")
FRAMES = 240
CLOCK = np.arange(FRAMES) / 100.0
PLACES = np.array([[0.2, 0, 0.1], [0, 0.25, 0], [0, 0, 0.3], [-0.2, 0.1, 0], [0.1, -0.2, 0.1], [-0.1, -0.1, -0.2]])


def waves(seed, number):
    """`(frames, number)`: ways that have nothing to do with each other, between about -1 and 1."""
    rng = np.random.default_rng(seed)
    return np.sin(CLOCK[:, None] * rng.uniform(3, 11, number) + rng.uniform(0, 6, number))


def carried(body, seed=0, far=1.5):
    """`(frames, markers, 3)` seen from a body -> in the world, where the body turns so far (radians) and wanders."""
    turn = Rotation.from_rotvec(far * waves(seed, 3))
    return np.stack([turn.apply(body[:, marker]) for marker in range(body.shape[1])], 1) + waves(seed + 1, 3)[:, None]


def lost(truth, *holes, fps=100.0):
    """A cloud that lacks what the holes `(marker, start, stop)` say; NaN stands there."""
    truth = np.asarray(truth, np.float32)
    observed = np.ones(truth.shape[:2], bool)
    for marker, start, stop in holes:
        observed[start:stop, marker] = False
    names = [f"m{marker}" for marker in range(truth.shape[1])]
    return Motion(np.where(observed[..., None], truth, np.float32(np.nan)), observed, fps, Skeleton.cloud(names))


def errors(fill, motion, truth):
    """Metres `(missing samples,)`, and the gaps as the fill tells them."""
    filled, found = fill.fill(motion)
    assert np.array_equal(filled.positions[motion.observed], motion.positions[motion.observed])
    return np.linalg.norm(filled.positions - truth, axis=-1)[~motion.observed], found


# --- what is planted is found -----------------------------------------------------------------------------


def test_local_is_exact_on_rigid_bodies_and_at_their_edges():
    """Two bodies that move each on its own: each marker is carried by three of its own body."""
    one, other = (carried(np.repeat(PLACES[None], FRAMES, axis=0), seed) for seed in (0, 5))
    truth = np.concatenate([one, other + np.array([0.5, 0, 0])], axis=1)
    motion = lost(truth, (0, 60, 180), (1, 0, 50), (8, 190, 240), (9, 100, 130))
    missed, found = errors(FILLS["local"], motion, truth)
    assert missed.max() < 2e-6 and set(found.method) == {"local"}
    for row, donors in found.donors.items():
        assert len(donors) == 3 and {donor // 6 for donor in donors} == {found.joint[row] // 6}


def test_regression_finds_a_linear_relation():
    """On a body that turns far, two things move four others and, by another mixture, the marker: centimetres."""
    rng = np.random.default_rng(3)
    things = waves(7, 2)
    swaying = PLACES[:4] * 0.5 + 0.01 * (things @ rng.normal(size=(2, 12))).reshape(FRAMES, 4, 3)
    followed = np.array([0.1, 0.1, 0.1]) + 0.03 * things @ rng.normal(size=(2, 3))
    still = np.repeat(PLACES[None], FRAMES, axis=0)
    truth = carried(np.concatenate([followed[:, None], swaying, still], axis=1))
    motion = lost(truth, (0, 80, 160))
    assert errors(FILLS["local"], motion, truth)[0].mean() > 0.02
    missed, found = errors(FILLS["regression"], motion, truth)
    assert missed.max() < 1e-3 and missed.mean() < 3e-4 and list(found.method) == ["regression"]
    assert errors(FILLS["average"], motion, truth)[0].mean() < 2e-3


def test_regression_is_a_kernel_ridge_by_hand():
    """Donors that only stretch, so that their body stands still: three axes, each by the formula, pair by pair."""
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * [0.3, 0.4, 0.5]
    stretch = 1 + 0.1 * np.repeat(waves(4, 3), 2, axis=1).reshape(FRAMES, 3, 2).transpose(0, 2, 1).reshape(FRAMES, 6)
    known = corners * stretch[..., None]
    own = np.stack([stretch[:, 0] * stretch[:, 1], stretch[:, 2] ** 2, stretch[:, 0]], axis=1) * 0.02
    truth = np.concatenate([own[:, None], known], axis=1)
    motion = lost(truth, (0, 100, 140))
    taught = np.flatnonzero(motion.observed[:, 0])
    apart = np.linalg.norm(truth[taught][:, 1:] - truth[taught][:, :1], axis=-1)
    loose = np.hypot(apart.std(axis=0), 0.05 * apart.mean(axis=0))
    weights = loose**-2 / np.sum(loose**-2)
    seen = truth[:, 1:] - np.einsum("d,fdi->fi", weights, truth[:, 1:])[:, None]
    goal = truth[:, 0] - np.einsum("d,fdi->fi", weights, truth[:, 1:])
    x = (seen * np.sqrt(weights / weights.max())[:, None]).reshape(FRAMES, 18)
    middle = x[taught].mean(axis=0)
    v = np.mean(np.sum((x[taught] - middle) ** 2, axis=1))

    def kernel(one, two):
        return (one - middle) @ (two - middle) / v + np.exp(-np.sum((one - two) ** 2) / (2 * v))

    gram = np.array([[kernel(x[one], x[two]) for two in taught] for one in taught])
    level = goal[taught].mean(axis=0)
    weight = np.linalg.solve(gram + 1e-3 * np.eye(len(taught)), goal[taught] - level)
    inside = np.array([[kernel(x[frame], x[two]) for two in taught] for frame in range(100, 140)])
    answer = inside @ weight + level + np.einsum("d,fdi->fi", weights, truth[100:140, 1:])
    filled = FILLS["regression"].complete(motion).positions[100:140, 0]
    np.testing.assert_allclose(filled, answer, atol=3e-5)
    assert np.abs(filled - truth[100:140, 0]).max() < 5e-4


def test_pca_recovers_a_cloud_of_few_components():
    """Ten markers that three components move; what the middle of the others does is no component."""
    rng = np.random.default_rng(1)
    shape, ways = rng.normal(0, 0.3, (10, 3)), rng.normal(0, 0.1, (3, 10, 3))
    cloud = shape + np.einsum("fk,kmi->fmi", waves(2, 3), ways)
    truth = cloud - cloud[:, 1:].mean(axis=1, keepdims=True) + waves(9, 3)[:, None]
    motion = lost(truth, (0, 90, 190))
    missed, found = errors(FILLS["pca"], motion, truth)
    assert missed.max() < 1e-3 and list(found.method) == ["pca"]
    assert errors(FILLS["eased"], motion, truth)[0].mean() > 0.1


def test_averages_weights_are_scipys_densities():
    sway = 0.01 * waves(3, 18).reshape(FRAMES, 6, 3)
    truth = carried(PLACES + sway)
    motion = lost(truth, (0, 100, 130))
    candidates, near = np.arange(6) > 0, np.array([98, 99, 130, 131])
    one = lesson(motion, 0, 100, 130, near, candidates, 5)
    assert one is not None
    answers = truth[100:130, 0] + np.array([[0.0, 0, 0], [0.004, 0, 0.002], [0, 0.03, 0.02]])[:, None]
    weights = likelihoods(one, answers)
    expected = np.zeros((3, 30))
    seen = np.r_[0:100, 130:FRAMES]
    for place in range(3):
        donor = one.donors[place]
        apart = np.linalg.norm(truth[seen, 0] - truth[seen, donor], axis=-1)
        width = 1.06 * apart.std() * len(seen) ** -0.2 + SURE_SHARE * apart.mean()
        density = gaussian_kde(apart, width / apart.std(ddof=1))
        for model in range(3):
            expected[model] += density.logpdf(np.linalg.norm(answers[model] - truth[100:130, donor], axis=-1))
    expected = np.exp(expected) / np.exp(expected).sum(axis=0)
    np.testing.assert_allclose(weights.sum(axis=0), 1)
    np.testing.assert_allclose(weights, expected, atol=0.06)  # of hundreds of distances a hundred make the density
    assert weights.mean(axis=1).argmax() == 0 and weights[2].mean() < 0.05


# --- gaps as they come ------------------------------------------------------------------------------------


def test_a_gap_with_too_few_donors_here_and_there_is_stitched_and_told():
    """Of six donors some blink all the time and for a while all are lost, too."""
    truth = carried(np.repeat(PLACES[None], FRAMES, axis=0), far=0.05)
    blinks = [(marker, 30 * marker + 20, 30 * marker + 55) for marker in range(1, 6)]
    motion = lost(truth, (0, 40, 200), *blinks, *((marker, 115, 125) for marker in range(6)))
    for name in LEARNED:
        filled, found = FILLS[name].fill(motion)
        row = int(np.flatnonzero(found.joint == 0)[0])
        assert found.method[row] == name and filled.observed.all()
        crossed = int(found.reasons[row].split()[0])
        assert found.reasons[row].startswith(f"{crossed} of its 160 frames by eased") and 10 <= crossed < 100
        missed = np.linalg.norm(filled.positions[:, 0] - truth[:, 0], axis=-1)
        assert np.sum(missed > 0.01) <= crossed
        steps = np.linalg.norm(np.diff(filled.positions[:, 0], axis=0), axis=-1)
        assert steps.max() < 3 * np.linalg.norm(np.diff(truth[:, 0], axis=0), axis=-1).max()


@pytest.mark.parametrize("name", LEARNED)
def test_without_three_others_it_is_eased_and_says_so(name):
    truth = carried(np.repeat(PLACES[None, :3], FRAMES, axis=0))
    motion = lost(truth, (0, 100, 140))
    filled, found = FILLS[name].fill(motion)
    assert list(found.method) == ["eased"] and not found.donors
    assert np.array_equal(filled.positions, FILLS["eased"].complete(motion).positions)
    line = waves(0, 3)[:, None] + np.arange(5)[:, None] * [0.1, 0, 0]  # three on a line have no orientation
    if name != "pca":
        assert list(FILLS[name].fill(lost(line, (0, 100, 140)))[1].method) == ["eased"]


@pytest.mark.parametrize("name", LEARNED)
def test_named_donors_are_the_only_ones(name):
    truth = carried(PLACES + 0.005 * waves(3, 18).reshape(FRAMES, 6, 3))
    motion = lost(truth, (0, 100, 140))
    _, found = replace(FILLS[name], donors=("m2", "m3", "m5")).fill(motion)
    assert set(found.donors[0]) == {2, 3, 5}


@pytest.mark.parametrize("name", LEARNED)
def test_several_gone_at_once_and_an_edge(name):
    places = np.concatenate([PLACES, 1.3 * PLACES])  # pca knows no turns, but small ones
    truth = carried(np.repeat(places[None], FRAMES, axis=0), far=0.05 if name == "pca" else 1.5)
    motion = lost(truth, *((marker, 90, 150) for marker in range(5)), (7, 200, FRAMES), (8, 0, 60))
    missed, found = errors(FILLS[name], motion, truth)
    assert set(found.method) == {name} and missed.mean() < (2e-3 if name == "pca" else 1e-4)


# --- other takes teach ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["regression", "pca", "average"])
def test_frames_of_another_take_teach(name):
    """The marker bends to what another does, which is seen in this take only while it is lost."""
    bend = np.where((CLOCK > 0.9) & (CLOCK < 1.5), 1 - np.cos((CLOCK - 0.9) / 0.6 * 2 * np.pi), 0)
    body = np.repeat(PLACES[None], FRAMES, axis=0)
    body[:, 1] += 0.05 * bend[:, None] * [1, 0, 0]
    body[:, 0] += 0.05 * bend[:, None] * [0, 1, 1]
    truth, other = (carried(body, seed, 0.02 if name == "pca" else 1.5) for seed in (0, 20))
    motion = lost(truth, (0, 90, 150))
    unseen = np.full((7, 6, 3), np.nan)
    alone, taught = (
        errors(fill, motion, truth)[0].mean()
        for fill in (FILLS[name], replace(FILLS[name], teaching=np.concatenate([unseen, other + np.array([0, 1, 0])])))
    )
    assert taught < 0.25 * alone
    nothing = replace(FILLS[name], teaching=unseen).complete(motion)
    assert np.array_equal(nothing.positions, FILLS[name].complete(motion).positions)


# --- properties -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LEARNED)
@given(st.integers(0, 10_000), st.sampled_from([1e-3, 0.0254, 40.0, 1000.0]))
@settings(max_examples=10, derandomize=True, deadline=None)
def test_another_unit_is_the_same_in_that_unit(name, seed, unit):
    """Lost for a while, at an edge and in stretches; the answer, in what the unit is."""
    truth = carried(PLACES + 0.01 * waves(seed, 18).reshape(FRAMES, 6, 3), seed)
    motion = lost(truth, (0, 80, 150), (1, 200, 240), (2, 100, 110))
    scaled = replace(motion, positions=np.float32(unit) * motion.positions)
    one, other = (FILLS[name].complete(some) for some in (motion, scaled))
    assert np.array_equal(one.observed, other.observed)
    np.testing.assert_allclose(other.positions / unit, one.positions, atol=2e-4)


@pytest.mark.parametrize("name", LEARNED)
@given(st.integers(0, 10_000))
@settings(max_examples=10, derandomize=True, deadline=None)
def test_a_take_that_is_turned_and_moved_far_is_answered_there(name, seed):
    truth = carried(PLACES + 0.01 * waves(seed, 18).reshape(FRAMES, 6, 3), seed)
    motion = lost(truth, (0, 80, 150), (1, 200, 240), (2, 100, 110))
    turn, shift = Rotation.random(rng=seed).as_matrix(), np.array([20.0, -5.0, 8.0])
    there = np.float32(motion.positions @ turn.T + shift)
    one, other = (FILLS[name].complete(some) for some in (motion, replace(motion, positions=there)))
    np.testing.assert_allclose(other.positions, one.positions @ turn.T + shift, atol=3e-4)


# --- auto -------------------------------------------------------------------------------------------------


def test_auto_takes_average_for_markers_where_it_is_best():
    places = np.concatenate([PLACES, 1.3 * PLACES, -0.8 * PLACES])
    truth = carried(places + 0.01 * waves(3, 54).reshape(FRAMES, 18, 3))
    motion = lost(truth, (0, 100, 150))
    filled, found = Auto().fill(motion)
    assert list(found.method) == ["average"]
    assert np.array_equal(filled.positions, FILLS["average"].complete(motion).positions)


def test_auto_does_not_believe_average_where_many_are_gone_and_curves_do_better():
    """Markers that go their own ways at a steady pace: what others do says nothing, and curves are exact."""
    rng = np.random.default_rng(0)
    steady = rng.normal(size=(12, 3)) + CLOCK[:, None, None] * rng.normal(size=(12, 3)) * 0.3
    wild = rng.normal(size=(6, 3)) + 0.3 * waves(1, 18).reshape(FRAMES, 6, 3)
    truth = np.concatenate([steady, wild], axis=1)
    motion = lost(truth, *((marker, 100, 140) for marker in range(8)))
    missed, found = errors(Auto(), motion, truth)
    assert missed.max() < 1e-5 and "average" not in found.method


def test_auto_hands_on_what_other_takes_teach():
    places = np.concatenate([PLACES, 1.3 * PLACES, -0.8 * PLACES])
    truth, other = (carried(places + 0.02 * waves(3, 54).reshape(FRAMES, 18, 3), seed) for seed in (0, 20))
    motion = lost(truth, (0, 60, 180))
    alone, taught = (errors(Auto(teaching=frames), motion, truth)[0].mean() for frames in (None, other))
    assert taught < 0.5 * alone
    expected = replace(FILLS["average"], teaching=other).complete(motion).positions
    assert np.array_equal(Auto(teaching=other).complete(motion).positions, expected)
