"""Which samples a step trains on, and having them ready before it begins."""

from __future__ import annotations

import math
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any

import numpy as np

from ..corpora.corpus import Corpus
from ..errors import InputError
from ..networks.models import network_class
from ..networks.models.network import Network
from .config import Settings
from .moments import Moments

Array = np.ndarray
BLOCKS = 8  # processes that may share a batch, at most; the more, the longer small networks wait for their samples


class Batches:
    """Training batches as a pure function of seed and step.

    A batch is cut into gcd(batch, BLOCKS) blocks. Each block draws its windows and their corruption from its own
    generator, seeded by (seed, step, block), so N processes that share the blocks see exactly the samples
    that one process would see, and a resumed run those that it had not come to.
    """

    def __init__(
        self, network: Network, corpora: Sequence[Corpus], *, batch: int, stride: int, seed: int,
        anywhere: bool = False,
    ):  # fmt: skip
        """Windows of the corpora's split "train"; from `moments.Moments` if `anywhere`.

        InputError where a corpus has no such windows, or has another rate or other joints than it should.
        """
        self.network, self.corpora, self.seed = network, corpora, seed
        self.blocks = math.gcd(batch, BLOCKS)
        self.rows = batch // self.blocks
        for corpus in corpora:
            if corpus.fps != network.fps:
                hint = f"build it with --fps {network.fps:g}"
                expected = f"{network.fps:g}, the network's"
                raise InputError(f"{corpus.fps:g} frames a second", where=corpus.path, expected=expected, hint=hint)
            if corpus.skeleton != corpora[0].skeleton:
                raise InputError(f"other joints than in {corpora[0].path}", where=corpus.path)
        self.starts = [corpus.starts("train", network.frames, stride, pad=True) for corpus in corpora]
        for corpus, starts in zip(corpora, self.starts):
            if not len(starts):
                raise InputError('no clip is in the split "train"', where=corpus.path)
        hours = np.array([sum(clip.frames for clip in corpus.in_split("train")) for corpus in corpora], float)
        self.shares = hours / hours.sum()
        self.moments = Moments(corpora, network.frames) if anywhere else None

    @classmethod
    def of(cls, settings: Settings, network: Network, corpora: Sequence[Corpus]) -> Batches:
        """As the settings of a run have it."""
        return cls(
            network, corpora, batch=settings.batch, stride=settings.stride, seed=settings.seed,
            anywhere=settings.anywhere,
        )  # fmt: skip

    def make(self, step: int, first: int = 0, last: int | None = None) -> dict[str, Array]:
        """Blocks `[first, last)` of a step's batch, one after the other: named arrays of rows."""
        last = self.blocks if last is None else last
        chances = [np.random.default_rng([self.seed, step, block]) for block in range(first, last)]
        if self.moments:
            uniform = np.concatenate([rng.random((4, self.rows)) for rng in chances], axis=1)
            positions, observed = self.moments.drawn(uniform)
        else:
            uniform = np.concatenate([rng.random((2, self.rows)) for rng in chances], axis=1)
            positions, observed = self.windows(*self.choose(uniform))
        made = []
        for number, rng in enumerate(chances):
            rows = slice(number * self.rows, (number + 1) * self.rows)
            made.append(self.network.batch(positions[rows], observed[rows], rng, step))
        return {name: np.concatenate([block[name] for block in made]) for name in made[0]}

    def choose(self, uniform: Array) -> tuple[Array, Array]:
        """From chance `(2, W)`, uniform in [0, 1): which corpus, in proportion to its hours, and which first frame."""
        corpus = np.searchsorted(np.cumsum(self.shares)[:-1], uniform[0], side="right")
        starts = np.empty(len(corpus), np.int64)
        for number, known in enumerate(self.starts):
            mine = corpus == number
            starts[mine] = known[np.minimum((uniform[1, mine] * len(known)).astype(int), len(known) - 1)]
        return corpus, starts

    def windows(self, corpus: Array, starts: Array) -> tuple[Array, Array]:
        """Positions `(W, T, J, 3)` and observed `(W, T, J)` of windows from several corpora."""
        shape = len(corpus), self.network.frames, len(self.corpora[0].skeleton)
        positions, observed = np.empty((*shape, 3), np.float32), np.empty(shape, bool)
        for number in np.unique(corpus):
            mine = corpus == number
            positions[mine], observed[mine] = self.corpora[number].windows(starts[mine], self.network.frames)
        return positions, observed


def share(blocks: int, rank: int, processes: int) -> tuple[int, int]:
    """The blocks `[first, last)` of one of several processes. InputError if they cannot share equally."""
    if blocks % processes:
        hint = f"choose a batch that is a multiple of {processes}"
        raise InputError(f"{blocks} blocks of samples for {processes} processes", hint=hint)
    return rank * blocks // processes, (rank + 1) * blocks // processes


class Workers:
    """Batches made in processes of their own, for networks whose step is shorter than making one batch takes.

    Calling it with steps, one after the other from `first`, gives what `Batches.make` would.
    """

    def __init__(self, count: int, batches: Batches, settings: Settings, blocks: tuple[int, int], first: int):
        joints = len(batches.corpora[0].skeleton)
        self.blocks, self.asked, self.stop, self.count = blocks, first, settings.steps, count
        self.pool = ProcessPoolExecutor(
            count, multiprocessing.get_context("spawn"), _begin, (settings, joints, batches.corpora)
        )
        self.futures: dict[int, Future] = {}

    def __call__(self, step: int) -> dict[str, Array]:
        while self.asked < min(step + 2 * self.count, self.stop):
            self.futures[self.asked] = self.pool.submit(_make, self.asked, *self.blocks)
            self.asked += 1
        return self.futures.pop(step).result()

    def close(self) -> None:
        self.pool.shutdown(cancel_futures=True)


_batches: Batches  # of this process, where it is a worker


def _begin(settings: Settings, joints: int, corpora: Sequence[Corpus]) -> None:
    global _batches
    # Ctrl-C is the main process's to handle; and where that was killed, nobody else would end this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    network = network_class(settings.name)(settings.network, joints)
    _batches = Batches.of(settings, network, corpora)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _make(step: int, first: int, last: int) -> dict[str, Array]:
    return _batches.make(step, first, last)


class Ahead:
    """What `make(step)` gives for steps `[first, last)`, made in a thread a few steps before it is asked for.

    waited : seconds that the asker has spent waiting so far.
    """

    def __init__(self, make: Callable[[int], Any], first: int, last: int, depth: int = 4):
        self.waited = 0.0
        self._queue: queue.Queue = queue.Queue(depth)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, args=(make, first, last), daemon=True)
        self._thread.start()

    def _work(self, make: Callable[[int], Any], first: int, last: int) -> None:
        for step in range(first, last):
            try:
                item = make(step), None
            except BaseException as error:  # whatever it is, it is the asker's to raise
                item = None, error
            while not self._closed.is_set():
                try:
                    self._queue.put(item, timeout=0.1)
                    break
                except queue.Full:
                    continue
            if self._closed.is_set() or item[1] is not None:
                return

    def next(self) -> Any:
        began = time.perf_counter()
        made, error = self._queue.get()
        self.waited += time.perf_counter() - began
        if error is not None:
            raise error
        return made

    def __enter__(self) -> Ahead:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._thread.join()
