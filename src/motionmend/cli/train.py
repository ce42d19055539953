"""The verb `train`: a network, its options, and the defaults it brings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Optional, get_type_hints

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, Suppress, arg

from ..errors import InputError
from ..networks.models import network_class
from ..training import papers
from ..training.config import Settings, read, settle
from ..training.papers import Data
from .common import Output

File = Annotated[Path | None, arg(metavar="FILE")]


@dataclass(frozen=True, kw_only=True)
class Train(Settings):
    """Train a network on corpora: `motionmend train NAME --corpus cmu.corpus -o runs/NAME`.

    `train NAME --help` also shows the sizes and the defaults of that network.
    """

    name: Positional[str]
    """The network: a registered name, or package.module:Class for one of your own."""
    output: Output
    """The run's folder: settings, checkpoints, logs, samples and, in the end, the exported network."""
    config: File = None
    """A TOML file of options, such as a run's config.toml. Flags win over it, it wins over the network's defaults."""
    paper: Annotated[Optional[Data], arg(metavar="DATA")] = None
    """Train as the network's own paper did on holden, h36m, amass or cmu: its steps, batch, rates, schedule and
    initialisation, and none of our clipping, averaging or structure. --config and flags win over it."""
    resume: bool = False
    """Continue the run in the folder from its last checkpoint, with its settings; start it if there is none."""
    network: Suppress[Any] = None

    def run(self) -> int:
        from ..training.loop import train
        from ..training.runs import leave

        settings = Settings(**{each.name: getattr(self, each.name) for each in fields(Settings)})
        status = train(settings, self.output, resume=self.resume)
        leave(status)
        return status


def parsed(argv: Sequence[str]) -> Any:
    """The command that a command line means, with its options; `argv` begins with the verb."""
    commands = {"train": train_command(argv[1:])}
    # Both --mirror and --no-mirror, whatever a resumed run has; in the help, the one that changes something.
    pairs = (FlagCreatePairsOff,) if {"-h", "--help"} & set(argv) else ()
    return tyro.extras.subcommand_cli_from_dict(commands, prog="motionmend", args=argv, config=pairs)


def train_command(argv: Sequence[str]) -> type[Train]:
    """The class of options for `train` with these arguments, those after the verb.

    It has the named network's own options, and the defaults that the network, its paper, the run to resume and the
    --config file give; so flags are all that is left to win over them. Where no network is named
    (`train --help`) it is the plain class, and nothing heavy is imported.
    """
    if not argv or argv[0] in ("-h", "--help"):
        return Train
    if argv[0].startswith("-"):
        raise InputError(f"{argv[0]} came first", expected="the network: motionmend train NAME --corpus … -o …")
    name = argv[0]
    network = network_class(name)
    layers: list[dict[str, Any]] = []
    if not {"-h", "--help"} & set(argv):
        plain = with_defaults(settle(name, network))
        first = tyro.cli(plain, args=argv, prog="motionmend train")
        saved = first.output / "config.toml"
        layers += [read(saved, name)] if first.resume and saved.is_file() else []
        layers += [read(first.config, name)] if first.config else []
        if first.paper:
            asked = tyro.cli(with_defaults(settle(name, network, *layers)), args=argv, prog="motionmend train")
            layers.insert(0, papers.layer(name, first.paper, asked.network))
        if first.steps != settle(name, network).steps:  # what lasts as long as the training goes by it
            layers.append({"steps": first.steps})
    return with_defaults(settle(name, network, *layers))


def with_defaults(settings: Settings) -> type[Train]:
    """Train, with these settings as its defaults and the network's own options among the others."""
    hints = get_type_hints(Train, include_extras=True) | {"network": type(settings.network)}
    values = {each.name: getattr(settings, each.name) for each in fields(Settings) if each.name != "name"}
    described: list[Any] = [
        (name, hints[name], field(default_factory=lambda value=value: value)) for name, value in values.items()
    ]
    told = {"__doc__": Train.__doc__}
    return make_dataclass("Train", described, bases=(Train,), frozen=True, kw_only=True, namespace=told)
