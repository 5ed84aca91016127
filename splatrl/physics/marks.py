"""Single-colour shapes made of Gaussians, which mark places and take no part in contacts."""

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor

from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0
from splatrl.values import require_rgb

OPACITY, SPREAD, THICKNESS = 0.97, 0.6, 0.001
"""Opacity of each Gaussian; its standard deviation along the surface, as a fraction of the distance between two
Gaussians; and its standard deviation across the surface, metres."""
BEACON = 0.8
"""Radius of a beacon's ball, as a fraction of its disc's."""
GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


def disc(radius: float, rgb: Sequence[float], count: int = 400) -> Gaussians:
    """Make a disc of one colour in the plane z = 0, centred on the origin.

    Args:
        radius: radius of the disc, metres.
        rgb: red, green and blue in [0, 1].
        count: number of Gaussians, which lie along a sunflower spiral.

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
    """Make a ball of one colour, centred on the origin and brighter towards the top.

    Args:
        radius: radius of the ball, metres.
        rgb: red, green and blue in [0, 1].
        count: number of Gaussians, which lie along a Fibonacci spiral.

    Raises:
        ValueError: for a colour that is not three numbers in [0, 1].
    """
    number = torch.arange(count, dtype=torch.float64)
    z, angle = 1.0 - 2.0 * (number + 0.5) / count, GOLDEN * number
    across = (1.0 - z * z).sqrt()
    normals = torch.stack([across * angle.cos(), across * angle.sin(), z], 1)
    spread = SPREAD * radius * math.sqrt(4.0 * math.pi / count)
    half = torch.stack([1.0 + z, -normals[:, 1], normals[:, 0], torch.zeros_like(z)], 1)  # rotates z to the normal
    quats = torch.nn.functional.normalize(half, dim=1).float()
    found = _coloured((radius * normals).float(), quats, torch.tensor([spread, spread, min(spread, THICKNESS)]), rgb)
    shade = (0.8 + 0.2 * z).float().view(-1, 1, 1)
    found.sh = (shade * (found.sh * C0 + 0.5) - 0.5) / C0
    return found


def beacon(radius: float, rgb: Sequence[float], height: float) -> Gaussians:
    """Make a disc around the origin, and above it a smaller ball of its colour that is visible from further away.

    Args:
        radius: radius of the disc, metres; the ball's is 0.8 times that.
        rgb: red, green and blue in [0, 1].
        height: height of the ball's centre, metres.

    Raises:
        ValueError: for a colour that is not three numbers in [0, 1].
    """
    above = ball(BEACON * radius, rgb)
    above.means = above.means + torch.tensor([0.0, 0.0, height])
    below = disc(radius, rgb)
    return cast(Gaussians, torch.cat([below, above]))


def _coloured(means: Tensor, quats: Tensor, scales: Tensor, rgb: Sequence[float]) -> Gaussians:
    """Make opaque Gaussians of one size and colour, from means [N, 3], quats [N, 4] and scales [3]."""
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
