"""A procedurally drawn red apple, available at any resolution without a download."""

import functools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAMPLES = 2
"""Samples along each side of a pixel."""


@functools.cache
def apple(side: int = 256) -> NDArray[np.uint8]:
    """Draw a red apple with a stem and a leaf; the fruit is as wide as the picture.

    Args:
        side: width and height of the picture in pixels.

    Returns:
        [side, side, 4] uint8, RGBA, straight alpha, sRGB; cached and shared by all envs, so treat it as read-only.
    """
    count = SAMPLES * side
    axis = (np.arange(count) + 0.5) / count
    x, y = np.meshgrid(2 * axis - 1, 2 * axis - 1)  # right and down, from -1 to 1 across the picture
    premultiplied = np.zeros((count, count, 4))
    for color, cover in (_stem(x, y), _body(x, y), _leaf(x, y)):
        layer = np.concatenate([color, np.ones_like(color[..., :1])], -1) * cover[..., None]
        premultiplied = layer + premultiplied * (1 - cover[..., None])
    small = premultiplied.reshape(side, SAMPLES, side, SAMPLES, 4).mean((1, 3))
    alpha = small[..., 3:]
    straight = np.concatenate([small[..., :3] / np.maximum(alpha, 1e-9), alpha], -1)
    return (255 * straight.clip(0, 1) + 0.5).astype(np.uint8)


def _body(x: Array, y: Array) -> tuple[Array, Array]:
    """Return colour and coverage of the fruit: round, wider at the top, hollow at the stem, lit from the upper left."""
    down = (y - 0.13) / 0.86
    across = x / (0.99 - 0.07 * np.clip(down + 0.25, 0, None) ** 2)
    dip = 0.20 * np.exp(-((x / 0.26) ** 2)) - 0.05 * np.exp(-((x / 0.16) ** 2))  # hollow around the stem
    foot = 0.06 * np.exp(-((x / 0.20) ** 2))
    squeezed = np.where(down < 0, down / (1 - dip), down / (1 - foot))
    radius = np.hypot(across, squeezed)
    normal_z = np.sqrt(np.clip(1 - radius**2, 0, 1))
    light = np.clip((-0.45 * across - 0.55 * squeezed + 0.70 * normal_z + 0.6) / 1.6, 0, 1)  # includes ambient light
    shade = 0.54 + 0.46 * light
    hollow = np.exp(-((x / 0.22) ** 2) - ((y + 0.60) / 0.10) ** 2)
    red = np.array([0.90, 0.10, 0.09])
    color = red * (shade * (1 - 0.30 * hollow))[..., None]
    gloss = 0.8 * np.exp(-(((x + 0.42) / 0.13) ** 2) - ((y + 0.26 + 0.5 * (x + 0.42)) / 0.20) ** 2)
    color = color + (np.array([1.0, 0.58, 0.54]) - color) * gloss[..., None]
    return color, (radius < 1).astype(float)


def _stem(x: Array, y: Array) -> tuple[Array, Array]:
    """Return colour and coverage of a short brown stem that leans to the right."""
    up = (-0.52 - y) / 0.44
    middle = 0.03 + 0.13 * up**2
    inside = (np.abs(x - middle) < 0.040 + 0.020 * up**2) & (up > 0) & (up < 1)
    color = np.array([0.36, 0.22, 0.10]) * (1.1 - 0.5 * (x > middle))[..., None]
    return color, inside.astype(float)


def _leaf(x: Array, y: Array) -> tuple[Array, Array]:
    """Return colour and coverage of a small leaf to the right of the stem."""
    angle = -0.45
    along = ((x - 0.10) * np.cos(angle) + (y + 0.74) * np.sin(angle)) / 0.44
    beside = (-(x - 0.10) * np.sin(angle) + (y + 0.74) * np.cos(angle)) / 0.44
    width = 0.30 * np.sin(np.pi * np.clip(along, 0, 1)) ** 0.8
    inside = (along > 0) & (along < 1) & (np.abs(beside) < width)
    color = np.array([0.26, 0.52, 0.13]) * (1.0 - 0.25 * (beside > 0))[..., None]
    return color, inside.astype(float)
