"""Quality of images: PSNR to the exact image, and to the average over an image with 64 times the pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from figure import Comparison
from plan import Look, Renderers
from torch import Tensor
from tqdm import tqdm

from splatrl.cameras import Cameras
from splatrl.renderers import NativeRenderer

SUPERSAMPLING = 8
MOST_DB = 100.0
"""PSNR assigned to equal images, where the logarithm would be infinite, dB."""


@dataclass(frozen=True)
class Quality:
    """PSNR over some views: the mean and the worst in dB, and the row of the worst view."""

    mean_db: float
    worst_db: float
    worst_view: int


def psnr(images: Tensor, truth: Tensor) -> Tensor:
    """Return the PSNR of each view, for colours in [0, 1]: [B, H, W, 3] each -> [B] dB."""
    error = (images.double() - truth.double()).square().flatten(1).mean(1)
    return -10 * error.clamp_min(10 ** (-MOST_DB / 10)).log10()


def quality(images: Tensor, truth: Tensor) -> Quality:
    """Return the mean PSNR and that of the worst view."""
    ratios = psnr(images, truth)
    return Quality(round(float(ratios.mean()), 2), round(float(ratios.min()), 2), int(ratios.argmin()))


def shown(renderer: NativeRenderer, cameras: Cameras) -> Tensor:
    """Render images as a screen shows them, before rounding to bytes: [B, H, W, 3] float32 in [0, 1]."""
    return renderer.render(cameras).rgb.clamp(0, 1)


def supersampled(renderer: NativeRenderer, cameras: Cameras) -> Tensor:
    """Render each pixel as the mean of ``SUPERSAMPLING``² finer pixels: [B, H, W, 3] float32."""
    n = SUPERSAMPLING
    K = cameras.K * torch.tensor([[n], [n], [1.0]])
    fine = Cameras(cameras.camera_to_world, K, n * cameras.width, n * cameras.height)
    frames = [shown(renderer, fine[row : row + 1]) for row in range(len(fine))]  # one at a time, to save memory
    return torch.cat([frame.unflatten(2, (-1, n)).unflatten(1, (-1, n)).mean((2, 4)) for frame in frames])


def judged(
    looks: Sequence[Look], renderers: Renderers, views: dict[str, Cameras], fine_views: int
) -> tuple[dict[Look, tuple[Quality, Quality]], list[Comparison]]:
    """Return the quality of each look against exact and supersampled images, and a comparison of images per scene."""
    found: dict[Look, tuple[Quality, Quality]] = {}
    comparisons: dict[str, Comparison] = {}
    truths: dict[Look, Tensor] = {}
    exacts: dict[Look, Tensor] = {}
    for look in tqdm(looks, desc="judging"):
        cameras = views[look.scene]
        exact, truth = look._replace(tolerance=0.0), look._replace(tolerance=0.0, mode="antialiased")
        if exact not in exacts:
            exacts[exact] = shown(renderers[exact], cameras)
        if truth not in truths:
            truths[truth] = supersampled(renderers[truth], cameras[:fine_views])
        images = shown(renderers[look], cameras)
        against_exact = quality(images, exacts[exact])
        found[look] = against_exact, quality(images[:fine_views], truths[truth])
        if look.tolerance > 0 and look.scene not in comparisons:
            row = against_exact.worst_view
            pair = exacts[exact][row], images[row]
            comparisons[look.scene] = Comparison(look.scene, look.tolerance, *pair, against_exact.worst_db)
    return found, list(comparisons.values())
