"""Sprites: pictures with alpha, stored as mipmaps so that they can be drawn at any size."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, pad

from splatrl.envs.drawing.apple_picture import apple
from splatrl.files import expanded, refusing
from splatrl.images import eight_bits

TAPS = 3
"""Texels that a pixel reads along each axis; smaller mip levels are padded to this size with empty texels."""
LARGEST = 4096
"""Maximum length of a picture file's longest side, pixels."""
FINEST = 512
"""Maximum length of a sprite's longest side, texels."""


@dataclass(frozen=True)
class Sprite:
    """A mipmap of premultiplied colours, each level half the size of the one before (Williams, Pyramidal Parametrics).

    Sides are powers of two, so a texel is exactly the mean of the texels that it covers in the level before.

    Attributes:
        texels: [T, 4] float32, all levels, row by row: red, green and blue times alpha in [0, 255], alpha in [0, 1].
        heights: [L] int64, height of each level in texels.
        widths: [L] int64, width of each level in texels.
        starts: [L] int64, index of each level's first texel.
        aspect: height of the picture over its width.
    """

    texels: Tensor
    heights: Tensor
    widths: Tensor
    starts: Tensor
    aspect: float

    @classmethod
    def of(cls, picture: Tensor) -> "Sprite":
        """Make a sprite from a picture.

        Args:
            picture: [H, W, 4] uint8, RGBA, straight alpha.

        Raises:
            ValueError: for any other shape or dtype, or an empty picture.
        """
        if picture.ndim != 3 or picture.shape[2] != 4 or picture.dtype != torch.uint8 or not picture.numel():
            raise ValueError(f"sprite: expected [H, W, 4] uint8, got {list(picture.shape)} {picture.dtype}")
        height, width = picture.shape[:2]
        colors, alpha = picture[..., :3].float(), picture[..., 3:].float() / 255
        premultiplied = torch.cat([colors * alpha, alpha], -1).permute(2, 0, 1).unsqueeze(0)
        sides = _power_of_two(height), _power_of_two(width)
        if sides != (height, width):
            premultiplied = interpolate(premultiplied, sides, mode="bilinear", antialias=True).clamp_min(0)
        levels = [premultiplied]
        while max(levels[-1].shape[2:]) > 1:
            levels.append(avg_pool2d(levels[-1], [min(2, side) for side in levels[-1].shape[2:]]))
        padded = [pad(x, (0, max(0, TAPS - x.shape[3]), 0, max(0, TAPS - x.shape[2]))) for x in levels]
        counts = torch.tensor([x.shape[2] * x.shape[3] for x in padded])
        return cls(
            texels=torch.cat([x[0].flatten(1).T for x in padded]).contiguous(),
            heights=torch.tensor([x.shape[2] for x in levels]),
            widths=torch.tensor([x.shape[3] for x in levels]),
            starts=counts.cumsum(0) - counts,
            aspect=height / width,
        )

    @property
    def finest(self) -> Tensor:
        """Texels of the finest level, without those that pad it: [N, 4] float32."""
        height, width = int(self.heights[0]), int(self.widths[0])
        rows, columns = max(height, TAPS), max(width, TAPS)
        return self.texels[: rows * columns].view(rows, columns, 4)[:height, :width].flatten(0, 1)

    def to(self, device: torch.device | str) -> "Sprite":
        """Return a copy of the sprite on a device."""
        return replace(
            self,
            texels=self.texels.to(device),
            heights=self.heights.to(device),
            widths=self.widths.to(device),
            starts=self.starts.to(device),
        )


def _power_of_two(side: int) -> int:
    """Round to the nearest power of two (in log scale), at most ``FINEST``."""
    return min(FINEST, 2 ** round(np.log2(side)))


def load_sprite(name: str | Path) -> Sprite:
    """Load a sprite by name or from a file.

    Args:
        name: ``"apple"``, or the path of a PNG with alpha.

    Raises:
        ValueError: for a file that is missing, not a PNG, damaged, without alpha or larger than 4096 pixels per side.
    """
    if name == "apple":
        return Sprite.of(torch.from_numpy(apple()))
    return Sprite.of(torch.from_numpy(_read_png(expanded(name))))


def _read_png(path: Path) -> np.ndarray:
    """Read a PNG with alpha: [H, W, 4] uint8."""
    if not path.is_file():
        raise ValueError(f"sprite: expected apple or the path of a PNG with alpha, got {path}, which is not a file")
    with refusing(path, "a PNG file"), Image.open(path, formats=["PNG"]) as image:
        if max(image.size) > LARGEST:  # read from the header, before anything is allocated
            raise ValueError(f"sprite {path}: expected at most {LARGEST} pixels per side, got {image.size}")
        if not image.has_transparency_data:
            raise ValueError(f"sprite {path}: expected an alpha channel, got mode {image.mode}")
        return np.array(eight_bits(image).convert("RGBA"))
