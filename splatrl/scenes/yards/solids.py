"""Sizes and solid parts of things in their own frames, with the origin at the centre of their base."""

from splatrl.scenes.yard.layout import Solid

Size = tuple[float, float, float]
"""Extent along x, y and z, metres."""
Solids = tuple[Solid, ...]


def box(name: str, size: Size, below: float = 0.0) -> Solid:
    """Return a box centred on the vertical through the origin, from height ``below`` up to the height of ``size``."""
    return Solid(name, (-size[0] / 2, -size[1] / 2, below), (size[0] / 2, size[1] / 2, size[2]))


def whole(size: Size) -> Solids:
    """Return a single solid that fills the size."""
    return (box("thing", size),)
