"""The depth of pixels by plane sweep (Collins 1996): of many depths, the one at which neighbouring photos agree."""

import torch
from torch import Tensor

from splatrl.capture.fit_pictures import Pictures

DEPTHS = 64
NEIGHBOURS = 4
AGREEING = 2
"""Of the neighbours, how many must agree: the others may see something else in front."""
PATCH = 3
APART = 0.06
"""Distance to the best neighbours, in the median depth."""
TURNED = 0.8
"""Least cosine between the optical axes of neighbours."""
TRUST = 0.05
"""Cost of being the whole range of inverse depths away from what is expected: it decides where nothing else does."""


def neighbours_of(seen: Pictures, row: int, rows: Tensor, depth: float) -> Tensor:
    """Up to ``NEIGHBOURS`` of the views ``rows`` that see the same from a little to the side: [n] int64."""
    poses = seen.camera_to_world
    others = rows[(rows != row) & (poses[rows, :3, 2] @ poses[row, :3, 2] > TURNED)]
    distance = (poses[others, :3, 3] - poses[row, :3, 3]).norm(dim=1).clamp_min(1e-6)
    return others[(distance / (APART * depth)).log().abs().argsort(stable=True)[:NEIGHBOURS]]


def sweep(seen: Pictures, row: int, neighbours: Tensor, places: Tensor, expected: Tensor) -> Tensor:
    """Inverse depths of pixels.

    Args:
        seen: the photos.
        row: of the photo whose pixels these are.
        neighbours: [m] int64, the photos that it is compared with.
        places: [n, 2] float32, column and row, pixels.
        expected: [n] float32, inverse depths to prefer where photos do not decide, and whose range is searched.

    Returns:
        [n] float32.
    """
    low, high = 0.6 * float(expected.min()), 1.6 * float(expected.max())
    inverses = torch.linspace(low, high, DEPTHS)
    offsets = torch.arange(PATCH) - PATCH // 2
    patch = torch.stack(torch.meshgrid(offsets, offsets, indexing="xy"), -1).view(1, -1, 2)
    around = places[:, None] + patch  # [n, 9, 2]
    own = flattened(sampled(seen.pixels[row], around))  # [n, 9, 3]
    rays = torch.cat([around, torch.ones_like(around[..., :1])], -1) @ torch.linalg.inv(seen.K).T
    costs = []
    for other in neighbours.tolist():
        relative = torch.linalg.inv(seen.camera_to_world[other]) @ seen.camera_to_world[row]
        turned = rays @ (seen.K @ relative[:3, :3]).T  # [n, 9, 3]
        shift = seen.K @ relative[:3, 3]
        ahead = turned[:, None] + inverses[None, :, None, None] * shift  # [n, D, 9, 3]
        there = ahead[..., :2] / ahead[..., 2:].clamp_min(1e-6)
        theirs = flattened(sampled(seen.pixels[other], there.flatten(0, 1))).unflatten(0, there.shape[:2])
        cost = (theirs - own[:, None]).abs().mean((2, 3))
        height, width = seen.pixels.shape[1:3]
        outside = (there < 0).any(-1) | (there > torch.tensor([width, height])).any(-1) | (ahead[..., 2] <= 0)
        costs.append(torch.where(outside.any(-1), 1.0, cost))
    agreed = torch.stack(costs).sort(0).values[:AGREEING].mean(0)  # [n, D]
    away = (inverses - expected[:, None]).abs() / (high - low)
    return inverses[(agreed + TRUST * away).argmin(1)]


def sampled(image: Tensor, places: Tensor) -> Tensor:
    """Colours [n, p, 3] of an image [H, W, 3] uint8 at places [n, p, 2], between pixels."""
    size = torch.tensor([image.shape[1], image.shape[0]])
    planes = image.movedim(-1, 0).float()[None] / 255
    found = torch.nn.functional.grid_sample(
        planes, (2 * places / size - 1)[None], padding_mode="border", align_corners=False
    )
    return found[0].movedim(0, -1)


def flattened(patches: Tensor) -> Tensor:
    """Patches [n, p, 3] without their mean colours, which change with the exposure."""
    return patches - patches.mean(1, keepdim=True)
