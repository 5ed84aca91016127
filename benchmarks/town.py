"""Measures the cost of rendering a town in blocks: python benchmarks/town.py

Three measurements at 64 × 64 pixels with level of detail (0.5 pixels): a frame of the whole town compared with one of a
single block; a frame of the town reduced to the 10,000 … 10,000,000 Gaussians nearest to its cameras; and the memory of
a process that draws from all over the town within a budget. Frames are measured in CPU time of one core, in turns, so
that other work on the machine matters little. The town is generated and packed first, which takes minutes, once.
"""

import argparse
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

import torch
from machine import measured_machine

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.renderers import BlockRenderer
from splatrl.scenes import write_gaussians
from splatrl.scenes.blocks import Block, BlockScene, joined
from splatrl.scenes.town import town

SIZE, FOV, TOLERANCE = 64, math.radians(80.0), 0.5
CUTS = (10_000, 100_000, 1_000_000, 10_000_000)
BATCH = 64
STREET = 2.0
"""Maximum distance of cameras from the middle of a street, metres."""
BLOCK = 20.0


def cameras_at(eyes: torch.Tensor, yaws: torch.Tensor) -> Cameras:
    """Return cameras at the given positions and headings that look slightly downwards."""
    away = torch.stack([yaws.cos(), yaws.sin(), torch.full_like(yaws, -0.08)], 1)
    poses = [look_at(eye.tolist(), (eye + way).tolist()) for eye, way in zip(eyes, away, strict=True)]
    return Cameras(torch.stack(poses), intrinsics(FOV, SIZE, SIZE), SIZE, SIZE)


def heights(g: torch.Generator) -> torch.Tensor:
    """Draw camera heights between those of a small robot and of a person, metres."""
    return 0.4 + 1.2 * torch.rand(BATCH, generator=g)


def into_one_block(seed: int) -> Cameras:
    """Draw cameras on the streets around the block at the origin that look into it, within 45° of its middle."""
    g = torch.Generator().manual_seed(seed)
    along, off = BLOCK * torch.rand(BATCH, generator=g), STREET * torch.rand(BATCH, generator=g)
    side = torch.randint(0, 4, (BATCH,), generator=g)
    x = torch.where(side == 0, off, torch.where(side == 1, BLOCK - off, along))
    y = torch.where(side == 2, off, torch.where(side == 3, BLOCK - off, along))
    to_middle = torch.atan2(BLOCK / 2 - y, BLOCK / 2 - x)
    yaws = to_middle + math.radians(45.0) * (2 * torch.rand(BATCH, generator=g) - 1)
    return cameras_at(torch.stack([x, y, heights(g)], 1), yaws)


def at_the_crossing(seed: int) -> Cameras:
    """Draw cameras within 2 m of the crossing in the middle, along x and y, with any heading."""
    g = torch.Generator().manual_seed(seed)
    places = STREET * (2 * torch.rand(BATCH, 2, generator=g) - 1)
    return cameras_at(torch.cat([places, heights(g)[:, None]], 1), 2 * math.pi * torch.rand(BATCH, generator=g))


def all_over(scene: BlockScene, seed: int) -> Cameras:
    """Draw cameras on any street of the town, with any heading."""
    g = torch.Generator().manual_seed(seed)
    low = min(block.bounds[0][0] for block in scene.blocks)
    high = max(block.bounds[1][0] for block in scene.blocks)
    along = low + (high - low) * torch.rand(BATCH, generator=g)
    street = BLOCK * torch.randint(round(low / BLOCK) + 1, round(high / BLOCK), (BATCH,), generator=g)
    across = street + STREET * (2 * torch.rand(BATCH, generator=g) - 1)
    swapped = torch.rand(BATCH, generator=g) < 0.5
    x, y = torch.where(swapped, across, along), torch.where(swapped, along, across)
    return cameras_at(torch.stack([x, y, heights(g)], 1), 2 * math.pi * torch.rand(BATCH, generator=g))


def nearest_first(scene: BlockScene) -> list[Block]:
    """Sort the blocks by their distance from the origin, after the surroundings of the town."""

    def away(block: Block) -> float:
        (x0, y0, _), (x1, y1, _) = block.bounds
        return math.hypot(max(x0, -x1, 0.0), max(y0, -y1, 0.0)) + 1e-3 * math.hypot(x0 + x1, y0 + y1)

    return sorted(scene.blocks, key=lambda block: (block.splat.stem != "around", away(block)))


