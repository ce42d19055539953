"""A run's folder and machine: begun or gone on with, the same in every process, stopped by a signal."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from accelerate import Accelerator
from accelerate.utils import broadcast_object_list

from ..benchmark.results import evenly
from ..corpora.corpus import Corpus
from ..errors import InputError
from ..networks.checkpoints import load_network
from ..networks.models import network_class
from ..networks.models.network import Network
from . import arithmetic, config, state
from .config import Settings

MEASURED = 512  # windows by which a network learns how its data are spread


def prepare(settings: Settings, folder: Path, resume: bool, corpora: list[Corpus], device: torch.device) -> Settings:
    """Make the run's folder, or check that it can be gone on with; returns the settings as they are saved there."""
    path, last = folder / "config.toml", folder / "last.safetensors"
    if resume and last.is_file():
        metadata = state.load(last)[1]
        if not {"done", "data", "settings"} <= metadata.keys():
            raise InputError("this is not a run's last checkpoint", where=last)
        # As they were, whatever has become of config.toml.
        was_settled = config.parse(metadata["settings"], settings.name, last)
        old = config.settle(settings.name, network_class(settings.name), was_settled)
        settings = config.resolved(settings, old.precision)
        differ = config.changes(old, settings, int(metadata["done"]))
        if (was := json.loads(metadata["data"])) != (now := data_of(corpora)):
            differ.append(f"the data is {', '.join(now)} and was {', '.join(was)}, or has another hash")
        if differ:
            hint = "leave these options out, or start a new run in another folder"
            raise InputError("this run was begun otherwise: " + "; ".join(differ), where=folder, hint=hint)
    elif not (resume and path.is_file()) and in_use(folder):
        hint = "go on with it by --resume, or choose another folder" if path.is_file() else "choose another"
        raise InputError("a run is there already" if path.is_file() else "this is not a run", where=folder, hint=hint)
    else:
        settings = config.resolved(settings, arithmetic.faster(device))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with state.aside(path) as part:
            part.write_text(config.write(settings), encoding="utf-8")
    except OSError as error:
        raise InputError(f"the run's folder cannot be written: {error.strerror}", where=folder) from None
    return settings


def begin(network: Network, settings: Settings, corpora: list[Corpus]) -> None:
    """Give a new network what it must know of the training takes, or all the weights of the checkpoint to start with.

    InputError where there is no such checkpoint, or its weights are those of another shape.
    """
    if not settings.start:
        drawn = [corpus.starts("train", network.frames, 1, pad=True) for corpus in corpora]
        share = max(1, MEASURED // len(corpora))
        windows = [corpus.windows(evenly(starts, share), network.frames) for corpus, starts in zip(corpora, drawn)]
        network.measure(*(np.concatenate(each) for each in zip(*windows)))
        return
    found = load_network(settings.start)
    try:
        network.load_state_dict(found.state_dict())
    except RuntimeError:
        was = [f"{name} {value}" for name, value in asdict(found.config).items()
               if value != getattr(network.config, name, None)]  # fmt: skip
        raise InputError(f"these are not weights of this {network.name}", where=settings.start,
                         hint=f"it was made with {', '.join(was)}" if was else "") from None  # fmt: skip


def in_use(folder: Path) -> bool:
    """Whether a folder, or a file, is there and holds more than a killed run's first unfinished file."""
    return folder.exists() and (not folder.is_dir() or any(each.suffix != ".part" for each in folder.iterdir()))


def together(accelerator: Accelerator, work: Callable[[], Settings]) -> Settings:
    """What `work` returns or raises in the main process, in all of them."""
    outcome: list[Any] = [None]
    if accelerator.is_main_process:
        try:
            outcome = [work()]
        except (InputError, OSError) as error:
            outcome = [error]
    if accelerator.num_processes > 1:
        broadcast_object_list(outcome)
    if isinstance(outcome[0], Exception):
        raise outcome[0]
    return outcome[0]


def data_of(corpora: list[Corpus]) -> list[str]:
    return [f"{corpus.name} {corpus.sha256}" for corpus in corpora]


def machine(device: torch.device) -> str:
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    from ..benchmark.provenance import machine

    return machine()


@contextlib.contextmanager
def signals() -> Iterator[list[int]]:
    """A list that gets the signal when the user or the machine asks to stop; a second one stops at once."""
    heard: list[int] = []
    before: dict[int, Any] = {}

    def hear(signum: int, _: object) -> None:
        heard.append(signum)
        print("motionmend: stopping after this step", file=sys.stderr, flush=True)
        restore()

    def restore() -> None:
        for signum, handler in before.items():
            signal.signal(signum, handler)

    with contextlib.suppress(ValueError):  # not in the main thread: whoever runs us there stops us
        for signum in (signal.SIGINT, signal.SIGTERM):
            before[signum] = signal.signal(signum, hear)
    try:
        yield heard
    finally:
        restore()


def leave(status: int) -> None:
    """End this process here and now, if it is one of several; otherwise do nothing.

    All is written by then. Threads that torch.distributed leaves behind, taken down with the interpreter, abort one end
    in twenty on a busy machine, and the launcher then calls the whole run a failure.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
