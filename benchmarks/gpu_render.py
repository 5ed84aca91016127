"""Frames per second on a GPU, their quality compared with exact images, and the speed relative to the GPU's bound."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import torch
from gpu_bench import Bench, on
from gpu_bound import bound_us
from gpu_device import Machine, Rate, in_turns, peak_memory, rate
from quality import quality, shown
from scenes import Subject

from splatrl.cameras import Cameras
from splatrl.renderers import NativeRenderer
from splatrl.renderers.cuda import CudaRenderer

MODULE = "gsplat_cuda"
"""Name of the module with gsplat's compiled kernels."""


@dataclass(frozen=True)
class Rendering:
    """A row of the table: frames per second at one batch size."""

    what = "rendering"
    renderer: str
    scene: str
    gaussians: int
    sh_degree: int
    tolerance: float
    batch: int
    frames_per_second: Rate
    memory_bytes: int  # PyTorch's peak, including the scene and other renderers


@dataclass(frozen=True)
class Effort:
    """The work of a frame, averaged over views, and the bound computed from it."""

    what = "effort"
    scene: str
    tolerance: float
    batch: int
    candidates: float
    visible: float
    blended: float
    bound_flops_us: float
    bound_bytes_us: float
    frame_us: float


@dataclass(frozen=True)
class Likeness:
    """Agreement of two sets of images over some views: the fraction of 8-bit values within one step, and PSNR."""

    what = "likeness"
    renderer: str
    scene: str
    tolerance: float
    against: str
    views: int
    within_one: float
    mean_db: float
    worst_db: float


