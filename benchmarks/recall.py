"""A memory of takes against fills, on gaps of a whole body, an arm and a leg: shares of a curve's error. Markdown.

    python benchmarks/recall.py --corpus cmu30.corpus [--split validation] [--strangers free30.corpus …] [--auto]

The corpora are built by `motionmend data build … --fps 30`. In every take of the split gaps are planted one at a time,
about one a second: all joints, the left arm from the elbow on, the left leg from the knee on. `recall` learns from the
take itself, without the gap; from that and the other takes of the same person; or from that and the training takes of
other corpora. Errors are the mean distances of the lost joints in the gap, in the world and for whole bodies also as
seen from the hips; the tables have them as shares of those of `eased` (of `bones` for limbs), which are given in mm.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import shared

from motionmend.body.joints import LIMBS
from motionmend.corpora.corpus import Clip, Corpus
from motionmend.fills.points import FILLS, Fill
from motionmend.memory.filling import Recall
from motionmend.memory.sessions import Session, joined, remember
from motionmend.motion import Motion

SECONDS = (0.1, 0.3, 0.5, 0.9, 1.5, 2.0)
CONTEXT = 8  # frames beside a gap that are whole
PARTS = {"whole body": None, "arm": LIMBS["left_arm"][1:], "leg": LIMBS["left_leg"][1:]}


def remembered(corpus: Corpus, clips: tuple[Clip, ...]) -> tuple[Session, ...]:
    return joined(remember(corpus.motion(clip), None, clip.name, f"{corpus.name} {clip.name}") for clip in clips)


def places(motion: Motion, length: int, random: np.random.Generator) -> list[int]:
    """First frames of gaps, about one a second, where all joints that are ever seen are seen."""
    seen = motion.observed[:, motion.observed.any(axis=0)].all(axis=1)
    starts = range(CONTEXT + int(random.integers(15)), len(motion) - length - CONTEXT, max(30, length))
    return [start for start in starts if seen[start - CONTEXT : start + length + CONTEXT].all()]


def misses(fill: Fill, motion: Motion, start: int, length: int, lost: list[int]) -> tuple[float, float]:
    """The mean error in mm, in the world and as seen from the first of the lost joints."""
    observed = motion.observed.copy()
    observed[start : start + length, lost] = False
    hidden = np.where(observed[..., None], motion.positions, np.float32(np.nan))
    filled = fill.complete(replace(motion, positions=hidden, observed=observed))
    off = (filled.positions - motion.positions)[start : start + length, lost].astype(float)
    return tuple(1e3 * float(np.linalg.norm(each, axis=-1).mean()) for each in (off, off - off[:, :1]))


def main() -> None:
    asked = shared.options(
        __doc__, corpus=Path, split="validation", strangers=["none"], auto=False, seed=0, every=1, parts=[*PARTS]
    )
    corpus = Corpus.open(asked.corpus)
    clips = corpus.in_split(asked.split) if asked.split else corpus.clips
    people: dict[str, list[Clip]] = defaultdict(list)
    for clip in clips:
        people[clip.subject].append(clip)
    own = {person: remembered(corpus, tuple(theirs)) for person, theirs in people.items()}
    opened = [Corpus.open(path) for path in asked.strangers if path != "none"]
    others = joined(session for each in opened for session in remembered(each, each.in_split("train")))

    def fills(clip: Clip) -> dict[str, Fill]:
        without = frozenset([f"{corpus.name} {clip.name}"])
        found: dict[str, Fill] = {"recall, the take itself": Recall()}
        found["recall, the person's takes"] = Recall(own[clip.subject], without)
        if others:
            found["recall, strangers' takes"] = Recall(others, without)
        if asked.auto:
            from motionmend.repairs.chooser import Chooser
            from motionmend.repairs.network_fill import installed

            found["auto"] = Chooser((), None, {name: network.improve for name, network in installed().items()})
        return found

    minutes = sum(clip.frames for clip in clips) / corpus.fps / 60
    data = f"{corpus.name}, {asked.split or 'all takes'}: {len(clips)} takes of {len(people)} people, {minutes:.1f} min"
    some = f", gaps in every {asked.every}th" if asked.every > 1 else ""
    print(f"{data}{some}, seed {asked.seed}, {shared.here()}")
    for part in asked.parts:
        table(part, corpus, clips[:: asked.every], fills, asked.seed)


def table(
    part: str, corpus: Corpus, clips: tuple[Clip, ...], fills: Callable[[Clip], dict[str, Fill]], seed: int
) -> None:
    """Print the errors of all fills on gaps of one part."""
    base = "eased" if PARTS[part] is None else "bones"
    rows: dict[str, list[str]] = defaultdict(list)
    for seconds in SECONDS:
        random, length = np.random.default_rng(seed), round(seconds * corpus.fps)
        errors: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for clip in clips:
            motion = corpus.motion(clip)
            joints = np.flatnonzero(motion.observed.any(axis=0))
            lost = [joint for joint in PARTS[part] or range(motion.observed.shape[1]) if joint in joints]
            for start in places(motion, length, random):
                for name, fill in {base: FILLS[base], **fills(clip)}.items():
                    errors[name].append(misses(fill, motion, start, length, lost))
        whole = {name: np.mean(each, axis=0) for name, each in errors.items()}
        rows["gaps"].append(str(len(errors[base])))
        for name, found in whole.items():
            shown = found if name == base else found / whole[base]
            digits, label = (".0f", f"`{base}`, mm") if name == base else (".2f", name)
            rows[label].append("/".join(f"{each:{digits}}" for each in shown[: 1 + (base == "eased")]))
    print(f"\n**{part}**\n")
    print(shared.seconds_head([""], SECONDS))
    for name, cells in rows.items():
        print(shared.row(name, *cells), flush=True)


if __name__ == "__main__":
    main()
