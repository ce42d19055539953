"""TrajeVAE's protocol and its nearest neighbours: planted corpora with answers known by hand, slow twins."""

from __future__ import annotations

import numpy as np
import pytest

from motionmend.benchmark import neighbours, trajevae
from motionmend.benchmark.constrained import constrained
from motionmend.benchmark.method import Method
from motionmend.benchmark.methods import find, find_all, of_completer
from motionmend.benchmark.results import TRUTH
from motionmend.body.joints import BODY, JOINT
from motionmend.corpora.corpus import ClipInfo
from motionmend.corpora.writing import write_corpus
from motionmend.errors import InputError
from motionmend.metrics.sampling import bone_stretch
from motionmend.motion import Motion, Skeleton
from walks import walk

SHAPE = np.random.default_rng(3).uniform([-0.5, 0.2, -0.5], [0.5, 1.6, 0.5], (21, 3))
for _name in ("thigh", "upper_arm"):  # so that it faces +z
    SHAPE[JOINT[f"left_{_name}"]], SHAPE[JOINT[f"right_{_name}"]] = (0.2, 1, 0), (-0.2, 1, 0)
SHAPE[0] = 0, 1, 0


def turned(positions, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([x * cos + z * sin, y, z * cos - x * sin], axis=-1)


def lively(frames, seed):
    """Everybody moves in another way."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / 50
    sway = 0.15 * np.sin(2 * np.pi * (rng.uniform(0.3, 1.5, (1, 21, 3)) * t + rng.random((1, 21, 3))))
    return SHAPE + sway + rng.uniform(-1, 1, 3) * [1, 0, 1] * t


def corpus_of(path, *clips, skeleton=BODY, fps=50.0):
    """Clips `(split, positions)` as a corpus."""
    path.mkdir(exist_ok=True)

    def motion(positions):
        positions = np.asarray(positions, np.float32)
        return Motion(positions, np.isfinite(positions).all(axis=-1), fps, skeleton)

    named = [(ClipInfo(f"c{n}", split=split), motion(clip)) for n, (split, clip) in enumerate(clips)]
    return write_corpus(path / "toy.corpus", name="toy", fps=fps, skeleton=skeleton, clips=named)


def asked(positions, given):
    """What a method is told of windows `(B, 101, 21, 3)`: pose, trajectories, given."""
    positions = np.asarray(positions, np.float32)
    mask = np.broadcast_to(trajevae.told(given), positions[:, 1:].shape[:-1]).copy()
    return positions[:, 0], np.where(mask[..., None], positions[:, 1:], np.float32(np.nan)), mask


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    clips = [("train", lively(161, seed)) for seed in range(6)]
    return corpus_of(tmp_path_factory.mktemp("people"), *clips)


@pytest.mark.parametrize("given", [0, 1, 4, 21])
def test_nearest_finds_a_training_window_wherever_it_stands_and_faces(people, given):
    source = np.stack([lively(161, 2)[20:121], lively(161, 4)[60:161], lively(161, 0)[:101]])
    angles = np.array([0.4, -2.9, 3.1])[:, None, None]
    shifted = turned(source, angles) + np.array([[3, 0, -7], [-120, 0, 0.5], [0, 0, 0]])[:, None, None]
    samples = find("nearest", people).sample(*asked(shifted, given), 3, 0)
    assert samples.shape == (3, 3, 100, 21, 3)
    assert samples[:, 0] == pytest.approx(shifted[:, 1:], abs=1e-4)
    assert np.abs(samples[:, 1] - shifted[:, 1:]).max() > 0.05  # the second is another one


def test_height_tells_windows_apart(people):
    """Bodies are turned about the vertical and moved on the floor, never lifted."""
    lifted = lively(161, 2)[None, :101] + [0, 0.4, 0]
    sample = find("nearest", people).sample(*asked(lifted, 0), 1, 0)
    assert np.abs(sample[0, 0, :, :, 1] - lifted[0, 1:, :, 1]).mean() > 0.2


def test_trajectories_decide_between_equal_start_poses(tmp_path):
    still = np.broadcast_to(SHAPE, (101, 21, 3))
    raised = still.copy()
    raised[1:, JOINT["right_foot"]] += [0, 0.3, 0]
    away = still.copy()
    away[1:, JOINT["left_hand"]] += [0, 0.3, 0]
    corpus = corpus_of(tmp_path, ("train", still), ("train", raised), ("train", away))
    nearest = find("nearest", corpus)
    assert nearest.sample(*asked(raised[None], 1), 1, 0)[0, 0] == pytest.approx(raised[1:], abs=1e-5)
    # The left hand is told fourth: until then `away` looks like `still`, the first of its equals.
    assert nearest.sample(*asked(away[None], 3), 1, 0)[0, 0] == pytest.approx(still[1:], abs=1e-5)
    assert nearest.sample(*asked(away[None], 4), 1, 0)[0, 0] == pytest.approx(away[1:], abs=1e-5)


def test_costs_are_what_a_slow_twin_says(people):
    kept = neighbours.Neighbours.of(people, 101)
    assert len(kept) == 6 * 7
    positions = np.stack([lively(101, 20), turned(lively(101, 21), 1.0) + np.array([4, 0, 4])])
    pose, trajectories, given = asked(positions, 3)
    given[1] = np.random.default_rng(0).random(given[1].shape) < 0.2  # any joint, any time
    trajectories = np.where(given[..., None], positions[:, 1:], np.nan).astype(np.float32)
    found = kept.costs(pose, trajectories, given)

    def seen_from_its_start(window):
        start, across = window[0], np.zeros(3)
        for part in ("thigh", "upper_arm"):
            across = across + start[JOINT[f"left_{part}"]] - start[JOINT[f"right_{part}"]]
        forward = np.cross(across, [0, 1, 0])
        return turned(window - window[0, 0] * [1, 0, 1], -np.arctan2(forward[0], forward[2]))

    for window in range(2):
        query = seen_from_its_start(positions[window])
        for row in range(0, len(kept), 5):
            other = seen_from_its_start(people.windows(kept.starts[row : row + 1], 101)[0][0].astype(float))
            apart = ((query - other) ** 2).sum(axis=-1)
            compared = [apart[t, j] for t in range(4, 101, 4) for j in range(21) if given[window, t - 1, j]]
            expected = neighbours.POSE_WEIGHT * apart[0].mean() + np.mean(compared)
            assert found[window, row] == pytest.approx(expected, rel=1e-4)


def test_carried_begins_at_the_given_pose_and_goes_over_to_the_neighbour(tmp_path):
    corpus = corpus_of(tmp_path, ("train", np.broadcast_to(SHAPE, (101, 21, 3))))
    off = np.zeros((21, 3))
    off[JOINT["head"]] = 0.1, 0.2, -0.1
    window = turned(np.broadcast_to(SHAPE + off, (1, 101, 21, 3)), 0.8) + np.array([2, 0, 3])
    sample = find("nearest-carried", corpus).sample(*asked(window, 0), 1, 0)[0, 0]
    weights = np.exp(-np.arange(1, 101) / 50 / neighbours.FADE_SECONDS)
    expected = turned(SHAPE + weights[:, None, None] * off, 0.8) + np.array([2, 0, 3])
    assert sample == pytest.approx(expected, abs=1e-5)


def test_fewer_neighbours_than_samples_come_again(tmp_path):
    corpus = corpus_of(tmp_path, ("train", lively(111, 1)))
    samples = find("nearest", corpus).sample(*asked(lively(101, 1)[None], 1), 5, 0)
    assert np.array_equal(samples[:, 0], samples[:, 2]) and np.array_equal(samples[:, 1], samples[:, 3])


def test_neighbours_come_from_whole_training_windows_only(tmp_path):
    broken = lively(101, 1)
    broken[50, 3] = np.nan
    clips = [("train", broken), ("validation", lively(101, 2)), ("test", lively(101, 3)), ("train", lively(101, 4))]
    corpus = corpus_of(tmp_path, *clips)
    assert neighbours.Neighbours.of(corpus, 101).starts.tolist() == [303]
    with pytest.raises(InputError, match="no whole window"):
        find("nearest", corpus_of(tmp_path / "b", clips[1])).sample(*asked(lively(101, 1)[None], 1), 1, 0)


def test_without_a_training_corpus_nearest_says_so():
    with pytest.raises(InputError, match="no corpus"):
        find("nearest").sample(*asked(lively(101, 1)[None], 1), 1, 0)


@pytest.fixture
def few(monkeypatch):
    """Fewer columns, for speed."""
    monkeypatch.setattr(trajevae, "GIVEN", {50: (0, 2), 1: (0, 2)})


def test_zero_velocity_on_a_walk_is_known_by_hand(tmp_path):
    """One hand swings out evenly while the whole body walks: hips at the origin, the hand alone is off."""
    t = np.arange(101)[:, None]
    walk = SHAPE + 0.02 * t[:, None] * [0, 0, 1]
    walk[:, JOINT["right_hand"]] += 0.01 * t * [1, 0, 0]
    corpus = corpus_of(tmp_path, ("validation", walk))
    cells = trajevae.measure(corpus, "validation", find_all(["zero-velocity"]))
    found = {(c.task, c.setting, c.metric): c.value for c in cells if c.method == "zero-velocity"}
    for count, every in trajevae.GIVEN.items():
        for given in every:
            key = f"K = {count}", f"k = {given}"
            assert found[(*key, "ADE")] == found[(*key, "MMADE")] == pytest.approx(0.01 * 101 / 2, rel=1e-4)
            assert found[(*key, "FDE")] == found[(*key, "MMFDE")] == pytest.approx(1, rel=1e-4)
            assert found[(*key, "bone stretch")] == pytest.approx(0, abs=1e-5)
            assert ((*key, "control error") in found) == (given > 0)
    both_feet = 100 * 0.02 * 101 / 2  # walk on
    assert found["K = 1", "k = 2", "control error"] == pytest.approx(both_feet, rel=1e-4)
    assert found["K = 50", "k = 2", "APD"] == 0 and ("K = 1", "k = 2", "APD") not in found
    # Standing still has no pop here: the truth's velocity is even and the held pose has none after frame 0.
    truth = {(c.setting, c.metric): c.value for c in cells if c.method == TRUTH}
    assert truth["k = 0", "pop after the start pose"] == pytest.approx(0, abs=1e-3)


def test_nearest_scores_zero_where_the_training_corpus_holds_the_windows(tmp_path):
    walk = lively(126, 5)
    corpus = corpus_of(
        tmp_path, ("train", lively(101, 1)), ("train", turned(walk, 2.0)[:101] + np.array([1, 0, 1])),
        ("train", turned(walk, -1.0)[25:]), ("validation", walk),
    )  # fmt: skip
    cells = trajevae.measure(corpus, "validation", find_all(["nearest"], corpus))
    found = {(c.task, c.setting, c.metric): c.value for c in cells if c.method == "nearest"}
    for given in trajevae.GIVEN[1]:
        for metric, within in (("ADE", 1e-3), ("FDE", 1e-3), ("pop after the start pose", 60)):
            assert found["K = 1", f"k = {given}", metric] < within
        if given:
            assert found["K = 1", f"k = {given}", "control error"] < 0.01


def test_methods_are_told_what_is_given_and_nothing_else(tmp_path):
    corpus = corpus_of(tmp_path, ("validation", lively(160, 1)), ("validation", lively(101, 2)))
    told = []

    def sample(pose, trajectories, given, count, seed):
        assert np.isnan(trajectories[~given]).all() and np.isfinite(trajectories[given]).all()
        names = {BODY.names[joint] for joint in np.flatnonzero(given.any(axis=(0, 1)))}
        assert (given == given[:1, :1]).all() and names == set(trajevae.ORDER[: len(names)])
        told.append((len(pose), len(names), count, seed))
        return np.broadcast_to(pose[:, None, None], (len(pose), count, *trajectories.shape[1:]))

    trajevae.measure(corpus, "validation", [Method("spy", sample=sample)], seed=5)
    assert [(windows, given, count) for windows, given, count, _ in told] == [
        (4, given, count) for count, every in trajevae.GIVEN.items() for given in every
    ]
    assert len({seed for *_, seed in told}) == len(told)
    assert set(trajevae.ORDER) == set(BODY.names) and len(trajevae.ORDER) == 21


def test_samples_of_the_wrong_shape_are_refused(tmp_path):
    corpus = corpus_of(tmp_path, ("validation", lively(101, 1)))
    wrong = Method("wrong", sample=lambda *asked: np.zeros((1, asked[3], 99, 21, 3)))
    with pytest.raises(ValueError, match="wrong gave samples"):
        trajevae.measure(corpus, "validation", [wrong])


def noisy(pose, trajectories, given, count, seed):
    """Diverse samples: the start pose and a random walk."""
    batch, frames, joints, _ = trajectories.shape
    steps = np.random.default_rng(seed).normal(0, 0.01, (batch, count, frames, joints, 3))
    return pose[:, None, None] + np.cumsum(steps, axis=2)


def test_more_samples_do_not_err_more_and_the_same_call_gives_the_same_cells(tmp_path, few):
    corpus = corpus_of(tmp_path, *(("validation", lively(126, seed)) for seed in range(2)))
    drunk = Method("drunk", sample=noisy)
    cells = trajevae.measure(corpus, "validation", [drunk], limit=3)
    found = {(c.task, c.setting, c.metric): c.value for c in cells if c.method == "drunk"}
    for given in (0, 2):
        assert found["K = 50", f"k = {given}", "ADE"] < found["K = 1", f"k = {given}", "ADE"]
        assert found["K = 50", f"k = {given}", "APD"] > 0.1
    assert repr(cells) == repr(trajevae.measure(corpus, "validation", [drunk], limit=3))
    assert repr(cells) != repr(trajevae.measure(corpus, "validation", [drunk], limit=3, seed=1))


def test_a_guess_repeated_scores_as_if_it_were_many(tmp_path, few):
    corpus = corpus_of(tmp_path, ("validation", lively(126, 3)))
    one = noisy(np.zeros((2, 21, 3)), np.zeros((2, 100, 21, 3)), None, 1, 0)
    almost = np.zeros((1, 50, 1, 1, 1))
    almost[0, 1] = 1e-9

    def same(pose, trajectories, given, count, seed):
        return np.repeat(pose[:, None, None] + one, count, axis=1)

    def other(pose, trajectories, given, count, seed):
        return same(pose, trajectories, given, count, seed) + almost[:, :count]

    cells = trajevae.measure(corpus, "validation", [Method("same", sample=same), Method("other", sample=other)])
    by = {(c.method, c.task, c.setting, c.metric): c.value for c in cells}
    for (name, *key), value in by.items():
        if name == "same":
            assert by["other", *key] == pytest.approx(value, rel=1e-6, abs=1e-6)


def test_quick_is_by_ade(tmp_path, few):
    corpus = corpus_of(tmp_path, ("validation", lively(151, 3)))
    found = trajevae.quick(Method("drunk", sample=noisy), corpus, "validation", windows=2)
    assert next(iter(found)) == "ADE" and 0 < found["ADE"] < found["ADE, K = 1"]


def test_what_cannot_be_measured_is_said(tmp_path):
    short = corpus_of(tmp_path, ("validation", lively(100, 1)))
    with pytest.raises(InputError, match="no whole window of 101 frames"):
        trajevae.measure(short, "validation", [])
    other = corpus_of(tmp_path / "b", ("train", np.zeros((101, 2, 3))), skeleton=Skeleton(("hips", "head"), (-1, 0)))
    with pytest.raises(InputError, match="not BODY's"):
        trajevae.starts(other, "train")
    with pytest.raises(InputError, match="not BODY's"):
        neighbours.Neighbours.of(other, 101)


def test_paths_are_exchanged_between_windows_that_begin_alike():
    still = np.broadcast_to(SHAPE, (101, 21, 3))
    rising = still + np.linspace(0, 1, 101)[:, None, None] * [0.2, 0.3, 0.5]
    off = still.copy()
    off[:, JOINT["right_foot"]] += [0, 0.02, 0]  # farther than REACH where the right foot is given
    truths = np.stack([still, turned(rising, 0.7) + np.array([3, 0, -2]), off]).astype(np.float32)
    mixed = trajevae.exchanged(truths, 1)
    assert len(mixed) == 2
    assert mixed[0] == pytest.approx(rising, abs=1e-5)  # the first pose, and the second's future as seen from there
    assert mixed[1, 1:] == pytest.approx(np.broadcast_to(truths[1, 0], (100, 21, 3)), abs=1e-5)


def test_other_paths_are_a_task_of_their_own(tmp_path):
    walking = lively(126, 1)
    corpus = corpus_of(tmp_path, ("test", walking), ("test", turned(walking, 1.0) + np.array([5, 0, 0])))
    found = {}
    for cell in trajevae.measure(corpus, "test", find_all(["zero-velocity"]), limit=2):
        if cell.task.startswith("other paths"):
            found[cell.setting, cell.metric] = cell.value
    assert {setting for setting, _ in found} == {f"k = {given}, 2 pairs" for given in (1, 2, 3, 4)}
    assert found["k = 1, 2 pairs", "ADE"] > 0 and found["k = 1, 2 pairs", "APD"] == 0


def test_constraints_keep_bones_and_meet_paths():
    truth = walk(50.0).positions[None, :101].astype(np.float32)
    rng = np.random.default_rng(0)

    def stretched(pose, trajectories, given, count, seed):
        sway = 0.05 * np.sin(np.arange(100)[:, None, None] / 15 + rng.uniform(0, 6, (count, 1, 21, 3)))
        return (truth[:, None, 1:] * [1, 1.03, 1] + sway).astype(np.float32)

    raw = Method("raw", sample=stretched)
    assert raw.can_sample(10**6) and constrained(raw).can_sample(1000) and not constrained(raw).can_sample(2000)
    samples = constrained(raw).sample(*asked(truth, 4), 2, 0)
    loose = stretched(*asked(truth, 4), 2, 0)
    before, after = (bone_stretch(each, truth[0, 0], BODY.parents)[1] for each in (loose, samples))
    assert before > 5 and after < 0.1
    paths = trajevae.told(4)
    assert np.linalg.norm(samples[:, :, :, paths] - truth[:, None, 1:, paths], axis=-1).max() < 0.005


def test_a_method_that_cannot_sample_cannot_be_constrained():
    with pytest.raises(InputError, match="does not sample"):
        find("linear+constraints")


def test_a_network_with_one_answer_gives_it_for_every_sample():
    torch = pytest.importorskip("torch")
    from motionmend.networks.loading import module_completer
    from motionmend.networks.models.infilling import Infilling, InfillingConfig

    torch.manual_seed(0)
    network = Infilling(InfillingConfig(channels=(4, 6, 8, 8, 8), begin="curve"), 21).eval()
    truth = walk(50.0).positions[None, :101].astype(np.float32)
    samples = of_completer("one", module_completer(network)).sample(*asked(truth, 4), 3, 0)
    assert samples.shape == (1, 3, 100, 21, 3) and np.isfinite(samples).all()
    assert (samples == samples[:, :1]).all()


def test_infilling_trains_on_a_pose_and_whole_paths():
    pytest.importorskip("torch")
    from motionmend.networks.models.infilling import Infilling, InfillingConfig

    network = Infilling(InfillingConfig(channels=(4, 6, 8, 8, 8)), 21)
    truth = walk(50.0).positions[None, :101].astype(np.float32).repeat(40, axis=0)
    hidden = network._hidden(truth, np.ones(truth.shape[:3], bool), np.random.default_rng(0), 0)
    assert not hidden[:, 0].any() and (hidden[:, 1:] == hidden[:, 1:2]).all()
    assert 0.8 < hidden[:, 1].mean() < 0.9


@pytest.mark.parametrize("name", ["trajevae", "cvae-rnn"])
def test_one_guess_is_the_priors_mean_decoded_and_several_are_drawn(name):
    """Table 3 of the paper: K = 1 is no sample."""
    torch = pytest.importorskip("torch")
    from motionmend.networks.loading import module_completer
    from motionmend.networks.models import network_class

    kind = network_class(name)
    torch.manual_seed(0)
    network = kind(kind.Config(**kind.TRIALS[""]), 21)
    completer = module_completer(network)
    truth = np.stack([lively(101, 30), lively(101, 31)]).astype(np.float32)
    pose, paths, given = asked(truth, 2)
    inputs, known = completer.space.encode(truth, np.concatenate([np.ones_like(given[:, :1]), given], axis=1))
    tensors = {key: torch.from_numpy(np.ascontiguousarray(each)) for key, each in inputs.items()}
    with torch.inference_mode():
        mean = network.eval()(**tensors, noise=torch.zeros(2, network.noise_size)).numpy()
    mean = completer.space.decode(mean, known)[:, 1:]
    method = of_completer(name, completer)
    for row in (method, constrained(method)):
        one, again = (row.sample(pose, paths, given, 1, seed) for seed in (0, 1))
        assert np.array_equal(one, again)
    np.testing.assert_allclose(method.sample(pose, paths, given, 1, 0)[:, 0], mean, atol=1e-5)
    drawn = method.sample(pose, paths, given, 2, 0)
    assert np.abs(drawn[:, 0] - drawn[:, 1]).max() > 1e-4 < np.abs(drawn - mean[:, None]).max()
