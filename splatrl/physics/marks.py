"""Flat shapes of Gaussians that lie on the ground and touch nothing."""

import math
from collections.abc import Sequence

import torch

from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0

OPACITY, SPREAD, THICKNESS = 0.97, 0.6, 0.001
"""Of each Gaussian: standard deviation along the disc, as a share of the distance between two; across, metres."""
GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


def disc(radius: float, rgb: Sequence[float], count: int = 400) -> Gaussians:
    """A disc of one colour in the plane z = 0, around the origin.

    Args:
        radius: metres.
        rgb: red, green and blue in [0, 1].
        count: Gaussians, which lie along a sunflower's spiral.

    Raises:
        ValueError: for a colour that is not three numbers in [0, 1].
    """
    if len(rgb) != 3 or not all(0.0 <= value <= 1.0 for value in rgb):
        raise ValueError(f"task.mark_rgb: expected red, green and blue in [0, 1], got {list(rgb)}")
    number = torch.arange(count, dtype=torch.float64)
    spread = SPREAD * radius * math.sqrt(math.pi / count)
    far, angle = (radius - spread) * ((number + 0.5) / count).sqrt(), GOLDEN * number
    means = torch.stack([far * angle.cos(), far * angle.sin(), torch.zeros_like(far)], 1).float()
    colour = (torch.tensor([float(value) for value in rgb]) - 0.5) / C0
    return Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.tensor([spread, spread, min(spread, THICKNESS)]).repeat(count, 1),
        opacities=torch.full((count,), OPACITY),
        sh=colour.repeat(count, 1, 1),
        batch_size=[count],
    )
