"""The papers' protocols: every method on the same damage, in one table.

In: a corpus, a split, and methods by name. Out: cells, a table and figures in a folder, the same bytes every time. It
must not know how anything is trained.

A protocol is a module of this package with

    PROTOCOL : results.Protocol
    measure(corpus, split, methods, *, seed, limit, train, stage=silent) -> list[results.Cell]
    quick(method, corpus, split, *, windows, seed) -> dict[str, float]   # optional; the first key is to choose by
    CLASSICAL = {"fill": "hermite", …}                                   # with quick: who does each in its stead
    starts(corpus, split, limit) -> (W,) first frames of its windows     # optional: how many go into the header
    figures(cells) -> dict[str, Figure]                                  # optional: more PNGs, by file stem

`methods` are `method.Method`s; one that has no `fill` (or `restore`, or `sample`) is left out of the tasks that
need it, and the table shows a dash. `train` is a Corpus whose split "train" may be looked up (nearest neighbours). A
protocol whose PROTOCOL.source is True gets a Path as its `corpus`.
"""

from __future__ import annotations

import importlib
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..corpora.corpus import Corpus
from ..errors import InputError, nearest_names
from ..progress import Stage, silent
from .method import Method
from .methods import find, find_all, of_completer
from .provenance import header
from .results import Cell, Protocol, Results
from .writing import refuse_folder, write

if TYPE_CHECKING:
    from ..networks.completers import NetworkCompleter

PROTOCOLS = {name: f"{__name__}.{name}" for name in ("xmae", "convae", "trajevae", "lafan1", "gaps")}


def protocol(name: str) -> Any:
    """The module of a protocol. InputError names the nearest if there is none."""
    if name not in PROTOCOLS:
        raise InputError(f"unknown protocol {name!r}", hint=nearest_names(name, PROTOCOLS))
    return importlib.import_module(PROTOCOLS[name])


def run(
    name: str,
    corpus: Corpus | str | Path,
    split: str,
    methods: Sequence[str | Method],
    out: str | Path | None = None,
    *,
    seed: int = 0,
    limit: int | None = None,
    train_corpus: Corpus | str | Path | None = None,
    force: bool = False,
    stage: Stage = silent,
) -> Results:
    """Measure methods by a protocol, and write the tables. The same call gives the same numbers, byte for byte.

    Parameters
    ----------
    name : of PROTOCOLS. corpus : of the protocol's rate; for "lafan1" the data set's archive or folder instead.
    split : "test", …
    methods : names (see `methods.find`) or Methods.
    out : the folder for results.json, table.md, runtime.json and figures; None writes nothing.
    limit : at most so many windows, spread evenly, for a quick look.
    train_corpus : whose split "train" "nearest" and "nearest-carried" look in; the corpus's own if None.
    force : replace results in a folder that is there.

    Raises
    ------
    InputError : for an unknown protocol or method, a corpus of another rate, a split without clips.
    """
    module = protocol(name)
    about: Protocol = module.PROTOCOL
    if limit is not None and limit < 1:
        raise InputError(f"a limit of {limit} windows", expected="at least 1")
    if not methods:
        raise InputError("no method was named", hint="say --methods linear,hermite")
    if out is not None:
        refuse_folder(Path(out), force)
    command = _command(about, corpus, split, methods, out, seed, limit, train_corpus)
    data: Any = Path(corpus) if about.source and not isinstance(corpus, Corpus) else opened(corpus)
    train = opened(train_corpus) if train_corpus is not None else (data if isinstance(data, Corpus) else None)
    if isinstance(data, Corpus):
        check(about, data, split)
    elif not data.exists():
        raise InputError("no such file or folder", where=data)
    named = find_all([each for each in methods if isinstance(each, str)], train)
    found = [named.pop(0) if isinstance(each, str) else each for each in methods]
    clock = Clock()
    cells = module.measure(
        data, split, [clock.timed(each) for each in found], seed=seed, limit=limit, train=train, stage=stage
    )
    windows = len(module.starts(data, split, limit)) if hasattr(module, "starts") else None
    top = header(about, command, data, split, found, seed=seed, windows=windows, limit=limit)
    extra = module.figures(cells) if hasattr(module, "figures") and out is not None else {}
    results = Results(about, top, cells, clock.table(), extra)
    if out is not None:
        stage("writing")
        write(results, Path(out), force)
    return results


