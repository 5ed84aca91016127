"""Random variation in how images look: exposure, colour, blur and sensor noise."""

import math

import torch
from torch import Tensor

from splatrl.envs.transforms.episode_look import EpisodeLook

NEUTRAL = (0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0)
"""The appearance that changes nothing."""


class Appearance(EpisodeLook):
    """Varies how ``pixels`` look: one appearance per episode, and fresh sensor noise in every step.

    The observation holds what was drawn: ``appearance`` [B, 7] float32 is brightness, contrast, the gains of red, green
    and blue, the standard deviation of the blur in pixels and that of the sensor noise. An ``appearance`` that is given
    to a reset is kept. The changes are applied in this order, with colours from 0 to 1: blur; gain · (contrast ·
    (colour − 0.5) + 0.5) + brightness; noise; rounding.

    Without an env, as in a replay buffer, it draws for each image that does not come with an ``appearance``.

    Args:
        brightness: largest offset, up or down, as a share of white.
        contrast: largest change of the contrast, whose neutral value is 1, in [0, 1].
        white_balance: largest change of each colour's gain, whose neutral value is 1, in [0, 1].
        blur: largest standard deviation of the blur, pixels, at most 8.
        noise: largest standard deviation of the sensor noise, as a share of white.
        seed: seed of its own generator (``RandomTransform``).

    Raises:
        ValueError: for values outside these ranges.
    """

    KEY = "appearance"
    SIZE = 7
    ranges: Tensor  # [7] float32, in the order of appearance
    neutral: Tensor  # [7] float32

    def __init__(
        self,
        brightness: float = 0.15,
        contrast: float = 0.2,
        white_balance: float = 0.1,
        blur: float = 0.7,
        noise: float = 0.02,
        seed: int = 0,
    ):
        super().__init__(seed)
        limits = {
            "brightness": (brightness, 1),
            "contrast": (contrast, 1),
            "white_balance": (white_balance, 1),
            "blur": (blur, 8),
            "noise": (noise, 1),
        }
        for name, (value, limit) in limits.items():
            if not 0 <= value <= limit:
                raise ValueError(f"appearance.{name}: expected a number in [0, {limit}], got {value}")
        ranges = [brightness, contrast, white_balance, white_balance, white_balance, blur, noise]
        self.reach = math.ceil(2.5 * blur)  # pixels to each side that a blur reads
        self.noisy = noise > 0
        self.register_buffer("ranges", torch.tensor(ranges, dtype=torch.float32), persistent=False)
        self.register_buffer("neutral", torch.tensor(NEUTRAL), persistent=False)

    def _draw(self, batch: torch.Size, level: Tensor | None = None) -> Tensor:
        """Random appearances: [*batch, 7]; all but blur and noise vary to both sides of neutral."""
        drawn = torch.rand(*batch, 7, generator=self.generator, device=self.ranges.device)
        drawn = torch.cat([2 * drawn[..., :5] - 1, drawn[..., 5:]], -1)
        return self.neutral + drawn * self.ranges

    def _changed(self, images: Tensor, look: Tensor, depth: Tensor | None) -> Tensor:
        count, height, width, _ = images.shape
        colors, own = images.reshape(count, height, width * 3).float(), look.reshape(count, 7, 1, 1)
        if self.reach:
            colors = _blurred(_blurred(colors, own[:, 5], self.reach, 1, 1), own[:, 5], self.reach, 2, 3)
        gain = own[:, 2:5, 0, 0].repeat(1, width).unsqueeze(1)  # [B, 1, 3 W]
        contrast, brightness = own[:, 1], own[:, 0]
        colors = colors * (gain * contrast) + 255 * (gain * 0.5 * (1 - contrast) + brightness)
        if self.noisy:
            noise = torch.randn(colors.shape, generator=self.generator, device=colors.device)
            colors = colors + noise * (255 * own[:, 6])
        return (colors + 0.5).floor().clamp(0, 255).to(torch.uint8).view(images.shape)


def _blurred(colors: Tensor, sigma: Tensor, reach: int, dim: int, stride: int) -> Tensor:
    """Blur along one axis, with the border repeated.

    Args:
        colors: [B, H, 3 W] float32.
        sigma: [B, 1, 1] standard deviation, pixels; 0 changes nothing.
        reach: radius of the kernel, pixels.
        dim: 1 for rows, 2 for columns.
        stride: number of entries from one pixel to the next along ``dim``.
    """
    steps = torch.arange(reach + 1, device=colors.device).view(-1, 1, 1, 1)
    weights = torch.exp(-0.5 * (steps / sigma.clamp_min(1e-3)) ** 2)  # [reach + 1, B, 1, 1]
    weights = weights / (weights[0] + 2 * weights[1:].sum(0))
    size, margin = colors.shape[dim], reach * stride
    first, last = colors.narrow(dim, 0, stride), colors.narrow(dim, size - stride, stride)
    padded = torch.cat([first] * reach + [colors] + [last] * reach, dim)
    blurred = colors * weights[0]
    for step in range(1, reach + 1):
        before = padded.narrow(dim, margin - step * stride, size)
        after = padded.narrow(dim, margin + step * stride, size)
        blurred = blurred + (before + after) * weights[step]
    return blurred
