"""How close an image is to the exact one, and to what a camera with 64 times the pixels would average."""

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
"""PSNR of equal images, where the logarithm would be infinite."""


@dataclass(frozen=True)
class Quality:
    """Peak signal-to-noise ratios over some views, dB."""

    mean_db: float
    worst_db: float
    worst_view: int


def psnr(images: Tensor, truth: Tensor) -> Tensor:
    """PSNR of each view, for colours in [0, 1]: [B, H, W, 3] twice -> [B] dB."""
    error = (images.double() - truth.double()).square().flatten(1).mean(1)
    return -10 * error.clamp_min(10 ** (-MOST_DB / 10)).log10()


def quality(images: Tensor, truth: Tensor) -> Quality:
    """Mean and worst view."""
    ratios = psnr(images, truth)
    return Quality(round(float(ratios.mean()), 2), round(float(ratios.min()), 2), int(ratios.argmin()))


def shown(renderer: NativeRenderer, cameras: Cameras) -> Tensor:
    """What a screen shows, before it is rounded to bytes: [B, H, W, 3] float32 in [0, 1]."""
    return renderer.render(cameras).rgb.clamp(0, 1)


def supersampled(renderer: NativeRenderer, cameras: Cameras) -> Tensor:
    """The mean over ``SUPERSAMPLING``² pixels for each pixel: [B, H, W, 3] float32."""
    n = SUPERSAMPLING
    K = cameras.K * torch.tensor([[n], [n], [1.0]])
    fine = Cameras(cameras.camera_to_world, K, n * cameras.width, n * cameras.height)
    frames = [shown(renderer, fine[row : row + 1]) for row in range(len(fine))]  # one at a time, to save memory
    return torch.cat([frame.unflatten(2, (-1, n)).unflatten(1, (-1, n)).mean((2, 4)) for frame in frames])


def judged(
    looks: Sequence[Look], renderers: Renderers, views: dict[str, Cameras], fine_views: int
) -> tuple[dict[Look, tuple[Quality, Quality]], list[Comparison]]:
    """For every look, its quality against exact and against supersampled; and a comparison for each scene."""
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
