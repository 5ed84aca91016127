"""Shared by the sections of gpu.py: the device, builders of what is measured on it, sizes, deadlines and results."""

import math
import os
import pickle
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from gpu_device import CHAINS, RATE, STEPS, Machine, measured_machine
from scenes import YARD, Room, Subject, backyard, chosen, dense_backyard
from town import BATCH, FOV, into_one_block, nearest_first, town

from splatrl.bodies import Body
from splatrl.building import build_world
from splatrl.cameras import Cameras, intrinsics
from splatrl.capture.fitting.cuda import CudaFitter
from splatrl.collision import Occupancy
from splatrl.collision.cuda import CudaChecker
from splatrl.configuration import load_config
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.world import World
from splatrl.files import replacing
from splatrl.renderers.cuda import CudaRenderer
from splatrl.renderers.gsplat import GsplatRenderer
from splatrl.scenes import Gaussians, Scene
from splatrl.scenes.blocks import BlockScene, read_blocks
from splatrl.scenes.splitting import write_split

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Sizes:
    """Sizes of all measurements.

    Attributes:
        scenes: names of the scenes.
        pixels: width and height of the images.
        batches: cameras per launch, ascending; ``batches[base]`` is used for quality and comparisons.
        base: see ``batches``.
        frames: minimum number of frames per timed call; small batches are repeated.
        tolerances: tolerances of the level of detail, pixels.
        views: number of views in which level of detail is compared with exact images.
        native_views: number of these that the CPU draws as well.
        voxels: resolutions of the yard, by their names in collision.py, ascending in the number of voxels.
        queries: collision queries per call.
        compared: number of queries that the CPU answers as well.
        robots: robots per env.
        steps: env steps per timed call.
        fits: scenes to which Gaussians are fitted, with the width and height of their photos in pixels.
        fit_views: views per step of the fit, ascending.
        copied: bytes that are copied to measure the bandwidth.
        training: overrides of splatrl-train.
        iterations: maximum number of PPO iterations that are timed.
    """

    scenes: tuple[str, ...] = ("dense", "kitchen")
    pixels: int = 64
    batches: tuple[int, ...] = (1, 64, 1024, 4096)
    base: int = 2
    frames: int = 64
    tolerances: tuple[float, ...] = (0.45, 0.5, 1.0)
    views: int = 256
    native_views: int = 64
    voxels: tuple[str, ...] = ("10k", "300k")
    queries: tuple[int, ...] = (65_536, 1_048_576)
    compared: int = 65_536
    robots: tuple[int, ...] = (64, 1024, 4096)
    steps: int = 16
    fits: tuple[tuple[str, int, int], ...] = (("backyard", 320, 240), ("dense", 400, 300))
    fit_views: tuple[int, ...] = (1, 2, 8)
    copied: int = 2**30
    training: tuple[str, ...] = ("ppo=many", "collector.total_frames=100000000")
    iterations: int = 8


TINY = Sizes(
    scenes=("tiny",),
    pixels=16,
    batches=(1, 3),
    base=1,
    frames=2,
    views=5,
    native_views=3,
    voxels=("10k",),
    queries=(40, 90),
    compared=60,
    robots=(2, 4),
    steps=2,
    fits=(("tiny", 37, 22),),
    fit_views=(1, 2),
    copied=2**20,
    training=(
        "env.num_envs=4",
        "collector.frames_per_batch=16",
        "collector.total_frames=160",
        "loss.mini_batch_size=8",
        "loss.ppo_epochs=2",
    ),
    iterations=2,
)
"""Sizes of a dry run."""


