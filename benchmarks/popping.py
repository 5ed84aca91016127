"""Measures popping: by how much pixels jump when level of detail changes between frames, on smooth paths.

    python benchmarks/popping.py        # the built-in backyard, a generated yard, and the kitchen if it is found

Cameras of 64×64 pixels move straight ahead in steps of 5 mm and turn slowly. All values are grey levels of the channel
that changes most, over all pixels:

- ``cut``: change of a frame when its tolerance grows by 0.25 %, by which a step of 5 mm changes what is 2 m away; this
  isolates the jumps.
- ``path``: change from frame to frame of the difference to the exact image, which includes edges displaced by level of
  detail.
- ``exact``: change of the exact image from frame to frame.
"""

import math
from collections.abc import Iterator

import torch
from record import print_markdown
from scenes import FOV, YARD, Room, kitchen
from torch import Tensor
from tqdm import tqdm

import splatrl
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Gaussians

SIDE = 64
WALKS, STEPS, STEP = 12, 120, 0.005
"""Number of paths, frames per path, and metres between frames."""
TURN = 0.3
"""Amplitude of the view's turn to either side, radians."""
GROWTH = 1.0025
TOLERANCES = (0.5, 1.0)
LARGE = 10
"""Change that people notice, grey levels."""


def places() -> Iterator[tuple[str, Gaussians, Room]]:
    """Yield the names of scenes, their Gaussians, and the rooms in which cameras move."""
    yield "backyard", splatrl.backyard().gaussians, YARD
    yield "scene=yard scene.seed=3", splatrl.yard(3).gaussians, YARD
    if (found := kitchen()) is not None:
        yield "kitchen", found.scene.gaussians, found.room


def walk(room: Room, seed: int) -> Cameras:
    """Return the cameras of a smooth path: [STEPS]."""
    begin = room.poses(1, torch.Generator().manual_seed(seed))[0]
    way = STEP * torch.arange(STEPS)
    ahead = begin[:3, 2]
    eyes = begin[:3, 3] + way[:, None] * ahead * torch.tensor([1.0, 1.0, 0.0])
    yaw = torch.atan2(ahead[1], ahead[0]) + TURN * (math.tau * torch.arange(STEPS) / STEPS).sin()
    looks = torch.stack([yaw.cos(), yaw.sin(), ahead[2].expand(STEPS)], 1)
    return Cameras(look_at(eyes, eyes + looks), intrinsics(FOV, SIDE, SIDE), SIDE, SIDE)


def summary(changes: Tensor) -> list[str]:
    """Format the maximum, the 99.99th percentile, and the number of large changes per million."""
    rank = math.ceil(0.9999 * changes.numel())
    large = float((changes > LARGE).float().mean())
    return [f"{changes.max():.0f}", f"{changes.flatten().kthvalue(rank).values:.0f}", f"{1e6 * large:.0f}"]


def most(difference: Tensor) -> Tensor:
    """Return the absolute difference of the channel that differs most."""
    return difference.abs().amax(-1)


def main() -> None:
    """Measure, and print a table."""
    rows = []
    for name, gaussians, room in places():
        exact = NativeRenderer(gaussians, tolerance=0.0)
        for tolerance in TOLERANCES:
            coarse, coarser = (NativeRenderer(gaussians, tolerance=t) for t in (tolerance, tolerance * GROWTH))
            path, cut, alone = list[Tensor](), list[Tensor](), list[Tensor]()
            for seed in tqdm(range(WALKS), desc=f"{name}, {tolerance} px", leave=False):
                cameras = walk(room, seed)
                truth, shown = exact.pixels(cameras).float(), coarse.pixels(cameras).float()
                alone.append(most(truth.diff(dim=0)))
                path.append(most((shown - truth).diff(dim=0)))
                cut.append(most(coarser.pixels(cameras).float() - shown))
            columns = [summary(torch.cat(each)) for each in (cut, path, alone)]
            rows.append([name, f"{tolerance}", *(", ".join(each) for each in columns)])
    figures = f"max, 99.99th percentile, per million above {LARGE}"
    print_markdown(["scene", "tolerance, px", f"cut: {figures}", "path", "exact"], rows)


if __name__ == "__main__":
    main()
