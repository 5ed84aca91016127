"""Frames per second in a scene in blocks, compared with one of its blocks alone."""

from dataclasses import dataclass

from gpu_bench import Bench
from gpu_device import Rate, in_turns, peak_memory, rate
from gpu_render import drawing


@dataclass(frozen=True)
class Town:
    """A row of the table: frames per second of views into a block, with all blocks and with that one alone."""

    what = "town"
    blocks: int
    gaussians: int
    tolerance: float
    batch: int
    frames_per_second: Rate
    block_frames_per_second: Rate
    memory_bytes: int  # PyTorch's peak, including both


def in_town(bench: Bench) -> None:
    """Draw the same views with a renderer of all blocks and one of a single block, in turns."""
    sizes, tolerance = bench.sizes, bench.sizes.tolerances[0]
    batch = sizes.batches[sizes.base]
    town, block, cameras = bench.town(2 * batch)
    with peak_memory(bench.device) as memory:
        renderers = {len(scene.blocks): bench.renderer(scene, tolerance) for scene in (town, block)}
        calls = {blocks: drawing(renderer, cameras, batch, sizes.frames) for blocks, renderer in renderers.items()}
        times = in_turns({blocks: call for blocks, (call, _) in calls.items()}, bench.device, 0.8 * bench.left)
    rates = [rate(frames, times[blocks]) for blocks, (_, frames) in calls.items()]
    gaussians = sum(len(read()) for read in town.pieces)
    bench.keep(Town(len(town.blocks), gaussians, tolerance, batch, *rates, memory[0]))
