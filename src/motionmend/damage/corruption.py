"""Damage made on purpose, as masks and arrays: to train networks and to measure every method on the same ground.

Whole batches at a time, `(windows, frames, joints)`, without a loop over the windows; whatever is drawn comes from
the generator that is given, and the same generator draws the same. Positions are metres, `(..., 3)`. `planting` puts
such damage into a Take.

Papers: ConvAE is Kaufmann et al. 2020, XMAE Björkstrand et al. 2023, TrajeVAE Kania et al. 2021.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..body.joints import JOINT
from ..errors import InputError
from ..rotations import from_rotvec, multiply, normalised, to_rotvec

Array = np.ndarray

_ARM, _LEG = ("upper_arm", "forearm", "hand"), ("thigh", "shin", "foot", "toe")

Stretch = tuple[Sequence[int], int, int]  # joint indices, start, stop


def token_masks(
    shape: tuple[int, int, int],
    rng: np.random.Generator,
    *,
    masked: float = 0.85,
    displaced: float = 0.05,
    observed: Array | None = None,
) -> tuple[Array, Array]:
    """Which tokens (one joint in one frame) XMAE masks and which it displaces, uniform over a window's tokens.

    Parameters
    ----------
    shape : (windows, frames, joints); a window has n = frames * joints tokens.
    masked, displaced : shares of n. `round(masked * n)` and `round(displaced * n)` tokens are drawn in each
        window, all different ones.
    observed : `shape` bool. A token that is unobserved anyway counts as masked, and as one of the first to be
        drawn. So the counts above hold in every window that lacks no more than `round(masked * n)` tokens; one
        that lacks more has only those masked, and fewer displaced, so that whatever is possible of the clean
        share stays clean. Mask the loss with `observed` too: nobody knows the truth there.

    Returns
    -------
    masked and displaced, `shape` bool, disjoint. Raises InputError for shares that are negative or above 1 together.

    Source: XMAE, section 3.1 and 4.1.
    """
    if min(masked, displaced) < 0 or masked + displaced > 1:
        found = f"shares of {masked:g} masked and {displaced:g} displaced tokens"
        raise InputError(found, expected="none below 0, and at most 1 together")
    windows, tokens = shape[0], shape[1] * shape[2]
    hidden = round(masked * tokens)
    moved = min(round(displaced * tokens), tokens - hidden)
    keys = rng.random((windows, tokens), np.float32)
    if observed is not None:
        keys[~observed.reshape(windows, tokens)] = -1
    # The tokens with the smallest keys. Counting by place, not by a threshold, keeps the counts exact in a tie.
    shown = _order(keys, hidden)[:, hidden:]
    chosen = np.take_along_axis(shown, _order(np.take_along_axis(keys, shown, axis=1), moved)[:, :moved], axis=1)
    is_masked, is_displaced = np.ones((windows, tokens), bool), np.zeros((windows, tokens), bool)
    np.put_along_axis(is_masked, shown, False, axis=1)
    np.put_along_axis(is_displaced, chosen, True, axis=1)
    is_masked, is_displaced = is_masked.reshape(shape), is_displaced.reshape(shape)
    return (is_masked, is_displaced) if observed is None else (is_masked | ~observed, is_displaced & observed)


def _order(keys: Array, count: int) -> Array:
    """An order of each row's entries with those of the `count` smallest keys first."""
    if not 0 < count < keys.shape[1]:
        return np.broadcast_to(np.arange(keys.shape[1]), keys.shape)
    return np.argpartition(keys, count - 1, axis=1)