def quick(
    name: str, completer: NetworkCompleter | None, corpus: Corpus, split: str, windows: int = 64, seed: int = 0
) -> dict[str, float]:
    """A protocol's few numbers to watch a network by while it trains; the first is the one to choose by.

    completer : the network; None measures what `classical` names on the same windows and damage.
    """
    module = protocol(name)
    check(module.PROTOCOL, corpus, split)
    if completer is not None:
        method = of_completer("network", completer)
    else:
        does = {what: getattr(find(who), what) for what, who in module.CLASSICAL.items()}
        method = replace(Method("classical"), **does)
    return module.quick(method, corpus, split, windows=windows, seed=seed)


def classical(name: str) -> str:
    """The classical methods that stand beside a network in a protocol's quick form, in words."""
    return " and ".join(protocol(name).CLASSICAL.values())


def opened(corpus: Corpus | str | Path) -> Corpus:
    return corpus if isinstance(corpus, Corpus) else Corpus.open(corpus)


def check(about: Protocol, corpus: Corpus, split: str) -> None:
    """InputError if a protocol cannot be run on this split of this corpus."""
    if corpus.fps != about.fps:
        raise InputError(
            f"a corpus at {corpus.fps:g} fps", where=corpus.path, expected=f"{about.fps:g} fps for {about.name}",
            hint=f"build one with `motionmend data build {corpus.name} --source DIR --fps {about.fps:g} -o …`",
        )  # fmt: skip
    if not corpus.in_split(split):
        splits = ", ".join(dict.fromkeys(clip.split for clip in corpus.clips if clip.split))
        hint = f"its splits are {splits}" if splits else "it was built without --splits"
        raise InputError(f"no clip is in the split {split!r}", where=corpus.path, hint=hint)


class Clock:
    """Measures how long methods take, call by call, apart from the protocol's own work."""

    def __init__(self):
        self.spent: dict[tuple[str, str], list[float]] = {}

    def timed(self, method: Method) -> Method:
        """The same method, under this clock."""
        return replace(
            method,
            fill=self._timed(method.name, "fill", method.fill, 0),
            restore=self._timed(method.name, "restore", method.restore, 0),
            sample=self._timed(method.name, "sample", method.sample, 1),
        )

    def _timed(self, name: str, kind: str, do: Callable[..., np.ndarray] | None, windows: int):
        """`do` under the clock; its argument number `windows` is (B, T, …)."""
        if do is None:
            return None

        def timed(*arguments: Any) -> np.ndarray:
            begun = time.perf_counter()
            done = do(*arguments)
            took = time.perf_counter() - begun
            frames = int(np.prod(arguments[windows].shape[:2]))
            if (name, kind) in self.spent:
                self.spent[name, kind][0] += took
                self.spent[name, kind][1] += frames
            else:  # the first call imports and warms up: it counts only if it stays the only one
                self.spent[name, kind] = [0.0, 0, took / frames]
            return done

        return timed

    def table(self) -> dict[str, dict[str, dict[str, float | None]]]:
        """For each method and what it did: seconds a frame, and how many times the linear fill's."""
        speeds = {key: (row[0] / row[1] if row[1] else row[2]) for key, row in self.spent.items()}
        linear = speeds.get(("linear", "fill"))
        found: dict[str, dict[str, dict[str, float | None]]] = {}
        for (name, kind), speed in speeds.items():
            ratio = speed / linear if linear else None
            found.setdefault(name, {})[kind] = {"seconds_per_frame": speed, "ratio": ratio}
        return found


def _command(
    about: Protocol, corpus: Any, split: str, methods: Sequence[str | Method], out: Any, seed: int, limit: int | None,
    train: Any,
) -> str:  # fmt: skip
    """What to type to get these numbers."""

    def path(value: Any) -> str:
        return str(value.path if isinstance(value, Corpus) else value)

    names = ",".join(each if isinstance(each, str) else each.name for each in methods)
    words = ["motionmend", "benchmark", about.name, "--source" if about.source else "--corpus", path(corpus)]
    words += ["--split", split, "--methods", names, "--seed", str(seed)]
    words += ["--limit", str(limit)] if limit is not None else []
    words += ["--train-corpus", path(train)] if train is not None else []
    words += ["-o", str(out)] if out is not None else []
    return shlex.join(words)


__all__ = ["PROTOCOLS", "Cell", "Clock", "Method", "Protocol", "Results", "check", "protocol", "quick", "run"]
