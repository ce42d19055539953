"""Options of a network, each changed by itself and trained for the same few steps. Prints a Markdown table.

    python benchmarks/ablations.py xmae --corpus cmu.corpus reactidle.corpus -o runs/ablations
    python benchmarks/ablations.py trajevae --corpus cmu50.corpus reactidle50.corpus -o runs/ablations50

The rows are the papers' ablations (Björkstrand et al. 2023, section 5; Kania et al. 2021, tables 4, 6) at a budget that
is a thousand times smaller, so that their findings can be looked for in shape. XMAE's begin at the curve through what
is seen, TrajeVAE's with our options but its own switches: from scratch, so few steps show only who learns first where a
body's joints are. The errors are those of the quick validation, on validation windows. A run that is there already is
not trained again.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
from pathlib import Path

import torch
from shared import head, parser, row

# network -> what all rows share of the training and of the network's options, and the rows.
TABLES: dict[str, tuple[dict[str, object], dict[str, object], dict[str, dict[str, object]]]] = {
    "xmae": (
        {"batch": 20, "lr": 1e-3, "ema": 0.98},
        {"size": "small", "curves": "on", "head": 16, "encoder_depth": 2, "decoder_depth": 2},
        {
            "base: 85 % masked, 5 % displaced by up to 1 m, cross, decoder depth 2, small": {},
            "75 % masked": {"masked": 0.75},
            "90 % masked": {"masked": 0.90},
            "none displaced": {"displaced": 0.0},
            "displaced by up to 2 m": {"radius": 2.0},
            "decoder depth 1": {"decoder_depth": 1},
            "decoder depth 4": {"decoder_depth": 4},
            "default size": {"size": "default"},
            "damaged as takes are, squared error (ours)": {"damage": "takes", "error": "rms"},
            "joint tokens, not from curves (the paper's)": {"curves": "", "head": 64, "encoder_depth": 6},
            "MAE decoder": {"decoder": "mae"},
            "BERT": {"decoder": "bert"},
        },
    ),
    "trajevae": (
        {"batch": 40, "lr": 1e-3, "ema": 0.98, "schedule": "trapezoid", "clip": 1.0},
        {"size": "small", "dropout": 0.0, "patch": 4, "standardised": True, "along": True, "direct": True, "hips": 1.0,
         "bones": 2.0, "climb": 200, "prior": "standard", "dct": False, "mask_future": False},
        {
            "base: standard prior, no DCT, whole futures": {},
            "+ learnable prior": {"prior": "learned"},
            "+ DCT": {"prior": "learned", "dct": True},
            "+ masked futures": {"prior": "learned", "dct": True, "mask_future": True},
            "all, answers not along the paths": {
                "prior": "learned", "dct": True, "mask_future": True, "along": False,
            },
            "all, steps summed up (the paper's)": {
                "prior": "learned", "dct": True, "mask_future": True, "direct": False,
            },
        },
    ),
}  # fmt: skip


def flag(name: str, value: object) -> str:
    """As `motionmend train` wants it: --network.mirror, --network.no-dct, --network.size=small."""
    name = name.replace("_", "-")
    return f"--network.{'' if value else 'no-'}{name}" if isinstance(value, bool) else f"--network.{name}={value}"


def trained(
    folder: Path, network: str, training: dict[str, object], fields: dict[str, object], options: argparse.Namespace
) -> dict[str, float]:
    """The scores of a run with these fields of the network's options, trained now if it was not yet."""
    if not (folder / "export").is_dir():
        settings = training | {"steps": options.steps, "seed": options.seed, "validate_every": 0}
        settings |= {"validation_windows": options.windows}
        command = [
            sys.executable, "-m", "motionmend", "train", network, "-o", str(folder), "--resume",
            "--corpus", *options.corpus, *(f"--{name.replace('_', '-')}={value}" for name, value in settings.items()),
            *(flag(name, value) for name, value in fields.items()),
        ]  # fmt: skip
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    lines = [json.loads(line) for line in reversed((folder / "log.jsonl").read_text().splitlines())]
    return next(line["validation"] for line in lines if "validation" in line)


def main() -> None:
    line = parser(__doc__, steps=500, windows=64, seed=0)
    line.add_argument("network", choices=list(TABLES))
    line.add_argument("--corpus", nargs="+", required=True)
    line.add_argument("-o", "--output", type=Path, required=True)
    options = line.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    training, shared, rows = TABLES[options.network]
    print(f"{options.network}: {options.steps} steps of {training['batch']} windows each, seed {options.seed}; "
          f"{options.windows} validation windows; {platform.machine()}, torch {torch.__version__}\n")  # fmt: skip
    for number, (name, fields) in enumerate(rows.items()):
        scores = trained(options.output / f"{number:02}", options.network, training, shared | fields, options)
        if not number:
            print(head("option", *scores))
        print(row(name, *(f"{value:.4g}" for value in scores.values())), flush=True)


if __name__ == "__main__":
    main()
