"""How long small commands take to start, beside an interpreter that does nothing.

    python benchmarks/startup.py
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from pathlib import Path

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

best = dict.fromkeys(COMMANDS, float("inf"))
for _ in range(TIMES):
    for name, arguments in COMMANDS.items():
        began = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        best[name] = min(best[name], time.perf_counter() - began)
print("| command | seconds |\n|---|---|")
for name, seconds in best.items():
    print(f"| `{name}` | {seconds:.2f} |")
print(f"\nBest of {TIMES}; {os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}")
