"""Collision queries per second on a GPU, and their agreement with the CPU's answers."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle, product

import torch
from collision import BODIES, RESOLUTIONS, Queries, queries_in, yard
from gpu_bench import Bench
from gpu_device import Rate, in_turns, rate

from splatrl.collision import NativeChecker, Occupancy
from splatrl.collision.cuda import CudaChecker

MARGIN = 1e-6
"""Tolerance of the free fraction; answers that differ by no more count as equal."""
PARTS = 4
"""Number of query sets that take turns, so that none is in a cache already."""


@dataclass(frozen=True)
class Collision:
    """A row of the table: queries per second, and the fraction of hits."""

    what = "collision"
    body: str
    voxels: str
    occupied: int
    poses: str
    query: str
    batch: int
    hits: float
    queries_per_second: Rate


@dataclass(frozen=True)
class Agreement:
    """Number of queries that GPU and CPU answer differently, of all that were compared."""

    what = "agreement"
    body: str
    voxels: str
    poses: str
    query: str
    compared: int
    different: int


def collision(bench: Bench) -> None:
    """Measure every body among few and many voxels, with static and swept queries, anywhere and near surfaces."""
    most = max(bench.sizes.queries)
    yards = {voxels: yard(RESOLUTIONS[voxels]) for voxels in bench.sizes.voxels}
    kinds = list(product(yards, BODIES))
    for number, (voxels, body) in enumerate(kinds):
        occupancy = yards[voxels]
        checker = bench.checker(occupancy, BODIES[body])
        budget = 0.5 * bench.left / (len(kinds) - number)
        for poses in ("uniform", "near"):
            queries = queries_in(occupancy, poses == "near", most)
            here = Queries(*(part.to(bench.device) for part in queries))
            speeds(bench, checker, (body, voxels, occupancy.count, poses), here, budget / 2)
            agreements(bench, checker, occupancy, (body, voxels, poses), queries)
        checker.raise_faults()
        bench.free()


def asking(
    checker: CudaChecker, queries: Queries, query: str, batch: int
) -> tuple[Callable[[], None], int, Callable[[], torch.Tensor]]:
    """Return a call that makes queries batch by batch, their number per call, and a call that returns all answers."""
    parts = min(PARTS, max(1, len(queries.start) // batch))
    starts, ends = (poses[: parts * batch].split(batch) for poses in queries)
    batches = cycle(zip(starts, ends, strict=True))

    def ask(start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
        return checker.sweeps(start, end) if query == "swept" else checker.collides(start)

    def call() -> None:
        for _ in range(parts):
            ask(*next(batches))

    return call, parts * batch, lambda: ask(*queries)


def speeds(
    bench: Bench, checker: CudaChecker, names: tuple[str, str, int, str], queries: Queries, budget: float
) -> None:
    """Measure queries per second; all batch sizes and both kinds of query take turns."""
    kinds = list(product(("static", "swept"), bench.sizes.queries))
    asked = {kind: asking(checker, queries, *kind) for kind in kinds}
    times = in_turns({kind: call for kind, (call, _, _) in asked.items()}, bench.device, budget)
    for kind, (_, count, answers) in asked.items():
        hits = round(float(answers().double().mean()), 4)
        bench.keep(Collision(*names, *kind, hits, rate(count, times[kind])))


def agreements(
    bench: Bench, checker: CudaChecker, occupancy: Occupancy, names: tuple[str, str, str], queries: Queries
) -> None:
    """Compare the answers with the CPU's."""
    native, count = NativeChecker(occupancy, BODIES[names[0]]), bench.sizes.compared
    some = Queries(*(part[:count] for part in queries))
    here = Queries(*(part.to(bench.device) for part in some))
    touches = checker.collides(here.start).cpu() != native.collides(some.start)
    fractions = checker.free_fraction(*here).cpu() - native.free_fraction(*some)
    for query, differs in (("static", touches), ("swept", fractions.abs() > MARGIN)):
        bench.keep(Agreement(*names, query, len(differs), int(differs.sum())))
