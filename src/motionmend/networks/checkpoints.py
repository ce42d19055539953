"""Checkpoints: a folder holds a network ready to run (`model.onnx`) and to train on (`model.safetensors`).

`config.json` describes it and holds the SHA-256 of the other files; `README.md` is its model card. A name is the name
of a folder in `$MOTIONMEND_MODELS` (several folders as in `$PATH`), in the user's data folder, or in the package.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, nearest_names
from ..io import sha256_of
from ..motion import Skeleton
from .spaces import SPACES
from .windows import LONGEST

if TYPE_CHECKING:
    from .models.network import Network

CONFIG, GRAPH, WEIGHTS, CARD = "config.json", "model.onnx", "model.safetensors", "README.md"
VERSION = 1
PATH_VARIABLE = "MOTIONMEND_MODELS"


@dataclass(frozen=True)
class Description:
    """What must be known of a network to run it.

    network : its name, or `package.module:Class`.
    space : how positions become its inputs and come back, a name in `spaces.SPACES`.
    fps, frames : of its windows; `any_length` where the graph takes other numbers of frames too.
    generative, noise_size : whether it has many answers, one for each noise `(noise_size,)`.
    longest : share of a window that a gap of the whole body may take.
    """

    network: str
    space: str
    fps: float
    frames: int
    skeleton: Skeleton
    generative: bool = False
    noise_size: int = 0
    any_length: bool = False
    longest: float = LONGEST

    @classmethod
    def of(cls, network: Network, skeleton: Skeleton, address: str = "") -> Description:
        """Of a torch network. `address` is the name it is found by, where that is not its own."""
        return cls(
            address or network.name, network.space, float(network.fps), int(network.frames), skeleton,
            network.generative, int(network.noise_size), bool(network.any_length), float(network.longest),
        )  # fmt: skip


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint folder whose files are what they were when it was written.

    config : the network's own, as its dataclass's fields.
    budget : what training it took: steps, batch, seconds, machine, corpus, …
    validation : metric → value.
    """

    path: Path
    description: Description
    config: dict[str, Any]
    budget: dict[str, Any]
    validation: dict[str, float]

    @property
    def name(self) -> str:
        """As it is asked for."""
        return name_of(self.path)

    @property
    def summary(self) -> str:
        """The training in one phrase, for the footnote of a table."""
        told = self.budget
        steps = f"{told['steps']:,} steps" if isinstance(told.get("steps"), int) else ""
        if steps and told.get("steps of the run", told["steps"]) != told["steps"]:
            steps += f" (the best of {told['steps of the run']:,})"
        batch = f"of {told['batch']} windows" if told.get("batch") else ""
        hours = f"in {span(told['seconds'])}" if isinstance(told.get("seconds"), int | float) else ""
        machine = f"on {told['machine']}" if told.get("machine") else ""
        corpus = f"({told['corpus']})" if told.get("corpus") else ""
        began = f"from {told['began with']}" if told.get("began with") else ""
        return " ".join(part for part in (steps, batch, hours, machine, corpus, began) if part)


def folders() -> list[Path]:
    """Where names are looked for, in this order."""
    named = [Path(each).expanduser() for each in os.environ.get(PATH_VARIABLE, "").split(os.pathsep) if each]
    return [*named, _data_folder() / "motionmend" / "models", Path(__file__).parents[1] / "weights"]


def _data_folder() -> Path:
    """Where programs keep a user's data on this system."""
    home = Path.home()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local"))
    if sys.platform == "darwin":
        return home / "Library" / "Application Support"
    return Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")


def installed() -> list[Path]:
    """The folders of all checkpoints that have a name, by name; of several with one name the one that is found.

    A folder of training runs will do: each goes by its run's name.
    """
    found: dict[str, Path] = {}
    for folder in folders():
        for each in sorted(folder.glob("[!.]*")):
            for path in (each, each / "export"):
                if (path / CONFIG).is_file():
                    found.setdefault(name_of(path), path)
    return [found[name] for name in sorted(found)]


def names() -> list[str]:
    """The names of all installed checkpoints."""
    return [name_of(path) for path in installed()]


def name_of(path: Path) -> str:
    """A checkpoint's name: its folder's, or that of the run whose export it is."""
    path = Path(os.path.abspath(path))  # noqa: PTH100  not resolved: a link has the name that was given to it
    return path.parent.name if path.name == "export" else path.name


