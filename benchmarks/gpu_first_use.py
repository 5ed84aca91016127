"""Times the first use, in which kernels are compiled, loaded and run."""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from collision import BODIES
from gpu_bench import Bench, cache_folder

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision import Occupancy
from splatrl.collision import cuda as collide
from splatrl.native.cuda.compiler import compiled
from splatrl.renderers import cuda as render
from splatrl.scenes import Gaussians

SOURCES = {"render": render.kernel_defines(True, 0, False), "collide": collide.kernel_defines(BODIES["box"])}


@dataclass(frozen=True)
class FirstUse:
    """Seconds until the first answer: to compile with an empty cache, and to load and run the compiled kernels."""

    what = "first use"
    kernels: str
    compile_seconds: float
    start_seconds: float


def first_use(bench: Bench) -> None:
    """Measure renderer and checker, each as if it had never run on this machine."""
    if bench.device.type == "cuda":
        torch.zeros(1, device=bench.device)  # so that PyTorch's own initialisation is not counted
    answers = {"render": first_frame, "collide": first_query}
    with tempfile.TemporaryDirectory() as folder, cache_folder(Path(folder)):
        for name, defines in SOURCES.items():
            start = time.perf_counter()
            compiled(name, bench.architecture(), defines)
            middle = time.perf_counter()
            answers[name](bench)
            bench.keep(FirstUse(name, middle - start, time.perf_counter() - middle))
        kept = list(Path(folder).glob("*.cubin"))
    assert len(kept) == len(SOURCES), kept  # nothing else was compiled


def first_frame(bench: Bench) -> None:
    """Draw a small image of one Gaussian, and read it back to the host."""
    scene = Gaussians(
        means=torch.tensor([[2.0, 0.0, 0.0]]),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        scales=torch.full((1, 3), 0.3),
        opacities=torch.ones(1),
        sh=torch.ones(1, 1, 3),
        batch_size=[1],
    )
    size = bench.sizes.pixels
    pose = look_at([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]).unsqueeze(0)
    cameras = Cameras(pose.to(bench.device), intrinsics(1.5, size, size).to(bench.device), size, size)
    assert bool(bench.renderer(scene).pixels(cameras).any())


def first_query(bench: Bench) -> None:
    """Test one pose against one voxel, and read the answer back to the host."""
    occupancy = Occupancy.from_points(torch.zeros(1, 3).numpy(), 0.1, crop=((-1, -1, -1), (1, 1, 1)))
    assert bool(bench.checker(occupancy, BODIES["box"]).collides(torch.eye(4, device=bench.device).unsqueeze(0)))
