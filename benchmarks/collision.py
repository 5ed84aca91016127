"""Measures the cost of a collision query: with the native checker, in plain torch, and in a loop over FCL.

    python benchmarks/collision.py                     # some minutes
    python benchmarks/collision.py --rounds 3 --json

The scene is a synthetic yard of 20 m, at two resolutions. Before anything is timed, the native checker's answers are
compared with FCL's. All rows take turns, round by round, so that a drifting machine affects all of them alike. The FCL
loop is the cost of python-fcl alone: it makes one object per pose and has none of ``FclChecker``'s look-ups. FCL's
moves are those of ``FclChecker``, tested pose by pose.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import fcl
import numpy as np
import torch
from machine import measured_machine
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from record import RESULTS, print_markdown, today, write_json
from timing import take_turns
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision import FclChecker, Occupancy, TorchChecker, verify, verify_sweeps
from splatrl.collision.fcl import fcl_octrees, fcl_shape
from splatrl.collision.native import NativeChecker
from splatrl.evaluation.figure_style import BLUE, DPI, INK, PURPLE
from splatrl.files import replacing
from splatrl.geometry import quats_to_rotations, rigid

BODIES: dict[str, Body] = {"box": Box((0.4, 0.4, 0.1)), "sphere": Sphere(0.2), "capsule": Capsule(0.1, 0.4)}
COLORS = {"box": INK, "sphere": BLUE, "capsule": PURPLE}
RESOLUTIONS = {"10k": 0.29, "300k": 0.05}
BATCHES = (1, 64, 1024, 65_536)
LOOPED, MOVED, TWIN = 256, 24, 16
"""Queries per turn of the FCL loop, of FCL's moves, and of the torch checker."""
STEP = 0.2
"""Length of a move, metres."""
BLOCKS = 4.0
LEAST = 4096
"""Minimum number of queries per turn of the native checker; larger batches take one batch."""
COMPARED = 512
"""Number of queries of each kind that are compared with FCL's answers."""


class Row(NamedTuple):
    """A measurement; ``poses`` is uniform or near (surfaces), ``query`` is static or swept."""

    backend: str
    body: str
    voxels: str
    poses: str
    query: str
    batch: int
    threads: int


@dataclass(frozen=True)
class Result:
    """One row of the table. Times are per query; ``hits`` is a fraction of all poses of this kind."""

    backend: str
    body: str
    voxels: str
    poses: str
    query: str
    batch: int
    threads: int
    occupied: int
    hits: float
    ns: float
    slowest: float
    fastest: float


class Queries(NamedTuple):
    """Start and end poses of moves, [N, 4, 4] each; static queries use the starts."""

    start: Tensor
    end: Tensor


def yard(resolution: float) -> Occupancy:
    """Build ground, walls and tree crowns in 20 m × 20 m × 6 m."""
    rng = np.random.default_rng(0)
    ground = rng.uniform(0, 20, (600_000, 2))
    height = 0.5 + 0.3 * np.sin(ground[:, 0]) * np.cos(0.7 * ground[:, 1])
    points = [np.column_stack([ground, height])]
    for x, y, along in ((3.0, 4.0, 0), (12.0, 9.0, 1), (6.0, 15.0, 0)):
        wall = np.tile([x, y, 0.3], (100_000, 1))
        wall[:, along] += rng.uniform(0, 5, len(wall))
        wall[:, 2] += rng.uniform(0, 2.5, len(wall))
        points.append(wall)
    for _ in range(12):
        center, size = rng.uniform([1, 1, 2], [19, 19, 4.5]), rng.uniform(0.2, 0.4)
        points.append(center + size * rng.standard_normal((20_000, 3)))
    return Occupancy.from_points(np.concatenate(points), resolution, crop=((0, 0, 0), (20, 20, 6)))


def queries_in(occupancy: Occupancy, near: bool, count: int) -> Queries:
    """Draw random moves: anywhere in the grid, or starting within 0.4 m of a solid voxel's centre along each axis."""
    generator = torch.Generator().manual_seed(0)
    share = torch.rand(count, 3, generator=generator)
    if near:
        centers = torch.from_numpy(occupancy.centers())
        places = centers[torch.randint(len(centers), (count,), generator=generator)] + 0.8 * share - 0.4
    else:
        lower, upper = (torch.from_numpy(corner).float() for corner in occupancy.bounds)
        places = lower + share * (upper - lower)
    rotation = quats_to_rotations(torch.randn(count, 4, generator=generator))
    way = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    return Queries(rigid(rotation, places), rigid(rotation, places + STEP * way))


