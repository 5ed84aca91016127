"""Prints the results of a run as Markdown tables."""

from collections.abc import Callable
from typing import Any

from figure import tolerance_name
from gpu_bench import Bench
from gpu_collision import Agreement, Collision
from gpu_first_use import FirstUse
from gpu_fit import Fit
from gpu_reach import Target
from gpu_render import Effort, Likeness, Rendering
from gpu_sections import Section
from gpu_town import Town
from gpu_training import Stepping, Training
from record import print_markdown

GIB = 2**30

Columns = dict[str, Callable[[Any], str]]
"""Functions that make the cells of a result, by the titles of their columns."""

TABLES: dict[type, Columns] = {
    FirstUse: {
        "first use of": lambda r: r.kernels,
        "compile s": lambda r: f"{r.compile_seconds:.1f}",
        "load and run s": lambda r: f"{r.start_seconds:.2f}",
    },
    Rendering: {
        "renderer": lambda r: r.renderer,
        "scene": lambda r: f"{r.scene}, {r.gaussians:,}",
        "detail": lambda r: tolerance_name(r.tolerance),
        "cameras": lambda r: f"{r.batch:,}",
        "frames/s (slowest to fastest)": lambda r: str(r.frames_per_second),
        "GiB": lambda r: f"{r.memory_bytes / GIB:.1f}",
    },
    Effort: {
        "scene": lambda r: r.scene,
        "detail": lambda r: tolerance_name(r.tolerance),
        "candidates": lambda r: f"{r.candidates:,.0f}",
        "visible": lambda r: f"{r.visible:,.0f}",
        "blended": lambda r: f"{r.blended:,.0f}",
        "µs per frame": lambda r: f"{r.frame_us:.2f}",
        "bound: operations": lambda r: f"{r.bound_flops_us:.2f}",
        "bound: bytes": lambda r: f"{r.bound_bytes_us:.2f}",
        "× the larger": lambda r: f"{r.frame_us / max(r.bound_flops_us, r.bound_bytes_us):.1f}",
    },
    Likeness: {
        "renderer": lambda r: r.renderer,
        "scene": lambda r: r.scene,
        "detail": lambda r: tolerance_name(r.tolerance),
        "compared with": lambda r: r.against,
        "views": lambda r: str(r.views),
        "bytes within 1": lambda r: f"{r.within_one:.4%}",
        "dB, mean / worst": lambda r: f"{r.mean_db:.1f} / {r.worst_db:.1f}",
    },
    Collision: {
        "body": lambda r: r.body,
        "voxels": lambda r: f"{r.occupied:,}",
        "poses": lambda r: r.poses,
        "query": lambda r: r.query,
        "batch": lambda r: f"{r.batch:,}",
        "hits": lambda r: f"{r.hits:.0%}",
        "million queries/s (slowest to fastest)": lambda r: millions(r.queries_per_second),
    },
    Stepping: {
        "scene": lambda r: r.scene,
        "detail": lambda r: tolerance_name(r.tolerance),
        "robots": lambda r: f"{r.robots:,}",
        "CUDA graph": lambda r: "yes" if r.cuda_graph else "no",
        "steps/s (slowest to fastest)": lambda r: str(r.steps_per_second),
        "bare renderer, frames/s": lambda r: str(r.bare_frames_per_second),
        "steps/s of bare frames/s": lambda r: f"{r.share:.0%}",
    },
    Training: {
        "scene": lambda r: r.scene,
        "robots": lambda r: f"{r.robots:,}",
        "batch": lambda r: f"{r.frames_per_batch:,} in {r.mini_batch_size:,}, {r.epochs} epochs",
        "frames/s of PPO (slowest to fastest)": lambda r: str(r.frames_per_second),
        "collection alone, frames/s": lambda r: str(r.collected_per_second),
    },
    Fit: {
        "Gaussians": lambda r: f"{r.gaussians:,}",
        "photos": lambda r: f"{r.width}×{r.height}",
        "views per step": lambda r: str(r.views_a_step),
        "views/s of the fit (slowest to fastest)": lambda r: str(r.views_per_second),
        "gradients, cosine with the CPU's": lambda r: f"{r.cosine:.6f}",
        "GiB": lambda r: f"{r.memory_bytes / GIB:.1f}",
    },
    Town: {
        "blocks": lambda r: f"{r.blocks}, {r.gaussians:,} Gaussians",
        "detail": lambda r: tolerance_name(r.tolerance),
        "cameras": lambda r: f"{r.batch:,}",
        "frames/s (slowest to fastest)": lambda r: str(r.frames_per_second),
        "with one block, frames/s": lambda r: str(r.block_frames_per_second),
        "GiB": lambda r: f"{r.memory_bytes / GIB:.1f}",
    },
    Section: {
        "section": lambda r: r.name,
        "ending": lambda r: r.ending,
        "s": lambda r: f"{r.seconds:.0f}",
    },
    Target: {
        "reach (H200)": lambda r: r.name,
        "at least": lambda r: number(r.least, r.unit),
        "aim": lambda r: number(r.aim, r.unit),
        "found": lambda r: f"{number(r.found, r.unit)} {r.how and f'({r.how})'}".strip(),
        "": lambda r: r.verdict,
    },
}


def millions(rate: Any) -> str:
    """Format a rate in millions."""
    return f"{rate.typical / 1e6:,.4g} ({rate.slowest / 1e6:,.4g} to {rate.fastest / 1e6:,.4g})"


def number(value: float, unit: str) -> str:
    """Format the number of a target; a dash for NaN."""
    if value != value:
        return "–"
    if unit == "":
        return f"{value:.0%}"
    if unit == "/s":
        return f"{value:,.0f}" if value < 1e6 else f"{value / 1e6:,.0f} million"
    return f"{value:.3g} {unit}"


def print_tables(bench: Bench, targets: list[Target]) -> None:
    """Print all results, the targets last."""
    for kind, columns in TABLES.items():
        rows = targets if kind is Target else bench.found(kind)
        if rows:
            print_markdown(list(columns), [[cell(row) for cell in columns.values()] for row in rows])
    answers = bench.found(Agreement)
    if answers:
        asked, different = sum(row.compared for row in answers), sum(row.different for row in answers)
        print(f"collision: {different:,} of {asked:,} answers differ from the CPU's")
