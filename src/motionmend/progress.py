"""What is being done now: a moving line on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Stage = Callable[[str], None]

QUIET_SECONDS = 5.0


def silent(_: str) -> None:
    """A Stage that says nothing."""


@contextmanager
def following(name: str) -> Iterator[Stage]:
    """Yields a function to call with what is done next ("reading", "filling 3 of 12", …).

    On a terminal one line shows it with the time; elsewhere a line is printed every few seconds at most, of what is
    being done at that time, so that logs of quick work stay quiet and those of long work short.
    """
    began = said = time.monotonic()
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(name)
            yield lambda what: bar.update(task, description=f"{name}: {what}")
        return

    def say(what: str) -> None:
        nonlocal said
        said = time.monotonic()
        print(f"{name}: {what} ({said - began:.0f} s)", file=sys.stderr, flush=True)

    later = threading.Timer(0, say)

    def line(what: str) -> None:
        nonlocal later
        later.cancel()
        later = threading.Timer(max(0.0, said + QUIET_SECONDS - time.monotonic()), say, [what])
        later.daemon = True
        later.start()

    try:
        yield line
    finally:
        later.cancel()
