"""Measures the cost of generated yards: seconds to generate them and to read them from the cache, and bytes on disk.

    python benchmarks/yards.py            # 16 yards, half a minute
    python benchmarks/yards.py --count 64

Yards are generated one after the other in one process, with an empty cache at first.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path
from statistics import median

from splatrl import yards
from splatrl.scenes.yards import Yard


def timed(seeds: list[int]) -> tuple[list[float], list[Yard]]:
    """Return the seconds that each yard took, and the yards."""
    seconds, made = [], []
    for seed in seeds:
        start = time.perf_counter()
        made += yards([seed])
        seconds.append(time.perf_counter() - start)
    return seconds, made


def main() -> None:
    """Generate, read and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=16, help="number of yards")
    seeds = list(range(parser.parse_args().count))
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SPLATRL_CACHE"] = folder
        cold, made = timed(seeds)
        warm, _ = timed(seeds)
        sizes = [path.stat().st_size / 1e6 for path in Path(folder).iterdir()]
    counts = [len(one.scene.gaussians.means) for one in made]
    print("| yards | generated, s: median, max | read, s: all | MB: median, max | Gaussians: min, max |")
    print("|---|---|---|---|---|")
    print(
        f"| {len(seeds)} | {median(cold):.2f}, {max(cold):.2f} | {sum(warm):.2f} "
        f"| {median(sizes):.1f}, {max(sizes):.1f} | {min(counts):,}, {max(counts):,} |"
    )
    blocked, longest = [one.blocked for one in made], [one.longest for one in made]
    print(f"\nblocked {min(blocked):.2f} to {max(blocked):.2f}, longest path {min(longest)} to {max(longest)} steps")


if __name__ == "__main__":
    main()
