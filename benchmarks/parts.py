"""Measures the cost of models placed in scenes in the native renderer.

    python benchmarks/parts.py                          # a minute
    python benchmarks/parts.py --scene backyard --tolerance 0 1

Two comparisons: a scene with balls, placed differently in each row, against the scene alone; and rows that each draw a
different model of the same size against rows that all draw the same one. All take turns, round by round, and draw the
same views.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

import torch
from figure import tolerance_name
from machine import measured_machine
from record import print_markdown, write_json
from scenes import Room, Subject, chosen
from timing import take_turns
from torch import Tensor

from splatrl.geometry import rigid, rotations_to_quats
from splatrl.renderers import NativeRenderer, Parts
from splatrl.scenes import Gaussians
from splatrl.spherical_harmonics import C0

SIZE = 64
"""Width and height of the images, pixels."""
THICKNESS = 0.001
"""Standard deviation of a ball's discs along the surface normal, metres."""


@dataclass(frozen=True)
class Result:
    """One row of the table: time per frame of one core, and its ratio to the row with which it is compared."""

    scene: str
    tolerance: float
    what: str
    batch: int
    threads: int
    frame_ms: float
    fastest_ms: float
    ratio: float  # ratio of the medians
    bytes_shown: float  # fraction of bytes that differ between the two, which shows whether the parts are visible


def ball(count: int = 800, radius: float = 0.1) -> Gaussians:
    """Make a ball of two colours from flat discs, spread evenly by the golden angle."""
    height = 1 - (2 * torch.arange(count) + 1) / count
    turn = math.pi * (3 - math.sqrt(5)) * torch.arange(count)
    across = (1 - height.square()).sqrt()
    normals = torch.stack([across * turn.cos(), across * turn.sin(), height], 1)
    side = torch.nn.functional.normalize(torch.linalg.cross(normals, torch.tensor([0.3, 0.5, 0.81]).expand(count, 3)))
    turns = torch.stack([side, torch.linalg.cross(normals, side), normals], -1)
    spread = 0.4 * radius * math.sqrt(4 * math.pi / count)
    colors = torch.where(height[:, None] > 0, torch.tensor([0.8, 0.1, 0.1]), torch.tensor([0.9, 0.9, 0.9]))
    return Gaussians(
        means=radius * normals,
        quats=rotations_to_quats(turns),
        scales=torch.tensor([spread, spread, THICKNESS]).expand(count, 3).clone(),
        opacities=torch.full((count,), 0.97),
        sh=((colors - 0.5) / C0).unsqueeze(1),
        batch_size=[count],
    )


def with_balls(room: Room, batch: int, balls: int) -> Parts:
    """Return parts with model 0 at the origin and balls, model 1, at random places in the room, up to eye height."""
    g = torch.Generator().manual_seed(2)
    low, high = torch.tensor([*room.lower[:2], 0.1]), torch.tensor(room.upper)
    places = low + (high - low) * torch.rand(batch, balls, 3, generator=g)
    stands = torch.cat([torch.zeros(batch, 1, 3), places], 1)
    model = torch.cat([torch.zeros(batch, 1), torch.ones(batch, balls)], 1).long()
    return Parts(model, rigid(torch.eye(3).expand(batch, 1 + balls, 3, 3), stands))


def each_its_own(model: Tensor) -> Parts:
    """Return parts with one model at the origin of each row: [B] models."""
    return Parts(model.unsqueeze(1), torch.eye(4).repeat(len(model), 1, 1, 1))


def measure(subject: Subject, tolerance: float, options: argparse.Namespace) -> list[Result]:
    """Make both comparisons in a scene."""
    scene, batch = subject.scene, options.batch
    settings = {"threads": options.threads, "tolerance": tolerance}
    moving = NativeRenderer([scene, ball()], **settings)
    copies = NativeRenderer([scene] * batch, **settings)
    views = subject.room.views(batch, SIZE, SIZE)
    calls: dict[str, tuple[NativeRenderer, Parts | None]] = {
        "the scene": (moving, None),
        f"the scene and {options.balls} balls": (moving, with_balls(subject.room, batch, options.balls)),
        "the same model in all rows": (copies, each_its_own(torch.zeros(batch, dtype=torch.long))),
        "a different model in each row": (copies, each_its_own(torch.arange(batch))),
    }

    def call(renderer: NativeRenderer, parts: Parts | None) -> Callable[[], Tensor]:
        return lambda: renderer.pixels(views, parts)

    seconds = take_turns({what: call(*arguments) for what, arguments in calls.items()}, options.rounds)
    names, results = list(calls), []
    for number, (what, (renderer, parts)) in enumerate(calls.items()):
        base = names[number - number % 2]
        shown = renderer.pixels(views, parts) != calls[base][0].pixels(views, calls[base][1])
        core_ms = 1e3 * options.threads / batch
        results.append(
            Result(
                scene=scene.name,
                tolerance=tolerance,
                what=what,
                batch=batch,
                threads=options.threads,
                frame_ms=round(core_ms * median(seconds[what]), 4),
                fastest_ms=round(core_ms * min(seconds[what]), 4),
                ratio=round(median(seconds[what]) / median(seconds[base]), 3),
                bytes_shown=round(float(shown.double().mean()), 4),
            )
        )
    return results


def print_table(results: Sequence[Result]) -> None:
    """Print the results as Markdown."""
    header = ["scene", "detail", "drawn", "rows", "threads", "ms per frame (fastest)", "ratio", "bytes that differ"]
    rows = [
        [
            *(r.scene, tolerance_name(r.tolerance), r.what, str(r.batch), str(r.threads)),
            *(f"{r.frame_ms:.3f} ({r.fastest_ms:.3f})", f"{r.ratio:.3f}", f"{r.bytes_shown:.1%}"),
        ]
        for r in results
    ]
    print_markdown(header, rows)


def main() -> None:
    """Parse the command line, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", help="a name, or a splat file (z up); default: kitchen if found, else backyard")
    parser.add_argument("--tolerance", nargs="+", type=float, default=[0.0, 1.0], help="pixels; 0 is exact")
    parser.add_argument("--balls", type=int, default=8, help="balls per row")
    parser.add_argument("--batch", type=int, default=64, help="rows per call, and number of models")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-parts.json")
    options = parser.parse_args()
    machine = measured_machine()
    print(machine)
    found = chosen([options.scene] if options.scene else ["kitchen", "backyard"])
    subject = next(iter(found.values()))
    results = [row for tolerance in options.tolerance for row in measure(subject, tolerance, options)]
    print_table(results)
    if options.json:
        print(f"written to {write_json('parts', machine, results)}")


if __name__ == "__main__":
    main()
