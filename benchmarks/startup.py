"""How long small commands take to start, beside an interpreter that does nothing.

    python benchmarks/startup.py
"""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from pathlib import Path

from shared import best, head, here, options, row

import motionmend

WALK = str(Path(motionmend.__file__).parent / "examples" / "walk.bvh")
COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "python -c 'import motionmend'": ["-c", "import motionmend"],
    "python -c 'import numpy'": ["-c", "import numpy"],
    "motionmend --help": ["-m", "motionmend", "--help"],
    "motionmend inspect walk.bvh": ["-m", "motionmend", "inspect", WALK],
}
TIMES = 15



def run(arguments: list[str]) -> None:
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    options(__doc__)
    print(head("command", "seconds"))
    for name, seconds in best({name: partial(run, arguments) for name, arguments in COMMANDS.items()}, TIMES).items():
        print(row(f"`{name}`", f"{seconds:.2f}"))
    print(f"\nBest of {TIMES}; {here()}")
