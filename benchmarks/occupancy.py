"""Measures how well the occupancy of a captured and a generated scene agrees with what is known to be solid there.

    python benchmarks/occupancy.py [--poses 20000]

Prints a table of recipes for each scene, and writes results/<date>-occupancy.json and -occupancy-gaps-<scene>.png. The
columns are the false hits of a 0.1 m cube in free space, the recall of a 0.2 m cube centred on known surfaces, and
the fractions of 0.2 m cubes, free at first, that are stopped when swept through the floor and outwards through a wall.
"""

import argparse
import dataclasses
import json
import time
from typing import Any

import torch
from occupancy_gaps import draw_gaps
from occupancy_truth import Truth, kitchen_truth, yard_truth
from record import RESULTS, print_markdown, today
from tqdm import tqdm

from splatrl.bodies import Box
from splatrl.collision import DensitySettings, NativeChecker, Occupancy
from splatrl.files import replacing
from splatrl.geometry import rigid

SMALL, LARGE = Box((0.1, 0.1, 0.1)), Box((0.2, 0.2, 0.2))
DEFAULT: dict[str, Any] = {}
VARIED: list[dict[str, Any]] = [
    *({"min_opacity": value} for value in (0.02, 0.05, 0.2, 0.5)),
    *({"cutoff": value} for value in (0.1, 0.3, 0.7, 0.9)),
    *({"min_volume": value} for value in (0.0, 0.001, 0.03, 0.1)),
    *({"max_scale": value} for value in (0.1, 0.3, 3.0)),
    {"min_opacity": 0.05, "cutoff": 0.1, "min_volume": 0.0},  # as in splat-transform
]
"""Recipes, each as the settings that differ from the defaults: one at a time, and those of splat-transform."""


@dataclasses.dataclass(frozen=True)
class Result:
    """Results of one recipe, as fractions of the poses or moves of each kind.

    Attributes:
        scene: name of the scene.
        resolution: edge of a voxel, metres.
        recipe: settings that differ from the defaults.
        seconds: time to build the occupancy.
        voxels: number of solid voxels.
        false_hits: hits in free space.
        recall: hits on known surfaces.
        floor: moves through the floor that are stopped.
        wall: moves outwards through a closed part of a wall that are stopped.
        low_wall: the same where the captured wall has gaps.
    """

    scene: str
    resolution: float
    recipe: dict[str, Any]
    seconds: float
    voxels: int
    false_hits: float
    recall: float
    floor: float
    wall: float
    low_wall: float


def measured(truth: Truth, resolution: float, recipe: dict[str, Any], count: int) -> Result:
    """Build the occupancy by one recipe, and compare it with the truth."""
    start = time.perf_counter()
    lower, upper = torch.tensor(truth.scene.bounds, dtype=torch.float64)
    margin = 0.1 * (upper - lower).max()
    density = DensitySettings(**{key: value for key, value in recipe.items() if key != "fill"})
    crop = ((lower - margin).tolist(), (upper + margin).tolist())
    occupancy = Occupancy.from_gaussians(truth.scene.gaussians, resolution, density, crop)
    if "fill" in recipe:
        occupancy = occupancy.solid(recipe["fill"], [truth.seed])
    seconds = time.perf_counter() - start
    small, large = NativeChecker(occupancy, SMALL), NativeChecker(occupancy, LARGE)

    def swept(moves: tuple[torch.Tensor, torch.Tensor]) -> float:
        start, end = (_upright(ends) for ends in moves)
        begins_free = ~large.collides(start)
        return float(large.sweeps(start[begins_free], end[begins_free]).float().mean())

    return Result(
        truth.scene.name,
        resolution,
        recipe,
        round(seconds, 3),
        occupancy.count,
        float(small.collides(_upright(truth.free(count))).float().mean()),
        float(large.collides(_upright(truth.surface(count))).float().mean()),
        swept(truth.through_floor(count)),
        swept(truth.through_wall(count, truth.whole)),
        swept(truth.through_wall(count, truth.gappy)),
    )


def _upright(points: torch.Tensor) -> torch.Tensor:
    return rigid(torch.eye(3), points.float())


def _row(result: Result) -> list[str]:
    shares = (result.false_hits, result.recall, result.floor, result.wall, result.low_wall)
    recipe = ", ".join(f"{key} {value:g}" for key, value in result.recipe.items()) or "defaults"
    return [f"{result.resolution:g}", recipe, f"{result.voxels:,}", *(f"{100 * share:.2f}" for share in shares)]


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=20_000, help="number of poses of each kind")
    arguments = parser.parse_args()
    truths = [truth for truth in (kitchen_truth(), yard_truth()) if truth is not None]
    results = []
    for truth in truths:
        recipes = [DEFAULT, {"fill": 0.2}, *VARIED]
        plan = [(resolution, recipe) for resolution in (0.05, 0.1) for recipe in recipes]
        rows = [measured(truth, *setting, arguments.poses) for setting in tqdm(plan, desc=truth.scene.name)]
        results += rows
        print(f"\n{truth.scene.name}, {arguments.poses} poses of each kind, per cent")
        header = ["voxel, m", "recipe", "voxels", "false hits", "recall", "floor", "wall", "low wall"]
        print_markdown(header, [_row(row) for row in rows])
        draw_gaps(truth, RESULTS / f"{today()}-occupancy-gaps-{truth.scene.name}.png")
    with replacing(RESULTS / f"{today()}-occupancy.json") as stream:
        record = {"date": today(), "poses": arguments.poses, "results": [dataclasses.asdict(r) for r in results]}
        stream.write((json.dumps(record, indent=2) + "\n").encode())


if __name__ == "__main__":
    main()
