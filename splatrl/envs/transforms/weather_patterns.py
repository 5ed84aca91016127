"""Patterns of rain, snow and drops on a lens, generated once and then shifted over the images."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Floats = NDArray[np.float64]

TILES = 2
"""Height and width of a pattern in multiples of the image's; patterns wrap around at their edges."""


@dataclass(frozen=True)
class Layer:
    """Rain or snow at one distance.

    Attributes:
        distance: distance from the camera, metres; anything nearer occludes it.
        count: number of streaks or flakes per image area, at full strength.
        length: length of a streak or flake, as a fraction of the image's height.
        width: standard deviation of the profile across it, as a fraction of the image's height.
        cover: fraction of the light behind it that a streak or flake hides.
    """

    distance: float
    count: int
    length: float
    width: float
    cover: float


RAIN = (Layer(0.6, 14, 0.30, 0.0085, 0.42), Layer(1.6, 40, 0.17, 0.0060, 0.38), Layer(4.0, 90, 0.09, 0.0045, 0.34))
SNOW = (Layer(0.6, 9, 0.03, 0.020, 0.85), Layer(1.6, 32, 0.012, 0.0125, 0.90), Layer(4.0, 100, 0.0, 0.0080, 0.85))
DROPS = 26
"""Number of drops per image area on a fully wet lens."""
BULGE = 1.7
"""Radius of the part of the image that a drop shows upside down, in radii of the drop."""


@dataclass(frozen=True)
class Pattern:
    """Rain or snow to be laid over images, as texels of a larger tileable picture.

    Attributes:
        cover: [K, T, U] float32, fraction of the light that is hidden, for K layers.
        rank: [K, T, U] float32 in [0, 1), rank of the streak or flake in each texel, which appears where the strength
            exceeds it.
        distance: [K] float32, distance of each layer, metres.
    """

    cover: Tensor
    rank: Tensor
    distance: Tensor


@dataclass(frozen=True)
class Lens:
    """Drops on a lens, as texels of a larger tileable picture.

    Attributes:
        shift: [T, U, 2] int64, offset in rows and columns to the pixel from which a texel's light comes.
        cover: [T, U] float32, fraction of the texel that the drop fills.
        shine: [T, U] float32, light that the drop adds by its glint and rim; negative where it is darker.
        rank: [T, U] float32 in [0, 1), as in ``Pattern``.
    """

    shift: Tensor
    cover: Tensor
    shine: Tensor
    rank: Tensor


@cache
def pattern(layers: tuple[Layer, ...], height: int, width: int, device: torch.device) -> Pattern:
    """Generate streaks or flakes for images of a given size.

    They fall straight down; wind shears them when they are laid over an image.
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
            thin = min(1.0, size * layer.width * height / across)  # streaks below the minimum width are fainter instead
            drawn = layer.cover * thin * np.exp(-0.5 * (x**2 + beyond**2) / across**2)
            if half > across:
                drawn *= 0.55 + 0.45 * np.clip(y / half, -1, 1)  # brighter towards the lower end
            _lay(covers[k], ranks[k], drawn, order / count, row, column)
    cover, rank = (torch.from_numpy(part).float().to(device) for part in (covers, ranks))
    return Pattern(cover, rank, torch.tensor([layer.distance for layer in layers], device=device))


def _lay(cover: Floats, rank: Floats, drawn: Floats, order: float, row: float, column: float) -> None:
    """Add one streak or flake to a tileable picture, wherever it covers more than what is already there."""
    tall, wide = cover.shape
    rows = (np.arange(drawn.shape[0]) - drawn.shape[0] // 2 + int(row)) % tall
    columns = (np.arange(drawn.shape[1]) - drawn.shape[1] // 2 + int(column)) % wide
    place = np.ix_(rows, columns)
    more = drawn > cover[place]
    cover[place] = np.where(more, drawn, cover[place])
    rank[place] = np.where(more, order, rank[place])


@cache
def lens(height: int, width: int, device: torch.device) -> Lens:
    """Generate drops on a lens for images of a given size; each drop shows its surroundings upside down."""
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
        dy = dy / rng.uniform(1.0, 1.35)  # drops sag: they are elongated downwards
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