def drawing(renderer: Any, cameras: Cameras, batch: int, frames: int) -> tuple[Callable[[], None], int]:
    """Return a call that draws several batches in turn, and its number of frames."""
    starts = range(0, len(cameras) - batch + 1, batch)
    batches = cycle([cameras[start : start + batch] for start in starts])
    repeats = max(2, frames // batch)

    def call() -> None:
        for _ in range(repeats):
            renderer.pixels(next(batches))

    return call, repeats * batch


def rendering(bench: Bench, machine: Machine) -> None:
    """Measure every scene, exact and at each tolerance."""
    subjects = bench.subjects()
    left = [(name, tolerance) for name in subjects for tolerance in (0.0, *bench.sizes.tolerances)]
    for name, subject in subjects.items():
        cameras = bench.views(subject, 2 * max(bench.sizes.batches))
        exact = bench.renderer(subject.scene)
        for tolerance in (0.0, *bench.sizes.tolerances):
            budget = 0.6 * bench.left / len(left)
            renderer = bench.renderer(subject.scene, tolerance) if tolerance else exact
            measure(bench, subject, tolerance, renderer, cameras, budget)
            count_effort(bench, machine, subject, tolerance, renderer, cameras)
            compare(bench, subject, tolerance, renderer, exact, cameras)
            left.remove((name, tolerance))
            bench.free()


def measure(
    bench: Bench, subject: Subject, tolerance: float, renderer: CudaRenderer, cameras: Cameras, budget: float
) -> None:
    """Measure frames per second at every batch size, starting with that of the comparisons."""
    sizes, gaussians = bench.sizes, subject.scene.gaussians
    for batch in sorted(sizes.batches, key=lambda batch: batch != sizes.batches[sizes.base]):
        call, frames = drawing(renderer, cameras, batch, sizes.frames)
        with peak_memory(bench.device) as memory:
            times = in_turns({batch: call}, bench.device, budget / len(sizes.batches))[batch]
        facts = (subject.scene.name, gaussians.numel(), gaussians.sh_degree, tolerance, batch)
        bench.keep(Rendering("CudaRenderer", *facts, rate(frames, times), memory[0]))
    renderer.raise_faults()


def count_effort(
    bench: Bench, machine: Machine, subject: Subject, tolerance: float, renderer: CudaRenderer, cameras: Cameras
) -> None:
    """Count the work of a frame, and compute its bound."""
    scene, batch = subject.scene, bench.sizes.batches[bench.sizes.base]
    counts = renderer.efforts(cameras[: bench.sizes.views]).double().mean(0).tolist()
    bound = bound_us(machine, *counts, scene.gaussians.sh_degree, bench.sizes.pixels**2)
    (row,) = bench.found(Rendering, renderer="CudaRenderer", scene=scene.name, tolerance=tolerance, batch=batch)
    taken = 1e6 / row.frames_per_second.typical
    bench.keep(Effort(scene.name, tolerance, batch, *counts, *bound, taken))


def likeness(names: tuple[str, str, float, str], ours: Any, theirs: Any, mine: Cameras, other: Cameras) -> Likeness:
    """Compare two renderers on the same views, each on its own device."""
    steps = (ours.pixels(mine).cpu().int() - theirs.pixels(other).cpu().int()).abs()
    images = quality(shown(ours, mine).cpu(), shown(theirs, other).cpu())
    within = float((steps <= 1).double().mean())
    return Likeness(*names, len(mine), within, images.mean_db, images.worst_db)


def compare(
    bench: Bench, subject: Subject, tolerance: float, renderer: CudaRenderer, exact: CudaRenderer, cameras: Cameras
) -> None:
    """Compare level of detail with exact images, and both with the CPU's."""
    name, sizes = subject.scene.name, bench.sizes
    if tolerance:
        views = cameras[: sizes.views]
        bench.keep(likeness(("CudaRenderer", name, tolerance, "exact"), renderer, exact, views, views))
    native = NativeRenderer(subject.scene, tolerance=tolerance)
    views = cameras[: sizes.native_views]
    names = ("CudaRenderer", name, tolerance, "NativeRenderer")
    bench.keep(likeness(names, renderer, native, views, on(views, torch.device("cpu"))))


def gsplat_missing() -> str | None:
    """Return why gsplat cannot be measured; None if it can."""
    if importlib.util.find_spec("gsplat") is None:
        return "not installed"
    if importlib.util.find_spec("gsplat.csrc") is not None:
        return None  # a wheel with compiled kernels
    from torch.utils.cpp_extension import _get_build_directory

    if (Path(_get_build_directory(MODULE, verbose=False)) / f"{MODULE}.so").is_file():
        return None
    return "installed, but not compiled; compile it once, which takes minutes: python -c 'import gsplat.cuda._backend'"


def gsplat(bench: Bench, missing: str | None) -> None:
    """Measure gsplat and CudaRenderer in turns on the same exact frames."""
    if missing:
        bench.note(f"gsplat: left out, {missing}")
        return
    subjects = bench.subjects()
    for number, subject in enumerate(subjects.values()):
        against_gsplat(bench, subject, 0.8 * bench.left / (len(subjects) - number))
        bench.free()


def against_gsplat(bench: Bench, subject: Subject, budget: float) -> None:
    """Measure speed on antialiased images, which splatrl uses, and agreement on classic ones, which both draw alike."""
    sizes, scene = bench.sizes, subject.scene
    batch = sizes.batches[sizes.base]
    cameras = bench.views(subject, 4 * batch)
    renderers = {"gsplat": bench.gsplat(scene), "CudaRenderer beside gsplat": bench.renderer(scene)}
    calls = {name: drawing(renderer, cameras, batch, sizes.frames) for name, renderer in renderers.items()}
    with peak_memory(bench.device) as memory:
        times = in_turns({name: call for name, (call, _) in calls.items()}, bench.device, budget)
    facts = (scene.name, scene.gaussians.numel(), scene.gaussians.sh_degree, 0.0, batch)
    for name, (_, frames) in calls.items():
        bench.keep(Rendering(name, *facts, rate(frames, times[name]), memory[0]))
    del renderers, calls
    bench.free()
    views = cameras[: sizes.native_views]
    ours, theirs = bench.renderer(scene, antialiased=False), bench.gsplat(scene, antialiased=False)
    names = ("CudaRenderer", scene.name, 0.0, "gsplat, both classic")
    bench.keep(likeness(names, ours, theirs, views, views))
