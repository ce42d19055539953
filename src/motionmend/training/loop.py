"""The training loop: one process or many, the same samples; stopped at any moment, the same weights in the end."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from accelerate import Accelerator
from torch import Tensor, nn

from ..corpora.corpus import Corpus
from ..errors import InputError
from ..networks.models import network_class
from ..networks.models.network import Network
from . import config, runs, state
from .batches import Ahead, Batches, Workers, share
from .config import Settings, rate
from .ending import Export, budget, exported
from .logs import Journal, listed
from .optimisers import Optimiser, optimiser_of, set_rate
from .validation import Validate, classical_scores, described, judge, scores_of


class Objective(nn.Module):
    """A network's mean losses over the rows of a batch, as a module, so that gradients are shared between processes."""

    def __init__(self, network: Network, precision: str):
        super().__init__()
        self.network, self.precision = network, precision

    def forward(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        device = next(iter(batch.values())).device.type
        with torch.autocast(device, torch.bfloat16, enabled=self.precision == "bf16"):
            losses = self.network.loss(batch, step)
        return {name: each.float().mean() for name, each in losses.items()}


@dataclass
class Progress:
    """What a checkpoint says of its run besides the tensors. done : steps taken. best : the best validation so far."""

    done: int = 0
    best: float = math.inf
    best_step: int = 0
    seconds: float = 0.0

    @classmethod
    def of(cls, metadata: dict[str, str]) -> Progress:
        return cls(
            int(metadata["done"]), float(metadata["best"]), int(metadata["best_step"]), float(metadata["seconds"])
        )


def train(
    settings: Settings,
    folder: Path,
    *,
    resume: bool = False,
    validate: Validate = scores_of,
    export: Export = exported,
) -> int:
    """Train a network into a run's folder. Returns the exit status: 0, or 128 + the signal that stopped it.

    Parameters
    ----------
    folder : gets config.toml, last.safetensors, best.safetensors, log.jsonl, samples/, and in the end export/.
    resume : go on from last.safetensors where there is one; start where there is none.
    validate : scores of a network on a corpus, the first of which chooses the best (lower is better).
    export : writes the trained network.

    Raises
    ------
    InputError : for settings or data that do not fit, a folder in use, a resumed run with other settings, and
        for a loss that is not a number.
    """
    config.check(settings)
    kind = network_class(settings.name)
    corpora = [Corpus.open(path) for path in settings.corpus]
    # Without GPUs accelerate takes the processes that torchrun starts for strangers, unless it is told of the CPU.
    many = int(os.environ.get("WORLD_SIZE", "1")) > 1
    # The Objective casts by itself.
    accelerator = Accelerator(mixed_precision="no", cpu=many and not torch.cuda.is_available())
    device = accelerator.device
    torch.manual_seed(settings.seed)
    network = kind(settings.network, len(corpora[0].skeleton)).to(device)
    if not (resume and (folder / "last.safetensors").is_file()):
        runs.begin(network, settings, corpora)
    batches = Batches.of(settings, network, corpora)
    for corpus in corpora:
        judge(network, corpus)  # an unknown protocol is an error before a folder is made
    mine = share(batches.blocks, accelerator.process_index, accelerator.num_processes)
    settings = runs.together(accelerator, lambda: runs.prepare(settings, folder, resume, corpora, device))
    optimiser = optimiser_of(network, settings, device)
    average = state.Average(network, settings.ema)
    progress, last = Progress(), folder / "last.safetensors"
    if resume and last.is_file():
        tensors, metadata = state.load(last)
        state.spread(tensors, network, optimiser, average)
        progress = Progress.of(metadata)
    objective = Objective(network, settings.precision)
    if settings.compile:
        objective.compile()

    workers = Workers(settings.workers, batches, settings, mine, progress.done) if settings.workers else None

    def make(step: int) -> dict[str, Tensor]:
        arrays = workers(step) if workers else batches.make(step, *mine)
        tensors = {name: torch.from_numpy(np.ascontiguousarray(each)) for name, each in arrays.items()}
        return {name: each.pin_memory() for name, each in tensors.items()} if device.type == "cuda" else tensors

    run = Run(
        settings, folder, corpora, accelerator, network, accelerator.prepare(objective), optimiser, average, progress,
        validate,
    )  # fmt: skip
    try:
        with runs.signals() as heard, Ahead(make, progress.done, settings.steps) as ahead:
            status = run.go(ahead, heard)
        if not status and run.main:
            run.finish(export)
    finally:
        if workers:
            workers.close()
        if run.journal:
            run.journal.close()
    accelerator.wait_for_everyone()  # a process that leaves while another still writes may take gloo down with it
    accelerator.end_training()
    return status


@dataclass(eq=False)
class Run:
    """One run, as this process sees it. Only the main process writes."""

    settings: Settings
    folder: Path
    corpora: list[Corpus]
    accelerator: Accelerator
    network: Network
    objective: nn.Module
    optimiser: Optimiser
    average: state.Average
    progress: Progress
    validate: Validate
    saved: float = field(default_factory=time.monotonic)
    journal: Journal | None = None  # in the main process

    @property
    def main(self) -> bool:
        return self.accelerator.is_main_process

    @property
    def judges(self) -> list[Corpus]:
        """What validation looks at: all corpora that have a split for it."""
        return [each for each in self.corpora if each.in_split("validation")]

    @property
    def held_out(self) -> Corpus | None:
        """The first of them, by which the best weights are chosen."""
        return next(iter(self.judges), None)

    @cached_property
    def classical(self) -> tuple[str, dict[str, float]]:
        """Who would do without the network, and the same scores for it."""
        return classical_scores(self.network, self.held_out, self.settings) if self.held_out else ("", {})

    def go(self, ahead: Ahead, heard: list[int]) -> int:
        """Take all steps that are left; returns 0, or 128 + the signal that came first."""
        settings, progress, limit = self.settings, self.progress, self.settings.clip or math.inf
        if self.main:
            self.journal = Journal(
                self.folder, first=progress.done, steps=settings.steps, every=settings.log_every,
                seconds=progress.seconds,
            )  # fmt: skip
            self.greet()
        self.network.train()
        for step in range(progress.done, settings.steps):
            set_rate(self.optimiser, rate(settings, step))
            torch.manual_seed(seed_of(settings.seed, step, self.accelerator.process_index))
            batch = {name: each.to(self.accelerator.device, non_blocking=True) for name, each in ahead.next().items()}
            losses = self.objective(batch, step)
            if "loss" not in losses:
                found = f"its losses are {', '.join(losses)}"
                raise InputError(found, where=settings.name, expected='one named "loss"')
            self.accelerator.backward(losses["loss"])
            norm = self.accelerator.clip_grad_norm_(self.network.parameters(), limit)
            values, stop = self.agreed({**losses, "norm": norm}, heard)
            if bad := [name for name, value in values.items() if not math.isfinite(value)]:
                self.break_off(bad[0], values[bad[0]], batch)
            self.optimiser.step()
            self.optimiser.zero_grad()
            self.average.update(self.network, step)
            progress.done = step + 1
            if self.journal:
                self.journal.step(progress.done, values, rate(settings, step), ahead.waited)
                self.write_down(self.journal, stop)
            if stop:
                self.tell(f"stopped after step {progress.done:,}. To go on, say the same command with --resume")
                return 128 + stop
        return 0

    def agreed(self, values: dict[str, Tensor | None], heard: list[int]) -> tuple[dict[str, float], int]:
        """Values as means over all processes, and the signal to stop for, if any of them has heard one.

        Every process sees the same, so all stop, or fail, at the same step, and none waits for another for ever.
        """
        device = self.accelerator.device
        rows = [torch.as_tensor(value, dtype=torch.float32, device=device).detach() for value in values.values()]
        rows.append(torch.tensor(float(bool(heard)), device=device))
        together = self.accelerator.reduce(torch.stack(rows), "mean")
        assert isinstance(together, Tensor)
        *means, stop = together.tolist()
        return dict(zip(values, means)), (heard[0] if heard else int(signal.SIGTERM)) if stop else 0

    def write_down(self, journal: Journal, stop: int) -> None:
        """Validate and save, where it is time to."""
        settings, done, began = self.settings, self.progress.done, time.perf_counter()
        last = done == settings.steps
        if last or (settings.validate_every and done % settings.validate_every == 0):
            self.validated(journal)
        by_step = settings.checkpoint_every and done % settings.checkpoint_every == 0
        minutes = settings.checkpoint_minutes
        by_time = minutes and time.monotonic() - self.saved > 60 * minutes
        if last or stop or by_step or by_time:
            self.save()
        if by_step:
            state.keep_copy(self.folder / "last.safetensors", done, settings.keep)
        journal.pause(time.perf_counter() - began)

    def validated(self, journal: Journal) -> None:
        """Score the averaged weights, draw samples, and keep the weights if they are the best so far."""
        if self.held_out is None:
            return
        done = self.progress.done
        picture = self.folder / "samples" / f"{done:09d}.png"
        averaged = self.averaged()
        scores = self.validate(averaged, self.held_out, self.settings, picture)
        for other in self.judges[1:]:
            beside = picture.with_stem(f"{picture.stem}-{other.name}")
            found = self.validate(averaged, other, self.settings, beside)
            scores |= {f"{other.name}: {name}": value for name, value in found.items()}
        who, theirs = self.classical
        if done == self.settings.validate_every and theirs:
            journal.say(f"for comparison, {who}: {listed(theirs)}")
        value = next(iter(scores.values()))
        best = value < self.progress.best
        if best:
            self.progress.best, self.progress.best_step = value, done
            said = {"step": done, "validation": json.dumps(scores)}
            state.save(self.folder / "best.safetensors", self.average.values, said)
        journal.validation(done, scores, best)

    def averaged(self) -> Network:
        """A second network with the averaged weights."""
        with torch.random.fork_rng():
            network = type(self.network)(self.settings.network, self.network.joints).to(self.accelerator.device)
        network.load_state_dict(self.average.values)
        return network.eval()

    def save(self) -> None:
        if self.journal:
            self.progress.seconds = self.journal.seconds
        tensors = state.gather(self.network, self.optimiser, self.average)
        data = json.dumps(runs.data_of(self.corpora))
        said = asdict(self.progress) | {"data": data, "settings": config.write(self.settings)}
        state.save(self.folder / "last.safetensors", tensors, said)
        self.saved = time.monotonic()

    def break_off(self, name: str, value: float, batch: dict[str, Tensor]) -> None:
        """A loss or gradient is not a number: keep the weights from before it, and say so."""
        done = self.progress.done
        if self.main:
            self.save()
        for key, each in batch.items():
            if not torch.isfinite(each).all():
                hint = "unobserved samples are NaN in what `batch` is given, and must not be in what it returns"
                raise InputError(f"{key!r} of the batch of step {done + 1} has NaN or inf",
                                 where=self.settings.name, hint=hint)  # fmt: skip
        raise InputError(
            f"{name} is {value} in step {done + 1}", where=self.folder,
            hint=f"the weights after step {done:,} are in last.safetensors; try a lower --lr or --clip, "
            "or --precision fp32, in a new run",
        )  # fmt: skip

    def greet(self) -> None:
        size = sum(parameter.numel() for parameter in self.network.parameters())
        hours = [sum(clip.frames for clip in each.in_split("train")) / each.fps / 3600 for each in self.corpora]
        data = ", ".join(f"{each.name} {h:.2f} h" for each, h in zip(self.corpora, hours))
        went = f", from step {self.progress.done:,}" if self.progress.done else ""
        many = self.accelerator.num_processes
        corpus, device = self.held_out, self.accelerator.device
        self.tell(
            f"{self.settings.name}: {size:,} parameters on {runs.machine(device)}, "
            f"{f'{many} processes, ' if many > 1 else ''}{self.settings.precision}; "
            f"{data}{went}; "
            + (f"validation by {judge(self.network, corpus)} on {corpus.name}" if corpus else "nothing to validate on")
        )

    def tell(self, line: str) -> None:
        if self.journal:
            self.journal.say(line)

    def finish(self, export: Export) -> None:
        """Export the best weights by validation; the last where nothing was validated."""
        best = self.folder / "best.safetensors"
        network, scores, step = self.averaged(), {}, self.progress.done
        if best.is_file():
            tensors, metadata = state.load(best)
            network.load_state_dict(tensors)
            scores, step = json.loads(metadata["validation"]), int(metadata["step"])
        spent = budget(self.settings, self.corpora, step, self.progress.seconds, self.accelerator)
        if scores and self.held_out:
            spent["validated by"] = described(self.network, self.held_out, self.settings)
            if self.classical[1]:
                spent["beside"] = dict([self.classical])
        where = export(network, self.folder / "export", self.corpora, spent, scores)
        best_of = f"the weights of step {step:,}{', the best,' if scores else ''}"
        self.tell(f"done: {self.progress.done:,} steps; {best_of} are in {where}")


def seed_of(seed: int, step: int, rank: int) -> int:
    """Seed of torch's own chance (dropout) in a step of a process."""
    return int(np.random.SeedSequence([seed, step, rank]).generate_state(1, np.uint64)[0] >> np.uint64(1))
