"""The protocol of gaps: shares of what a classical fill misses, on bodies whose paths are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionmend import InputError
from motionmend.benchmark import gaps, quick
from motionmend.benchmark.method import Method
from motionmend.benchmark.methods import find
from motionmend.body.joints import BODY, JOINT
from motionmend.corpora.corpus import ClipInfo, Corpus
from motionmend.corpora.writing import write_corpus
from motionmend.motion import Motion
from motionmend.networks.checkpoints import Description
from motionmend.networks.completers import NetworkCompleter


def swaying(frames: int) -> np.ndarray:
    """All joints on the same circle, each about a place of its own."""
    time = np.arange(frames)[:, None, None] / 30
    places = np.random.default_rng(0).uniform((-0.5, 0.5, -0.5), (0.5, 1.5, 0.5), (len(BODY), 3))
    return (places + 0.2 * np.concatenate([np.sin(6 * time), 0 * time, np.cos(6 * time)], axis=-1)).astype(np.float32)


@pytest.fixture
def corpus(tmp_path) -> Corpus:
    motion = Motion(swaying(300), np.ones((300, len(BODY)), bool), 30.0, BODY)
    clips = [(ClipInfo(split, split=split), motion) for split in ("validation", "test")]
    return write_corpus(tmp_path / "toy.corpus", name="toy", fps=30.0, skeleton=BODY, clips=clips)


def off_by(metres: float) -> Method:
    """It knows the truth, and lifts all that is missing but the hips."""
    truth = swaying(300)

    def fill(positions, observed, fps, skeleton):
        out = positions.copy()
        for row, (window, seen) in enumerate(zip(positions, observed)):
            frame = int(np.flatnonzero(seen.all(axis=1))[0])
            start = int(np.abs(truth - window[frame]).sum(axis=(1, 2)).argmin()) - frame
            out[row] = np.where(seen[..., None], window, truth[start : start + len(window)])
            out[row, :, 1:, 1] += np.where(seen[:, 1:], 0, np.float32(metres))
        return out

    return Method("known", fill)


def cell(cells, task, setting, method, metric):
    (found,) = [c for c in cells if (c.task, c.setting, c.method, c.metric) == (task, setting, method, metric)]
    return found.value


def test_a_known_error_is_that_error_and_the_fills_own_share_is_one(corpus):
    cells = gaps.measure(corpus, "test", [off_by(0.02), find("eased"), find("bones")], limit=3)
    moved = 20 * (len(BODY) - 1) / len(BODY)  # the hips are where they were
    for setting in ("0.5 s", "6 s"):
        for metric in (gaps.WORLD, gaps.ROOTED):
            assert cell(cells, "whole body", setting, "known", metric) == pytest.approx(moved, abs=0.01)
            classical = cell(cells, "whole body", setting, "eased", metric)
            share = {gaps.WORLD: gaps.SHARE, gaps.ROOTED: gaps.ROOTED_SHARE}[metric]
            if classical > 1e-3:  # all joints go the same way, so a curve misses nothing as seen from the hips
                assert cell(cells, "whole body", setting, "known", share) == pytest.approx(moved / classical, rel=1e-4)
                assert cell(cells, "whole body", setting, "eased", share) == 1
    assert cell(cells, "leg", "0.9 s", "known", gaps.WORLD) == pytest.approx(20, abs=0.01)
    assert cell(cells, "leg", "0.9 s", "known", gaps.ROOTED) == pytest.approx(20, abs=0.01)
    assert cell(cells, "arm", "0.9 s", "bones", gaps.SHARE) == 1


def test_what_is_lost_is_what_is_judged(corpus):
    asked = {}

    def fill(positions, observed, fps, skeleton):
        assert np.isnan(positions[~observed]).all()
        asked.setdefault(observed.shape[1], []).append(~observed[0])
        return np.nan_to_num(positions)

    gaps.measure(corpus, "test", [Method("nosy", fill)], limit=1)
    assert set(asked) == {96, 240}
    limbs = [lost for lost in asked[96] if not lost.all(axis=1).any()]
    joints = {frozenset(np.flatnonzero(lost.any(axis=0)).tolist()) for lost in limbs}
    names = [["left_shin", "left_foot", "left_toe"], ["left_forearm", "left_hand"]]
    assert joints == {frozenset(JOINT[name] for name in each) for each in names}
    ends = [lost for lost in asked[96] if lost[-1].all()]
    assert sorted(lost.all(axis=1).sum() for lost in ends) == [6, 15, 27, 45, 60]
    inside = [lost for lost in asked[96] + asked[240] if not lost[-1].any()]
    bodies = [lost.all(axis=1).sum() for lost in inside if lost.all(axis=1).any()]
    assert sorted(bodies) == [3, 6, 9, 15, 27, 45, 60, 90, 120, 180]


def test_quick_has_the_mean_first_and_the_classical_fill_at_one(corpus):
    found = quick("gaps", None, corpus, "validation", windows=2)
    assert next(iter(found)) == "mean share" and found["whole body, 0.5 s"] == 1
    lying = NetworkCompleter(Description("zero", "floor_mean", 30.0, 96, BODY), lambda inputs: 0 * inputs["positions"])
    assert quick("gaps", lying, corpus, "validation", windows=2)["mean share"] > 2


def test_other_joints_and_short_clips_are_refused(corpus, tmp_path):
    short = Motion(swaying(60), np.ones((60, len(BODY)), bool), 30.0, BODY)
    made = write_corpus(
        tmp_path / "s.corpus", name="s", fps=30.0, skeleton=BODY, clips=[(ClipInfo("a", split="test"), short)]
    )
    with pytest.raises(InputError, match="no whole window of 96 frames"):
        gaps.measure(made, "test", [find("eased")])
    with pytest.raises(InputError, match="not BODY's"):
        gaps.measure(replace(corpus, skeleton=BODY.__class__(("a",), (-1,))), "test", [find("eased")])
