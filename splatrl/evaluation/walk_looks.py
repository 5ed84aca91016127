"""Simulated imperfections of a real camera: exposure, tint, blur and noise, drawn anew for every clip."""

from dataclasses import dataclass

import torch
from scipy import ndimage
from torch import Tensor

from splatrl.hdr import GAMMA


@dataclass(frozen=True)
class Lens:
    """Ranges over which cameras vary; each clip draws its own camera uniformly.

    Attributes:
        exposure: largest change of exposure in either direction, stops.
        tint: largest change of a colour channel in either direction, as a fraction.
        blur: largest standard deviation of the blur, as a fraction of the image's height.
        noise: largest standard deviation of the noise in each channel value, grey levels.
    """

    exposure: float = 0.5
    tint: float = 0.06
    blur: float = 0.008
    noise: float = 5.0


def photographed(pixels: Tensor, lens: Lens, generator: torch.Generator) -> Tensor:
    """Degrade the frames of one clip as if a random camera had recorded them.

    Args:
        pixels: [T, H, W, 3] uint8.
        lens: how much the camera may vary.
        generator: draws the camera and its noise.

    Returns:
        [T, H, W, 3] uint8.
    """
    draw = torch.rand(6, generator=generator, dtype=torch.float64).tolist()
    stops, tints = lens.exposure * (2 * draw[0] - 1), [1 + lens.tint * (2 * value - 1) for value in draw[1:4]]
    gain = torch.tensor([2**stops * tint for tint in tints])
    light = (pixels.cpu().float() / 255) ** GAMMA
    deviation = draw[4] * lens.blur * pixels.shape[1]
    light = torch.from_numpy(ndimage.gaussian_filter(light.numpy(), (0, deviation, deviation, 0), truncate=3.0))
    noise = torch.randn(light.shape, generator=generator) * (draw[5] * lens.noise)
    return (255 * (light * gain) ** (1 / GAMMA) + noise + 0.5).floor().clamp(0, 255).to(torch.uint8)
