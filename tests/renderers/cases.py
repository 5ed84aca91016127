"""Scenes, cameras and metrics that the renderer tests share."""

import math

import torch
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0
from tests.tiny import CountingRenderer

LIKENESS = 60.0
"""Minimum PSNR of a fast renderer against the reference, decibels."""


def gaussians(
    means: list[list[float]],
    colors: list[list[float]] | None = None,
    scale: float | list[float] = 0.05,
    opacity: float | list[float] = 0.8,
) -> Gaussians:
    """Return a few axis-aligned Gaussians of degree 0, in float64."""
    count = len(means)
    rgb = torch.tensor(colors or [[1.0, 1.0, 1.0]] * count, dtype=torch.float64)
    return Gaussians(
        means=torch.tensor(means, dtype=torch.float64),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(count, 1),
        scales=torch.tensor(scale, dtype=torch.float64).expand(count, 3).clone(),
        opacities=torch.tensor(opacity, dtype=torch.float64).expand(count).clone(),
        sh=((rgb - 0.5) / C0).unsqueeze(1),
        batch_size=[count],
    )


def random_gaussians(seed: int, count: int = 300, degree: int = 0) -> Gaussians:
    """Return a cloud of dust, discs and needles with a radius of about 1.5 m around the origin, in float32."""
    g = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=0.8 * torch.randn(count, 3, generator=g),
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=g), dim=1),
        scales=torch.exp(torch.empty(count, 3).uniform_(math.log(0.002), math.log(0.4), generator=g)),
        opacities=torch.rand(count, generator=g),
        sh=0.5 * torch.randn(count, (degree + 1) ** 2, 3, generator=g),
        batch_size=[count],
    )


def dust(seed: int, opacity: float, scale: float, count: int = 3000) -> Gaussians:
    """Return tiny Gaussians 20 m away along x, which merge into a few that cover more area than their members."""
    g = torch.Generator().manual_seed(seed)
    means = [[20.0, 0.0, 0.0]] * count
    cloud = gaussians(means, scale=scale, opacity=opacity).float()
    cloud.means += 0.6 * torch.randn(count, 3, generator=g)
    return cloud


def ball(count: int = 800, radius: float = 0.15) -> Gaussians:
    """Return discs on a sphere at the origin whose colours vary slowly, as on the links of robots."""
    number = torch.arange(count) + 0.5
    height, turn = 1 - 2 * number / count, math.pi * (1 + math.sqrt(5)) * number
    around = (1 - height.square()).sqrt()
    normals = torch.stack([around * turn.cos(), around * turn.sin(), height], 1)
    half = torch.stack([1 + height, -normals[:, 1], normals[:, 0], torch.zeros(count)], 1)  # rotates z to the normal
    return Gaussians(
        means=radius * normals,
        quats=half / half.norm(dim=1, keepdim=True),
        scales=torch.tensor([1.0, 1.0, 0.05]) * (0.45 * radius * math.sqrt(4 * math.pi / count)) * torch.ones(count, 1),
        opacities=torch.full((count,), 0.97),
        sh=normals.unsqueeze(1),
        batch_size=[count],
    )


def random_cameras(seed: int, batch: int = 3, width: int = 37, height: int = 22) -> Cameras:
    """Return cameras around and inside the cloud, with off-centre principal points and pixels that are not square."""
    g = torch.Generator().manual_seed(seed)
    positions = torch.nn.functional.normalize(torch.randn(batch, 3, generator=g), dim=1)
    positions = positions * torch.empty(batch, 1).uniform_(0.3, 3.0, generator=g)
    K = intrinsics(1.2, width, height).repeat(batch, 1, 1)
    K[:, :2, :2] *= torch.empty(batch, 2, 1).uniform_(0.6, 1.5, generator=g)
    K[:, :2, 2] += torch.empty(batch, 2).uniform_(-0.3, 0.3, generator=g) * torch.tensor([width, height])
    return Cameras(look_at(positions, 0.3 * torch.randn(batch, 3, generator=g)), K, width, height)


def ahead(width: int = 41, height: int = 31, focal: float = 40.0) -> Cameras:
    """Return one camera at the origin that looks along world x; the middle pixel is centred on its axis."""
    K = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Cameras(look_at([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]).unsqueeze(0), K, width, height)


def double(scene: Gaussians) -> Gaussians:
    """Return the same Gaussians in float64."""
    return Gaussians(
        means=scene.means.double(),
        quats=scene.quats.double(),
        scales=scene.scales.double(),
        opacities=scene.opacities.double(),
        sh=scene.sh.double(),
        batch_size=scene.batch_size,
    )


def psnr(image: Tensor, reference: Tensor) -> float:
    """Return the peak signal-to-noise ratio, decibels, of the worst image of a batch [B, H, W, C] in [0, 1]."""
    errors = (image.double() - reference.double()).square().flatten(1).mean(1)
    return float(-10 * errors.clamp_min(1e-20).log10().max())


class TwoModels(CountingRenderer):
    """A renderer of two models that counts the rows it is asked to draw."""

    def __init__(self) -> None:
        super().__init__(NativeRenderer([random_gaussians(0, 100), random_gaussians(1, 30)], threads=1))
