"""Shapes of Gaussians of one colour that mark places and touch nothing."""

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor

from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0
from splatrl.values import require_rgb

OPACITY, SPREAD, THICKNESS = 0.97, 0.6, 0.001
"""Of each Gaussian: standard deviation along the disc, as a share of the distance between two; across, metres."""
BEACON = 0.8
"""Radius of the ball of a beacon, as a share of its disc's."""
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
    number = torch.arange(count, dtype=torch.float64)
    spread = SPREAD * radius * math.sqrt(math.pi / count)
    far, angle = (radius - spread) * ((number + 0.5) / count).sqrt(), GOLDEN * number
    means = torch.stack([far * angle.cos(), far * angle.sin(), torch.zeros_like(far)], 1).float()
    flat = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1)
    return _coloured(means, flat, torch.tensor([spread, spread, min(spread, THICKNESS)]), rgb)


def ball(radius: float, rgb: Sequence[float], count: int = 400) -> Gaussians:
    """A ball of one colour around the origin, brighter towards the top.

    Args:
        radius: metres.
        rgb: red, green and blue in [0, 1].
        count: Gaussians, which lie along a Fibonacci spiral.

    Raises:
        ValueError: for a colour that is not three numbers in [0, 1].
    """
    number = torch.arange(count, dtype=torch.float64)
    z, angle = 1.0 - 2.0 * (number + 0.5) / count, GOLDEN * number
    across = (1.0 - z * z).sqrt()
    normals = torch.stack([across * angle.cos(), across * angle.sin(), z], 1)
    spread = SPREAD * radius * math.sqrt(4.0 * math.pi / count)
    half = torch.stack([1.0 + z, -normals[:, 1], normals[:, 0], torch.zeros_like(z)], 1)  # turns z to the normal
    quats = torch.nn.functional.normalize(half, dim=1).float()
    found = _coloured((radius * normals).float(), quats, torch.tensor([spread, spread, min(spread, THICKNESS)]), rgb)
    shade = (0.8 + 0.2 * z).float().view(-1, 1, 1)
    found.sh = (shade * (found.sh * C0 + 0.5) - 0.5) / C0
    return found


def beacon(radius: float, rgb: Sequence[float], height: float) -> Gaussians:
    """A disc around the origin, and a smaller ball of its colour that hovers above it and is seen from further away.

    Args:
        radius: of the disc, metres; the ball has 0.8 of it.
        rgb: red, green and blue in [0, 1].
        height: of the middle of the ball, metres.

    Raises:
        ValueError: for a colour that is not three numbers in [0, 1].
    """
    above = ball(BEACON * radius, rgb)
    above.means = above.means + torch.tensor([0.0, 0.0, height])
    below = disc(radius, rgb)
    return cast(Gaussians, torch.cat([below, above]))


def _coloured(means: Tensor, quats: Tensor, scales: Tensor, rgb: Sequence[float]) -> Gaussians:
    """Opaque Gaussians of one size and colour: [N, 3], [N, 4], [3]."""
    require_rgb("rgb", rgb)
    count, colour = len(means), (torch.tensor([float(value) for value in rgb]) - 0.5) / C0
    return Gaussians(
        means=means,
        quats=quats,
        scales=scales.repeat(count, 1),
        opacities=torch.full((count,), OPACITY),
        sh=colour.repeat(count, 1, 1),
        batch_size=[count],
    )
