"""The look of a generated yard, drawn from its seed: light, sky, and the colours of things."""

from dataclasses import dataclass

import numpy as np

from splatrl.scenes.yard.light import Light
from splatrl.scenes.yard.materials import Color, Rng
from splatrl.scenes.yard.sky import SkyLook

Palette = tuple[Color, Color]
"""Two colours between which leaves or bricks vary."""


@dataclass(frozen=True)
class Mood:
    """A time of day and its weather.

    Attributes:
        elevation_deg: minimum and maximum elevation of the sun.
        sun: linear light of the sun.
        open_sky: linear light of the sky.
        look: appearance of the sky.
    """

    elevation_deg: tuple[float, float]
    sun: Color
    open_sky: Color
    look: SkyLook


MOODS = (
    Mood((48, 66), (1.62, 1.51, 1.28), (0.56, 0.67, 0.86), SkyLook()),
    Mood((42, 60), (1.50, 1.42, 1.22), (0.62, 0.70, 0.84), SkyLook((0.86, 0.90, 0.94), (0.42, 0.60, 0.84), clear=-0.2)),
    Mood(
        (26, 34), (1.95, 1.36, 0.78), (0.55, 0.58, 0.72), SkyLook((0.98, 0.84, 0.66), (0.42, 0.55, 0.78), (1, 0.9, 0.8))
    ),
    Mood((30, 40), (1.6, 1.28, 0.94), (0.60, 0.62, 0.74), SkyLook((0.96, 0.90, 0.82), (0.46, 0.62, 0.84), clear=1.2)),
    Mood((45, 65), (0.34, 0.34, 0.33), (1.12, 1.16, 1.2), SkyLook((0.85, 0.87, 0.89), (0.70, 0.74, 0.78), clear=-0.6)),
    Mood((40, 55), (0.85, 0.82, 0.74), (0.88, 0.93, 1.0), SkyLook((0.90, 0.91, 0.91), (0.62, 0.72, 0.84), clear=0.0)),
)
"""In order: noon, scattered clouds, evening, a clear morning, overcast, haze."""
LAWNS: tuple[Palette, ...] = (
    ((0.27, 0.42, 0.13), (0.60, 0.60, 0.27)),
    ((0.20, 0.40, 0.12), (0.40, 0.55, 0.20)),
    ((0.46, 0.47, 0.20), (0.72, 0.65, 0.38)),
    ((0.33, 0.50, 0.20), (0.55, 0.66, 0.30)),
)
"""Colours of grass: fresh and dry."""
LEAVES: tuple[Palette, ...] = (
    ((0.28, 0.43, 0.14), (0.52, 0.64, 0.25)),
    ((0.16, 0.33, 0.14), (0.36, 0.52, 0.24)),
    ((0.13, 0.28, 0.18), (0.28, 0.44, 0.28)),
    ((0.40, 0.48, 0.16), (0.68, 0.70, 0.28)),
    ((0.36, 0.42, 0.34), (0.60, 0.64, 0.52)),
    ((0.62, 0.34, 0.10), (0.86, 0.60, 0.18)),
    ((0.40, 0.18, 0.18), (0.56, 0.30, 0.25)),
    ((0.86, 0.62, 0.68), (0.97, 0.86, 0.88)),
)
"""Colours of leaves; the last three are autumn leaves, copper beech and cherry blossom."""
EVERGREEN = 5
"""Number of green palettes, which come first in ``LEAVES``: hedges and distant trees use only these."""
WOODS: tuple[Color, ...] = (
    (0.76, 0.55, 0.31),
    (0.58, 0.40, 0.25),
    (0.42, 0.28, 0.19),
    (0.66, 0.63, 0.58),
    (0.86, 0.86, 0.82),
    (0.33, 0.42, 0.36),
    (0.24, 0.24, 0.26),
)
PAINTS: tuple[Color, ...] = (
    (0.16, 0.33, 0.68),
    (0.20, 0.44, 0.36),
    (0.88, 0.87, 0.83),
    (0.90, 0.72, 0.25),
    (0.48, 0.62, 0.68),
    (0.30, 0.30, 0.32),
    (0.62, 0.52, 0.66),
)
"""Colours of paint; none is red, because only the egg is red."""
PLASTERS: tuple[Color, ...] = (
    (0.93, 0.87, 0.72),
    (0.90, 0.90, 0.87),
    (0.86, 0.70, 0.52),
    (0.74, 0.80, 0.82),
    (0.80, 0.78, 0.70),
    (0.93, 0.80, 0.68),
    (0.70, 0.76, 0.66),
)
BRICKS: tuple[Palette, ...] = (
    ((0.56, 0.33, 0.25), (0.69, 0.46, 0.35)),
    ((0.72, 0.58, 0.43), (0.83, 0.72, 0.55)),
    ((0.44, 0.42, 0.40), (0.62, 0.60, 0.57)),
    ((0.80, 0.78, 0.74), (0.90, 0.88, 0.84)),
    ((0.40, 0.27, 0.24), (0.54, 0.38, 0.33)),
)
STONES: tuple[Color, ...] = ((0.60, 0.58, 0.54), (0.72, 0.66, 0.55), (0.45, 0.46, 0.48), (0.68, 0.58, 0.50))
ROOFS: tuple[Color, ...] = ((0.55, 0.30, 0.22), (0.36, 0.35, 0.38), (0.44, 0.36, 0.30), (0.62, 0.44, 0.32))
BLOSSOMS: tuple[Color, ...] = (
    (0.96, 0.79, 0.16),
    (0.95, 0.94, 0.90),
    (0.55, 0.35, 0.78),
    (0.93, 0.55, 0.70),
    (0.40, 0.50, 0.90),
    (0.97, 0.62, 0.25),
)
GROUNDS = ("lawn", "gravel", "slabs", "bricks", "bark")
"""Surfaces that the ground of a yard may have."""


