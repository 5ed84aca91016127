"""Things that are built in generated yards, each in its own frame: origin at the centre of its base, facing -y."""

import numpy as np

from splatrl.scenes.yard.enclosure import framed, panel
from splatrl.scenes.yard.furniture import garden_wall, roof
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.materials import Color, Rng, boards, plaster, shades
from splatrl.scenes.yard.surfels import Rectangle, Surfels, faces, join
from splatrl.scenes.yards.solids import Size, box
from splatrl.scenes.yards.style import Style
from splatrl.scenes.yards.turning import turned


def wall(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a free-standing wall of bricks along x."""
    along = Solid("wall", (-size[1] / 2, -size[0] / 2, 0.0), (size[1] / 2, size[0] / 2, size[2]))
    return turned(garden_wall(rng, along, style.brick), quarters=1)


def kennel(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a dog kennel with a roof and a dark doorway."""
    wide, deep, height = size
    eaves = 0.62 * height
    solid = box("kennel", (wide, deep, eaves))
    front, *sides = faces(solid.low, solid.high, "-y+y+x-x")
    parts = [boards(face, rng, style.paint[0], 0.09, (0.03, 0.045), contrast=0.6) for face in (front, *sides)]
    parts.append(
        plaster(panel(front, (0.3 * wide, 0.02), (0.4 * wide, 0.75 * eaves), 0.012), rng, (0.10, 0.08, 0.07), 0.03)
    )
    parts += gable((wide, deep), eaves, height - eaves, style.roof, style.paint[0], rng, (0.03, 0.04))
    return join(parts)


def gable(
    floor: tuple[float, float],
    eaves: float,
    rise: float,
    tiles: Color,
    ends: Color,
    rng: Rng,
    step: tuple[float, float],
) -> list[Surfels]:
    """Build a roof whose ridge runs along y, and the triangular gables under it."""
    wide, deep = floor
    over = 0.06 * wide
    reach = wide / 2 + over
    slope = float(np.hypot(reach, rise))
    parts = []
    for side in (1, -1):
        corner = (side * reach, -side * (deep / 2 + over), eaves - rise * over / reach)
        tilted = (-side * reach / slope, 0.0, rise / slope)
        parts.append(roof(Rectangle(corner, (0.0, float(side), 0.0), tilted, deep + 2 * over, slope), rng, tiles, step))
    for side in (1, -1):
        face = Rectangle(
            (-side * -wide / 2, side * deep / 2, eaves), (-float(side), 0.0, 0.0), (0.0, 0.0, 1.0), wide, rise
        )
        st, size = face.cells(step[0])
        inside = st[:, 1] < rise * (1 - np.abs(2 * st[:, 0] / wide - 1)) - 0.3 * size[1]
        parts.append(face.surfels(st[inside], size, shades(ends, 0.05 * rng.normal(size=int(inside.sum())))))
    return parts


def shed(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a small wooden shed with a door and a window."""
    wide, deep, height = size
    solid = box("shed", (wide, deep, height))
    front, *sides = faces(solid.low, solid.high, "-y+x-x+y")
    parts = [boards(face, rng, style.paint[1], 0.13, (0.13, 0.14), contrast=0.4) for face in sides]
    parts.append(boards(front, rng, style.paint[1], 0.14, (0.035, 0.12), contrast=0.4))
    door = panel(front, (0.12 * wide, 0.02), (0.34 * wide, min(1.7, 0.85 * height)))
    parts.append(boards(door, rng, style.wood, 0.15, (0.03, 0.09), contrast=0.5))
    parts += framed(front, (0.58 * wide, 0.45 * height), (0.3 * wide, 0.3 * height), rng)
    parts += gable((wide, deep), height, 0.3 * wide, style.roof, style.paint[1], rng, (0.12, 0.12))
    return join(parts)
