"""A network's view of a window: there and back, and the copies of a window that training makes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionmend.body.joints import BODY, JOINT, LIMBS
from motionmend.body.measures import facing
from motionmend.body.standing import STANDING
from motionmend.metrics.positional import bone_lengths
from motionmend.motion import Motion
from motionmend.networks.gap_space import OUTPUTS
from motionmend.networks.spaces import SMOOTHING, SPACES, mirrored, smoother, turned

QUICK = settings(max_examples=40, deadline=None, derandomize=True)


def windows(seed: int, batch: int = 3, frames: int = 6, joints: int = 21, hidden: float = 0.3):
    rng = np.random.default_rng(seed)
    positions = rng.normal([30, 1, -20], 1, (batch, frames, joints, 3)).astype(np.float32)
    observed = rng.random((batch, frames, joints)) >= hidden
    positions[~observed] = np.nan
    return positions, observed


def unpacked(inputs: dict[str, np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """Tokens back in their places, token by token."""
    out = np.zeros((*shape, 3), np.float32)
    for row, (tokens, index, there) in enumerate(zip(inputs["tokens"], inputs["index"], inputs["there"])):
        for token, place, real in zip(tokens, index, there):
            if real:
                out[row, place // shape[2], place % shape[2]] = token
    return out


def a_body() -> np.ndarray:
    """One pose (1, 1, 21, 3) that faces +Z, asymmetric."""
    pose = np.zeros((1, 1, 21, 3), np.float32)
    pose[0, 0, :, 1] = np.arange(21) / 10
    for name, joint in JOINT.items():
        pose[0, 0, joint, 0] = 0.2 if name.startswith("left") else -0.2 if name.startswith("right") else 0
    pose[0, 0, JOINT["left_hand"]] = 0.9, 1.5, 0.4
    return pose


@pytest.mark.parametrize("name", SPACES)
@given(seed=st.integers(0, 1000), frames=st.integers(1, 8), hidden=st.sampled_from([0.0, 0.5, 1.0]))
@QUICK
def test_what_goes_in_comes_back(name, seed, frames, hidden):
    positions, observed = windows(seed, frames=frames, hidden=hidden)
    space = SPACES[name]()
    assert space.name == name
    inputs, known = space.encode(positions, observed)
    kinds = (np.float32, np.bool_, np.int64)
    assert all(np.isfinite(value).all() and value.dtype in kinds for value in inputs.values())
    # What each space calls the answer of a network that changes nothing.
    unchanged = {
        "floor_mean": lambda: inputs["positions"],
        "first_pelvis": lambda: inputs["trajectories"],
        "joint_tokens": lambda: unpacked(inputs, observed.shape),
        "poses_on_curves": lambda: np.zeros_like(inputs["curve"][..., :3]),
        "poses_off_curves": lambda: np.zeros_like(inputs["curve"][..., :3]),
        "poses_off_curves_asked": lambda: np.zeros_like(inputs["curve"][..., :3]),
        "poses_smooth_curves": lambda: inputs["curve"][..., 9:12] / 10,  # a straight line through what is seen
        "body_rows": lambda: inputs["rows"],
        "beside_curves": lambda: np.zeros((*observed.shape[:2], OUTPUTS), np.float32),
        "seen_rows": lambda: inputs["rows"],
    }
    back = space.decode(unchanged[name](), known)
    assert back.shape == positions.shape and back.dtype == np.float32
    assert np.isfinite(back).all()
    np.testing.assert_allclose(back[observed], positions[observed], atol=1e-5)


def test_floor_mean_is_that_of_observed_samples_and_leaves_the_height():
    positions, observed = windows(1, batch=2)
    inputs, _ = SPACES["floor_mean"]().encode(positions, observed)
    for window, seen, made in zip(positions, observed, inputs["positions"]):
        known = [window[t, j].astype(float) for t in range(6) for j in range(21) if seen[t, j]]
        mean = [sum(each[axis] for each in known) / len(known) for axis in range(3)]
        for t in range(6):
            for j in range(21):
                wanted = window[t, j] - [mean[0], 0, mean[2]] if seen[t, j] else np.zeros(3)
                np.testing.assert_allclose(made[t, j], wanted, atol=1e-5)
    assert np.array_equal(inputs["observed"], observed)


def test_floor_mean_forgets_where_on_the_floor():
    positions, observed = windows(2)
    moved = positions + np.array([64, 0, -32], np.float32)
    one, two = (SPACES["floor_mean"]().encode(each, observed)[0]["positions"] for each in (positions, moved))
    np.testing.assert_allclose(one, two, atol=2e-5)


def test_tokens_are_what_is_observed_once_and_in_order():
    positions, observed = windows(3, batch=4)
    observed[1], observed[2] = False, True
    inputs, _ = SPACES["joint_tokens"]().encode(positions, observed)
    assert inputs["tokens"].shape == (4, 6 * 21, 3)
    for row in range(4):
        frames, joints = np.nonzero(observed[row])
        assert inputs["there"][row].sum() == len(frames)
        assert inputs["index"][row, inputs["there"][row]].tolist() == (frames * 21 + joints).tolist()
    few, _ = SPACES["joint_tokens"]().encode(positions[1:2], observed[1:2])
    assert few["tokens"].shape == (1, 1, 3) and not few["there"].any()


@given(turn=st.floats(-3.1, 3.1), seed=st.integers(0, 99))
@QUICK
def test_poses_on_curves_do_not_depend_on_where_the_body_stands_and_faces(turn, seed):
    rng = np.random.default_rng(seed)
    body = np.repeat(a_body(), 8, axis=1) + rng.normal(0, 0.03, (1, 8, 21, 3)).astype(np.float32)
    observed = rng.random((1, 8, 21)) > 0.3
    elsewhere = turned(body, np.array([turn])) + np.array([3, 0, -2], np.float32)
    one, two = (SPACES["poses_on_curves"]().encode(each, observed)[0] for each in (body, elsewhere))
    np.testing.assert_allclose(one["tokens"], two["tokens"], atol=2e-4)
    np.testing.assert_allclose(one["curve"], two["curve"], atol=2e-4)


def test_a_body_that_is_encoded_faces_z():
    body, observed = turned(a_body(), np.array([2.0])), np.ones((1, 1, 21), bool)
    inputs, _ = SPACES["poses_on_curves"]().encode(body, observed)
    where = inputs["curve"][0, ..., :3] / 3 + STANDING
    np.testing.assert_allclose(facing(Motion(where, observed[0], 60, BODY))[0], [0, 0, 1], atol=1e-5)


def test_a_pose_that_is_a_token_says_where_each_joint_is_how_it_moves_and_whether_it_is_seen():
    """A mean body that glides by 10 mm a frame, one arm unseen in the middle."""
    path = np.arange(30)[:, None, None] * np.array([0, 0, 0.01])
    body = (np.add(STANDING, (0, 0.95, 0)) + path)[None].astype(np.float32)
    observed = np.ones((1, 30, 21), bool)
    observed[0, 10:20, LIMBS["left_arm"]] = False
    body[~observed] = np.nan
    every = SPACES["poses_on_curves"]().encode(body, observed)[0]
    few = SPACES["poses_off_curves"]().encode(body, observed)[0]
    told, seen = every["tokens"][0, :, :189].reshape(30, 21, 9), every["tokens"][0, :, 189:]
    assert np.array_equal(seen, observed[0]) and every["there"].all()
    np.testing.assert_allclose(told[..., 3:6], 0, atol=1e-5)  # as the mean stands
    np.testing.assert_allclose(told[..., 6:], np.broadcast_to([0, 0, 10 * 6 * 0.01], (30, 21, 3)), atol=1e-5)
    np.testing.assert_allclose((told - told[:1])[..., 2] / 3, np.broadcast_to(path[..., 2], (30, 21)), atol=1e-5)
    frames = few["index"][few["there"]] // 21
    assert frames.tolist() == [0, 6, 9, 10, 12, 18, 19, 20, 24]  # every tick, and both sides of both seams
    assert np.array_equal(few["tokens"][few["there"]], every["tokens"][0, frames])


def test_an_answer_off_curves_counts_by_the_distance_from_what_is_seen():
    observed = np.ones((1, 30, 21), bool)
    observed[0, 4:24, 5] = False  # 20 frames
    observed[0, 27:, 6] = False  # to the end
    observed[0, :, 7] = False
    positions = np.zeros((1, 30, 21, 3), np.float32)
    space = SPACES["poses_off_curves"]()
    _, known = space.encode(positions, observed)
    moved = space.decode(np.ones_like(positions), known)[0, :, :, 1]
    assert (moved[observed[0]] == 0).all()
    np.testing.assert_allclose(moved[4:24, 5], [min(1, min(d, 21 - d) / 8) ** 2 for d in range(1, 21)], atol=1e-6)
    np.testing.assert_allclose(moved[27:, 6], [1 / 64, 4 / 64, 9 / 64], atol=1e-6)
    assert (moved[:, 7] == 1).all()


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 60])
def test_smoothing_is_whittakers(frames):
    """min |x - y|² + SMOOTHING |third differences of x|², by least squares over both at once."""
    noisy = np.random.default_rng(0).normal(size=(frames, 4))
    bends = np.zeros((0, frames)) if frames < 4 else np.diff(np.eye(frames), n=3, axis=0)
    rows = np.concatenate([np.eye(frames), SMOOTHING**0.5 * bends])
    expected = np.linalg.lstsq(rows, np.concatenate([noisy, np.zeros((len(bends), 4))]), rcond=None)[0]
    assert smoother(frames) @ noisy == pytest.approx(expected, abs=1e-4)


def test_an_answer_of_nothing_from_smooth_curves_takes_noise_away_and_leaves_parabolas():
    clock = np.linspace(0, 1, 60, dtype=np.float32)[None, :, None, None]
    moving = a_body() + clock * [0.5, 0, 1] + clock**2 * [0, 0.1, 0.3]
    moving = moving.astype(np.float32)
    noisy = moving + np.random.default_rng(0).normal(0, 0.02, moving.shape).astype(np.float32)
    space, there = SPACES["poses_smooth_curves"](), np.ones(moving.shape[:3], bool)
    for shown, least, most in ((moving, 0, 1e-5), (noisy, 0.1, 0.45)):
        _, known = space.encode(shown, there)
        left = np.linalg.norm(space.decode(np.zeros_like(shown), known) - moving, axis=-1).mean()
        was = max(1.0 if shown is moving else 0, float(np.linalg.norm(shown - moving, axis=-1).mean()))
        assert least <= left / was <= most


def test_first_pelvis_is_the_origin_in_height_too():
    positions, observed = windows(3, hidden=0.0)
    observed[:, 1:, 4] = False
    inputs, known = SPACES["first_pelvis"]().encode(positions, observed)
    assert not inputs["pose"][:, JOINT["hips"]].any()
    pelvis = positions[:, :1, :1]
    np.testing.assert_array_equal(inputs["pose"], (positions - pelvis)[:, 0])
    wanted = (positions - pelvis)[:, 1:]
    wanted[:, :, 4] = 0
    np.testing.assert_array_equal(inputs["trajectories"], wanted)
    assert np.array_equal(inputs["given"], observed[:, 1:])
    decoded = SPACES["first_pelvis"]().decode(np.zeros((3, 5, 21, 3), np.float32), known)
    np.testing.assert_array_equal(decoded[:, 0], positions[:, 0])
    np.testing.assert_array_equal(decoded[:, 1:], np.broadcast_to(pelvis, (3, 5, 21, 3)))


def test_a_joint_missing_in_the_first_frame_stands_where_the_output_begins():
    positions, observed = windows(4, batch=1, hidden=0.0)
    observed[0, 0, [0, 7]] = False
    positions[0, 0, [0, 7]] = np.nan
    inputs, known = SPACES["first_pelvis"]().encode(positions, observed)
    middle = positions[0, 0][observed[0, 0]].mean(axis=0)
    np.testing.assert_allclose(inputs["pose"][0, 1], positions[0, 0, 1] - middle, atol=1e-5)
    decoded = SPACES["first_pelvis"]().decode(inputs["trajectories"], known)
    np.testing.assert_array_equal(decoded[0, 0, [0, 7]], decoded[0, 1, [0, 7]])


def test_a_quarter_turn_takes_z_to_x():
    axes = np.eye(3, dtype=np.float32)[None]
    np.testing.assert_allclose(turned(axes, np.array([np.pi / 2]))[0], [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-7)


def test_turns_keep_bones_and_heights_and_add_up():
    positions, observed = windows(5)
    angles, more = np.array([0.3, -2.0, 9.0]), np.array([1.0, 0.0, -4.0])
    once = turned(positions, angles)
    assert once.dtype == np.float32
    np.testing.assert_array_equal(once[..., 1], positions[..., 1])
    for before, after in zip(positions, once):
        np.testing.assert_allclose(
            bone_lengths(after, BODY.parents), bone_lengths(before, BODY.parents), atol=2e-5
        )
    np.testing.assert_allclose(turned(once, more), turned(positions, angles + more), atol=2e-5)
    np.testing.assert_array_equal(np.isnan(once).any(axis=-1), ~observed)


def test_a_turned_body_faces_where_it_was_turned_to():
    body = turned(a_body(), np.array([np.pi / 2]))[0]
    faces = facing(Motion(body, np.ones((1, 21), bool), 60, BODY))
    np.testing.assert_allclose(faces, [[1, 0, 0]], atol=1e-6)


def test_a_mirrored_left_hand_is_a_right_hand_on_the_other_side():
    body, observed = a_body(), np.ones((1, 1, 21), bool)
    observed[0, 0, JOINT["left_foot"]] = False
    other, seen = mirrored(body, observed, np.array([True]))
    np.testing.assert_array_equal(other[0, 0, JOINT["right_hand"]], np.float32([-0.9, 1.5, 0.4]))
    assert not seen[0, 0, JOINT["right_foot"]] and seen[0, 0, JOINT["left_foot"]]
    assert other[0, 0, JOINT["left_hand"], 0] > 0  # a left hand is still to the left of a body that faces +Z
    np.testing.assert_allclose(facing(Motion(other[0], seen[0], 60, BODY)), [[0, 0, 1]], atol=1e-6)


def test_mirroring_twice_changes_nothing_and_only_where_asked():
    positions, observed = windows(6)
    which = np.array([True, False, True])
    other, seen = mirrored(positions, observed, which)
    np.testing.assert_array_equal(other[1], positions[1])
    assert not np.array_equal(other[0], positions[0], equal_nan=True)
    again, seen_again = mirrored(other, seen, which)
    np.testing.assert_array_equal(again, positions)
    np.testing.assert_array_equal(seen_again, observed)
    np.testing.assert_array_equal(np.isnan(other).any(axis=-1), ~seen)
    for name in BODY.names:
        side = name.replace("left", "?").replace("right", "left").replace("?", "right")
        before = bone_lengths(positions[0], BODY.parents)[:, JOINT[name]]
        np.testing.assert_allclose(bone_lengths(other[0], BODY.parents)[:, JOINT[side]], before, atol=1e-5)
