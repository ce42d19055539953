"""Damage for training and benchmarks: exact counts, distributions within bounds that chance does not cross, seeds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionmend.body.joints import JOINT, LIMBS
from motionmend.damage import corruption
from motionmend.errors import InputError
from motionmend.rotations import apply, from_rotvec, inverse, multiply, to_rotvec

SETTINGS = settings(max_examples=60, derandomize=True, deadline=None)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def within(count: float, trials: int, share: float) -> bool:
    """Whether a binomial count is one that happens: 5 standard deviations."""
    return abs(count - trials * share) <= 5 * np.sqrt(trials * share * (1 - share))


# ── tokens ──────────────────────────────────────────────────────────────────────────────────────────────────────


def test_tokens_have_xmaes_counts():
    masked, displaced = corruption.token_masks((128, 60, 21), rng())
    assert masked.shape == displaced.shape == (128, 60, 21)
    assert (masked.sum((1, 2)) == 1071).all()  # 0.85 * 1260
    assert (displaced.sum((1, 2)) == 63).all()  # 0.05 * 1260
    assert not (masked & displaced).any()


def test_tokens_are_uniform_over_time_and_joints():
    windows = 20_000
    masked, displaced = corruption.token_masks((windows, 4, 5), rng(), masked=0.6, displaced=0.2)
    for mask, share in ((masked, 0.6), (displaced, 0.2)):
        for count in mask.sum(0).ravel():
            assert within(count, windows, share)
    # Two tokens are masked together as often as drawing without putting back makes it: 12/20 * 11/19.
    both = (masked[:, 0, 0] & masked[:, 2, 3]).sum()
    assert within(both, windows, 12 / 20 * 11 / 19)


def test_every_set_of_displaced_tokens_is_as_likely():
    # 2 masked and 1 displaced of 4 tokens: 12 outcomes.
    windows = 24_000
    masked, displaced = corruption.token_masks((windows, 2, 2), rng(1), masked=0.5, displaced=0.25)
    codes = (masked.reshape(windows, 4) + 2 * displaced.reshape(windows, 4)) @ (3 ** np.arange(4))
    outcomes, counts = np.unique(codes, return_counts=True)
    assert len(outcomes) == 12
    assert all(within(count, windows, 1 / 12) for count in counts)


def slow_counts(unobserved: int, tokens: int, masked: float, displaced: float) -> tuple[int, int]:
    """Token by token: the unobserved ones first use up the masked places, then the displaced ones."""
    hidden = moved = 0
    to_hide, to_move = round(masked * tokens), round(displaced * tokens)
    for token in range(tokens):
        if token < unobserved or token < to_hide:
            hidden += 1
        elif token < to_hide + to_move:
            moved += 1
    return hidden, moved


@SETTINGS
@given(
    st.integers(1, 5), st.integers(1, 12), st.integers(1, 8), st.integers(0, 20), st.integers(0, 20),
    st.floats(0, 1), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_counts_are_exact_whatever_is_missing(windows, frames, joints, masked, displaced, missing, seed):
    masked, displaced = masked / 40, displaced / 40
    observed = rng(seed).random((windows, frames, joints)) >= missing
    hidden, moved = corruption.token_masks(
        observed.shape, rng(seed), masked=masked, displaced=displaced, observed=observed
    )
    assert not (hidden & moved).any()
    assert hidden[~observed].all()
    for window in range(windows):
        unobserved = int((~observed[window]).sum())
        want = slow_counts(unobserved, frames * joints, masked, displaced)
        assert (hidden[window].sum(), moved[window].sum()) == want


def test_missing_tokens_leave_the_clean_share_alone():
    observed = np.ones((64, 60, 21), bool)
    observed[:, :, 3] = False
    masked, displaced = corruption.token_masks(observed.shape, rng(), observed=observed)
    clean = ~masked & ~displaced
    assert (clean.sum((1, 2)) == 126).all()
    assert not clean[:, :, 3].any()
    # Those that are observed share the rest evenly.
    assert within(clean[:, :, 0].sum(), 64 * 60, 126 / 1200)


@pytest.mark.parametrize("shares", [(0.9, 0.2), (-0.1, 0.5), (0.5, -0.1)])
def test_impossible_shares_are_refused(shares):
    with pytest.raises(InputError, match="shares of"):
        corruption.token_masks((2, 3, 4), rng(), masked=shares[0], displaced=shares[1])


@pytest.mark.parametrize("shares", [(0, 0), (1, 0), (0, 1), (0.5, 0.5)])
def test_shares_at_the_ends(shares):
    masked, displaced = corruption.token_masks((3, 4, 5), rng(), masked=shares[0], displaced=shares[1])
    assert (masked.sum((1, 2)) == 20 * shares[0]).all() and (displaced.sum((1, 2)) == 20 * shares[1]).all()


# ── offsets ─────────────────────────────────────────────────────────────────────────────────────────────────────


def test_ball_is_uniform():
    points = corruption.ball((40_000,), 2.0, rng())
    assert points.dtype == np.float32
    lengths = np.linalg.norm(points, axis=-1)
    assert lengths.max() <= 2 + 1e-5
    assert within((lengths < 1).sum(), 40_000, 1 / 8)  # the share of the volume
    assert within((lengths < 1.6).sum(), 40_000, 0.8**3)
    # Any half and any cap: a cap of height h on the unit sphere has the share h / 2 of its surface.
    assert within((points[:, 0] > 0).sum(), 40_000, 0.5)
    assert within((points[:, 1] > 0.8 * lengths).sum(), 40_000, 0.1)


def test_constant_offsets_are_half_a_metre_to_one():
    offsets = corruption.constant_offsets(20_000, rng())
    assert offsets.shape == (20_000, 1, 1, 3) and offsets.dtype == np.float32
    lengths = np.linalg.norm(offsets, axis=-1).ravel()
    assert lengths.min() >= 0.5 - 1e-6 and lengths.max() <= 1 + 1e-6
    for bound in (0.6, 0.75, 0.9):  # uniform in length, not in volume
        assert within((lengths < bound).sum(), 20_000, (bound - 0.5) / 0.5)
    assert within((offsets[..., 2].ravel() < -0.8 * lengths).sum(), 20_000, 0.1)


def test_displace_moves_what_the_mask_says_and_nothing_else():
    positions = rng(1).normal(size=(3, 5, 4, 3)).astype(np.float32)
    kept = positions.copy()
    mask = rng(2).random((3, 5, 4)) < 0.4
    few = corruption.ball((int(mask.sum()),), 1.0, rng(3))
    moved, next_offset = corruption.displace(positions, mask, few), iter(few)
    constant = corruption.constant_offsets(3, rng(4))
    shifted = corruption.displace(positions, mask, constant)
    assert moved.dtype == shifted.dtype == np.float32
    for place in np.ndindex(mask.shape):
        if mask[place]:
            np.testing.assert_array_equal(moved[place], kept[place] + next(next_offset))
            np.testing.assert_array_equal(shifted[place], kept[place] + constant[place[0], 0, 0])
        else:
            np.testing.assert_array_equal(moved[place], kept[place])
            np.testing.assert_array_equal(shifted[place], kept[place])
    np.testing.assert_array_equal(positions, kept)


# ── ConvAE's curriculum ─────────────────────────────────────────────────────────────────────────────────────────


def test_curriculum_grows_as_the_paper_says():
    means = [corruption.curriculum_mean(epoch) for epoch in range(200)]
    assert set(means[:14]) == {10} and means[14:19] == [20] * 5 and means[19] == 30
    assert means[63] == 110 and set(means[64:]) == {120}
    lost = [corruption.curriculum_lost(epoch, 200) for epoch in range(200)]
    assert lost[0] == 1 and lost[66] == 1 and lost[67] == 2 and lost[133] == 2 and lost[134] == lost[199] == 3


def ends(gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First frame and length of each row's single gap; the test fails where there are two."""
    edges = np.diff(np.pad(gaps, ((0, 0), (1, 1))).astype(int), axis=1)
    assert ((edges == 1).sum(1) <= 1).all()
    return edges.argmax(1), gaps.sum(1)


