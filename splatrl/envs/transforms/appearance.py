"""Random variation in how images look: exposure, colour, blur and sensor noise."""

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from splatrl.envs.transforms.randomness import RandomTransform

NEUTRAL = (0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0)
"""The appearance that changes nothing."""


class Appearance(RandomTransform):
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
        super().__init__(seed, in_keys=["pixels"], out_keys=["pixels", "appearance"])
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

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        drawn = self._draw(tensordict_reset.batch_size)  # always drawn, so that later draws do not depend on it
        given = tensordict.get("appearance", None)
        tensordict_reset.set("appearance", drawn if given is None else given.clone())
        rows = _wanted(tensordict.get("_reset", None))
        if rows is None:
            return self._change(tensordict_reset)
        pixels = tensordict_reset["pixels"].clone()  # TorchRL keeps the old pixels of rows that are not reset
        pixels[rows] = self._change(tensordict_reset.select("pixels", "appearance")[rows])["pixels"]
        return tensordict_reset.set("pixels", pixels)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._change(next_tensordict.set("appearance", tensordict["appearance"].clone()))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change images that do not come from an env."""
        if "appearance" not in tensordict.keys():  # noqa: SIM118, a TensorDict is no dict
            tensordict.set("appearance", self._draw(tensordict["pixels"].shape[:-3]))
        return self._change(tensordict)

    def _draw(self, batch: torch.Size) -> Tensor:
        """Random appearances: [*batch, 7]; all but blur and noise vary to both sides of neutral."""
        drawn = torch.rand(*batch, 7, generator=self.generator, device=self.ranges.device)
        drawn = torch.cat([2 * drawn[..., :5] - 1, drawn[..., 5:]], -1)
        return self.neutral + drawn * self.ranges

    def _change(self, tensordict: TensorDictBase) -> TensorDictBase:
        pixels, appearance = tensordict["pixels"], tensordict["appearance"]
        height, width = pixels.shape[-3:-1]
        colors = pixels.reshape(math.prod(pixels.shape[:-3]), height, width * 3).float()
        look = appearance.reshape(len(colors), 7, 1, 1)
        if self.reach:
            colors = _blurred(_blurred(colors, look[:, 5], self.reach, 1, 1), look[:, 5], self.reach, 2, 3)
        gain = look[:, 2:5, 0, 0].repeat(1, width).unsqueeze(1)  # [B, 1, 3 W]
        contrast, brightness = look[:, 1], look[:, 0]
        colors = colors * (gain * contrast) + 255 * (gain * 0.5 * (1 - contrast) + brightness)
        if self.noisy:
            noise = torch.randn(colors.shape, generator=self.generator, device=colors.device)
            colors = colors + noise * (255 * look[:, 6])
        changed = (colors + 0.5).floor().clamp(0, 255).to(torch.uint8)
        return tensordict.set("pixels", changed.view(pixels.shape))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``appearance`` to the observation."""
        return self._with_appearance(observation_spec)

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Read ``appearance`` from the input of a step or a reset."""
        return self._with_appearance(state_spec)

    def _with_appearance(self, spec: Composite) -> Composite:
        spec = spec.clone()
        spec["appearance"] = Unbounded(shape=(*spec.shape, 7), dtype=torch.float32, device=spec.device)
        return spec


def _wanted(mask: Tensor | None) -> Tensor | None:
    """Which rows to change in a reset, [B] bool; None changes all, since selecting rows would synchronise a GPU."""
    return None if mask is None or mask.device.type != "cpu" else mask.squeeze(-1)


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
