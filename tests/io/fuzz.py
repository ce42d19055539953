"""Mutation fuzzing of the readers: damaged files must load or be refused with one clear error, quickly.

    python tests/io/fuzz.py --files 100000 --seed 1

Small good files of every format are mutated (bytes flipped, cut, doubled, moved; numbers replaced by hostile
ones; files truncated or spliced) and given to `motionmend.load`. Anything but a Take or an InputError is a
failure: another exception, a warning, a crash of the process, more than 5 s, more than 1 GB. Failing files are
kept. Prints one row a format; exit status 1 if anything failed.
"""

from __future__ import annotations

import argparse
import collections
import io
import multiprocessing
import resource
import signal
import sys
import tempfile
import time
import warnings
import zipfile
from pathlib import Path

import numpy as np

import motionmend as mm
from motionmend.io import FORMATS

HOSTILE = b"nan inf -1 0 1e308 99999999999999999999 2147483648 - , { } \x00 \xff".split(b" ")
SECONDS, BYTES = 5, 1 << 30


def seeds(folder: Path) -> list[Path]:
    """One small good file or more of every format that is read."""
    walk = mm.load(Path(mm.__file__).parent / "examples" / "walk.bvh")
    text = Path(walk.source).read_bytes().splitlines(keepends=True)
    start = next(index for index, line in enumerate(text) if line.startswith(b"Frame Time"))
    bvh = folder / "seed.bvh"
    bvh.write_bytes(b"".join(text[: start + 13]).replace(b"Frames: 359", b"Frames: 12"))
    small = mm.load(bvh, unit="asf")
    made = [bvh]
    for name, format in FORMATS.items():
        if format.reads and format.writes and name != "bvh":
            made.append(mm.save(small, folder / f"seed{format.suffixes[0]}"))
    (folder / "seed.asf").write_text(ASF)
    amc = folder / "seed.amc"
    amc.write_text(AMC)
    return [*made, amc]


ASF = """:version 1.10
:name VICON
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name lfemur
     direction 0.34202 -0.939693 0
     length 6.57749
     axis 0 0 20 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
     id 2
     name ltibia
     direction 0.34202 -0.939693 0
     length 7.94618
     axis 0 0 20 XYZ
    dof rx
    limits (-10.0 170.0)
  end
:hierarchy
  begin
    root lfemur
    lfemur ltibia
  end
"""
AMC = "#!OML:ASF\n:FULLY-SPECIFIED\n:DEGREES\n" + "".join(
    f"{frame}\nroot 1.0 {16 + frame / 10} -34.8 12.4 1.2 -0.9\nlfemur -23.3 {frame} -22.4\nltibia 30.08\n"
    for frame in range(1, 7)
)


def mutate(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """One random change or a few."""
    buffer = bytearray(data)
    for _ in range(rng.geometric(0.6)):
        if not buffer:
            break
        at, span = int(rng.integers(len(buffer))), int(rng.integers(1, 40))
        kind = rng.integers(8)
        if kind == 0:
            buffer[at] = rng.integers(256)
        elif kind == 1:
            buffer[at] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            del buffer[at : at + span]
        elif kind == 3:
            buffer[at:at] = buffer[at : at + span] * int(rng.integers(1, 4))
        elif kind == 4:
            del buffer[at:]
        elif kind == 5:
            buffer[at : at + span] = bytes(other[at : at + span])
        elif kind == 6:
            buffer[at : at + int(rng.integers(0, 8))] = HOSTILE[rng.integers(len(HOSTILE))]
        else:
            line = buffer.rfind(b"\n", 0, at) + 1
            end = buffer.find(b"\n", at) + 1 or len(buffer)
            buffer[line:line] = buffer[line:end] if rng.random() < 0.5 else b"\n"
    return bytes(buffer)


def mutate_member(archive: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """The same inside one array of an NPZ, whose checksums would otherwise give almost every change away."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as source, zipfile.ZipFile(out, "w") as target:
        names = source.namelist()
        chosen = names[rng.integers(len(names))]
        for name in names:
            data = source.read(name)
            target.writestr(name, mutate(data, other, rng) if name == chosen else data)
    return out.getvalue()


def too_slow(*_: object) -> None:
    raise TimeoutError(f"more than {SECONDS} s")


def batch(job: tuple[str, str, int, int, str]) -> tuple[str, collections.Counter, list[str]]:
    """Mutate one seed `count` times and load each; returns counts and the failures."""
    seed_path, other_path, count, seed, keep = job
    resource.setrlimit(resource.RLIMIT_AS, (4 * BYTES, 4 * BYTES))
    signal.signal(signal.SIGALRM, too_slow)
    warnings.simplefilter("error")
    source = Path(seed_path)
    data, other = source.read_bytes(), Path(other_path).read_bytes()
    rng = np.random.default_rng(seed)
    counts: collections.Counter = collections.Counter()
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / source.name
        if source.suffix == ".amc":
            skeleton = (source.with_suffix(".asf")).read_bytes()
        for index in range(count):
            inside = source.suffix == ".npz" and index % 2
            broken = mutate_member(data, other, rng) if inside else mutate(data, other, rng)
            trial.write_bytes(broken)
            # Half of the AMC trials keep their frames and get a broken skeleton.
            if source.suffix == ".amc":
                trial.write_bytes(data if index % 2 else broken)
                trial.with_suffix(".asf").write_bytes(mutate(skeleton, other, rng) if index % 2 else skeleton)
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            signal.alarm(SECONDS)
            try:
                mm.load(trial)
                counts["loaded"] += 1
            except mm.InputError:
                counts["refused"] += 1
            except BaseException as error:
                counts["failed"] += 1
                kept = Path(keep) / f"{seed}-{index}-{source.name}"
                kept.write_bytes(broken)
                failures.append(f"{kept}: {type(error).__name__}: {error}")
            finally:
                signal.alarm(0)
            if (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 > BYTES // 4:
                counts["failed"] += 1
                failures.append(f"{seed}-{index}-{source.name}: took much memory")
    return source.suffix, counts, failures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "motionmend-fuzz")
    options = parser.parse_args()
    options.keep.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        made = seeds(Path(folder))
        size = 250
        jobs = [
            (
                str(made[number % len(made)]),
                str(made[(number // len(made)) % len(made)]),
                size,
                options.seed * 10**6 + number,
                str(options.keep),
            )
            for number in range(-(-options.files // size))
        ]
        totals: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
        failures: list[str] = []
        # One process a batch, so that a crash of an extension is one batch's failure and is seen.
        context = multiprocessing.get_context("spawn")
        with context.Pool(maxtasksperchild=20) as pool:
            results = [(job, pool.apply_async(batch, (job,))) for job in jobs]
            for job, result in results:
                try:
                    suffix, counts, failed = result.get(timeout=size * SECONDS)
                except multiprocessing.TimeoutError:
                    suffix, counts = Path(job[0]).suffix, collections.Counter(failed=size)
                    failed = [f"{job}: the process died or hung"]
                totals[suffix] += counts
                failures += failed
    print(f"{'format':8}{'files':>9}{'loaded':>9}{'refused':>9}{'failed':>8}")
    for suffix, counts in sorted(totals.items()):
        print(f"{suffix:8}{sum(counts.values()):9}{counts['loaded']:9}{counts['refused']:9}{counts['failed']:8}")
    print(f"seed {options.seed}, {time.monotonic() - began:.0f} s")
    print(*failures[:50], sep="\n")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