def test_gaps_have_the_lengths_of_the_normal_and_lie_anywhere():
    gaps = corruption.curriculum_gaps(20_000, 240, 120, rng())
    starts, lengths = ends(gaps)
    assert abs(lengths.mean() - 120) < 5 * 20 / np.sqrt(20_000)
    assert abs(lengths.std() - 20) < 0.6
    one = lengths == 120
    assert set(np.unique(starts[one])) <= set(range(121)) and len(np.unique(starts[one])) > 90
    early = (starts[one] < 61).sum()
    assert within(early, one.sum(), 61 / 121)


def test_gaps_stay_in_the_window():
    short = corruption.curriculum_gaps(20_000, 240, 10, rng())
    none = (ends(short)[1] == 0).sum()
    assert within(none, 20_000, 0.3173)  # the normal's share below 0.5, that is 0.475 sigma under the mean: 0.3174
    assert corruption.curriculum_gaps(50, 30, 120, rng()).sum(1).max() == 30
    assert corruption.curriculum_gaps(50, 30, 120, rng(), sigma=0).all()


def test_fixed_gaps():
    starts, lengths = ends(corruption.curriculum_gaps(18_100, 240, 60, rng(), sigma=0))
    assert (lengths == 60).all()
    counts = np.bincount(starts, minlength=181)
    assert len(counts) == 181 and all(within(count, 18_100, 1 / 181) for count in counts)


