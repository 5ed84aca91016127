"""Measures the GPU path from end to end, in one process and under eight minutes.

    python benchmarks/gpu.py                 # with an NVIDIA GPU; writes JSON and PNG to benchmarks/results
    python benchmarks/gpu.py --only rendering collision
    python benchmarks/gpu.py --dry-run       # anywhere: tiny, emulated, not saved; shows that it runs

Every section has its share of the time; one that fails says why and does not affect the others, and the exit status is
then 1. The captured kitchen is left out where SPLATRL_SCENES has none, gsplat where it is not installed and compiled.
"""

import argparse
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from gpu_bench import Bench, DryRun
from gpu_collision import collision
from gpu_device import Machine
from gpu_figure import draw
from gpu_first_use import first_use
from gpu_fit import fitting
from gpu_reach import targets
from gpu_render import gsplat, gsplat_missing, rendering
from gpu_tables import print_tables
from gpu_training import stepping, training
from record import RESULTS, today, write_json

SECONDS = {"first use": 40, "rendering": 130, "collision": 60, "stepping": 60, "training": 60, "fit": 25, "gsplat": 80}
"""Time limit of each section, in this order; what one does not use goes to those after it."""
SPARE = 20
"""Seconds that a section may run beyond that before it is interrupted: together with ``SECONDS``, under 8 minutes."""

DRY = "DRY RUN: emulated on a CPU, and no number here is a measurement"


def sections(bench: Bench, machine: Machine) -> dict[str, Callable[[], None]]:
    """The sections that can be measured, by the names in ``SECONDS``."""
    dry = isinstance(bench, DryRun)
    return {
        "first use": lambda: first_use(bench),
        "rendering": lambda: rendering(bench, machine),
        "collision": lambda: collision(bench),
        "stepping": lambda: stepping(bench),
        "training": lambda: training(bench),
        "fit": lambda: fitting(bench),
        "gsplat": lambda: gsplat(bench, None if dry else gsplat_missing()),
    }


@contextmanager
def interrupted_after(seconds: float) -> Iterator[None]:
    """Raise ``TimeoutError`` if a block takes longer."""

    def raise_timeout(*_: Any) -> None:
        raise TimeoutError(f"took longer than {seconds:.0f} s")

    before = signal.signal(signal.SIGALRM, raise_timeout)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def run(bench: Bench, machine: Machine, names: list[str]) -> list[str]:
    """Run sections; returns the names of those that failed."""
    failed, planned = [], time.monotonic()
    for name, section in sections(bench, machine).items():
        if name not in names:
            continue
        planned += SECONDS[name]
        bench.ends, begun = planned, time.monotonic()
        print(f"\n{name} ...", flush=True)
        try:
            with interrupted_after(planned + SPARE - begun):
                bench.free()
                section()
        except Exception:
            failed.append(name)
            bench.note(f"{name}: failed\n{traceback.format_exc()}")
        print(f"{name}: {time.monotonic() - begun:.0f} s", flush=True)
    return failed


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dry-run", action="store_true", help="on the CPU, by the tests' emulator, at tiny sizes")
    parser.add_argument("--only", nargs="+", default=list(SECONDS), choices=list(SECONDS), metavar="SECTION")
    parser.add_argument("--folder", type=Path, help="for <date>-<device>-gpu.json and .png; default benchmarks/results")
    parser.add_argument("--commit", help="the commit that is measured, if the checkout does not know it")
    return parser.parse_args()


def main() -> int:
    """Measure, print and save."""
    options, begun = parsed(), time.monotonic()
    if not (options.dry_run or torch.cuda.is_available()):
        print("no CUDA device: nothing was measured; --dry-run shows that everything runs")
        return 1
    folder = options.folder or (Path(tempfile.mkdtemp()) if options.dry_run else RESULTS)
    if options.dry_run:
        if folder.resolve() == RESULTS:
            raise SystemExit("--folder: expected a folder other than that of results for a dry run")
        print(DRY)
    bench = DryRun() if options.dry_run else Bench(torch.device("cuda", torch.cuda.current_device()))
    machine = bench.machine()
    print(machine, flush=True)
    failed = run(bench, machine, options.only)
    reach = targets(bench)
    print_tables(bench, reach)
    path = write_json("gpu", machine, [*bench.results, *reach], machine.slug, folder, options.commit, bench.notes)
    title = f"{machine.name}, {bench.sizes.pixels}×{bench.sizes.pixels} pixels, {today()}"
    draw(bench, reach, f"{DRY}\n{title}" if options.dry_run else title, path.with_suffix(".png"))
    print(f"{path} and {path.with_suffix('.png').name}, {time.monotonic() - begun:.0f} s in all")
    if failed:
        print(f"failed: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
