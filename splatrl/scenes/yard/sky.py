"""The sky: a dome of large Gaussians without gaps, so that no view sees past it."""

from dataclasses import dataclass

import numpy as np

from splatrl.scenes.yard.materials import Color, Rng, mixed, waves
from splatrl.scenes.yard.surfels import Surfels, frames, surfels

RADIUS = 30.0
"""Radius of the dome, metres."""
COUNT = 1500


@dataclass(frozen=True)
class SkyLook:
    """The appearance of a sky.

    Attributes:
        horizon: colour at the horizon, sRGB.
        zenith: colour overhead, sRGB.
        cloud: colour of clouds, sRGB.
        clear: clearness of the sky: clouds appear where noise of roughly unit variance exceeds this.
    """

    horizon: Color = (0.80, 0.88, 0.95)
    zenith: Color = (0.33, 0.56, 0.87)
    cloud: Color = (0.97, 0.97, 0.98)
    clear: float = 0.55


BLUE = SkyLook()


def sky(rng: Rng, look: SkyLook = BLUE) -> Surfels:
    """Build a dome, pale at the horizon, with a few clouds; it emits its own light."""
    index = np.arange(COUNT) + 0.5
    height = 1.06 * index / COUNT - 0.06  # sine of the elevation: uniform in area, from just below the horizon
    azimuth = index * np.pi * (3 - np.sqrt(5))
    level = np.sqrt(1 - height**2)
    directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], -1)
    colors = mixed(look.horizon, look.zenith, np.maximum(height, 0.0) ** 0.55)
    stretched = directions * np.array([1.0, 1.0, 2.2])
    cover = waves(stretched, rng, 0.9) + 0.6 * waves(stretched, rng, 0.4) + 0.35 * waves(stretched, rng, 0.2)
    cloud = np.clip((cover - look.clear) / 1.1, 0.0, 1.0)[:, None] * np.clip(height * 6, 0.0, 1.0)[:, None]
    colors = (1 - 0.9 * cloud) * colors + 0.9 * cloud * np.array(look.cloud)
    width = 0.85 * RADIUS * np.sqrt(2.12 * np.pi / COUNT)
    return surfels(
        RADIUS * directions, frames(-directions, np.array([0.1, 0.2, 1.0])), (width, width, 0.2), colors, opacity=0.995
    )