def test_lost_joints():
    lost = corruption.lost_joints(20_000, 22, 3, rng())
    assert (lost.sum(1) == 3).all() and not lost[:, 0].any()
    assert all(within(count, 20_000, 3 / 21) for count in lost[:, 1:].sum(0))
    kept = corruption.lost_joints(100, 5, 9, rng(), never=(1, 4))
    assert (kept == [True, False, True, True, False]).all()


def test_convae_damage_is_one_or_the_other():
    hidden = corruption.convae_damage((4000, 240, 22), 199, 200, rng())
    throughout = hidden.all(1) & ~hidden.all((1, 2))[:, None]
    loses = throughout.any(1)
    assert within(loses.sum(), 4000, 0.3)
    assert (throughout[loses].sum(1) == 3).all() and not throughout[loses, 0].any()
    gaps = hidden[~loses]
    assert (gaps == gaps[:, :, :1]).all()
    assert abs(ends(gaps[:, :, 0])[1].mean() - 120) < 5 * 20 / np.sqrt(2500)


# ── the rest ────────────────────────────────────────────────────────────────────────────────────────────────────


def test_constant_joints():
    kept = corruption.constant_joints(20_000, 17, rng())
    assert kept.shape == (20_000, 17) and kept.dtype == bool
    assert all(within(count, 20_000, 0.15) for count in kept.sum(0))
    assert within((~kept.any(1)).sum(), 20_000, 0.85**17)


@SETTINGS
@given(st.integers(1, 300), st.integers(0, 320))
def test_centred_gaps(frames, length):
    gap = corruption.centred_gap(frames, length)
    start, stop = corruption.centred_span(frames, length)
    assert np.flatnonzero(gap).tolist() == list(range(start, stop))
    assert gap.sum() == min(length, frames)
    if gap.any():
        before, after = gap.argmax(), gap[::-1].argmax()
        assert 0 <= after - before <= 1


def test_the_papers_gaps():
    assert corruption.centred_span(240, 60) == (90, 150)
    assert corruption.centred_span(60, 6) == (27, 33)
    assert corruption.centred_span(60, 54) == (3, 57)


def test_limbs():
    mask = corruption.limb_mask(10, 6, (1, 4), (3, 7))
    assert {(int(t), int(j)) for t, j in np.argwhere(mask)} == {(t, j) for t in range(3, 7) for j in (1, 4)}


def test_dropouts():
    mask = corruption.dropouts((500, 20, 5), 0.3, rng())
    assert within(mask.sum(), mask.size, 0.3)
    assert within((mask[1:] & mask[:-1]).sum(), mask[1:].size, 0.09)
    assert not corruption.dropouts((50, 4), 0.0, rng()).any() and corruption.dropouts((50, 4), 1.0, rng()).all()


def test_position_noise():
    positions = rng(5).normal(size=(50, 60, 7, 3)).astype(np.float32)
    noise = corruption.position_noise(positions, 0.0625, rng()) - positions
    assert noise.dtype == np.float32
    scale = noise.reshape(-1, 3).std(0) / 0.0625
    assert np.abs(scale - 1).max() < 5 / np.sqrt(2 * 21_000)
    assert np.abs(np.corrcoef(noise.reshape(-1, 3).T)[np.triu_indices(3, 1)]).max() < 5 / np.sqrt(21_000)
    np.testing.assert_array_equal(corruption.position_noise(positions, 0.0, rng()), positions)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rotation_noise_composes_turns_of_the_size_asked_for(dtype):
    clean = from_rotvec(rng(6).normal(size=(200, 100, 3))).astype(dtype)
    noisy = corruption.rotation_noise(clean, 0.1, rng())
    assert noisy.dtype == dtype
    assert np.abs(np.linalg.norm(noisy, axis=-1) - 1).max() < 1e-6
    turns = to_rotvec(multiply(inverse(clean), noisy)).reshape(-1, 3)
    assert np.abs(turns.std(0) / 0.1 - 1).max() < 5 / np.sqrt(2 * 20_000)
    assert np.abs(turns.mean(0)).max() < 5 * 0.1 / np.sqrt(20_000)


def test_rotation_noise_added_to_the_vectors():
    vectors = rng(7).uniform(-1, 1, (300, 50, 3))
    noisy = corruption.rotation_noise(from_rotvec(vectors), 0.05, rng(), added=True)
    difference = (to_rotvec(noisy) - vectors).reshape(-1, 3)
    assert np.abs(difference.std(0) / 0.05 - 1).max() < 5 / np.sqrt(2 * 15_000)
    from scipy.spatial.transform import Rotation

    want = Rotation.from_rotvec(vectors.reshape(-1, 3) + difference).apply([0.2, 1.0, -0.3])
    np.testing.assert_allclose(apply(noisy.reshape(-1, 4), np.array([0.2, 1.0, -0.3])), want, atol=1e-9)


