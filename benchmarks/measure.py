"""Measures the speed of every row: frames per second, the stages of a frame, and the ratio to the bound."""

from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

import torch
from bound import bound_ms
from machine import Machine
from plan import Renderers, Setup
from timing import take_turns

from splatrl.cameras import Cameras
from splatrl.renderers import NativeRenderer

FRAMES = 64
"""Minimum number of frames per timing; small batches are repeated on other views."""


def call_of(
    setup: Setup, cameras: Cameras, draw_batch: Callable[[Cameras], Any], renderer: NativeRenderer
) -> Callable[[], list[Any]]:
    """Return a call that draws all views batch by batch and returns the result of each batch."""
    batches = [cameras[start : start + setup.batch] for start in range(0, len(cameras), setup.batch)]

    def call() -> list[Any]:
        renderer.threads = setup.threads
        return [draw_batch(batch) for batch in batches]

    return call


def timed(
    setups: Sequence[Setup], renderers: Renderers, views: dict[str, Cameras], machine: Machine, rounds: int
) -> dict[Setup, dict[str, float]]:
    """Measure the speed, stages and bound of every row."""
    counts = {setup: max(setup.batch, FRAMES // setup.batch * setup.batch) for setup in setups}
    efforts: dict[Setup, list[list[Any]]] = {setup: [] for setup in setups}
    calls: dict[tuple[Setup, str], Callable[[], Any]] = {}
    for setup in setups:
        renderer, cameras = renderers[setup.look], views[setup.look.scene][: counts[setup]]
        drawing = call_of(setup, cameras, renderer.pixels, renderer)
        measuring = call_of(setup, cameras, renderer.efforts, renderer)
        calls[setup, "pixels"] = drawing
        calls[setup, "efforts"] = lambda kept=efforts[setup], measuring=measuring: kept.append(measuring())
    seconds = take_turns(calls, rounds)
    return {
        setup: {
            **_speed(counts[setup], seconds[setup, "pixels"]),
            **_stages(setup, counts[setup], seconds[setup, "efforts"], efforts[setup][1:], machine),
        }
        for setup in setups
    }


def _speed(frames: int, seconds: list[float]) -> dict[str, float]:
    rates = {"frames_per_second": median(seconds), "slowest": max(seconds), "fastest": min(seconds)}
    return {name: round(frames / value, 1) for name, value in rates.items()}


def _stages(
    setup: Setup, frames: int, seconds: list[float], efforts: list[list[Any]], machine: Machine
) -> dict[str, float]:
    names = ("projected", "visible", "blended", "project_ms", "sort_ms", "blend_ms")
    rounds = [
        {name: float(torch.cat([getattr(e, name) for e in batch]).double().mean()) for name in names}
        for batch in efforts
    ]
    means = {name: median(values[name] for values in rounds) for name in names}
    core_ms = 1e3 * setup.threads * median(seconds) / frames
    counted = (means["projected"], means["visible"], means["blended"])
    flops_ms, bytes_ms = bound_ms(machine, *counted, setup.look.sh_degree, setup.look.mode == "antialiased")
    times = {name: means[name] for name in names[3:]}
    times["other_ms"] = core_ms - sum(times.values())
    times |= {"bound_flops_ms": flops_ms, "bound_bytes_ms": bytes_ms}
    ratio = core_ms / (flops_ms + bytes_ms)
    return {
        **{name: round(means[name]) for name in names[:3]},
        **{name: round(value, 4) for name, value in times.items()},
        "bound_ratio": round(ratio, 2),
    }