def directions(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """`(*shape, 3)` float32 unit vectors, uniform over the sphere."""
    return normalised(rng.standard_normal((*shape, 3), np.float32))


def ball(shape: tuple[int, ...], radius: float, rng: np.random.Generator) -> Array:
    """`(*shape, 3)` float32 offsets, uniform in a ball of `radius` (XMAE, section 3.1)."""
    # The volume within r grows as r³.
    lengths = radius * np.cbrt(rng.random(shape, np.float32))
    return directions(shape, rng) * lengths.astype(np.float32)[..., None]


def constant_offsets(windows: int, rng: np.random.Generator, *, shortest: float = 0.5, longest: float = 1.0) -> Array:
    """`(windows, 1, 1, 3)` float32: one offset a window, of any direction, its length uniform in metres.

    Source: XMAE's task of a constantly displaced arm, section 4.1.
    """
    lengths = rng.uniform(shortest, longest, (windows, 1)).astype(np.float32)
    return (directions((windows,), rng) * lengths)[:, None, None]


def displace(positions: Array, mask: Array, offsets: Array) -> Array:
    """A copy of `positions (..., 3)` with those where `mask (...)` is True shifted.

    offsets : `(mask.sum(), 3)`, one for each True in order, which is the cheaper way when they are few; or one with
        the axes of `positions` that broadcasts to it, such as `constant_offsets`.
    """
    moved = positions.copy()
    moved[mask] += offsets if offsets.ndim == 2 < positions.ndim else np.broadcast_to(offsets, positions.shape)[mask]
    return moved


def curriculum_mean(
    epoch: int, *, first: float = 10, last: float = 120, step: float = 10, every: int = 5, start: int = 10
) -> float:
    """The mean length in frames of ConvAE's training gaps in an epoch, counted from 0.

    `first` before `start`; from then on `every` epochs make `step` frames more (so epoch 14 is the first with 20, and
    64 the first with 120), up to `last`. Source: section 3.3; the epoch of the start from the authors' code.
    """
    return min(last, first + step * max(0, (epoch - start + 1) // every))


def curriculum_lost(epoch: int, epochs: int, *, most: int = 3) -> int:
    """How many joints ConvAE's training takes in an epoch, counted from 0: one more with each third of `epochs`."""
    return min(most, 1 + most * epoch // max(epochs, 1))


def curriculum_gaps(windows: int, frames: int, mean: float, rng: np.random.Generator, sigma: float = 20) -> Array:
    """`(windows, frames)` bool, True in one gap a window; where it lies is uniform over what fits.

    Its length is N(mean, sigma²) rounded, within 0 to `frames`: at the start of the curriculum a third of the gaps are
    none. A mean of 60 with sigma 0 is the variant of fixed gaps. Source: ConvAE, section 3.3; sigma from the authors'
    code.
    """
    lengths = np.clip(np.rint(rng.normal(mean, sigma, windows)), 0, frames).astype(int)
    starts = rng.integers(0, frames - lengths, endpoint=True)
    time = np.arange(frames)
    return (time >= starts[:, None]) & (time < (starts + lengths)[:, None])


def lost_joints(windows: int, joints: int, count: int, rng: np.random.Generator, never: Sequence[int] = (0,)) -> Array:
    """`(windows, joints)` bool, True for the `count` joints that a window loses for all its time; `never` are kept."""
    free = np.setdiff1d(np.arange(joints), never)
    count = min(count, len(free))
    chosen = free[_order(rng.random((windows, len(free)), np.float32), count)[:, :count]]
    lost = np.zeros((windows, joints), bool)
    np.put_along_axis(lost, chosen, True, axis=1)
    return lost


def convae_damage(
    shape: tuple[int, int, int],
    epoch: int,
    epochs: int,
    rng: np.random.Generator,
    *,
    lose: float = 0.3,
    sigma: float = 20,
    never: Sequence[int] = (0,),
) -> Array:
    """`(windows, frames, joints)` bool, True = hidden: what ConvAE's training hides in an epoch, counted from 0.

    Each window, with probability `lose`, misses `curriculum_lost` joints throughout; else every joint through a gap of
    `curriculum_gaps`. (The authors draw which of both once a batch, which asks the same of the network on average.)
    """
    windows, frames, joints = shape
    gaps = curriculum_gaps(windows, frames, curriculum_mean(epoch), rng, sigma)
    lost = lost_joints(windows, joints, curriculum_lost(epoch, epochs), rng, never)
    loses = rng.random(windows) < lose
    return np.where(loses[:, None, None], lost[:, None, :], gaps[:, :, None])


def constant_joints(windows: int, joints: int, rng: np.random.Generator, keep: float = 0.15) -> Array:
    """`(windows, joints)` bool, True for the joints whose trajectory is given; each with probability `keep`.

    On its own, so a window may be given none. Source: TrajeVAE, section 4, where p_m = 0.85 is to be masked.
    """
    return rng.random((windows, joints), np.float32) < keep


def centred_span(frames: int, length: int) -> tuple[int, int]:
    """`(start, stop)` of `length` frames in the middle; an odd frame that is left over comes after them."""
    start = max(0, (frames - length) // 2)
    return start, min(frames, start + length)


def centred_gap(frames: int, length: int) -> Array:
    """`(frames,)` bool, True in the middle `length` frames."""
    start, stop = centred_span(frames, length)
    time = np.arange(frames)
    return (time >= start) & (time < stop)


def limb_mask(frames: int, joints: int, limb: Sequence[int], span: tuple[int, int]) -> Array:
    """`(frames, joints)` bool, True for the joints in `limb` in the frames `[start, stop)` of `span`."""
    return stretches_mask(frames, joints, [(limb, *span)])


def stretches_mask(frames: int, joints: int, stretches: Sequence[Stretch]) -> Array:
    """`(frames, joints)` bool, True in each stretch `(joint indices, start, stop)`."""
    mask = np.zeros((frames, joints), bool)
    for which, start, stop in stretches:
        mask[start:stop, list(which)] = True
    return mask


def dropouts(shape: tuple[int, ...], share: float, rng: np.random.Generator) -> Array:
    """`shape` bool, each entry True with probability `share`, on its own."""
    return rng.random(shape, np.float32) < share


def position_noise(positions: Array, sigma: float, rng: np.random.Generator) -> Array:
    """`positions` plus Gaussian noise of standard deviation `sigma` metres in each axis, in their dtype."""
    noise = rng.standard_normal(positions.shape, np.float32)
    return positions + noise.astype(positions.dtype) * positions.dtype.type(sigma)


def rotation_noise(rotations: Array, sigma: float, rng: np.random.Generator, *, added: bool = False) -> Array:
    """Rotations `(..., 4)` xyzw with Gaussian noise of `sigma` radians in each component of a rotation vector.

    added : False composes a small turn with each rotation, of one distribution whatever the rotation. True adds the
        noise to the rotation's own vector of axis times angle, which is what XMAE's Table 4 does to SMPL's numbers.
    """
    noise = (sigma * rng.standard_normal((*rotations.shape[:-1], 3), np.float32)).astype(rotations.dtype)
    if added:
        return from_rotvec(to_rotvec(rotations) + noise).astype(rotations.dtype)
    return multiply(rotations, from_rotvec(noise)).astype(rotations.dtype)


GROUPS = tuple(
    tuple(JOINT[f"{side}_{part}"] for side in sides for part in parts)
    for parts, sides in (
        *((limb, (side,)) for limb in (_ARM, _LEG) for side in ("left", "right") for _ in range(3)),
        *((limb, (side,)) for limb in (_ARM[1:], _LEG[1:]) for side in ("left", "right")),
        (_ARM, ("left", "right")), (_LEG, ("left", "right")),
        (("shoulder", *_ARM), ("left",)), (("shoulder", *_ARM), ("right",)),
        (("shoulder", *_ARM, *_LEG), ("left",)), (("shoulder", *_ARM, *_LEG), ("right",)),
    )
)  # fmt: skip


def take_damage(
    positions: Array, observed: Array, rng: np.random.Generator, *, only: str = ""
) -> tuple[Array, Array, Array]:
    """What happens to real takes, one kind a window: what XMAE's uniform masks are too mild and too even to teach.

    A gap of the whole body (35 %); of one of GROUPS, at times for the whole window (29 %); 50 to 95 % of all samples
    gone one by one (10 %); a gap of its own for each of some joints (8 %); one of GROUPS displaced by one offset of up
    to a metre for a while (10 %); Gaussian noise of up to 60 mm on everything (8 %). In one window of six, 5 % of what
    is left are displaced besides, as XMAE does. With `only="gaps"` nothing is shown that is not true; with
    `only="wrong"` nothing is hidden, half of the windows have one of GROUPS displaced and half have noise, mostly
    little, of up to 100 mm.

    Parameters
    ----------
    positions : `(B, T, J, 3)` float32 metres of BODY's joints; observed : `(B, T, J)` bool.

    Returns
    -------
    positions, damaged; `(B, T, J)` hidden; `(B, T, J)` moved, True where a sample is shown that is not the truth.
    """
    windows, frames, joints = observed.shape
    chance = rng.random(windows) * (0.82 if only == "gaps" else 1)
    if only == "wrong":
        chance = np.where(chance < 0.5, 0.9, 0.99)  # of the kinds that are not gaps
    kind = np.searchsorted(np.cumsum([0.35, 0.29, 0.10, 0.08, 0.10]), chance, side="right")
    clock = np.arange(frames)[:, None]
    members = np.zeros((len(GROUPS), joints), bool)
    for row, group in enumerate(GROUPS):
        members[row, list(group)] = True
    chosen = members[rng.integers(len(GROUPS), size=windows)]
    some = rng.random((windows, joints)) < 0.3
    who = np.select([kind[:, None] == 0, kind[:, None] == 3], [np.ones((windows, joints), bool), some], chosen)
    # One span for all joints, but one each where each has its own gap. Half of them in the middle, as tests have them.
    own = (kind == 3)[:, None]
    uniform = np.where(own, rng.random((3, windows, joints)), rng.random((3, windows, 1)))
    longest = np.where(kind == 0, frames - 4, frames)[:, None]
    length = 3 + np.floor(uniform[0] * (longest - 2))
    length = np.where((kind[:, None] != 0) & (uniform[2] > 0.9), frames, length)
    room = frames - length
    start = np.where(uniform[2] < 0.5, np.round(room * (0.45 + 0.1 * uniform[1])), np.floor(uniform[1] * (room + 1)))
    inside = (clock >= start[:, None]) & (clock < (start + length)[:, None]) & who[:, None]
    share = rng.uniform(0.5, 0.95, (windows, 1, 1))
    scattered = rng.random(observed.shape, np.float32) < share
    hidden = np.select([(kind < 2)[:, None, None] | own[:, None], kind[:, None, None] == 2], [inside, scattered], False)

    if only == "gaps":
        return positions, hidden, np.zeros_like(hidden)
    moved = inside & (kind == 4)[:, None, None]
    odd = (rng.random((windows, 1, 1)) < 1 / 6) & (rng.random(observed.shape, np.float32) < 0.05)
    offsets = np.where(moved[..., None], constant_offsets(windows, rng, shortest=0.05), 0)
    offsets = np.where((odd & ~moved)[..., None], ball(observed.shape, 1.0, rng), offsets)
    noisy = (kind == 5)[:, None, None]
    sigma = 0.1 * rng.random((windows, 1, 1)) ** 2 if only == "wrong" else rng.uniform(0, 0.06, (windows, 1, 1))
    sigma = np.where(noisy, sigma, 0)[..., None].astype(np.float32)
    noise = sigma * rng.standard_normal(positions.shape, np.float32)
    shown = observed & ~hidden
    return positions + offsets.astype(np.float32) + noise, hidden, shown & (moved | odd | noisy)
