"""The command line: which verb is meant, and the exit status."""

from __future__ import annotations

import importlib
import io
import os
import sys
from collections.abc import Sequence
from dataclasses import make_dataclass
from typing import Any

import tyro
from tyro.conf import FlagCreatePairsOff

from .. import __version__
from ..errors import InputError
from .common import complain

# What the list of commands says of each verb. A verb is one file of this folder, imported when it is asked for, with a
# class of its own name, or a function `parsed` where there is more to its command line than one class.
VERBS = {
    "inspect": "Say what is in a take, which rig it is, and what is untrusted and why. Changes nothing.",
    "repair": "Find what is damaged in takes and repair it, or repair what you name; touch nothing else.",
    "learn": "Remember takes in one file, so that many repairs can learn from them.",
    "damage": "Plant damage in a good take, to try a repair on it. The same seed plants the same damage.",
    "compare": "Measure how far a take is from another: MPJPE, bone lengths, seams, samples that differ.",
    "convert": "Write a take in another format: BVH, C3D, TRC, CSV, NPZ, or GLB for Blender and game engines.",
    "demo": "Repair a bundled damaged take, and write it, its report and a picture into a folder.",
    "animate": "Animate a pose along the paths of some joints.",
    "blend": "Put the motion of some joints from another take into this one.",
    "chain": "Make one motion of several clips, the gaps between them filled.",
    "data": "Build corpora from raw takes, and show what is in them.",
    "benchmark": "Measure methods by the papers' protocols.",
    "train": "Train a network on corpora.",
    "models": "List the trained networks that are installed.",
}


def parsed(argv: Sequence[str]) -> Any:
    """The command that a command line means, with its options."""
    commands: dict[str, Any] = {
        name: make_dataclass(name, (), namespace={"__doc__": told}) for name, told in VERBS.items()
    }
    if argv and argv[0] in VERBS:
        module = importlib.import_module(f".{argv[0]}", __package__)
        if hasattr(module, "parsed"):
            return module.parsed(argv)
        commands = {argv[0]: getattr(module, argv[0].capitalize())}
    return tyro.extras.subcommand_cli_from_dict(
        commands, prog="motionmend", args=argv, config=(FlagCreatePairsOff,),
        description="Repair human motion capture, and touch nothing else.",
    )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0, 1 when any file failed, 2 for a wrong command line."""
    argv = list(sys.argv[1:] if argv is None else argv)
    if argv == ["--version"]:
        print(f"motionmend {__version__}")
        return 0
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot show "←" shows "?"
    try:
        status = parsed(argv).run()
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader (`head`, `less`) has seen enough. Python would complain again when it closes stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (InputError, OSError, MemoryError) as error:
        return complain(error)
    except KeyboardInterrupt:
        print("motionmend: stopped; nothing half-written is left", file=sys.stderr)
        return 130