DRAWS = {
    "tokens": lambda rng: np.stack(corruption.token_masks((4, 10, 5), rng)),
    "ball": lambda rng: corruption.ball((4, 10), 1.0, rng),
    "offsets": lambda rng: corruption.constant_offsets(4, rng),
    "gaps": lambda rng: corruption.curriculum_gaps(8, 240, 60, rng),
    "lost": lambda rng: corruption.lost_joints(20, 22, 2, rng),
    "convae": lambda rng: corruption.convae_damage((8, 240, 22), 50, 200, rng),
    "joints": lambda rng: corruption.constant_joints(8, 17, rng),
    "dropouts": lambda rng: corruption.dropouts((10, 7), 0.3, rng),
    "positions": lambda rng: corruption.position_noise(np.zeros((4, 5, 3), np.float32), 0.1, rng),
    "rotations": lambda rng: corruption.rotation_noise(np.tile([0.0, 0, 0, 1], (4, 5, 1)), 0.1, rng),
}


@pytest.mark.parametrize("draw", DRAWS.values(), ids=DRAWS)
def test_the_seed_decides(draw):
    np.testing.assert_array_equal(draw(rng(3)), draw(rng(3)))
    assert not np.array_equal(draw(rng(3)), draw(rng(4)))


# ── what happens to real takes ──────────────────────────────────────────────────────────────────────────────────


def test_real_takes_lose_bodies_and_limbs_for_a_while_and_are_displaced():
    positions = rng(5).normal(0, 1, (6000, 60, 21, 3)).astype(np.float32)
    observed = rng(6).random(positions.shape[:3]) > 0.1
    before = positions.copy()
    damaged, hidden, moved = corruption.take_damage(positions, observed, rng(7))
    assert np.array_equal(positions, before)
    assert damaged.dtype == np.float32 and hidden.shape == moved.shape == (6000, 60, 21)
    changed = np.any(damaged != positions, axis=-1) & observed & ~hidden
    assert not (moved & ~observed).any() and not (moved & hidden).any()
    assert not (changed & ~moved).any(), "what is shown wrong is told"
    assert (changed & moved).sum() > 0.999 * moved.sum()
    apart = np.linalg.norm(damaged - positions, axis=-1)[moved]
    assert 0.9 < apart.max() <= 1.3 and np.median(apart) < 0.3
    whole_body = hidden.any(axis=(1, 2)) & (hidden.all(axis=2) == hidden.any(axis=2)).all(axis=1)
    assert within(whole_body.sum(), 6000, 0.35)
    nothing_hidden = ~hidden.any(axis=(1, 2))
    assert within(nothing_hidden.sum(), 6000, 0.18)  # displaced, or noisy
    lengths = hidden.all(axis=2).sum(axis=1)[whole_body]
    assert lengths.min() == 3 and lengths.max() == 56


def test_gaps_alone_show_nothing_that_is_not_true():
    positions = rng(8).normal(0, 1, (500, 60, 21, 3)).astype(np.float32)
    observed = np.ones(positions.shape[:3], bool)
    damaged, hidden, moved = corruption.take_damage(positions, observed, rng(9), only="gaps")
    assert np.array_equal(damaged, positions) and not moved.any()
    assert hidden.any(axis=(1, 2)).mean() > 0.99  # each of some joints may be none


def test_wrong_samples_alone_hide_nothing():
    positions = rng(8).normal(0, 1, (2000, 60, 21, 3)).astype(np.float32)
    observed = np.ones(positions.shape[:3], bool)
    damaged, hidden, moved = corruption.take_damage(positions, observed, rng(9), only="wrong")
    changed = np.any(damaged != positions, axis=-1)
    assert not hidden.any() and not (changed & ~moved).any() and changed.sum() > 0.999 * moved.sum()
    noisy = moved.all(axis=(1, 2))
    assert within(noisy.sum(), 2000, 0.5) and moved.any(axis=(1, 2)).mean() > 0.99
    sigmas = 1.4826 * np.median(np.abs(damaged - positions)[noisy], axis=(1, 2, 3))
    assert 0.08 < sigmas.max() < 0.11 and 0.02 < np.median(sigmas) < 0.03


def test_groups_are_limbs_that_hang_together():
    for group in corruption.GROUPS:
        assert len(set(group)) == len(group) and JOINT["hips"] not in group and JOINT["head"] not in group
    assert set(LIMBS.values()) <= set(corruption.GROUPS)
