"""Measures rendered robot steps per second without learning: 64×64 pixels, random actions.

    python benchmarks/env.py             # random poses in the kitchen, and the grid task in the backyard
    python benchmarks/env.py --json

``poses``: each step gives every robot a new random pose in the room, so that no view repeats; a step is the pose and
its pixels. ``SplatEnv``: the grid task with collisions, rewards and automatic resets, without the cache of views. All
rows take turns, round by round.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

import torch
from figure import tolerance_name
from machine import measured_machine
from record import print_markdown, write_json
from scenes import FOV, Subject, chosen
from timing import take_turns
from torch import Tensor
from torchrl.envs import EnvBase
from tqdm import tqdm

import splatrl
from splatrl.cameras import Cameras, intrinsics
from splatrl.renderers import NativeRenderer, Parts, Renderer, RenderOutput

SIZE = 64
"""Width and height of the images, pixels."""


@dataclass(frozen=True)
class Result:
    """One row of the table; a step is that of one robot."""

    kind: str
    scene: str
    tolerance: float
    batch: int
    threads: int
    steps_per_second: float
    slowest: float
    fastest: float
    rendering: float  # fraction of the time


class TimedRenderer:
    """Wraps a renderer and adds up the seconds that its ``pixels`` takes."""

    def __init__(self, renderer: Renderer):
        self.renderer, self.seconds = renderer, 0.0

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        return self.renderer.render(cameras, parts, only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        start = time.perf_counter()
        pixels = self.renderer.pixels(cameras, parts, only)
        self.seconds += time.perf_counter() - start
        return pixels


def random_poses(subject: Subject, renderer: Renderer, batch: int) -> Callable[[], None]:
    """Return a step that renders robots at new random poses."""
    generator = torch.Generator().manual_seed(0)
    K = intrinsics(FOV, SIZE, SIZE)

    def step() -> None:
        pixels = renderer.pixels(Cameras(subject.room.poses(batch, generator), K, SIZE, SIZE))
        assert pixels.shape == (batch, SIZE, SIZE, 3), pixels.shape

    return step


def random_actions(env: EnvBase) -> Callable[[], None]:
    """Return a step of an env with random actions, in which finished robots are reset."""
    state = env.reset()

    def step() -> None:
        nonlocal state
        state = env.step_and_maybe_reset(env.rand_action(state))[1]

    return step


def backyard_env(tolerance: float, batch: int, threads: int) -> splatrl.SplatEnv:
    """Build the grid task with starts from the whole start set and without the cache of views."""
    settings = [f"renderer.threads={threads}", f"renderer.tolerance={tolerance}"]
    return splatrl.make_env(
        ["device=cpu", "curriculum=none", "renderer.cache.max_bytes=0", *settings], batch_size=[batch]
    )


def measure(subject: Subject, tolerances: Sequence[float], options: argparse.Namespace) -> list[Result]:
    """Measure the steps per second of both kinds at every tolerance."""
    batch, threads = options.batch, options.threads
    renderers: dict[tuple[str, str, float], TimedRenderer] = {}
    steps: dict[tuple[str, str, float], Callable[[], None]] = {}
    for tolerance in tqdm(tolerances, desc="building"):
        key = "poses", subject.scene.name, tolerance
        renderers[key] = TimedRenderer(NativeRenderer(subject.scene, threads=threads, tolerance=tolerance))
        steps[key] = random_poses(subject, renderers[key], batch)
        key = "SplatEnv", "backyard", tolerance
        env = backyard_env(tolerance, batch, threads)
        renderers[key] = env.drawing.renderer = TimedRenderer(env.drawing.renderer)
        steps[key] = random_actions(env)

    rendering: dict[tuple[str, str, float], list[float]] = {key: [] for key in steps}

    def round_of(key: tuple[str, str, float]) -> Callable[[], None]:
        def call() -> None:
            before = renderers[key].seconds
            for _ in range(options.steps):
                steps[key]()
            rendering[key].append(renderers[key].seconds - before)

        return call

    seconds = take_turns({key: round_of(key) for key in steps}, options.rounds)
    taken = batch * options.steps
    return [
        Result(
            *key,
            batch=batch,
            threads=threads,
            steps_per_second=round(taken / median(seconds[key]), 1),
            slowest=round(taken / max(seconds[key]), 1),
            fastest=round(taken / min(seconds[key]), 1),
            rendering=round(sum(rendering[key][1:]) / sum(seconds[key]), 3),
        )
        for key in sorted(steps, key=lambda key: (key[0] != "poses", key[2]))
    ]


def print_table(results: Sequence[Result]) -> None:
    """Print the results as Markdown."""
    header = ["kind", "scene", "detail", "robots", "threads", "steps/s (slowest to fastest)", "time rendering"]
    rows = []
    for r in results:
        rate = f"{r.steps_per_second:,.0f} ({r.slowest:,.0f} to {r.fastest:,.0f})"
        row = [r.kind, r.scene, tolerance_name(r.tolerance), str(r.batch), str(r.threads), rate, f"{r.rendering:.0%}"]
        rows.append(row)
    print_markdown(header, rows)


def main() -> None:
    """Parse the command line, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="kitchen", help="scene of the random poses: a name, or a splat file (z up)")
    parser.add_argument("--tolerance", nargs="*", type=float, default=[0.5, 1.0], help="pixels; exact is included")
    parser.add_argument("--batch", type=int, default=64, help="number of robots")
    parser.add_argument("--threads", type=int, default=2, help="threads of the renderer; PyTorch uses one")
    parser.add_argument("--steps", type=int, default=20, help="steps of every robot per round")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-env.json")
    options = parser.parse_args()
    machine = measured_machine()
    print(machine)
    subjects = chosen([options.scene])
    results = measure(next(iter(subjects.values())), [0.0, *options.tolerance], options)
    print_table(results)
    if options.json:
        print(f"written to {write_json('env', machine, results)}")


if __name__ == "__main__":
    main()
