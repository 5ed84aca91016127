"""Pictures of rain, snow and drops on a lens, made once and then moved over the images."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Floats = NDArray[np.float64]

TILES = 2
"""A pattern is so many times as high and as wide as the image, and goes on where it ends."""


@dataclass(frozen=True)
class Layer:
    """Rain or snow at one distance.

    Attributes:
        distance: from the camera, metres; what is nearer hides it.
        count: of streaks or flakes on the area of an image, at full strength.
        length: of a streak as a share of the image's height; 0 for flakes.
        width: standard deviation across, as a share of the image's height.
        cover: share of the light behind that one hides.
    """

    distance: float
    count: int
    length: float
    width: float
    cover: float


RAIN = (Layer(0.6, 14, 0.30, 0.0085, 0.42), Layer(1.6, 40, 0.17, 0.0060, 0.38), Layer(4.0, 90, 0.09, 0.0045, 0.34))
SNOW = (Layer(0.6, 9, 0.03, 0.020, 0.85), Layer(1.6, 32, 0.012, 0.0125, 0.90), Layer(4.0, 100, 0.0, 0.0080, 0.85))
DROPS = 26
"""On the area of an image, on a lens that is as wet as it gets."""
BULGE = 1.7
"""How far beyond its own radius, in radii, a drop shows the image, upside down."""


@dataclass(frozen=True)
class Pattern:
    """Things that lie over an image, as texels of a larger picture without borders.

    Attributes:
        cover: [K, T, U] float32, share of the light that they hide, for K layers.
        rank: [K, T, U] float32 in [0, 1), of the thing in each texel: it is there where the strength is above this.
        distance: [K] float32, metres.
    """

    cover: Tensor
    rank: Tensor
    distance: Tensor


@dataclass(frozen=True)
class Lens:
    """Drops on a lens, as texels of a larger picture without borders.

    Attributes:
        shift: [T, U, 2] int64, rows and columns to where a texel's light comes from.
        cover: [T, U] float32, how much of the texel the drop fills.
        shine: [T, U] float32, light added by the drop's edge; negative where it is darker.
        rank: [T, U] float32 in [0, 1), as in ``Pattern``.
    """

    shift: Tensor
    cover: Tensor
    shine: Tensor
    rank: Tensor


@cache
def pattern(layers: tuple[Layer, ...], height: int, width: int, device: torch.device) -> Pattern:
    """Streaks or flakes over images of a size.

    They are straight down; a wind shears them when they are laid over an image.
    """
    rng = np.random.default_rng(7)
    tall, wide = TILES * height, TILES * width
    covers, ranks = np.zeros((2, len(layers), tall, wide))
    for k, layer in enumerate(layers):
        count = max(1, round(layer.count * TILES**2 * min(1.0, width / height)))
        for order in range(count):
            row, column = rng.uniform((0, 0), (tall, wide))
            size = rng.uniform(0.65, 1.2)
            half, across = 0.5 * size * layer.length * height, max(0.35, size * layer.width * height)
            reach_y, reach_x = int(half + 3 * across) + 1, int(3 * across) + 1
            y, x = np.mgrid[-reach_y : reach_y + 1, -reach_x : reach_x + 1]
            y, x = y + np.floor(row) - row, x + np.floor(column) - column
            beyond = np.maximum(np.abs(y) - half, 0.0)
            thin = min(1.0, size * layer.width * height / across)  # narrower than a pixel: fainter
            drawn = layer.cover * thin * np.exp(-0.5 * (x**2 + beyond**2) / across**2)
            if half > across:
                drawn *= 0.55 + 0.45 * np.clip(y / half, -1, 1)  # brighter where it is going
            _lay(covers[k], ranks[k], drawn, order / count, row, column)
    cover, rank = (torch.from_numpy(part).float().to(device) for part in (covers, ranks))
    return Pattern(cover, rank, torch.tensor([layer.distance for layer in layers], device=device))


def _lay(cover: Floats, rank: Floats, drawn: Floats, order: float, row: float, column: float) -> None:
    """Lay one thing into a picture without borders, where it covers more than what is there."""
    tall, wide = cover.shape
    rows = (np.arange(drawn.shape[0]) - drawn.shape[0] // 2 + int(row)) % tall
    columns = (np.arange(drawn.shape[1]) - drawn.shape[1] // 2 + int(column)) % wide
    place = np.ix_(rows, columns)
    more = drawn > cover[place]
    cover[place] = np.where(more, drawn, cover[place])
    rank[place] = np.where(more, order, rank[place])


@cache
def lens(height: int, width: int, device: torch.device) -> Lens:
    """Drops on the lens of a camera with images of a size: each shows what is around it upside down."""
    rng = np.random.default_rng(8)
    tall, wide = TILES * height, TILES * width
    cover, shine, rank = np.zeros((3, tall, wide))
    shift = np.zeros((tall, wide, 2))
    y, x = np.mgrid[:tall, :wide] + 0.5
    count = round(DROPS * TILES**2 * min(1.0, width / height))
    for order in rng.permutation(count):
        row, column = rng.uniform((0, 0), (tall, wide))
        radius = height * rng.uniform(0.022, 0.085) * rng.uniform(0.5, 1.0)
        dy, dx = (y - row + tall / 2) % tall - tall / 2, (x - column + wide / 2) % wide - wide / 2
        dy = dy / rng.uniform(1.0, 1.35)  # drops hang
        out = np.hypot(dy, dx) / radius
        inside = out < 1.0
        shift[inside] = -np.stack([dy, dx], -1)[inside] * (1 + BULGE)
        rim = np.clip((out - 0.6) / 0.4, 0, 1) ** 2
        glint = np.exp(-0.5 * (((dy + 0.42 * radius) ** 2 + (dx + 0.3 * radius) ** 2) / (0.2 * radius) ** 2))
        shine[inside] = (0.24 * glint - 0.20 * rim * (dy < 0) + 0.10 * rim * (dy > 0))[inside]
        cover[inside] = np.clip((1.0 - out) * radius, 0, 1)[inside]
        rank[inside] = order / count
    return Lens(
        torch.from_numpy(shift.round()).long().to(device),
        *(torch.from_numpy(part).float().to(device) for part in (cover, shine, rank)),
    )
