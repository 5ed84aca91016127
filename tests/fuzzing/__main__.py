"""Entry point of ``python -m tests.fuzzing``."""

import argparse
import json
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from tests import fuzzing
from tests.fuzzing.formats import FORMATS
from tests.fuzzing.trials import Counts, try_apart

CHUNK = 2000
"""Files of a format per process."""


def main() -> None:
    """Try files of all formats in rounds, and print the outcomes for each format."""
    command = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=fuzzing.__doc__)
    command.add_argument("formats", nargs="*", help=f"any of {', '.join(FORMATS)}; by default all")
    command.add_argument("--count", type=int, default=1000, help="number of files of each format")
    command.add_argument("--first", type=int, default=0, help="number of the first file")
    command.add_argument("--seed", type=int, default=0)
    command.add_argument("--log", type=Path, help="file to which each process appends a line of JSON")
    options = command.parse_args()
    names = options.formats or list(FORMATS)
    all_counts = {name: Counts() for name in names}
    seconds = dict.fromkeys(names, 0.0)
    last = options.first + options.count
    for first in range(options.first, last, CHUNK):
        for name in names:
            with tempfile.TemporaryDirectory(dir=_memory()) as folder:
                began = time.monotonic()
                counts = try_apart(name, min(CHUNK, last - first), options.seed, Path(folder), first)
                seconds[name] += time.monotonic() - began
            all_counts[name].add(counts)
            for number, text in counts.faults:
                print(f"FAULT {name}, --seed {options.seed} --first {number} --count 1: {text}", flush=True)
            if options.log:
                said = {"format": name, "seed": options.seed, "first": first, "tried": counts.tried, **asdict(counts)}
                with options.log.open("a") as stream:
                    stream.write(json.dumps(said) + "\n")
    for name, counts in all_counts.items():
        print(_row(name, counts), f"{seconds[name]:8.1f} s", flush=True)
    total = Counts()
    for counts in all_counts.values():
        total.add(counts)
    print(_row("all", total))
    raise SystemExit(bool(total.faults))


def _row(name: str, counts: Counts) -> str:
    kinds = f"{counts.header:>9,} refused at the header, {counts.behind:>9,} past it, {counts.read:>9,} read"
    worst = f"{counts.slowest:.2f} s, {counts.memory / 2**20:.0f} MiB"
    return f"{name:<15} {counts.tried:>9,} tried: {kinds}, {len(counts.faults)} faults; {worst}"


def _memory() -> str | None:
    """Return a folder in memory if the system has one, otherwise None."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


if __name__ == "__main__":
    main()
