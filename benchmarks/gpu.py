"""Measures the GPU path from end to end, in under eight minutes.

    python benchmarks/gpu.py                 # with an NVIDIA GPU; writes JSON and PNG to benchmarks/results
    python benchmarks/gpu.py --only rendering collision
    python benchmarks/gpu.py --only town     # frames/s in the generated town, which is generated first if needed
    python benchmarks/gpu.py --dry-run       # on any machine: tiny, emulated, not saved; shows that everything runs

Every section runs in its own process with its own time limit. A section that fails, crashes or hangs is reported and
does not affect the others; the results that it had found by then are kept, and the exit status is 1. The JSON is
rewritten after each section. The captured kitchen is left out if SPLATRL_SCENES has none, and gsplat if it is not
installed and compiled.
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
"""Section that always runs, before all others."""
TOWN = "town"
"""Section that only runs if it is named, and in dry runs."""
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
"""Time limit of each section, seconds, in the order in which they run; unused time passes to later sections."""
SPARE = 20
"""Seconds beyond its limit after which a section is killed; with ``SECONDS``, a run without the town stays under 8
minutes."""

DRY = "DRY RUN: emulated on a CPU, and no number here is a measurement"


def sections(bench: Bench, machine: Machine) -> dict[str, Callable[[], None]]:
    """Return the function that measures each section, by the names in ``SECONDS``."""
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
    """Make an empty bench, without touching the GPU yet."""
    return DryRun() if dry else Bench(torch.device("cuda", 0))


def machine_of(bench: Bench) -> Machine:
    """Return the machine among the results, or ``UNKNOWN``."""
    return next(iter(bench.found(Machine)), UNKNOWN)


def measure(name: str, dry: bool, folder: Path, ends: float) -> None:
    """Run a section in this process.

    Args:
        name: name of the section.
        dry: whether this is a dry run.
        folder: holds one file of results per section, which is complete after every result.
        ends: deadline of the section, by ``time.monotonic``.
    """
    before = bench_of(dry)
    before.read(folder / MACHINE)
    bench = bench_of(dry)
    bench.file, bench.ends = folder / name, ends
    sections(bench, machine_of(before))[name]()


def measure_apart(name: str, dry: bool, folder: Path, ends: float, bench: Bench) -> None:
    """Run a section in its own process, and record how it ended; arguments as in ``measure``."""
    command = [sys.executable, __file__, "--section", name, str(folder), str(ends), *(["--dry-run"] if dry else [])]
    section, said = run_section(name, command, ends + SPARE - time.monotonic())
    bench.keep(section)
    if not section.done:
        bench.notes.append(f"{name}: {section.ending}\n{said}")


class Run:
    """A run of some sections; all results so far are on disk after each of them.

    Args:
        dry: whether this is a dry run.
        folder: folder for ``<date>-<device>-gpu.json`` and ``.png``.
        commit: commit that is measured; None asks git.
    """

    def __init__(self, dry: bool, folder: Path, commit: str | None) -> None:
        self.dry, self.folder, self.commit = dry, folder, commit
        self.bench = bench_of(dry)

    def go(self, names: list[str]) -> None:
        """Run the named sections until all are done or the run is interrupted."""
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
        """Write all results so far, and return the file and the targets."""
        machine, reach = machine_of(self.bench), targets(self.bench)
        results = [*(one for one in self.bench.results if not isinstance(one, Machine)), *reach]
        return write_json("gpu", machine, results, machine.slug, self.folder, self.commit, self.bench.notes), reach

    def finish(self) -> None:
        """Print the tables, and draw the figure."""
        path, reach = self.write()
        print_tables(self.bench, reach)
        size = self.bench.sizes.pixels
        title = f"{machine_of(self.bench).name}, {size}×{size} pixels, {today()}"
        picture = path.with_suffix(".png")
        draw(self.bench, reach, f"{DRY}\n{title}" if self.dry else title, picture)
        print(f"{path} and {picture.name}" if picture.is_file() else path)


def parsed() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dry-run", action="store_true", help="run on the CPU at tiny sizes, with the tests' emulator")
    parser.add_argument("--only", nargs="+", choices=list(SECONDS), metavar="SECTION", help="sections to run")
    parser.add_argument("--folder", type=Path, help="folder of the JSON and PNG files; default benchmarks/results")
    parser.add_argument("--commit", help="commit that is measured, if this is no git checkout")
    parser.add_argument("--section", nargs=3, help=argparse.SUPPRESS)  # used by this program to run itself; see measure
    return parser.parse_args()


def main() -> int:
    """Measure, print and save."""
    options, begun = parsed(), time.monotonic()
    if options.section:
        name, folder, ends = options.section
        faulthandler.enable()
        faulthandler.dump_traceback_later(max(1.0, float(ends) + SPARE - 1 - begun))  # shows where it hangs
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
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that results are written and the section is killed
    sys.exit(main())