def asked(query: Callable[..., Tensor], batches: Sequence[tuple[Tensor, ...]]) -> None:
    """Query each batch; the batches are split beforehand."""
    for batch in batches:
        query(*batch)


def asking(checker: Any, queries: Queries, swept: bool, batch: int, total: int) -> Callable[[], None]:
    """Return a call that makes ``total`` queries to a checker, in batches."""
    starts, ends = (poses[:total].split(batch) for poses in queries)
    if swept:
        return partial(asked, checker.sweeps, list(zip(starts, ends, strict=True)))
    return partial(asked, checker.collides, [(start,) for start in starts])


def looped(shape: Any, octrees: Sequence[Any], queries: Queries) -> None:
    """Run the loop that a user of python-fcl would write."""
    for pose in queries.start[:LOOPED].double().numpy():
        item = fcl.CollisionObject(shape, fcl.Transform(pose[:3, :3], pose[:3, 3]))
        for octree in octrees:
            if fcl.collide(item, octree, fcl.CollisionRequest(), fcl.CollisionResult()):
                break


def planned(
    occupancies: dict[str, Occupancy], queries: dict[tuple[str, str], Queries]
) -> dict[Row, tuple[Callable[[], None], int]]:
    """Return, for every row, the call for one turn and its number of queries."""
    plan: dict[Row, tuple[Callable[[], None], int]] = {}
    for (voxels, occupancy), (name, body) in product(occupancies.items(), BODIES.items()):
        native = {threads: NativeChecker(occupancy, body, threads) for threads in (1, 2)}
        twin, shape = TorchChecker(occupancy, body), fcl_shape(body)
        by_fcl = {"fcl": None, f"fcl, {BLOCKS:g} m blocks": BLOCKS}
        trees = {backend: fcl_octrees(occupancy, blocks) for backend, blocks in by_fcl.items()}
        movers = {backend: FclChecker(occupancy, body, blocks) for backend, blocks in by_fcl.items()}
        for poses, query in product(("uniform", "near"), ("static", "swept")):
            some, swept = queries[voxels, poses], query == "swept"
            for threads, batch in product((1, 2), BATCHES):
                total = max(LEAST, batch)
                run = asking(native[threads], some, swept, batch, total)
                plan[Row("native", name, voxels, poses, query, batch, threads)] = run, total
            for batch in (1, 64):
                total = max(TWIN, batch)
                run = asking(twin, some, swept, batch, total)
                plan[Row("torch", name, voxels, poses, query, batch, 1)] = run, total
            for backend in by_fcl:
                row = Row(backend, name, voxels, poses, query, 1, 1)
                if swept:
                    plan[row] = asking(movers[backend], some, True, MOVED, MOVED), MOVED
                else:
                    plan[row] = partial(looped, shape, trees[backend], some), LOOPED
    return plan


def hit_shares(
    occupancies: dict[str, Occupancy], queries: dict[tuple[str, str], Queries]
) -> dict[tuple[str, str, str, str], float]:
    """Return the fraction of hits by body, voxels, poses and query."""
    shares = {}
    for (name, body), (voxels, poses) in product(BODIES.items(), queries):
        checker, some = NativeChecker(occupancies[voxels], body), queries[voxels, poses]
        shares[name, voxels, poses, "static"] = float(checker.collides(some.start).float().mean())
        shares[name, voxels, poses, "swept"] = float(checker.sweeps(some.start, some.end).float().mean())
    return shares


def print_agreement(occupancies: dict[str, Occupancy], queries: dict[tuple[str, str], Queries]) -> None:
    """Print how far the native checker's answers agree with FCL's near surfaces."""
    for (voxels, occupancy), (name, body) in product(occupancies.items(), BODIES.items()):
        native, oracle = NativeChecker(occupancy, body), FclChecker(occupancy, body)
        start, end = (poses[:COMPARED] for poses in queries[voxels, "near"])
        print(f"{name} in {voxels} voxels, static: {verify(native, oracle, start)}")
        print(f"{name} in {voxels} voxels, swept: {verify_sweeps(native, oracle, start, end)}")


