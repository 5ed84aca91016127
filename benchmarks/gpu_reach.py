"""Performance targets for an H200, and what a run achieved."""

import math
from dataclasses import dataclass

from gpu_bench import Bench
from gpu_collision import Collision
from gpu_first_use import FirstUse
from gpu_render import Likeness, Rendering
from gpu_training import Stepping, Training

MEAN_DB, WORST_DB = 40.0, 34.0
"""Minimum PSNR of images with level of detail against exact ones: of the mean and of the worst view, dB."""


@dataclass(frozen=True)
class Target:
    """One line of the table.

    Attributes:
        name: what is measured.
        unit: unit of the numbers.
        least: required minimum; for seconds, the maximum.
        aim: value to aim for.
        found: measured value; NaN if it was not measured.
        how: setting with which it was measured, if there was a choice.
    """

    what = "target"
    name: str
    unit: str
    least: float
    aim: float
    found: float
    how: str = ""

    @property
    def score(self) -> float:
        """``found`` relative to ``least``, inverted for seconds; more is better."""
        return self.least / self.found if self.unit == "s" else self.found / self.least

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        if math.isnan(self.found):
            return "not measured"
        aimed = self.found <= self.aim if self.unit == "s" else self.found >= self.aim
        return "aim reached" if aimed else "reached" if self.score >= 1 else "missed"


def targets(bench: Bench) -> list[Target]:
    """Return all lines of the table; a dry run fills them with its own sizes."""
    detailed, how = _with_detail(bench)
    exact = _frames(bench, "CudaRenderer", 0.0)
    ratio = _frames(bench, "CudaRenderer beside gsplat", 0.0) / _frames(bench, "gsplat", 0.0)
    queries = bench.found(Collision, body="box", query="swept", voxels=bench.sizes.voxels[-1], poses="near")
    steps = bench.found(Stepping, robots=bench.sizes.robots[-1])
    share = max((row.share for row in steps), default=math.nan)
    frames = [row.frames_per_second.typical for row in bench.found(Training)]
    seconds = [row.compile_seconds + row.start_seconds for row in bench.found(FirstUse)]
    return [
        Target("frames/s, 1M, B = 1024, level of detail", "/s", 100e3, 250e3, detailed, how),
        Target("frames/s, 1M, B = 1024, exact", "/s", 20e3, 100e3, exact),
        Target("speed relative to gsplat in this run, exact, B = 1024", "×", 5, 25, ratio),
        Target(
            "box queries/s, swept", "/s", 5e8, 2e9, _best([row.queries_per_second.typical for row in queries]), "near"
        ),
        Target("env steps/s relative to the bare renderer, B = 4096", "", 0.8, 0.95, share),
        Target("PPO frames/s end to end, FPS task", "/s", 50e3, 150e3, _best(frames)),
        Target("first use: compile and start", "s", 20, 5, sum(seconds) if seconds else math.nan),
    ]


def _best(values: list[float]) -> float:
    return max(values, default=math.nan)


def _frames(bench: Bench, renderer: str, tolerance: float) -> float:
    sizes = bench.sizes
    where = {"scene": sizes.scenes[0], "batch": sizes.batches[sizes.base]}
    rows = bench.found(Rendering, renderer=renderer, tolerance=tolerance, **where)
    return _best([row.frames_per_second.typical for row in rows])


def _with_detail(bench: Bench) -> tuple[float, str]:
    """Return the frames/s and the name of the fastest tolerance that has the required quality."""
    good = [
        (_frames(bench, "CudaRenderer", row.tolerance), f"{row.tolerance:g} px")
        for row in bench.found(Likeness, scene=bench.sizes.scenes[0], against="exact")
        if row.mean_db >= MEAN_DB and row.worst_db >= WORST_DB
    ]
    return max(good, default=(math.nan, ""))