def cut_to(scene: BlockScene, count: int, sizes: dict[Path, int], folder: Path) -> BlockScene:
    """Reduce the town to about ``count`` Gaussians: the nearest blocks, or the nearest Gaussians of the middle four."""
    around, *blocks = nearest_first(scene)
    if count < sizes[blocks[0].splat]:
        middle = joined([block.read() for block in blocks[:4]])
        nearest = middle.means[:, :2].norm(dim=1).argsort()[:count]
        write_gaussians(folder / f"{count}.ply", middle[nearest])
        return BlockScene("cut", [around, Block(folder / f"{count}.ply", blocks[0].bounds)])
    kept, held = [around], 0
    for block in blocks:
        if held < count:
            kept.append(block)
            held += sizes[block.splat]
    return BlockScene("cut", kept)


def frame_ms(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Measure the milliseconds of CPU time per frame: medians over rounds in which all calls take turns."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(rounds + 1):
        for name, call in calls.items():
            start = time.process_time()
            call()
            if turn:
                times[name].append(1e3 * (time.process_time() - start) / BATCH)
    return {name: median(values) for name, values in times.items()}


def resident(field: str) -> float:
    """Return the memory of this process in bytes: VmRSS is the current value, VmHWM the peak."""
    with open("/proc/self/status") as status:
        return 1024.0 * int(next(line for line in status if line.startswith(field)).split()[1])


def measure_memory(scene: BlockScene, budget: float, batches: int) -> None:
    """Draw from all over the town, and print how much memory that added to the process."""
    warm = BlockRenderer(BlockScene("warm", nearest_first(scene)[:2]), tolerance=TOLERANCE)
    warm.pixels(into_one_block(0))
    del warm
    before = resident("VmRSS")
    renderer = BlockRenderer(scene, tolerance=TOLERANCE, budget=budget)
    for seed in range(batches):
        renderer.pixels(all_over(scene, seed))
    peak, held = (resident("VmHWM") - before) / 1e6, renderer.bytes_held / 1e6
    print(f"memory: {peak:,.0f} MB at the peak, {1e6 * peak / budget:.2f} times the budget; blocks hold {held:,.0f} MB")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blocks", type=int, default=10, help="blocks along each side of the town")
    parser.add_argument("--rounds", type=int, default=41)
    parser.add_argument("--budget", type=float, default=6e8, help="budget for measuring memory, bytes")
    parser.add_argument("--memory", action="store_true", help="only measure memory, in this process")
    options = parser.parse_args()
    scene = town(blocks=options.blocks)
    if options.memory:
        measure_memory(scene, options.budget, options.rounds)
        return
    print(measured_machine())
    renderer = BlockRenderer(scene, tolerance=TOLERANCE, threads=1, budget=4e9)
    sizes = {block.splat: len(block.read()) for block in scene.blocks}
    gaussians, packed = sum(sizes.values()), renderer.bytes_in_all
    print(f"{len(scene.blocks) - 1} blocks, {gaussians:,} Gaussians, {packed / gaussians:.0f} bytes each")
    around, *blocks = nearest_first(scene)
    first = next(block for block in blocks if block.bounds[0][:2] == (0.0, 0.0))
    block = BlockRenderer(BlockScene("one", [around, first]), tolerance=TOLERANCE, threads=1)
    views = into_one_block(0)
    taken = frame_ms({"town": partial(renderer.pixels, views), "block": partial(block.pixels, views)}, options.rounds)
    in_town, in_block = taken["town"], taken["block"]
    print(f"frame: {in_town:.3f} ms in the town, {in_block:.3f} in one block: ratio {in_town / in_block:.2f}")
    with tempfile.TemporaryDirectory() as folder:
        cuts = [count for count in CUTS if count < sum(sizes.values())]
        scenes = {count: cut_to(scene, count, sizes, Path(folder)) for count in cuts}
        renderers = {f"{sum(sizes.values()):,}": renderer}
        for count, cut in scenes.items():
            renderers[f"{count:,}"] = BlockRenderer(cut, tolerance=TOLERANCE, threads=1, budget=4e9)
        street = at_the_crossing(1)
        taken = frame_ms({name: partial(one.pixels, street) for name, one in renderers.items()}, options.rounds)
    least = min(taken.values())
    print("reduced to: " + ", ".join(f"{name} {value:.3f} ms" for name, value in taken.items()))
    print(f"slowest relative to fastest: {max(taken.values()) / least:.2f}")
    words = ["--memory", f"--blocks={options.blocks}", f"--budget={options.budget}", f"--rounds={options.rounds}"]
    subprocess.run([sys.executable, __file__, *words], check=True)


if __name__ == "__main__":
    main()
