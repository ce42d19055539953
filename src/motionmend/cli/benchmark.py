"""The verb `benchmark`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, arg

from ..errors import InputError
from .common import Output

Folder = Annotated[Optional[Path], arg(metavar="PATH")]


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Measure methods by a paper's protocol, and write tables, figures and all numbers.

    The same call gives the same numbers: motionmend benchmark xmae --corpus cmu.corpus --methods linear,auto -o results
    """

    protocol: Positional[str]
    """xmae, convae, trajevae, lafan1 or gaps."""
    corpus: Folder = None
    """A corpus made by `motionmend data build`, at the protocol's rate."""
    source: Folder = None
    """For lafan1: the data set's archive, or a folder of its BVH files."""
    split: str = "test"
    """Which of its splits."""
    methods: str = "none,linear,hermite,cubic,pattern,rigid,auto,savgol,butterworth"
    """Fills, filters, zero-velocity, nearest, nearest-carried, networks, checkpoint folders; commas between them."""
    train_corpus: Folder = None
    """Where `nearest` and `nearest-carried` look, in the split "train"; otherwise in the corpus itself."""
    seed: int = 0
    """Seed of the damage."""
    limit: Optional[int] = None
    """Only so many windows, spread evenly, for a quick look."""
    output: Output
    """A new folder for the results."""
    force: bool = False
    """Replace the results in a folder that is there."""

    def run(self) -> int:
        from ..benchmark import protocol, run
        from ..benchmark.table import runtime_lines
        from ..progress import following

        wanted, other = ("source", "corpus") if protocol(self.protocol).PROTOCOL.source else ("corpus", "source")
        data = getattr(self, wanted)
        if data is None or getattr(self, other) is not None:
            raise InputError(f"{self.protocol} is measured on a {wanted}", hint=f"say --{wanted} PATH and no --{other}")
        names = [name.strip() for name in self.methods.split(",") if name.strip()]
        with following(self.protocol) as stage:
            results = run(
                self.protocol, data, self.split, names, self.output,
                seed=self.seed, limit=self.limit, train_corpus=self.train_corpus, force=self.force, stage=stage,
            )  # fmt: skip
        print(runtime_lines(results))
        print(f"written: {self.output / 'table.md'}")
        return 0


def parsed(argv: Sequence[str]) -> Benchmark:
    """The command that a command line means; its first word is the verb."""
    return tyro.cli(Benchmark, args=argv[1:], prog="motionmend benchmark", config=(FlagCreatePairsOff,))
