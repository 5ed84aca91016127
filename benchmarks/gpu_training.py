"""Steps per second of rendered envs, compared with the bare renderer; and frames per second of PPO, end to end."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

import torch
from gpu_bench import Bench
from gpu_device import Rate, in_turns, rate
from torch import Tensor
from torchrl.envs import EnvBase

from splatrl.building import build_trainer
from splatrl.cameras import Cameras
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs.nesting import layers
from splatrl.envs.restart import restart
from splatrl.envs.world import World
from splatrl.renderers import Parts, Renderer, RenderOutput
from splatrl.training.cuda_graph import CudaGraph


@dataclass(frozen=True)
class Stepping:
    """A row of the table: steps per second of ``task=fps`` with random actions, collisions and automatic resets."""

    what = "stepping"
    scene: str
    tolerance: float
    robots: int
    cuda_graph: bool
    steps_per_second: Rate
    bare_frames_per_second: Rate  # of the renderer alone, with the cameras that the env rendered
    share: float


@dataclass(frozen=True)
class Training:
    """A row of the table: frames per second of whole PPO iterations, and of collection alone."""

    what = "training"
    scene: str
    tolerance: float
    robots: int
    frames_per_batch: int
    mini_batch_size: int
    epochs: int
    frames_per_second: Rate
    collected_per_second: Rate


@dataclass
class Recording:
    """Wraps a renderer and records the cameras of every step."""

    renderer: Renderer
    cameras: list[Cameras] = field(default_factory=list)

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        return self.renderer.render(cameras, parts, only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        if only is None:  # a step; resets draw only some rows
            pose, K = cameras.camera_to_world.clone(), cameras.K.clone()
            self.cameras.append(Cameras(pose, K, cameras.width, cameras.height))
        return self.renderer.pixels(cameras, parts, only)


def stepper(env: EnvBase) -> Callable[[], None]:
    """Return a step with random actions and automatic resets that works in place, as rollouts on a GPU do."""
    now = env.reset().clone()
    spec = env.full_action_spec["action"]

    def step() -> None:
        acted = env.step(now.copy().set("action", spec.rand()))
        for key, value in restart(env, acted["next"]).items():
            now[key].copy_(value)

    return step


def repeated(call: Callable[[], object], times: int) -> Callable[[], None]:
    """Return a call that repeats another ``times`` times."""

    def calls() -> None:
        for _ in range(times):
            call()

    return calls


def recorded(env: EnvBase, step: Callable[[], None], steps: int) -> list[Cameras]:
    """Record the cameras that an env renders in some steps."""
    base = layers(env)[0]
    recording = Recording(base.drawing.renderer)
    base.drawing.renderer = recording
    repeated(step, steps)()
    base.drawing.renderer = recording.renderer
    return recording.cameras


def redrawing(renderer: Renderer, cameras: list[Cameras]) -> Callable[[], object]:
    """Return a call that renders recorded cameras again, those of one step at a time."""
    views = cycle(cameras)
    return lambda: renderer.pixels(next(views))


def stepping(bench: Bench) -> None:
    """Measure envs of every size, with and without a CUDA graph."""
    with tempfile.TemporaryDirectory() as folder:
        world, tolerance = bench.world(Path(folder), bench.overrides(Path(folder)))
    for number, robots in enumerate(reversed(bench.sizes.robots)):
        budget = 0.8 * bench.left / (len(bench.sizes.robots) - number)
        rates = step_rates(bench, world, robots, budget)
        bare = rates.pop("bare")
        for name, found in rates.items():
            share = round(found.typical / bare.typical, 4)
            bench.keep(Stepping(world.scene.name, tolerance, robots, name == "graph", found, bare, share))
        bench.free()


def step_rates(bench: Bench, world: World, robots: int, budget: float) -> dict[str, Rate]:
    """Measure steps per second, ``plain`` and as a CUDA ``graph``, and frames per second of the ``bare`` renderer."""
    steps = bench.sizes.steps
    calls, envs = {}, {}
    for name in ("plain", "graph"):
        env = world.env(robots, Curriculum(world.plan, first=None), 0)
        base = layers(env)[0]
        step = stepper(env)
        repeated(step, steps)()  # so that robots are no longer at their starts
        if name == "plain":
            calls["bare"] = repeated(redrawing(base.drawing.renderer, recorded(env, step, steps)), steps)
        elif not (base.capturable and bench.device.type == "cuda"):
            continue
        calls[name] = repeated(step if name == "plain" else CudaGraph(step, [base.generator]), steps)
        envs[name] = base
    times = in_turns(calls, bench.device, budget)
    for base in envs.values():
        base.raise_faults()
    return {name: rate(robots * steps, taken) for name, taken in times.items()}


def training(bench: Bench) -> None:
    """Measure PPO on ``task=fps``, built as splatrl-train builds it."""
    with tempfile.TemporaryDirectory() as name:
        folder, sizes = Path(name), bench.sizes
        overrides = [*bench.overrides(folder), *sizes.training]
        cfg = load_config(overrides)
        world, tolerance = bench.world(folder, overrides)
        ppo = build_trainer(cfg, world, folder).ppo
        frames = ppo.frames_per_batch
        ppo.iterate()  # warm-up: compiles, captures and allocates
        collected = timed(bench, ppo.collect, 0.3 * bench.left)
        taken = timed(bench, ppo.iterate, 0.8 * bench.left)
    facts = (world.scene.name, tolerance, cfg.env.num_envs, frames, cfg.loss.mini_batch_size, cfg.loss.ppo_epochs)
    bench.keep(Training(*facts, rate(frames, taken), rate(frames, collected)))


def timed(bench: Bench, call: Callable[[], object], budget: float) -> list[float]:
    """Measure the wall-clock seconds until the device has finished what a call queues, for at least two calls."""
    found: list[float] = []
    ends = time.perf_counter() + budget
    while len(found) < 2 or (len(found) < bench.sizes.iterations and time.perf_counter() < ends):
        start = time.perf_counter()
        call()
        if bench.device.type == "cuda":
            torch.cuda.synchronize(bench.device)
        found.append(time.perf_counter() - start)
    return found
