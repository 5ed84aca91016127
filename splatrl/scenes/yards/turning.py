"""Moves things from their own frames to where they stand."""

import math

from splatrl.scenes.yard.clutter import Shift, moved
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.surfels import Surfels

QUARTERS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""Cosine and sine of 0 to 3 quarter turns."""


def turned(part: Surfels, x: float = 0.0, y: float = 0.0, quarters: int = 0) -> Surfels:
    """Turn surfels counter-clockwise about the origin by quarter turns, then shift them."""
    return moved(part, (0.0, 0.0), Shift(x, y, quarters % 4 * math.pi / 2))


def turned_solid(solid: Solid, x: float = 0.0, y: float = 0.0, quarters: int = 0) -> Solid:
    """Turn and shift the box of a solid in the same way."""
    cos, sin = QUARTERS[quarters % 4]
    corners = [(cos * a - sin * b + x, sin * a + cos * b + y) for a, b, _ in (solid.low, solid.high)]
    (x0, x1), (y0, y1) = (sorted(pair) for pair in zip(*corners, strict=True))
    return Solid(solid.name, (x0, y0, solid.low[2]), (x1, y1, solid.high[2]))
