"""Networks by name or folder, as Completers."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from ..body.joints import BODY
from ..motion import Skeleton
from . import checkpoints
from .checkpoints import Description
from .runtimes import Graph, Module, Run

if TYPE_CHECKING:
    from .models.network import Network
from .completers import NetworkCompleter
from .generative import GenerativeCompleter


def completer(description: Description, run: Run, *, name: str = "", budget: str = "") -> NetworkCompleter:
    """The Completer that fits a network: a GenerativeCompleter for a generative one."""
    kind = GenerativeCompleter if description.generative else NetworkCompleter
    return kind(description, run, name=name, budget=budget)


def module_completer(network: Network, skeleton: Skeleton = BODY) -> NetworkCompleter:
    """The Completer of a torch network: as its weights are when it is asked, for validation during training."""
    return completer(Description.of(network, skeleton), Module(network))


def load_completer(name_or_path: str | os.PathLike) -> NetworkCompleter:
    """The installed network of this name, or that of a checkpoint's folder, ready for takes. Needs no torch.

    Raises
    ------
    InputError : if there is none, or its files are damaged.
    """
    found = checkpoints.load(name_or_path)
    return completer(found.description, Graph(found.path / checkpoints.GRAPH), name=found.name, budget=found.summary)