@dataclass
class Bench:
    """A GPU and the results found on it.

    Attributes:
        device: device that is measured.
        sizes: sizes of the measurements.
        results: dataclasses, in the order in which they were found.
        notes: lines for readers, such as what was left out.
        ends: deadline of the current section, by ``time.monotonic``.
        file: file to which results and notes are written as soon as they are found, for another process to read.
    """

    device: torch.device
    sizes: Sizes = field(default_factory=Sizes)
    results: list[Any] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    ends: float = math.inf
    file: Path | None = None

    @property
    def left(self) -> float:
        """Seconds left until the section's deadline."""
        return max(0.0, self.ends - time.monotonic())

    def found(self, kind: type, **fields: Any) -> list[Any]:
        """Return the results of a kind whose fields have the given values."""
        mine = (result for result in self.results if isinstance(result, kind))
        return [one for one in mine if all(getattr(one, name) == value for name, value in fields.items())]

    def keep(self, result: Any) -> None:
        """Add a result."""
        self.results.append(result)
        self._write()

    def note(self, line: str) -> None:
        """Print a line, and add it to the notes."""
        print(line, flush=True)
        self.notes.append(line)
        self._write()

    def read(self, file: Path) -> None:
        """Add the results and notes in another process's file, if it exists."""
        if file.is_file():
            results, notes = pickle.loads(file.read_bytes())
            self.results += results
            self.notes += notes

    def _write(self) -> None:
        if self.file is not None:
            with replacing(self.file) as stream:
                stream.write(pickle.dumps((self.results, self.notes)))

    def machine(self) -> Machine:
        """Measure the device."""
        return measured_machine(self.device, None, self.sizes.copied)

    def subjects(self) -> dict[str, Subject]:
        """Return the scenes, by name, with the places from which they are viewed."""
        return chosen(list(self.sizes.scenes))

    def views(self, subject: Subject, count: int) -> Cameras:
        """Return random views of a scene, on the device."""
        cameras = subject.room.views(count, self.sizes.pixels, self.sizes.pixels)
        return on(cameras, self.device)

    def town(self, count: int) -> tuple[BlockScene, BlockScene, Cameras]:
        """Return a town, one of its blocks with the surroundings of the town, and ``count`` views into that block."""
        scene = town()
        around, *blocks = nearest_first(scene)
        middle = next(block for block in blocks if block.bounds[0][:2] == (0.0, 0.0))
        seeds = [into_one_block(seed) for seed in range(-(-count // BATCH))]
        poses = torch.cat([cameras.camera_to_world for cameras in seeds])[:count]
        cameras = Cameras(poses, intrinsics(FOV, self.sizes.pixels, self.sizes.pixels), *[self.sizes.pixels] * 2)
        return scene, BlockScene("one", [around, middle]), on(cameras, self.device)

    def renderer(self, scene: Scene | Gaussians, tolerance: float = 0.0, antialiased: bool = True) -> CudaRenderer:
        """Make the renderer that is measured; it leaves most of the memory to others."""
        most = torch.cuda.get_device_properties(self.device).total_memory // 8
        return CudaRenderer(scene, antialiased, tolerance=tolerance, device=self.device, memory=most)

    def gsplat(self, scene: Scene, antialiased: bool = True) -> GsplatRenderer:
        """Make the renderer that it is compared with."""
        most = torch.cuda.get_device_properties(self.device).total_memory // 5
        return GsplatRenderer(scene, antialiased, device=self.device, memory=most)

    def checker(self, occupancy: Occupancy, body: Body) -> CudaChecker:
        """Make the checker that is measured."""
        return CudaChecker(occupancy, body, device=self.device)

    def fitter(self) -> CudaFitter:
        """Make the fitter that is measured."""
        return CudaFitter(self.device)

    def fitted(self, name: str) -> Subject:
        """Return Gaussians as a fit leaves them: those of the backyard, or 150,000 in the same place."""
        return Subject(backyard() if name == "backyard" else dense_backyard(150_000, 1), YARD)

    def architecture(self) -> str:
        """Return the architecture for which kernels are compiled."""
        major, minor = torch.cuda.get_device_capability(self.device)
        return f"sm_{major}{minor}"

    def overrides(self, folder: Path) -> list[str]:
        """Return the overrides of splatrl-train for the task that is trained."""
        return ["task=fps", f"device={self.device}"]

    def world(self, folder: Path, overrides: list[str]) -> tuple[World, float]:
        """Build the world that a config's envs share, and return it with the renderer's tolerance in pixels."""
        cfg = load_config(overrides)
        return build_world(cfg), float(cfg.renderer.tolerance)

    def free(self) -> None:
        """Release unused memory of the device."""
        if self.device.type == "cuda":
            torch.cuda.empty_cache()


class DryRun(Bench):
    """A bench on the CPU, at tiny sizes with the tests' emulator: shows that everything runs, but not how fast."""

    def __init__(self) -> None:
        super().__init__(torch.device("cpu"), TINY)
        self.blocks = tempfile.TemporaryDirectory()
        if str(ROOT) not in sys.path:
            sys.path.insert(0, str(ROOT))  # for the emulator of the tests

    def machine(self) -> Machine:
        from tests.emulator import emulated

        return measured_machine(self.device, emulated(RATE, {"CHAINS": CHAINS, "STEPS": STEPS}), self.sizes.copied)

    def subjects(self) -> dict[str, Subject]:
        from tests.tiny import tiny_gaussians

        scene = Scene("tiny", tiny_gaussians(), ((-1.5, -2.0, 0.0), (1.5, 2.0, 1.2)))
        return {"tiny": Subject(scene, Room((-1.0, -1.5, 0.4), (1.0, 1.5, 0.6)))}

    def town(self, count: int) -> tuple[BlockScene, BlockScene, Cameras]:
        subject, folder = self.subjects()["tiny"], Path(self.blocks.name)
        write_split(folder, subject.scene, 2.0)
        scene = read_blocks(folder)
        return scene, BlockScene("one", scene.blocks[:1]), self.views(subject, count)

    def renderer(self, scene: Scene | Gaussians, tolerance: float = 0.0, antialiased: bool = True) -> CudaRenderer:
        from tests.emulator import emulated

        return CudaRenderer(scene, antialiased, tolerance=tolerance, load=emulated)

    def gsplat(self, scene: Scene, antialiased: bool = True) -> GsplatRenderer:
        from tests.renderers.pretended_gsplat import modules

        with patch.dict(sys.modules, modules()):
            return GsplatRenderer(scene, antialiased, device="cpu")

    def checker(self, occupancy: Occupancy, body: Body) -> CudaChecker:
        from tests.emulator import emulated

        return CudaChecker(occupancy, body, load=emulated)

    def fitter(self) -> CudaFitter:
        from tests.emulator import emulated

        return CudaFitter("cpu", emulated)

    def fitted(self, name: str) -> Subject:
        return self.subjects()["tiny"]

    def architecture(self) -> str:
        return "sm_90"

    def overrides(self, folder: Path) -> list[str]:
        from tests.tiny import tiny_overrides

        return [*tiny_overrides(folder, "fps"), "device=cpu"]

    def world(self, folder: Path, overrides: list[str]) -> tuple[World, float]:
        world, tolerance = super().world(folder, overrides)
        drawing = SceneDrawing(self.renderer(world.scene, tolerance))
        return replace(world, drawing=drawing, checker=self.checker(world.occupancy, world.robot.body)), tolerance


def on(cameras: Cameras, device: torch.device) -> Cameras:
    """Move cameras to a device."""
    return Cameras(cameras.camera_to_world.to(device), cameras.K.to(device), cameras.width, cameras.height)


@contextmanager
def cache_folder(folder: Path) -> Iterator[None]:
    """Keep caches in this folder within the ``with`` block."""
    with patch.dict(os.environ, SPLATRL_CACHE=str(folder)):
        yield
