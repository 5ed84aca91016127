"""Measures the GPU path from end to end, in under eight minutes.

    python benchmarks/gpu.py                 # with an NVIDIA GPU; writes JSON and PNG to benchmarks/results
    python benchmarks/gpu.py --only rendering collision
    python benchmarks/gpu.py --only town     # frames/s in the generated town, which is made first if it is new
    python benchmarks/gpu.py --dry-run       # anywhere: tiny, emulated, not saved; shows that it runs

Every section is a process of its own, with its share of the time. One that fails, crashes or hangs is reported and does
not affect the others, what it had found by then is kept, and the exit status is 1. The JSON is written anew after each
section. The captured kitchen is left out where SPLATRL_SCENES has none, gsplat where it is not installed and compiled.
"""

import argparse
import faulthandler
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from gpu_bench import Bench, DryRun
from gpu_collision import collision
from gpu_device import UNKNOWN, Machine
from gpu_figure import draw
from gpu_first_use import first_use
from gpu_fit import fitting
from gpu_reach import Target, targets
from gpu_render import gsplat, gsplat_missing, rendering
from gpu_sections import Section, run_section
from gpu_tables import print_tables
from gpu_town import in_town
from gpu_training import stepping, training
from record import RESULTS, today, write_json

MACHINE = "machine"
"""The section that is always run, and first."""
TOWN = "town"
"""The section that is run where it is named, and in a dry run."""
SECONDS = {
    MACHINE: 15,
    "first use": 35,
    "rendering": 130,
    "collision": 60,
    "stepping": 60,
    "training": 60,
    "fit": 30,
    "gsplat": 65,
    TOWN: 240,
}
"""Time limit of each section, in this order; what one does not use goes to those after it."""
SPARE = 20
"""Seconds that a section may run beyond that before it is killed: together with ``SECONDS``, under 8 minutes
without the town."""

DRY = "DRY RUN: emulated on a CPU, and no number here is a measurement"


def sections(bench: Bench, machine: Machine) -> dict[str, Callable[[], None]]:
    """The sections that can be measured, by the names in ``SECONDS``."""
    dry = isinstance(bench, DryRun)
    return {
        MACHINE: lambda: bench.keep(bench.machine()),
        "first use": lambda: first_use(bench),
        "rendering": lambda: rendering(bench, machine),
        "collision": lambda: collision(bench),
        "stepping": lambda: stepping(bench),
        "training": lambda: training(bench),
        "fit": lambda: fitting(bench),
        "gsplat": lambda: gsplat(bench, None if dry else gsplat_missing()),
        TOWN: lambda: in_town(bench),
    }


def bench_of(dry: bool) -> Bench:
    """An empty bench; it does not touch the GPU yet."""
    return DryRun() if dry else Bench(torch.device("cuda", 0))


def machine_of(bench: Bench) -> Machine:
    """The machine among the results."""
    return next(iter(bench.found(Machine)), UNKNOWN)


def measure(name: str, dry: bool, folder: Path, ends: float) -> None:
    """Run a section in this process.

    Args:
        name: of the section.
        dry: whether this is a dry run.
        folder: holds what sections find, each in a file of its own, which is complete after every result.
        ends: when the section must be over, by ``time.monotonic``.
    """
    before = bench_of(dry)
    before.read(folder / MACHINE)
    bench = bench_of(dry)
    bench.file, bench.ends = folder / name, ends
    sections(bench, machine_of(before))[name]()


def measure_apart(name: str, dry: bool, folder: Path, ends: float, bench: Bench) -> None:
    """Run a section in a process of its own, and report how it ended. See ``measure``."""
    command = [sys.executable, __file__, "--section", name, str(folder), str(ends), *(["--dry-run"] if dry else [])]
    section, said = run_section(name, command, ends + SPARE - time.monotonic())
    bench.keep(section)
    if not section.done:
        bench.notes.append(f"{name}: {section.ending}\n{said}")


class Run:
    """A run of some sections, whose results are complete on disk after each.

    Args:
        dry: whether this is a dry run.
        folder: for ``<date>-<device>-gpu.json`` and ``.png``.
        commit: that is measured; None asks git.
    """

    def __init__(self, dry: bool, folder: Path, commit: str | None) -> None:
        self.dry, self.folder, self.commit = dry, folder, commit
        self.bench = bench_of(dry)

    def go(self, names: list[str]) -> None:
        """Run sections until all are over, or until it is interrupted."""
        planned = time.monotonic()
        with tempfile.TemporaryDirectory() as found:
            for name, seconds in SECONDS.items():
                if name not in (MACHINE, *names):
                    continue
                planned += seconds
                print(f"\n{name} ...", flush=True)
                try:
                    measure_apart(name, self.dry, Path(found), planned, self.bench)
                except KeyboardInterrupt:
                    self.bench.note(f"{name}: interrupted, and with it the run")
                    break
                finally:
                    self.bench.read(Path(found) / name)
                    self.write()
                if name == MACHINE:
                    print(machine_of(self.bench), flush=True)

    def write(self) -> tuple[Path, list[Target]]:
        """Write all that was found so far; returns the file, and how close the targets are."""
        machine, reach = machine_of(self.bench), targets(self.bench)
        results = [*(one for one in self.bench.results if not isinstance(one, Machine)), *reach]
        return write_json("gpu", machine, results, machine.slug, self.folder, self.commit, self.bench.notes), reach

    def finish(self) -> None:
        """Print the tables, and draw the picture."""
        path, reach = self.write()
        print_tables(self.bench, reach)
        size = self.bench.sizes.pixels
        title = f"{machine_of(self.bench).name}, {size}×{size} pixels, {today()}"
        draw(self.bench, reach, f"{DRY}\n{title}" if self.dry else title, path.with_suffix(".png"))
        print(f"{path} and {path.with_suffix('.png').name}")


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dry-run", action="store_true", help="on the CPU, by the tests' emulator, at tiny sizes")
    parser.add_argument("--only", nargs="+", choices=list(SECONDS), metavar="SECTION")
    parser.add_argument("--folder", type=Path, help="for <date>-<device>-gpu.json and .png; default benchmarks/results")
    parser.add_argument("--commit", help="the commit that is measured, if the checkout does not know it")
    parser.add_argument("--section", nargs=3, help=argparse.SUPPRESS)  # how this program calls itself: see measure
    return parser.parse_args()


def main() -> int:
    """Measure, print and save."""
    options, begun = parsed(), time.monotonic()
    if options.section:
        name, folder, ends = options.section
        faulthandler.enable()
        faulthandler.dump_traceback_later(max(1.0, float(ends) + SPARE - 1 - begun))  # where it hangs
        measure(name, options.dry_run, Path(folder), float(ends))
        return 0
    if not (options.dry_run or torch.cuda.is_available()):
        print("no CUDA device: nothing was measured; --dry-run shows that everything runs")
        return 1
    folder = options.folder or (Path(tempfile.mkdtemp()) if options.dry_run else RESULTS)
    if options.dry_run:
        if folder.resolve() == RESULTS:
            raise SystemExit("--folder: expected a folder other than that of results for a dry run")
        print(DRY)
    run = Run(options.dry_run, folder, options.commit)
    run.go(options.only or [name for name in SECONDS if name != TOWN or options.dry_run])
    run.finish()
    failed = [section.name for section in run.bench.found(Section) if not section.done]
    print(f"{time.monotonic() - begun:.0f} s in all" + (f"; failed: {', '.join(failed)}" if failed else ""))
    return 1 if failed else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # what was found is written, and the section killed
    sys.exit(main())
