"""What is recalled, against formulas by other ways, planted truth, and what must not matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

import motionmend as mm
from motionmend.fills.channels import fill_rig
from motionmend.fills.points import FILLS
from motionmend.memory import neighbours, recalling, regression
from motionmend.memory.channels import mirrored_channels, recall_rig
from motionmend.memory.descriptors import Layout, columns, terms
from motionmend.memory.filling import Recall, told
from motionmend.memory.sessions import joined, remember
from motionmend.motion import Motion
from strollers import as_point_take, as_points, as_rig_take, stroll

ARM = [7]
LEG = [3, 4]
BODY = list(range(9))


def remembered(*seeds, **options):
    return joined(remember(as_points(stroll(seed, **options)), None, f"take {seed}", str(seed)) for seed in seeds)


def hidden(motion: Motion, lost, start, stop, filler=np.nan) -> Motion:
    observed = motion.observed.copy()
    observed[start:stop, lost] = False
    positions = np.where(observed[..., None], motion.positions, np.float32(filler))
    return replace(motion, positions=positions, observed=observed)


def error(filled, truth, lost, start, stop):
    return np.linalg.norm((filled.positions - truth.positions)[start:stop, lost], axis=-1).mean()


# --- the parts, by other ways -----------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [BODY, LEG])
def test_distances_are_those_after_the_best_turn_and_shift(lost):
    """By brute force: windows mirrored by hand, turned by angles that a search finds, and shifted to their middle."""
    (session,) = remembered(1, 2, fps=30.0)
    gap, frames = 12, session.positions[200:228].astype(float)
    lost, seen = np.array(lost), np.setdiff1d(BODY, lost)
    anchors = np.zeros(len(lost), int)
    away = 0 if len(seen) else -1
    layout = Layout(lost, anchors if len(seen) else lost, seen, away, 7, 7, gap + 1)
    found = neighbours.nearest(frames, layout, session.skeleton.names, [session], frozenset())
    assert found is not None and found.start[0] == 200 and found.distance[0] < 1e-4 and not found.mirrored[0]

    def described(window, turn):
        window = Rotation.from_rotvec([0, turn, 0]).apply(window.reshape(-1, 3)).reshape(window.shape)
        made, weights, free = [], [], []
        for term in terms(layout):
            compared = columns(window, layout)[:, term.columns]
            made.append(sum(factor * compared[frame] for frame, factor in zip(term.frames, term.factors)))
            weights += [term.weight] * len(made[-1])
            free += [term.free] * len(made[-1])
        made, weights, free = np.concatenate(made), np.array(weights), np.array(free)
        if free.any():
            made[free] -= np.average(made[free], axis=0, weights=weights[free] ** 2) * [1, 0, 1]
        return made * weights[:, None]

    own = described(frames, 0.0)
    for row in (3, 40, 111, 200):
        window = session.positions[found.start[row] :][: len(frames)].astype(float)
        if found.mirrored[row]:
            window = window[:, [0, 1, 2, 5, 6, 3, 4, 8, 7]] * [-1, 1, 1]
        apart = lambda turn, window=window: np.linalg.norm(described(window, turn) - own)  # noqa: E731
        tries = [minimize_scalar(apart, (middle - 1, middle)).fun for middle in (-2, 0, 2)]
        assert found.distance[row] == pytest.approx(min(tries), rel=1e-5)
    assert np.all(np.diff(found.distance) >= 0) and len(found) == neighbours.NEAREST


def test_weights_are_those_of_a_ridge_regression_in_its_primal_form():
    random = np.random.default_rng(0)
    across, heights = random.normal(size=(30, 5)) + 1j * random.normal(size=(30, 5)), random.normal(size=(30, 5))
    own, distance, values = (across[0] + 0.1, heights[0] - 0.2), random.uniform(1, 4, 30), random.normal(size=(30, 7))
    weights, _ = regression.weights(across, heights, own, distance)
    kernel = np.exp(-0.5 * ((distance - distance.min()) / regression.WIDTH) ** 2)
    kernel /= kernel.sum()
    design = np.concatenate([across.real, across.imag, heights], axis=1)
    middle, mean = kernel @ design, kernel @ values
    slope = np.linalg.solve(
        (design - middle).T @ (kernel[:, None] * (design - middle)) + regression.RIDGE * np.eye(15),
        (design - middle).T @ (kernel[:, None] * (values - mean)),
    )
    expected = mean + (np.concatenate([own[0].real, own[0].imag, own[1]]) - middle) @ slope
    np.testing.assert_allclose(weights @ values, expected, atol=1e-10)
    assert weights.sum() == pytest.approx(1)


def test_belief_is_what_leaving_stretches_out_says():
    """By hand: each stretch predicted by a regression on all the others, with an intercept that is all but free."""
    random = np.random.default_rng(1)
    across, heights = random.normal(size=(24, 3)) + 1j * random.normal(size=(24, 3)), random.normal(size=(24, 3))
    distance, blocks = random.uniform(1, 3, 24), np.arange(24) // 4
    design = np.concatenate([across.real, across.imag, heights], axis=1)
    values = 0.2 * design[:, :2] + random.normal(size=(24, 2))
    _, fitted = regression.weights(across, heights, (across[0], heights[0]), distance)
    kernel = np.exp(-0.5 * ((distance - distance.min()) / regression.WIDTH) ** 2)
    kernel /= kernel.sum()
    features = np.column_stack([np.sqrt(regression.MEAN) * np.ones(24), design - kernel @ design])
    predicted = np.empty_like(values)
    for block in range(6):
        rest = blocks != block
        weighted = features[rest].T * kernel[rest]
        slope = np.linalg.solve(weighted @ features[rest] + regression.RIDGE * np.eye(10), weighted @ values[rest])
        predicted[~rest] = features[~rest] @ slope
    share = np.sum(kernel[:, None] * predicted * values) / np.sum(kernel[:, None] * predicted**2)
    assert 0 < share < 1
    assert regression.believed(fitted, values, blocks) == pytest.approx(share, rel=1e-6)


def test_a_rig_mirrored_moves_as_the_mirror_image_of_its_joints():
    rig = stroll(3, seconds=2.0, heading=0.7)
    session = remember(rig.motion(60.0), rig, "one")
    for axis in (0, 2):
        # The same rig lying along another axis of its rest pose.
        about = Rotation.from_rotvec([0, np.pi / 2 * (axis == 2), 0])
        bones = about.apply(rig.offsets)
        turns = Rotation.from_quat(rig.rotations.reshape(-1, 4))
        turned = (about * turns * about.inv()).as_quat().reshape(rig.rotations.shape)
        turned[:, 0] = (Rotation.from_quat(rig.rotations[:, 0]) * about.inv()).as_quat()
        shifts = np.broadcast_to(bones, rig.translations.shape).copy()
        shifts[:, 0] = rig.translations[:, 0]
        other = replace(rig, rotations=turned, translations=shifts, offsets=bones)
        np.testing.assert_allclose(other.kinematics[0], rig.kinematics[0], atol=1e-9)
        its = replace(session, offsets=bones.astype(np.float32))
        mirrored = mirrored_channels(turned, shifts, its, rig.skeleton.parents)
        moved = replace(other, rotations=mirrored[0], translations=mirrored[1]).kinematics[0]
        expected = rig.kinematics[0][:, [0, 1, 2, 5, 6, 3, 4, 8, 7]] * [-1, 1, 1]
        np.testing.assert_allclose(moved, expected, atol=1e-9)


# --- planted truth ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("lost", "base", "share"), [(BODY, "eased", 0.25), (LEG, "bones", 0.25), (ARM, "bones", 0.25)])
def test_steps_that_are_in_memory_come_back(lost, base, share):
    truth = as_points(stroll(0, heading=2.0))
    broken = hidden(truth, lost, 300, 340)
    filled, gaps = Recall(remembered(1, 2, 3)).fill(broken)
    assert set(gaps.method) == {"recall"} and filled.observed.all()
    assert error(filled, truth, lost, 300, 340) < share * error(FILLS[base].complete(broken), truth, lost, 300, 340)
    assert np.array_equal(filled.positions[broken.observed], truth.positions[broken.observed])
    alone, gaps = Recall().fill(broken)
    assert "itself (100%)" in gaps.reasons[0]
    assert error(alone, truth, lost, 300, 340) < 0.6 * error(FILLS[base].complete(broken), truth, lost, 300, 340)


def test_a_mirror_image_teaches_where_names_have_sides():
    truth = as_points(stroll(0))
    broken = hidden(truth, LEG, 300, 340)
    lame = as_points(stroll(1))
    still = lame.positions.copy()
    still[:, LEG] = np.nan  # the left leg was never captured there: only the right one can teach it
    lame = replace(lame, positions=still, observed=np.isfinite(still[..., 0]))
    answer = recalling.ask(broken, np.array(LEG), 300, 340, [remember(lame, None, "lame")], frozenset())
    assert answer == recalling.TOO_FEW, "what is seen through the gap, and its twin, must be known"
    near = recalling.ask(broken, np.array(LEG), 300, 340, remembered(1), frozenset())
    assert isinstance(near, recalling.Answer) and 0.2 < near.near.mirrored.mean() < 0.8
    plain = replace(truth.skeleton, names=tuple(f"m{joint}" for joint in range(9)))
    unsided = [remember(replace(as_points(stroll(1)), skeleton=plain), None, "plain")]
    near = recalling.ask(replace(broken, skeleton=plain), np.array(LEG), 300, 340, unsided, frozenset())
    assert isinstance(near, recalling.Answer) and not near.near.mirrored.any()


@pytest.mark.parametrize("fps", [24.0, 59.94, 100.0, 120.0])
def test_other_rates_teach_as_well(fps):
    truth = as_points(stroll(0, fps=60.0))
    broken = hidden(truth, BODY, 300, 340)
    others = joined(remember(as_points(stroll(s, fps=fps), fps), None, str(s)) for s in (1, 2))
    filled = Recall(others).complete(broken)
    assert error(filled, truth, BODY, 300, 340) < 0.3 * error(FILLS["eased"].complete(broken), truth, BODY, 300, 340)


@pytest.mark.parametrize(("start", "stop"), [(0, 30), (690, 720)])
def test_a_takes_ends_are_recalled_from_their_only_side(start, stop):
    truth = as_points(stroll(0))
    broken = hidden(truth, BODY, start, stop)
    filled, gaps = Recall(remembered(1, 2, 3)).fill(broken)
    assert set(gaps.method) == {"recall"}
    assert error(filled, truth, BODY, start, stop) < 0.4 * error(
        FILLS["eased"].complete(broken), truth, BODY, start, stop
    )


def test_channels_come_back_twist_included_and_bones_keep_their_lengths():
    rig = stroll(0, heading=1.0)
    for lost in (BODY, LEG, ARM):
        trusted = rig.trusted.copy()
        trusted[300:340, lost] = False
        broken = replace(rig, trusted=trusted, rotations=np.where(trusted[..., None], rig.rotations, np.nan))
        base, _ = fill_rig(broken, 60.0, "eased")
        others = joined(remember(other.motion(60.0), other, str(s)) for s in (1, 2, 3) for other in [stroll(s)])
        filled, gaps = recall_rig(broken, broken.motion(60.0), others)
        assert set(gaps.method) == {"recall"} and filled.trusted.all()
        assert np.array_equal(filled.rotations[trusted], rig.rotations[trusted])
        assert np.array_equal(filled.translations[trusted], rig.translations[trusted])

        truth, *turns = (
            Rotation.from_quat(each.rotations[300:340][:, lost].reshape(-1, 4)) for each in (rig, filled, base)
        )
        recalled, crossed = ((turn.inv() * truth).magnitude().mean() for turn in turns)
        assert recalled < 0.3 * crossed
        places = filled.kinematics[0]
        for joint, parent in enumerate(rig.skeleton.parents):
            if parent >= 0:
                lengths = np.linalg.norm(places[:, joint] - places[:, parent], axis=-1)
                np.testing.assert_allclose(lengths, np.linalg.norm(rig.offsets[joint]), atol=1e-9)


# --- what must not matter ---------------------------------------------------------------------------------


def test_nothing_missing_is_read_and_no_gap_teaches():
    truth = as_points(stroll(0))
    for lost in (BODY, LEG):
        filled = [Recall().complete(hidden(truth, lost, 300, 340, filler)) for filler in (np.nan, 1e9)]
        assert np.array_equal(filled[0].positions, filled[1].positions)


def test_what_is_distrusted_in_other_takes_does_not_teach():
    truth = as_points(stroll(0))
    broken, other = hidden(truth, BODY, 300, 340), as_points(stroll(1))
    wild = other.positions.copy()
    wild[200:400] = 5.0
    seen = np.ones(other.observed.shape, bool)
    seen[200:400] = False
    sane, spoilt = (
        Recall([remember(replace(other, positions=places, observed=seen), None, "other")]).complete(broken)
        for places in (other.positions, wild)
    )
    assert np.array_equal(sane.positions, spoilt.positions)


@pytest.mark.parametrize("as_rig", [False, True])
def test_an_earlier_repair_of_the_same_take_does_not_teach(as_rig):
    """It holds what was once guessed in the very gap."""
    take = as_rig_take(stroll(1, fps=60.0)) if as_rig else as_point_take(as_points(stroll(1, fps=60.0)))
    guessed = mm.repair(take, gaps=[(200, 230)], method="linear")
    alone = mm.repair(take, gaps=[(200, 230)], method="recall")
    taught = mm.repair(take, gaps=[(200, 230)], learn=[guessed])
    assert np.array_equal(alone.motion.positions, taught.motion.positions)


def test_turned_and_moved_in_the_world_is_the_same_there():
    truth, others = as_points(stroll(0)), remembered(1, 2)
    about, away = Rotation.from_rotvec([0, 1.3, 0]), np.array([20.0, 0, -7.0])
    moved = about.apply(truth.positions.reshape(-1, 3)).reshape(truth.positions.shape) + away
    for lost in (BODY, LEG):
        one = Recall(others).complete(hidden(truth, lost, 300, 340)).positions
        other = Recall(others).complete(hidden(replace(truth, positions=moved.astype(np.float32)), lost, 300, 340))
        expected = about.apply(one.reshape(-1, 3).astype(float)).reshape(one.shape) + away
        np.testing.assert_allclose(other.positions, expected, atol=2e-4)


def test_backwards_in_time_and_joints_in_another_order():
    odd = 721 / 60  # seconds: of so many frames the same ones are thinned out backwards
    truth, order = as_points(stroll(0, odd)), np.array([0, 1, 2, 7, 8, 5, 6, 3, 4])
    back = replace(truth, positions=truth.positions[::-1].copy())
    others = [as_points(stroll(seed, odd)) for seed in (1, 2)]
    for lost in (BODY, LEG):
        one = Recall([remember(m, None, "") for m in others]).complete(hidden(truth, lost, 300, 340)).positions
        turned = [remember(replace(m, positions=m.positions[::-1].copy()), None, "") for m in others]
        again = Recall(turned).complete(hidden(back, lost, len(truth) - 340, len(truth) - 300)).positions
        np.testing.assert_allclose(again[::-1], one, atol=2e-4)
        names = tuple(truth.skeleton.names[joint] for joint in order)
        above = np.array(truth.skeleton.parents)[order]
        parents = tuple(int(np.flatnonzero(order == parent)[0]) if parent >= 0 else -1 for parent in above)
        shuffled = Motion(truth.positions[:, order], truth.observed, truth.fps, mm.Skeleton(names, parents))
        its = [int(np.flatnonzero(order == joint)[0]) for joint in lost]
        mixed = Recall([remember(m, None, "") for m in others]).complete(hidden(shuffled, its, 300, 340)).positions
        np.testing.assert_allclose(mixed, one[:, order], atol=2e-4)


def test_the_report_names_the_takes_that_counted():
    class Answer(recalling.Answer):
        def __init__(self, *shares):
            object.__setattr__(self, "shares", shares)

        def sources(self):
            return [(f"t{number}", share) for number, share in enumerate(self.shares)]

    assert told(Answer(1.0)) == "as in t0 (100%)"
    assert told(Answer(0.5, 0.3, 0.1, 0.06, 0.037, 0.003)) == "as in t0 (50%), t1 (30%), t2 (10%) and 2 more"
    assert told(Answer(*[0.001] * 1000)) == "as in t0"
    assert told(recalling.TOO_FEW) == recalling.TOO_FEW


def test_no_pop_at_the_seams():
    truth = as_points(stroll(0))
    filled = Recall(remembered(1, 2)).complete(hidden(truth, BODY, 300, 340)).positions.astype(float)
    bend = np.linalg.norm(np.diff(filled, 2, axis=0), axis=-1).max(axis=1)
    usual = np.linalg.norm(np.diff(truth.positions.astype(float), 2, axis=0), axis=-1).max()
    assert max(bend[297:301].max(), bend[337:341].max()) < 1.5 * usual


def test_what_memory_has_nothing_like_falls_back_and_is_told():
    truth = as_points(stroll(0, seconds=3.0))
    take = as_point_take(hidden(truth, BODY, 60, 110))
    fixed = mm.repair(take, method="recall")
    assert fixed.motion.observed.all()
    assert [(fill.method, fill.why) for fill in fixed.report.fills] == [
        ("eased", "memory has too few stretches like it")
    ]
    plain = mm.repair(take, method="auto")
    assert np.array_equal(fixed.motion.positions, plain.motion.positions)


def test_channels_of_another_rig_do_not_teach():
    rig = stroll(0)
    other = stroll(1)
    leaning = replace(other, offsets=other.offsets[:, [1, 0, 2]])
    trusted = rig.trusted.copy()
    trusted[:60], trusted[100:] = False, False
    trusted[70:90] = False
    take = as_rig_take(rig)
    broken = replace(take, rig=replace(rig, trusted=trusted)).distrust(~trusted)
    fixed = [
        mm.repair(broken, find=False, method="recall", learn=[as_rig_take(each, name="other")]).report
        for each in (other, leaning)
    ]
    methods = [{fill.method for fill in report.fills if (fill.start, fill.stop) == (70, 90)} for report in fixed]
    assert methods[0] == {"recall"} and "recall" not in methods[1]
    assert any("other joints" in note for note in fixed[1].notes)
