"""XMAE's options, each changed by itself and trained for the same few steps. Prints a Markdown table.

    python benchmarks/ablations.py --corpus cmu.corpus reactidle.corpus -o runs/ablations [--steps 400] [--batch 32]

The rows are the paper's ablations (Björkstrand et al. 2023, section 5) at a budget that is thousands of times smaller,
so that its findings can be looked for in shape: what hides more, displaces more, or decodes otherwise. The errors are
those of the quick validation, in mm, on validation windows. A run that is there already is not trained again.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
from pathlib import Path

import torch

BASE = {"size": "small"}
VARIANTS: dict[str, dict[str, object]] = {
    "base: 85 % masked, 5 % displaced by up to 1 m, cross, depth 3, small": {},
    "75 % masked": {"masked": 0.75},
    "90 % masked": {"masked": 0.90},
    "none displaced": {"displaced": 0.0},
    "displaced by up to 0.5 m": {"radius": 0.5},
    "displaced by up to 2 m": {"radius": 2.0},
    "MAE decoder": {"decoder": "mae"},
    "BERT": {"decoder": "bert"},
    "decoder depth 1": {"decoder_depth": 1},
    "decoder depth 5": {"decoder_depth": 5},
    "default size": {"size": "default"},
    "curves, poses as tokens (ours)": {
        "curves": "off", "damage": "gaps", "error": "rms", "head": 16, "encoder_depth": 2, "decoder_depth": 2,
    },
}  # fmt: skip


def trained(folder: Path, fields: dict[str, object], options: argparse.Namespace) -> dict[str, float]:
    """The scores of a run with these fields of XMAEConfig, trained now if it was not yet."""
    log = folder / "log.jsonl"
    if not (folder / "export").is_dir():
        flags = [part for name, value in {**BASE, **fields}.items() for part in (f"--network.{name}", str(value))]
        command = [
            sys.executable, "-m", "motionmend", "train", "xmae", "-o", str(folder), "--resume",
            "--corpus", *options.corpus, "--steps", str(options.steps), "--batch", str(options.batch),
            "--lr", str(options.lr), "--seed", str(options.seed), "--validate-every", "0", "--ema", "0.98",
            "--validation-windows", str(options.windows), *flags,
        ]  # fmt: skip
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return next(line["validation"] for line in reversed(lines) if "validation" in line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--corpus", nargs="+", required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--batch", type=int, default=36)
    parser.add_argument("--lr", type=float, default=1e-3)
    parser.add_argument("--windows", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    print(f"{options.steps} steps of {options.batch} windows each, learning rate {options.lr:g}, seed {options.seed}; "
          f"{options.windows} validation windows; {platform.machine()}, torch {torch.__version__}\n")  # fmt: skip
    rows = {}
    for number, (name, fields) in enumerate(VARIANTS.items()):
        rows[name] = trained(options.output / f"{number:02}", fields, options)
        if not number:
            print("| option | " + " | ".join(rows[name]) + " |\n|---|" + "---:|" * len(rows[name]))
        print(f"| {name} | " + " | ".join(f"{value:.1f}" for value in rows[name].values()) + " |", flush=True)


if __name__ == "__main__":
    main()
