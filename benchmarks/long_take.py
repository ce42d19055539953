"""A ten-minute take at 120 Hz, inspected and repaired: seconds and memory of whole commands.

    python benchmarks/long_take.py [--frames 72000] [--take walk.bvh]

The frames of a BVH (the bundled walk by default) are laid end to end, forwards and backwards in turn so that there is
no jump where they meet; gaps, a lost arm, a jump and dropouts are planted. Each command runs as a process of its own.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

from shared import head, here, options, row

import motionmend

LIMITS = {"seconds": 30, "MB": 1500}


def run(*arguments: str) -> tuple[float, float]:
    """Seconds and peak resident MB of one command."""
    began = time.perf_counter()
    child = os.fork()
    if child == 0:
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        os.execv(sys.executable, [sys.executable, "-m", "motionmend", *arguments])
    _, status, usage = os.wait4(child, 0)
    if status:
        raise SystemExit(f"{' '.join(arguments)} ended with {os.waitstatus_to_exitcode(status)}")
    return time.perf_counter() - began, usage.ru_maxrss / 1024


def main() -> None:
    bundled = Path(motionmend.__file__).parent / "examples" / "walk.bvh"
    told = options(__doc__, take=bundled, frames=72_000)
    lines = told.take.read_bytes().splitlines(keepends=True)
    first = next(number for number, line in enumerate(lines) if line.startswith(b"Frame Time")) + 1
    rows = lines[first + 1 :]  # without the calibration pose in front
    there_and_back = rows + rows[::-1]
    rows = (there_and_back * (told.frames // len(there_and_back) + 1))[: told.frames]
    lines[first - 2] = f"Frames: {told.frames}\n".encode()

    with tempfile.TemporaryDirectory() as folder:
        long, broken, fixed = (str(Path(folder) / f"{name}.bvh") for name in ("long", "broken", "fixed"))
        Path(long).write_bytes(b"".join(lines[:first] + rows))
        damage = ["--gap", "1000:1060", "--gap", "30000:30050", "--lost", "LeftArm,LeftForeArm:5000:5060"]
        damage += ["--jump", "Head:9000:9002", "--dropout", "0.01", "--seed", "1"]
        print(head("command", "seconds", "peak MB"))
        for command in (
            ["inspect", long],
            ["damage", long, "-o", broken, *damage],
            ["inspect", broken],
            ["repair", broken, "-o", fixed],
        ):
            seconds, megabytes = run(*command)
            print(row(f"{command[0]} {Path(command[1]).name}", f"{seconds:.1f}", f"{megabytes:.0f}"))
        print(f"\n{told.frames} frames, {Path(long).stat().st_size / 1e6:.0f} MB of BVH; limits: {LIMITS}; {here()}")


if __name__ == "__main__":
    main()
