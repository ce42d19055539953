"""Corpora in words: hours, clips, joints, licences, and what was dropped and why."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..motion import Array
from .corpus import SPLITS, Clip, Corpus

# Telling --------------------------------------------------------------------------------------------------


def found(places: Iterable[Path]) -> list[Path]:
    """The corpora among some paths, and those directly inside the ones that are other folders.

    Raises
    ------
    InputError : for a path that is no folder.
    """
    corpora = []
    for place in places:
        if not place.is_dir():
            raise InputError("no such folder" if not place.exists() else "this is a file", where=place)
        inside = [place] if (place / "corpus.json").is_file() else sorted(place.iterdir())
        corpora += [path for path in inside if (path / "corpus.json").is_file()]
    return corpora


def length(corpus: Corpus, clips: Iterable[Clip]) -> str:
    """How long clips last together: "12.3 s", "47.2 min", "1.8 h"."""
    seconds = sum(clip.frames for clip in clips) / corpus.fps
    size, unit = (1, "s") if seconds < 60 else (60, "min") if seconds < 6000 else (3600, "h")
    return f"{seconds / size:.1f} {unit}"


def listed(corpus: Corpus) -> tuple[str, ...]:
    """A corpus in a row: path, clips, length, rate, joints, splits, licence."""
    splits = [f"{split or 'none'} {length(corpus, clips)}" for split, clips in _by_split(corpus)]
    return (
        str(corpus.path), str(len(corpus.clips)), length(corpus, corpus.clips), f"{corpus.fps:g} fps",
        f"{len(corpus.skeleton)} joints", ", ".join(splits), _licences(corpus),
    )  # fmt: skip


def described(corpus: Corpus, damage: str = "") -> str:
    """All that can be told of a corpus in text. damage : what `Corpus.damaged` has found."""
    clips, names = corpus.clips, corpus.skeleton.names
    seen = np.sum([corpus.observed[clip.start : clip.stop].sum(axis=0) for clip in clips], axis=0)
    never = [name for name, count in zip(names, seen) if not count]
    subjects = {clip.subject for clip in clips} - {""}
    lines = [
        f"{corpus.name}: {len(clips)} clips, {length(corpus, clips)}, {corpus.fps:g} fps, {corpus.dtype}"
        + (f", {len(subjects)} subjects" if subjects else ""),
        *(
            f"  {split or 'no split':<10} {length(corpus, group):>9}  {len(group):>5} clips"
            + (f"  {_plural(len({clip.subject for clip in group}), 'subject')}" if subjects else "")
            for split, group in _by_split(corpus)
        ),
        f"joints:    {len(names)}, never observed: {', '.join(never) or 'none'}",
        f"observed:  {100 * seen.sum() / corpus.observed.size:.2f} % of all samples",
        *_partly(names, seen / len(corpus)),
        f"rigs:      {_counted(clip.rig or 'unknown' for clip in clips)}",
        f"rates:     {_counted(f'{clip.file_fps:.6g} fps' for clip in clips)} in the files",
        f"ground:    {_grounds(clips)}",
        f"licence:   {_licences(corpus)}",
        f"credit:    {corpus.credit or 'none known'}",
        f"data hash: {corpus.sha256}, {damage or 'and the arrays have it'}",
        "notes:",
        *(f"  {count:>5}  {note}" for note, count in _notes(clips)),
        told_dropped(corpus),
    ]
    return "\n".join(lines)


def told_dropped(corpus: Corpus) -> str:
    """The files that were dropped, each with its reason."""
    lines = [f"  {each.file}: {each.reason}" for each in corpus.dropped]
    return "\n".join([f"dropped:   {len(lines) or 'nothing'}", *lines])


def _by_split(corpus: Corpus) -> list[tuple[str, tuple[Clip, ...]]]:
    return [(split, clips) for split in (*SPLITS, "") if (clips := corpus.in_split(split))]


def _licences(corpus: Corpus) -> str:
    return "; ".join(dict.fromkeys([corpus.licence, *(clip.licence for clip in corpus.clips)]))


def _counted(words: Iterable[str]) -> str:
    return ", ".join(f"{word} ({count})" for word, count in Counter(words).most_common())


def _partly(names: tuple[str, ...], shares: Array) -> Iterator[str]:
    """The joints that are observed now and then, alike ones together."""
    alike: dict[str, list[str]] = {}
    for name, share in zip(names, shares):
        if 0 < share < 0.995:
            alike.setdefault(f"{100 * share:.1f} %", []).append(name)
    yield from (f"           {share} of {', '.join(joints)}" for share, joints in alike.items())


def _grounds(clips: tuple[Clip, ...]) -> str:
    moved = [clip.floor for clip in clips if clip.floor]
    if not moved:
        return "y = 0 of the files"
    span = f"{min(moved):+.2f} to {max(moved):+.2f} m"
    return f"y = 0 of the files, but in {len(moved)} clips where the feet stand ({span})"


def _notes(clips: tuple[Clip, ...]) -> list[tuple[str, int]]:
    """Notes that differ in their numbers only, counted together."""
    return Counter(re.sub(r"\d[\d.e-]*", "…", note) for clip in clips for note in clip.notes).most_common(12)


def _plural(count: int, word: str) -> str:
    return f"{count} {word}" + "s" * (count != 1)
