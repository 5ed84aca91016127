"""First checks on a GPU, from the smallest to the largest; run each in its own process.

    python benchmarks/gpu_steps.py load      # load the renderer's kernels and draw a frame
    python benchmarks/gpu_steps.py thread    # the same for the checker, in threads in which PyTorch has done nothing
    python benchmarks/gpu_steps.py tiny      # a frame and a batch of queries, small enough for compute-sanitizer
    python benchmarks/gpu_steps.py frames    # compare 64 frames of the backyard with the CPU's
    python benchmarks/gpu_steps.py twice     # 4,096 frames must have the same bytes again, and in smaller batches
    python benchmarks/gpu_steps.py launch    # draw 1,024 frames of a million Gaussians three times, for a profiler

A step that finds a fault ends with exit status 1. ``--dry-run`` emulates a GPU at tiny sizes.
"""

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch
from collision import BODIES, RESOLUTIONS, queries_in, yard
from gpu_bench import Bench, DryRun, on
from gpu_first_use import first_frame, first_query
from gpu_render import likeness
from scenes import Subject

from splatrl.collision import NativeChecker
from splatrl.renderers import NativeRenderer

EXACT, DETAILED = (0.9999, 60.0), (0.999, 50.0)
"""Minimum fraction of bytes within one grey level of the CPU's, and minimum PSNR of a frame in dB. With level of detail
they are lower, since only the CPU draws what is behind a veil more coarsely."""
FRAMES, QUERIES = 64, 64
ROUNDS = 3


def load(bench: Bench, tolerance: float) -> None:
    """Load kernels and draw in the main thread."""
    first_frame(bench)
    print("a frame was drawn")


def thread(bench: Bench, tolerance: float) -> None:
    """Load kernels in threads in which PyTorch has done nothing: before its first use in the main thread, and after."""
    for _ in range(2):
        with ThreadPoolExecutor(1) as fresh:
            fresh.submit(first_query, bench).result()
        first_frame(bench)
    print("queries were answered in new threads, and frames drawn in the main one")


def tiny(bench: Bench, tolerance: float) -> None:
    """Draw one frame, exact and with level of detail, and answer a few queries."""
    first_frame(bench)
    subject = bench.fitted("backyard")
    for detail in (0.0, tolerance):
        compare(bench, subject, detail, 1)
    occupancy = yard(RESOLUTIONS["10k"])
    queries = queries_in(occupancy, True, QUERIES)
    for name, body in BODIES.items():
        answers = bench.checker(occupancy, body).sweeps(queries.start.to(bench.device), queries.end.to(bench.device))
        different = int((answers.cpu() != NativeChecker(occupancy, body).sweeps(queries.start, queries.end)).sum())
        print(f"{name}: {different} of {QUERIES} answers differ from the CPU's")
        if different:
            sys.exit(f"{name}: expected the CPU's answers")


def frames(bench: Bench, tolerance: float) -> None:
    """Draw frames, exact and with level of detail, and compare them with the CPU's."""
    for detail in (0.0, tolerance):
        compare(bench, bench.fitted("backyard"), detail, FRAMES)


def compare(bench: Bench, subject: Subject, tolerance: float, count: int) -> None:
    """Compare frames with the CPU's."""
    views = bench.views(subject, count)
    ours, theirs = bench.renderer(subject.scene, tolerance), NativeRenderer(subject.scene, tolerance=tolerance)
    there = on(views, torch.device("cpu"))
    found = likeness(("CudaRenderer", subject.scene.name, tolerance, "NativeRenderer"), ours, theirs, views, there)
    print(
        f"{count} frames at {tolerance:g} px: {found.within_one:.4%} of bytes within 1, worst {found.worst_db:.1f} dB"
    )
    within_one, worst_db = DETAILED if tolerance else EXACT
    if not (found.within_one >= within_one and found.worst_db >= worst_db):
        sys.exit(f"expected at least {within_one:.2%} and {worst_db:.0f} dB")


def twice(bench: Bench, tolerance: float) -> None:
    """Draw the same frames again, and in batches of 999."""
    subject = bench.fitted("backyard")
    views = bench.views(subject, max(bench.sizes.batches))
    for detail in (0.0, tolerance):
        renderer = bench.renderer(subject.scene, detail)
        once, again = renderer.pixels(views), renderer.pixels(views)
        parts = torch.cat([renderer.pixels(views[start : start + 999]) for start in range(0, len(views), 999)])
        different = [int((once != other).flatten(1).any(1).sum()) for other in (again, parts)]
        print(
            f"{len(views)} frames at {detail:g} px: {different[0]} differ when redrawn, {different[1]} in other batches"
        )
        if any(different):
            sys.exit("expected the same bytes")


def launch(bench: Bench, tolerance: float) -> None:
    """Draw the frames of the benchmark without comparing anything."""
    subject = next(iter(bench.subjects().values()))
    renderer = bench.renderer(subject.scene, tolerance)
    views = bench.views(subject, bench.sizes.batches[bench.sizes.base])
    for _ in range(ROUNDS):
        renderer.pixels(views)
    print(f"{ROUNDS} times {len(views)} frames, {int(renderer.pixels(views).sum())} in all")


STEPS: dict[str, Callable[[Bench, float], None]] = {
    step.__name__: step for step in (load, thread, tiny, frames, twice, launch)
}


def main() -> None:
    """Run the chosen step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=list(STEPS))
    parser.add_argument("--tolerance", type=float, default=0.5, help="level of detail, pixels; default 0.5")
    parser.add_argument("--dry-run", action="store_true", help="run on the CPU at tiny sizes, with the tests' emulator")
    options = parser.parse_args()
    if not (options.dry_run or torch.cuda.is_available()):
        sys.exit("no CUDA device: nothing was tried; --dry-run shows that everything runs")
    STEPS[options.step](DryRun() if options.dry_run else Bench(torch.device("cuda", 0)), options.tolerance)


if __name__ == "__main__":
    main()
