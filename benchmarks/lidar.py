"""Measures the cost of a lidar beam: ray casts against the voxels of a scene, on one core.

    python benchmarks/lidar.py                    # half a minute
    python benchmarks/lidar.py --rounds 3 --json

Times are CPU time of this process, which other work on the machine disturbs less.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from time import process_time

import torch
from collision import yard
from machine import measured_machine
from record import print_markdown, write_json
from torch import Tensor

from splatrl.bodies import Sphere
from splatrl.collision import NativeChecker, Occupancy
from splatrl.geometry import axis_rotations, quats_to_rotations, rigid
from splatrl.scenes import backyard

REACH = 10.0
BEAMS, RINGS = 64, 16
BODIES = 4096
OVER_GROUND = 0.5
"""Height of the lidar above the yard's uneven ground, metres."""


@dataclass(frozen=True)
class Result:
    """One row of the table, on one core; times are per ray."""

    place: str
    beams: str
    batch: int
    rays: int
    seen: float
    ns: float
    slowest: float
    fastest: float


def scan(rings: int = 1) -> Tensor:
    """Return beams all around, in rings at elevations from -15 to 15 degrees, or one level ring: [rings · BEAMS, 3]."""
    azimuth = torch.arange(BEAMS) * math.tau / BEAMS
    elevations = torch.linspace(-15.0, 15.0, rings).deg2rad() if rings > 1 else torch.zeros(1)
    rows = [
        torch.stack([e.cos() * azimuth.cos(), e.cos() * azimuth.sin(), e.sin().expand(BEAMS)], 1) for e in elevations
    ]
    return torch.cat(rows).contiguous()


def level_poses(places: Tensor, generator: torch.Generator) -> Tensor:
    """Return upright poses at the given places with random headings."""
    return rigid(axis_rotations(2, torch.rand(len(places), generator=generator) * math.tau), places).contiguous()


def cases() -> dict[tuple[str, str], tuple[NativeChecker, Tensor, Tensor]]:
    """Return checker, poses and beams by place and kind of scan."""
    generator = torch.Generator().manual_seed(0)
    wide, garden = yard(0.05), Occupancy.from_scene(backyard(), resolution=0.05)
    lower, upper = (torch.from_numpy(corner).float() for corner in wide.bounds)
    places = lower + torch.rand(BODIES, 3, generator=generator) * (upper - lower)
    anywhere = rigid(quats_to_rotations(torch.randn(BODIES, 4, generator=generator)), places).contiguous()
    over = places.clone()
    over[:, 2] = 0.5 + 0.3 * over[:, 0].sin() * (0.7 * over[:, 1]).cos() + OVER_GROUND
    level = level_poses(over, generator)
    inside = torch.rand(BODIES, 3, generator=generator) * torch.tensor([4.0, 4.0, 0.0]) + torch.tensor(
        [-2.0, -2.0, 0.4]
    )
    named = {"yard, 20 m": NativeChecker(wide, Sphere(0.2), 1), "backyard, 6 m": NativeChecker(garden, Sphere(0.2), 1)}
    return {
        ("yard, 20 m", f"level, {BEAMS}"): (named["yard, 20 m"], level, scan()),
        ("yard, 20 m", f"{RINGS} rings of {BEAMS}"): (named["yard, 20 m"], level[: BODIES // RINGS], scan(RINGS)),
        ("yard, 20 m", "any direction"): (named["yard, 20 m"], anywhere, scan(RINGS)[::RINGS]),
        ("backyard, 6 m", f"level, {BEAMS}"): (named["backyard, 6 m"], level_poses(inside, generator), scan()),
    }


def asked(checker: NativeChecker, batches: tuple[Tensor, ...], beams: Tensor) -> None:
    """Cast the beams of all batches."""
    for poses in batches:
        checker.ranges(poses, beams, REACH)


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-lidar.json")
    options = parser.parse_args()
    machine = measured_machine()
    print(machine)
    plan: dict[tuple[str, str, int], tuple[Callable[[], None], int, float]] = {}
    for (place, kind), (checker, poses, beams) in cases().items():
        seen = float((checker.ranges(poses, beams, REACH) < REACH).float().mean())
        for batch in (64, len(poses)):
            run = partial(asked, checker, poses.split(batch), beams)
            plan[place, kind, batch] = run, len(poses) * len(beams), seen
    seconds: dict[tuple[str, str, int], list[float]] = {row: [] for row in plan}
    for _ in range(options.rounds):
        for row, (run, _, _) in plan.items():
            begin = process_time()
            run()
            seconds[row].append(process_time() - begin)
    results = []
    for row, (_, rays, seen) in plan.items():
        ns = [1e9 * second / rays for second in seconds[row]]
        results.append(Result(*row, rays, seen, median(ns), max(ns), min(ns)))
    header = ["place", "beams", "robots per call", "beams that hit", "ns/ray (fastest to slowest)", "million rays/s"]
    rows = [
        [r.place, r.beams, f"{r.batch:,}", f"{r.seen:.0%}", f"{r.ns:.0f} ({r.fastest:.0f} to {r.slowest:.0f})",
         f"{1e3 / r.ns:.1f}"]
        for r in results
    ]  # fmt: skip
    print_markdown(header, rows)
    if options.json:
        print(f"written to {write_json('lidar', machine, results)}")


if __name__ == "__main__":
    main()
