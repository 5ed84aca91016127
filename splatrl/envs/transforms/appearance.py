"""Randomised image appearance: exposure, colour, blur and sensor noise."""

import math

import torch
from torch import Tensor

from splatrl.envs.transforms.episode_look import EpisodeLook
from splatrl.envs.transforms.native_images import cores_for, in_core
from splatrl.native import _core
from splatrl.values import require_number

NEUTRAL = (0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0)
"""The appearance that leaves images unchanged."""


class Appearance(EpisodeLook):
    """Randomises the appearance of ``pixels``: one appearance per episode, and fresh sensor noise in every step.

    The values drawn are part of the observation: ``appearance`` [B, 7] float32 holds brightness, contrast, the gains of
    red, green and blue, and the standard deviations of the blur in pixels and of the sensor noise. An ``appearance``
    given to a reset is kept. Changes are applied in this order, with colours from 0 to 1: blur; gain · (contrast ·
    (colour − 0.5) + 0.5) + brightness; noise; rounding.

    Without an env, as in a replay buffer, an appearance is drawn for each image that does not come with one.

    Args:
        brightness: maximum offset, up or down, as a fraction of white.
        contrast: maximum change of the contrast, whose neutral value is 1, in [0, 1].
        white_balance: maximum change of each colour's gain, whose neutral value is 1, in [0, 1].
        blur: maximum standard deviation of the blur, pixels, at most 8.
        noise: maximum standard deviation of the sensor noise, as a fraction of white.
        seed: seed of the transform's own generator (``RandomTransform``).

    Raises:
        ValueError: for values outside these ranges.
    """

    KEY = "appearance"
    SIZE = 7
    ranges: Tensor  # [7] float32, in the order of ``appearance``
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
            require_number(f"appearance.{name}", value, 0, limit)
        ranges = [brightness, contrast, white_balance, white_balance, white_balance, blur, noise]
        self.reach = math.ceil(2.5 * blur)  # radius of the blur kernel, pixels
        self.noisy = noise > 0
        self.register_buffer("ranges", torch.tensor(ranges, dtype=torch.float32), persistent=False)
        self.register_buffer("neutral", torch.tensor(NEUTRAL), persistent=False)

    def _draw(self, batch: torch.Size, level: Tensor | None = None) -> Tensor:
        """Draw random appearances: [*batch, 7]; all values but blur and noise vary to both sides of neutral."""
        drawn = torch.rand(*batch, 7, generator=self.generator, device=self.ranges.device)
        drawn = torch.cat([2 * drawn[..., :5] - 1, drawn[..., 5:]], -1)
        return self.neutral + drawn * self.ranges

    def _changed(self, images: Tensor, look: Tensor, depth: Tensor | None) -> Tensor:
        count, height, width, _ = images.shape
        brightness, contrast, grain = look[:, :1], look[:, 1:2], 255 * look[:, 6]
        weights = _weights(look[:, 5], self.reach)
        gain, offset = look[:, 2:5] * contrast, 255 * (look[:, 2:5] * 0.5 * (1 - contrast) + brightness)
        noise = None
        if self.noisy:
            noise = torch.randn(count, height, width * 3, generator=self.generator, device=images.device)
        if in_core(images):
            out, cores = torch.empty_like(images).contiguous(), cores_for(images)
            _core.change_appearance(images.contiguous(), weights, gain, offset, grain, noise, out, cores)
            return out
        colors = images.reshape(count, height, width * 3).float()
        if self.reach:
            colors = _blurred(_blurred(colors, weights, 1, 1), weights, 2, 3)
        colors = colors * gain.repeat(1, width)[:, None] + offset.repeat(1, width)[:, None]
        if noise is not None:
            colors = colors + noise * grain[:, None, None]
        return (colors + 0.5).floor().clamp(0, 255).to(torch.uint8).view(images.shape)


def _weights(sigma: Tensor, reach: int) -> Tensor:
    """Return one side of a Gaussian blur kernel: [B] standard deviations, pixels, 0 for no blur -> [B, reach + 1]."""
    steps = torch.arange(reach + 1, device=sigma.device)
    weights = torch.exp(-0.5 * (steps / sigma[:, None].clamp_min(1e-3)) ** 2)
    return weights / (weights[:, :1] + 2 * weights[:, 1:].sum(1, keepdim=True))


def _blurred(colors: Tensor, weights: Tensor, dim: int, stride: int) -> Tensor:
    """Blur along one axis, replicating the border.

    Args:
        colors: [B, H, 3 W] float32.
        weights: [B, reach + 1], weight of the pixel itself, then of its neighbours on both sides.
        dim: 1 for rows, 2 for columns.
        stride: number of entries from one pixel to the next along ``dim``.
    """
    own = weights[:, :, None, None].unbind(1)
    reach, size = len(own) - 1, colors.shape[dim]
    margin = reach * stride
    first, last = colors.narrow(dim, 0, stride), colors.narrow(dim, size - stride, stride)
    padded = torch.cat([first] * reach + [colors] + [last] * reach, dim)
    blurred = colors * own[0]
    for step in range(1, reach + 1):
        before = padded.narrow(dim, margin - step * stride, size)
        after = padded.narrow(dim, margin + step * stride, size)
        blurred = blurred + (before + after) * own[step]
    return blurred
