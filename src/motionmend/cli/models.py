"""The verb `models`: the trained networks that are installed."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from ..errors import InputError
from ..networks.models import NETWORKS


@dataclass(frozen=True, kw_only=True)
class Models:
    """List the trained networks that are installed, and those that can be trained."""

    def run(self) -> int:
        from ..networks.checkpoints import folders, installed, load

        rows = [("name", "network", "window", "training", "folder")]
        damaged = []
        for path in installed():
            try:
                model = load(path)
            except InputError as error:
                damaged.append(error)
                continue
            about = model.description
            rows.append((model.name, about.network, f"{about.frames} at {about.fps:g} fps", model.summary, str(path)))
        if len(rows) > 1 or damaged:
            widths = [max(map(len, column)) for column in zip(*rows)]
            for row in rows:
                print("  ".join(word.ljust(width) for word, width in zip(row, widths)).rstrip())
        else:
            print("no network is installed; looked in " + ", ".join(map(str, folders())))
        if NETWORKS:
            print("can be trained: " + ", ".join(NETWORKS))
        for error in damaged:
            print(f"motionmend: {error}", file=sys.stderr)
        return 1 if damaged else 0
