"""Compares the renderer's kernels with those of other checkouts on a GPU, in turns and in one process.

    git worktree add ../before HEAD~3
    python benchmarks/gpu_against.py ../before                     # frames/s of both, and how many bytes differ
    python benchmarks/gpu_against.py a b c --scenes kitchen --tolerances 0 0.5

Only ``splatrl/native`` of the other checkouts is used; their kernels must take the same arguments as those of this one.
``--dry-run`` emulates a GPU at tiny sizes, so that only the comparison of bytes is meaningful.
"""

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import torch
from gpu_bench import Bench, DryRun
from gpu_device import in_turns, rate
from gpu_render import drawing
from record import print_markdown
from scenes import Subject, chosen

from splatrl.native.cuda import compiler
from splatrl.renderers.cuda import CudaRenderer

HERE = "this one"
SECONDS = 8.0
"""Seconds per scene and tolerance for the turns of all checkouts together."""
FOUND = ("scene", "tolerance, px", "checkout", "frames/s (slowest to fastest)", "× this one", "bytes that differ")


@contextmanager
def sources_of(checkout: Path | None) -> Iterator[None]:
    """Compile kernels from a checkout's sources within the ``with`` block; None keeps those of this checkout."""
    if checkout is None:
        yield
        return
    native = checkout / "splatrl" / "native"
    if not (native / "cuda" / "render.cu").is_file():
        raise SystemExit(f"{checkout}: expected a checkout with splatrl/native/cuda/render.cu")
    folders = tuple(native / folder.relative_to(compiler.NATIVE) for folder in compiler.FOLDERS)
    with patch.object(compiler, "FOLDERS", folders):
        yield


def compare(bench: Bench, subject: Subject, tolerance: float, checkouts: Mapping[str, Path | None]) -> list[list[str]]:
    """Return the rows of the table for one scene and tolerance."""
    views = bench.views(subject, 2 * max(bench.sizes.batches))
    renderers: dict[str, CudaRenderer] = {}
    for name, checkout in checkouts.items():
        with sources_of(checkout):
            renderers[name] = bench.renderer(subject.scene, tolerance)
    batch = bench.sizes.batches[bench.sizes.base]
    frames = {name: renderer.pixels(views[:batch]) for name, renderer in renderers.items()}
    calls = {name: drawing(renderer, views, batch, bench.sizes.frames) for name, renderer in renderers.items()}
    times = in_turns({name: call for name, (call, _) in calls.items()}, bench.device, SECONDS)
    found = {name: rate(count, times[name]) for name, (_, count) in calls.items()}
    rows = []
    for name, each in found.items():
        speed = f"{each.typical:,.0f} ({each.slowest:,.0f} to {each.fastest:,.0f})"
        different = int((frames[name] != frames[HERE]).sum())
        ratio = f"{each.typical / found[HERE].typical:.3f}"
        rows.append([subject.scene.name, f"{tolerance:g}", name, speed, ratio, f"{different:,}"])
    return rows


def main() -> None:
    """Compare, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkouts", nargs="+", type=Path, help="folders of other checkouts")
    parser.add_argument("--scenes", nargs="+", default=["dense", "kitchen"])
    parser.add_argument("--tolerances", type=float, nargs="+", default=[0.0, 0.5])
    parser.add_argument("--dry-run", action="store_true", help="run on the CPU at tiny sizes, with the tests' emulator")
    options = parser.parse_args()
    if not (options.dry_run or torch.cuda.is_available()):
        raise SystemExit("no CUDA device: nothing was measured; --dry-run shows that everything runs")
    bench = DryRun() if options.dry_run else Bench(torch.device("cuda", 0))
    checkouts = {HERE: None, **{str(path): path for path in options.checkouts}}
    for subject in (bench.subjects() if options.dry_run else chosen(options.scenes)).values():
        for tolerance in options.tolerances:
            print_markdown(FOUND, compare(bench, subject, tolerance, checkouts))
            bench.free()


if __name__ == "__main__":
    main()