def find(name_or_path: str | os.PathLike) -> Path:
    """The checkpoint folder of this path (a training run's stands for its export) or installed name.

    Raises
    ------
    InputError : if there is none; it lists what is installed.
    """
    path = Path(name_or_path).expanduser()
    for folder in (path, path / "export"):
        if (folder / CONFIG).is_file():
            return folder
    if path.is_dir():
        expected = "a checkpoint, or a run that has exported one"
        raise InputError(f"this folder holds no {CONFIG}", where=path, expected=expected)
    if path.is_file():
        raise InputError("this is a file", where=path, expected="the checkpoint's folder")
    known = {name_of(folder): folder for folder in installed()}
    if str(name_or_path) in known:
        return known[str(name_or_path)]
    hint = "no network is installed; give a checkpoint's path"
    if known:
        hint = f"installed: {', '.join(known)}; {nearest_names(str(name_or_path), known)}"
    raise InputError(f"no network or checkpoint is named {os.fspath(name_or_path)!r}", hint=hint)


def load(name_or_path: str | os.PathLike) -> Checkpoint:
    """Find a checkpoint, read its description and check that none of its files was changed or cut short.

    Raises
    ------
    InputError : if there is none, or it is damaged.
    """
    path = find(name_or_path)
    where = path / CONFIG
    again = "copy or export the checkpoint again"
    try:
        table = json.loads(where.read_text("utf-8"))
        version = table["version"]
    except (ValueError, KeyError, TypeError):
        raise InputError("damaged, or no checkpoint's", where=where, hint=again) from None
    if version != VERSION:
        raise InputError(f"version {version}", where=where, expected=f"version {VERSION}", hint="update motionmend")
    try:
        skeleton = Skeleton(tuple(table["skeleton"]["names"]), tuple(table["skeleton"]["parents"]))
        description = Description(
            str(table["network"]), str(table["space"]), float(table["fps"]), int(table["frames"]), skeleton,
            bool(table["generative"]), int(table["noise_size"]), bool(table["any_length"]),
            float(table.get("longest", LONGEST)),
        )  # fmt: skip
        sums = {name: str(table["sha256"][name]) for name in (GRAPH, WEIGHTS)} | dict(table["sha256"])
        checkpoint = Checkpoint(path, description, *(dict(table[key]) for key in ("config", "budget", "validation")))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"damaged: {error!r}", where=where, hint=again) from None
    if description.space not in SPACES:
        raise InputError(f"its space {description.space!r} is not known", where=where, hint="update motionmend")
    for name, expected in sums.items():
        file = path / Path(name).name
        if not file.is_file():
            raise InputError("the checkpoint lacks this file", where=file, hint=again)
        if sha256_of(file) != expected:
            raise InputError("the file is not the one that was exported", where=file, hint=again)
    return checkpoint


def load_network(name_or_path: str | os.PathLike) -> Network:
    """The torch network with a checkpoint's weights, in evaluation mode, to train on. Needs torch.

    Raises
    ------
    InputError : as `load`; and if torch or the network's code is not installed, or is not that of these weights.
    """
    checkpoint = load(name_or_path)
    from .models import network_class

    kind = network_class(checkpoint.description.network)
    from safetensors.torch import load_file

    # JSON knows lists only; a frozen dataclass holds tuples.
    config = {name: tuple(value) if isinstance(value, list) else value for name, value in checkpoint.config.items()}
    try:
        network = kind(kind.Config(**config), len(checkpoint.description.skeleton))
        network.load_state_dict(load_file(checkpoint.path / WEIGHTS))  # halves are cast to what the network holds
    except (TypeError, RuntimeError) as error:
        raise InputError(f"{kind.name} does not fit these weights: {error}", where=checkpoint.path) from None
    return network.eval()


def span(seconds: float) -> str:
    """A time in words, with the two largest units: "2 h 10 min"."""
    seconds = round(seconds)
    minutes, hours = seconds // 60, seconds // 3600
    if seconds < 60:
        return f"{seconds:.0f} s"
    if hours < 1:
        return f"{minutes:.0f} min {seconds % 60:.0f} s"
    if hours < 24:
        return f"{hours:.0f} h {minutes % 60:.0f} min"
    return f"{hours // 24:.0f} d {hours % 24:.0f} h"
