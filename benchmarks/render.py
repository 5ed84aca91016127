"""Measures the native renderer's speed, its ratio to the machine's bound, and the quality of the images.

    python benchmarks/render.py                                # a few minutes: one option varied at a time
    python benchmarks/render.py --scene kitchen --batch 128    # one scene, another batch
    python benchmarks/render.py --full                         # every combination
    python benchmarks/render.py --against benchmarks/results/FILE.json

Options are varied one at a time on the first scene, while the others keep their first value. Every row is measured
exact and at each tolerance. Scenes that are not found are left out. All rows take turns, round by round.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args

from figure import Bar, draw, tolerance_name
from machine import Machine, measured_machine
from measure import FRAMES, timed
from plan import Mode, Renderers, planned
from quality import judged
from record import RESULTS, print_markdown, today, write_json
from scenes import NAMES, chosen
from tqdm import tqdm


@dataclass(frozen=True)
class Result:
    """One row of the table. Times are per core and frame; counts are means over frames, and qualities over views."""

    scene: str
    sh_degree: int
    mode: str
    tolerance: float
    width: int
    height: int
    batch: int
    threads: int
    gaussians: int
    frames_per_second: float
    slowest: float
    fastest: float
    project_ms: float
    sort_ms: float
    blend_ms: float
    other_ms: float  # writing pixels, starting and joining threads, waiting for a core
    projected: int
    visible: int
    blended: int
    bound_flops_ms: float
    bound_bytes_ms: float
    bound_ratio: float
    exact_mean_db: float
    exact_worst_db: float
    true_mean_db: float  # against the exact antialiased image, supersampled
    true_worst_db: float


ROW = ("scene", "sh_degree", "mode", "tolerance", "width", "height", "batch", "threads")
"""Fields in which rows of two runs must agree to be compared."""


def print_table(results: Sequence[Result], before: dict[tuple[Any, ...], float] | None) -> None:
    """Print the results as Markdown; ``before`` holds the frames/s of an earlier run by the fields of ``ROW``."""
    header = ["scene", "SH", "mode", "detail", "batch", "threads", "frames/s (slowest to fastest)"]
    header += ["ms: project + sort + blend + other", "projected", "visible", "blended", "bound ms", "× bound"]
    header += ["dB to exact, mean / worst", "dB to 8×, mean / worst"]
    header += [] if before is None else ["new / old"]
    rows = []
    for r in results:
        stages = " + ".join(f"{ms:.3f}" for ms in (r.project_ms, r.sort_ms, r.blend_ms, r.other_ms))
        row = [r.scene, str(r.sh_degree), r.mode, tolerance_name(r.tolerance), str(r.batch), str(r.threads)]
        row += [f"{r.frames_per_second:,.0f} ({r.slowest:,.0f} to {r.fastest:,.0f})", stages]
        row += [f"{count:,}" for count in (r.projected, r.visible, r.blended)]
        row += [f"{r.bound_flops_ms + r.bound_bytes_ms:.3f}", f"{r.bound_ratio:.2f}"]
        row += [f"{r.exact_mean_db:.1f} / {r.exact_worst_db:.1f}" if r.tolerance else "–"]
        row += [f"{r.true_mean_db:.1f} / {r.true_worst_db:.1f}"]
        if before is not None:
            old = before.get(tuple(asdict(r)[name] for name in ROW))
            row.append("–" if old is None else f"{r.frames_per_second / old:.2f}")
        rows.append(row)
    print_markdown(header, rows)


def earlier(path: Path, machine: Machine) -> dict[tuple[Any, ...], float]:
    """Read the frames/s of an earlier run by the fields of ``ROW``; rows of old files without them are left out."""
    record = json.loads(path.read_text())
    theirs = record["machine"].get("processor")
    if theirs != machine.processor:
        print(f"{path.name} is from another processor ({theirs}), so ratios also compare the machines")
    rows = [row for row in record["results"] if all(name in row for name in ROW)]
    return {tuple(row[name] for name in ROW): row["frames_per_second"] for row in rows}


def parsed() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", default=list(NAMES), help=f"{', '.join(NAMES)}, or a splat file (z up)")
    parser.add_argument("--mode", nargs="+", default=list(get_args(Mode)), choices=get_args(Mode))
    parser.add_argument("--tolerance", nargs="*", type=float, default=[0.5, 1.0], help="pixels; exact is included")
    parser.add_argument("--sh", nargs="+", type=int, default=[3, 0], help="SH degrees, up to that of the scene")
    parser.add_argument("--batch", nargs="+", type=int, default=[64, 1, 16, 256], help="cameras per call")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--size", nargs=2, type=int, default=[64, 64], metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--views", type=int, default=256, help="number of views compared with exact ones")
    parser.add_argument("--fine-views", type=int, default=32, help="number of these compared with supersampled ones")
    parser.add_argument("--full", action="store_true", help="measure every combination of the options")
    parser.add_argument("--against", type=Path, help="JSON file of an earlier run to compare with")
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-render.json")
    parser.add_argument("--png", type=Path, default=RESULTS / f"{today()}-cpu-render.png")
    return parser.parse_args()


def main() -> None:
    """Measure, judge and print."""
    options = parsed()
    machine = measured_machine()
    print(machine)
    before = None if options.against is None else earlier(options.against, machine)
    subjects = chosen(options.scene)
    most = max(options.views, FRAMES, *options.batch)
    views = {name: subject.room.views(most, *options.size) for name, subject in subjects.items()}
    setups = planned(subjects, options)
    looks = list(dict.fromkeys(setup.look for setup in setups))
    renderers = Renderers(subjects)
    for look in tqdm(looks, desc="building"):
        renderers[look].threads = machine.cores
    qualities, comparisons = judged(
        looks, renderers, {n: v[: options.views] for n, v in views.items()}, options.fine_views
    )
    rows = timed(setups, renderers, views, machine, options.rounds)
    results = []
    for setup in setups:
        to_exact, to_truth = qualities[setup.look]
        results.append(
            Result(
                **setup.look._asdict(),
                width=options.size[0],
                height=options.size[1],
                batch=setup.batch,
                threads=setup.threads,
                gaussians=len(subjects[setup.look.scene].scene.gaussians.means),
                **rows[setup],
                exact_mean_db=to_exact.mean_db,
                exact_worst_db=to_exact.worst_db,
                true_mean_db=to_truth.mean_db,
                true_worst_db=to_truth.worst_db,
            )
        )
    print_table(results, before)
    mode, batch, threads = options.mode[0], options.batch[0], options.threads[0]
    base = [r for r in results if (r.mode, r.batch, r.threads) == (mode, batch, threads)]
    degrees = {name: max(r.sh_degree for r in base if r.scene == name) for name in subjects}
    fields = Bar.__dataclass_fields__
    bars = [Bar(**{name: getattr(r, name) for name in fields}) for r in base if r.sh_degree == degrees[r.scene]]
    title = (
        f"{options.size[0]}×{options.size[1]} pixels, {mode}, batches of {batch}, {threads} of {machine.cores} cores"
    )
    draw(bars, comparisons, title, options.png)
    print(f"drawn to {options.png}")
    if options.json:
        print(f"written to {write_json('render', machine, results)}")


if __name__ == "__main__":
    main()
