"""A custom scene source: anything that returns a ``Scene``."""

import torch

from splatrl import Gaussians, Scene


def hall(side: float = 3.0, seed: int = 0) -> Scene:
    """A floor and four walls of coloured blobs, ``side`` metres long."""
    draw = torch.Generator().manual_seed(seed)
    half, count = side / 2, 400
    flat = (torch.rand(count, 2, generator=draw) - 0.5) * side
    floor = torch.cat([flat, torch.zeros(count, 1)], 1)
    along = (torch.rand(4, count, generator=draw) - 0.5) * side
    up, edge = torch.rand(4, count, generator=draw), torch.full((count,), half)
    walls = [torch.stack([s * edge, along[i], up[i]], 1) for i, s in enumerate((1, -1))]
    walls += [torch.stack([along[i], s * edge, up[i]], 1) for i, s in ((2, 1), (3, -1))]
    means = torch.cat([floor, *walls])
    gaussians = Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(len(means), 1),
        scales=torch.full((len(means), 3), 0.06),
        opacities=torch.full((len(means),), 0.9),
        sh=torch.randn(len(means), 1, 3, generator=draw),
        batch_size=[len(means)],
    )
    return Scene("hall", gaussians, ((-half, -half, 0.0), (half, half, 1.0)))