@dataclass(frozen=True)
class Style:
    """The materials, colours and light of a yard.

    Attributes:
        light: light of sun and sky on its things.
        sky: appearance of the sky.
        base: surface of most of its ground, one of ``GROUNDS``.
        laid: surface of its path, another one of ``GROUNDS``.
        lawn: colours of fresh and dry grass.
        hedge: colours of the leaves of hedges.
        leaves: colours of the leaves of three kinds of plants.
        wood: colour of fences and furniture.
        paint: two colours of doors, pots and barrels.
        plaster: two colours of plastered walls.
        brick: colours of bricks.
        stone: colour of rubble, slabs and gravel.
        roof: colour of roof tiles.
        blossoms: three colours of blossoms.
    """

    light: Light
    sky: SkyLook
    base: str
    laid: str
    lawn: Palette
    hedge: Palette
    leaves: tuple[Palette, ...]
    wood: Color
    paint: tuple[Color, ...]
    plaster: tuple[Color, ...]
    brick: Palette
    stone: Color
    roof: Color
    blossoms: tuple[Color, ...]

    @property
    def far(self) -> Color:
        """Colour of the land at the horizon, sRGB: that of the sky there, darkened."""
        red, green, blue = self.sky.horizon
        return 0.75 * red, 0.75 * green, 0.75 * blue


def drawn_style(rng: Rng) -> Style:
    """Draw a style."""
    mood = MOODS[rng.integers(len(MOODS))]
    base = GROUNDS[rng.choice(len(GROUNDS), p=(0.62, 0.13, 0.12, 0.05, 0.08))]
    laid = GROUNDS[1:4][rng.integers(3)]
    lawn = LAWNS[rng.integers(len(LAWNS))]
    under = np.array({"lawn": lawn[0], "bark": (0.36, 0.25, 0.17)}.get(base, (0.52, 0.50, 0.46)))
    elevation, azimuth = np.radians(rng.uniform(*mood.elevation_deg)), rng.uniform(0, 2 * np.pi)
    level = np.cos(elevation)
    sun = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    bounced = 0.3 * under * (np.array(mood.sun) + np.array(mood.open_sky))
    return Style(
        light=Light(sun, np.array(mood.sun), np.array(mood.open_sky), bounced),
        sky=mood.look,
        base=base,
        laid=laid if laid != base else "bark",
        lawn=lawn,
        hedge=LEAVES[rng.integers(EVERGREEN)],
        leaves=tuple(LEAVES[i] for i in rng.choice(len(LEAVES), 3, replace=False)),
        wood=varied(WOODS[rng.integers(len(WOODS))], rng),
        paint=tuple(varied(PAINTS[i], rng) for i in rng.choice(len(PAINTS), 2, replace=False)),
        plaster=tuple(varied(PLASTERS[i], rng) for i in rng.choice(len(PLASTERS), 2, replace=False)),
        brick=BRICKS[rng.integers(len(BRICKS))],
        stone=varied(STONES[rng.integers(len(STONES))], rng),
        roof=varied(ROOFS[rng.integers(len(ROOFS))], rng),
        blossoms=tuple(BLOSSOMS[i] for i in rng.choice(len(BLOSSOMS), 3, replace=False)),
    )


def varied(color: Color, rng: Rng) -> Color:
    """Return a colour slightly different from the given one."""
    red, green, blue = (float(v) for v in np.clip(np.array(color) * (1 + 0.06 * rng.normal(size=3)), 0.03, 0.97))
    return red, green, blue
