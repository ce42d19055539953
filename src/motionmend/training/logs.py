"""How a run goes: log.jsonl, TensorBoard where it is installed, and lines that a person reads."""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from pathlib import Path
from typing import Any

from ..networks.checkpoints import span
from .state import aside


class Journal:
    """Takes every step's losses; writes a line of JSON per `every` steps, and tells how long it still takes.

    Lines of log.jsonl: {"step": steps done, "loss": mean since the line before, …, "lr", "norm" (of the
    gradient, mean), "rate" (steps a second), "waiting" (share of the time spent waiting for batches), "seconds"}
    and, for a validation, {"step", "validation": {metric: value}, "best": whether it is the best so far}.
    """

    def __init__(self, folder: Path, *, first: int, steps: int, every: int, seconds: float = 0.0):
        """Go on after `first` steps, which took `seconds`: what an interrupted run logged beyond them is cut off."""
        cut_back(folder / "log.jsonl", first)
        self.file = (folder / "log.jsonl").open("a", encoding="utf-8")
        self.board: Any = None
        if importlib.util.find_spec("tensorboard"):
            from torch.utils.tensorboard import SummaryWriter

            self.board = SummaryWriter(str(folder / "tensorboard"), purge_step=first + 1)
        self.steps, self.every = steps, every
        self.terminal = sys.stderr.isatty()
        self.told = self.lap = self.began = time.perf_counter()
        self.before = seconds
        self.begun: tuple[int, float] | None = None  # steps done, and when, after the first: it may compile
        self.sums: dict[str, float] = {}
        self.count = 0
        self.waited = self.waited_lap = 0.0
        self.paused = 0.0

    @property
    def seconds(self) -> float:
        """Seconds that the run has taken, with those before it was interrupted."""
        return self.before + time.perf_counter() - self.began

    def step(self, done: int, values: dict[str, float], lr: float, waited: float) -> None:
        """After `done` steps: this one's losses and norm, its learning rate, all seconds of waiting so far."""
        for name, value in values.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
        self.count += 1
        self.waited = waited
        now = time.perf_counter()
        self.begun = self.begun or (done, now)
        if now - self.told > (0.5 if self.terminal else 20):
            self.told = now
            line = self._line(done, lr)
            print(f"\r{line}\x1b[K" if self.terminal else line, end="" if self.terminal else "\n", file=sys.stderr,
                  flush=True)  # fmt: skip
        if done % self.every == 0 or done == self.steps:
            self._write({"step": done, **self._means(), "lr": lr, **self._pace(), "seconds": round(self.seconds, 3)})
            self.sums, self.count = {}, 0
            self.lap, self.waited_lap, self.paused = now, waited, 0.0

    def validation(self, done: int, scores: dict[str, float], best: bool) -> None:
        self._write({"step": done, "validation": scores, "best": best})
        self.say(f"step {done:,}: validation {listed(scores)}{' (best)' if best else ''}")

    def say(self, line: str) -> None:
        """One line that stays."""
        print(f"\r{line}\x1b[K" if self.terminal else line, file=sys.stderr, flush=True)

    def pause(self, seconds: float) -> None:
        """Time that went into something else than steps: validation, checkpoints."""
        self.paused += seconds

    def close(self) -> None:
        self.file.close()
        if self.board:
            self.board.close()

    def _means(self) -> dict[str, float]:
        return {name: value / self.count for name, value in self.sums.items()}

    def _pace(self) -> dict[str, float]:
        spent = max(1e-9, time.perf_counter() - self.lap - self.paused)
        return {"rate": round(self.count / spent, 4), "waiting": round((self.waited - self.waited_lap) / spent, 5)}

    def _line(self, done: int, lr: float) -> str:
        pace = self._pace()
        losses = "  ".join(f"{name} {value:.4g}" for name, value in self._means().items())
        return (
            f"step {done:,}/{self.steps:,}  {losses}  lr {lr:.2g}  {pace['rate']:.3g} steps/s  "
            f"waiting {pace['waiting']:.1%}  {self._left(done)}"
        )

    def _left(self, done: int) -> str:
        """How long it still takes, if validations and checkpoints go on to take their share of the time."""
        first, when = self.begun or (done, 0.0)
        if done == first:
            return ""
        return f"{span((self.steps - done) * (time.perf_counter() - when) / (done - first))} left"

    def _write(self, row: dict[str, Any]) -> None:
        self.file.write(json.dumps(row) + "\n")
        self.file.flush()
        if self.board:
            for name, value in row.get("validation", row).items():
                if name != "step" and isinstance(value, float):
                    self.board.add_scalar(f"validation/{name}" if "validation" in row else name, value, row["step"])


def listed(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in values.items())


def cut_back(path: Path, step: int) -> None:
    """Drop the lines of a log that were written after `step`, and one that a kill left unfinished."""
    if not path.exists():
        return
    kept = []
    for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
        try:
            if line.endswith("\n") and json.loads(line)["step"] <= step:
                kept.append(line)
        except (ValueError, KeyError, TypeError):
            continue
    with aside(path) as part:
        part.write_text("".join(kept), encoding="utf-8")