def print_table(results: Sequence[Result]) -> None:
    """Print the results as Markdown, each compared with the FCL loop of the same run."""
    loops = {(r.body, r.voxels, r.poses, r.query): r.ns for r in results if r.backend == "fcl"}
    header = ["backend", "body", "voxels", "poses", "query", "batch", "threads", "hits"]
    header += ["ns/query (fastest to slowest)", "× fcl"]
    rows = []
    for r in results:
        row = [r.backend, r.body, f"{r.occupied:,}", r.poses, r.query, f"{r.batch:,}", str(r.threads)]
        row += [f"{r.hits:.0%}", f"{r.ns:,.0f} ({r.fastest:,.0f} to {r.slowest:,.0f})"]
        rows.append([*row, f"{loops[r.body, r.voxels, r.poses, r.query] / r.ns:,.3g}"])
    print_markdown(header, rows)


def draw(results: Sequence[Result], path: Path) -> None:
    """Plot the cost on one core against the batch size."""
    figure = Figure(figsize=(13, 9), dpi=DPI, layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    kinds = list(product(("uniform", "near"), RESOLUTIONS))
    for axes, (poses, voxels) in zip(panels.flat, kinds, strict=True):
        mine = [r for r in results if (r.poses, r.voxels, r.threads) == (poses, voxels, 1)]
        for r in mine:
            if r.backend.startswith("fcl") and r.query == "static":
                style = "--" if r.backend == "fcl" else ":"
                axes.axhline(r.ns, color=COLORS[r.body], linestyle=style, linewidth=1)
        for name, (backend, query, marker, line) in product(
            BODIES, (("native", "static", "o", "-"), ("native", "swept", "^", "-."), ("torch", "static", "x", "-"))
        ):
            points = [(r.batch, r.ns) for r in mine if (r.backend, r.query, r.body) == (backend, query, name)]
            axes.loglog(*zip(*points, strict=True), line, marker=marker, color=COLORS[name], markersize=5)
        axes.set_title(f"{mine[0].occupied:,} voxels, {'near surfaces' if poses == 'near' else 'uniform'}")
        axes.grid(color="0.9", linewidth=0.8)
    for axes in panels[-1]:
        axes.set(xlabel="bodies per call", xticks=BATCHES, xticklabels=[f"{batch:,}" for batch in BATCHES])
    for axes in panels[:, 0]:
        axes.set(ylabel="ns per query, one core")
    for name, color in COLORS.items():
        panels[0, 0].plot([], [], color=color, linewidth=4, label=name)
    for label, style in (("native", "o-"), ("native, swept", "^-."), ("torch", "x-"), ("FCL", "--")):
        panels[0, 0].plot([], [], style, color="0.4", markersize=5, label=label)
    panels[0, 0].plot([], [], ":", color="0.4", label=f"FCL, {BLOCKS:g} m blocks")
    figure.legend(frameon=False, ncols=8, loc="outside upper center")
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix.removeprefix("."))


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-collision.json")
    parser.add_argument("--png", type=Path, default=RESULTS / f"{today()}-cpu-collision.png")
    options = parser.parse_args()
    machine = measured_machine()
    print(machine)
    occupancies = {name: yard(resolution) for name, resolution in RESOLUTIONS.items()}
    kinds = product(occupancies, ("uniform", "near"))
    queries = {(v, poses): queries_in(occupancies[v], poses == "near", max(BATCHES)) for v, poses in kinds}
    print_agreement(occupancies, queries)
    plan, hits = planned(occupancies, queries), hit_shares(occupancies, queries)
    seconds = take_turns({row: run for row, (run, _) in plan.items()}, options.rounds)
    results = []
    for row, (_, total) in plan.items():
        ns = [1e9 * second / total for second in seconds[row]]
        count = occupancies[row.voxels].count
        share = hits[row.body, row.voxels, row.poses, row.query]
        results.append(Result(*row, count, share, median(ns), max(ns), min(ns)))
    print_table(results)
    draw(results, options.png)
    print(f"drawn to {options.png}")
    if options.json:
        print(f"written to {write_json('collision', machine, results)}")


if __name__ == "__main__":
    main()
