"""Repair every BVH of a folder and write one line a take into a table; a bad file does not stop the rest.

    python examples/repair_folder.py takes repaired

`motionmend repair takes/*.bvh -o repaired` does the same without the table.
"""

import csv
import sys
from pathlib import Path

import motionmend as mm


def main(source: str, target: str) -> int:
    folder, failed = Path(target), 0
    folder.mkdir(exist_ok=True)
    with (folder / "summary.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["file", "frames", "samples repaired", "samples left", "checks to look at"])
        for path in sorted(Path(source).glob("*.bvh")):
            try:
                fixed = mm.repair(mm.load(path))
                mm.save(fixed, folder / path.name)
            except mm.InputError as error:
                print(error, file=sys.stderr)
                failed += 1
                continue
            report = fixed.report
            look = [name for name, check in report.checks.items() if not check["ok"]]
            left = int((~fixed.trusted).sum())
            table.writerow([path.name, len(fixed), report.repaired, left, " ".join(look)])
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
