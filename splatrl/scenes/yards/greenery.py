"""Things that grow in generated yards, each in its own frame: origin at the centre of its base, facing -y."""

import numpy as np

from splatrl.scenes.yard.furniture import pot
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.materials import Color, Rng, boards, plaster, shades
from splatrl.scenes.yard.plants import blossoms, leaves, shrub
from splatrl.scenes.yard.surfels import Surfels, faces, join
from splatrl.scenes.yards.solids import Size, box
from splatrl.scenes.yards.style import Style


def greenery(
    solid: Solid, palette: tuple[Color, Color], leaf: float, rng: Rng, density: float, sides: str = "+x-x+y-y+z"
) -> Surfels:
    """Build a box of leaves over dark faces; ``density`` is the number of leaves per square metre."""
    parts = []
    low, high = np.array(solid.low), np.array(solid.high)
    inset = np.minimum(1.2 * leaf, 0.3 * (high - low)) * (1, 1, 0)
    deep = (low + inset).tolist(), (high - inset - (0, 0, leaf)).tolist()
    for face in faces(*deep, sides):
        st, size = face.cells(max(0.05, 1.6 * leaf))
        parts.append(face.surfels(st, size, shades(palette[0], 0.2 * rng.normal(size=len(st)) - 0.7)))
    for face in faces(solid.low, solid.high, sides):
        count = max(8, round(density * face.width * face.height))
        st = rng.uniform((0.0, 0.0), (face.width, face.height), (count, 2))
        depth = rng.random(count) ** 1.5
        bulge = 0.4 * leaf * np.sin(3.1 * st[:, 0]) * np.sin(2.3 * st[:, 1] + 1.0)
        outward = np.broadcast_to(np.cross(face.right, face.up), (count, 3))
        parts.append(leaves(face.points(st, bulge - 1.3 * leaf * depth), outward, depth, leaf, palette, rng))
    return join(parts)


def clipped(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a clipped block of box or yew."""
    return greenery(box("block", size), style.hedge, 0.034, rng, 2600)


def planter(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a raised bed of boards with plants in it."""
    wide, deep, height = size
    rim = 0.62 * height
    sides = box("boards", (wide, deep, rim))
    parts = [
        boards(face, rng, style.wood, 0.11, (0.036, 0.05), upright=False)
        for face in faces(sides.low, sides.high, "+x-x+y-y")
    ]
    parts.append(plaster(faces(sides.low, sides.high, "+z")[0], rng, (0.27, 0.20, 0.14), 0.05, 0.15))
    columns = max(1, round(wide / 0.22))
    for column in range(columns):
        x = -wide / 2 + (column + 0.5) * wide / columns
        radii = (0.52 * wide / columns, 0.42 * deep, 0.55 * (height - rim))
        palette = style.leaves[column % 2]
        parts.append(shrub((x, 0.0, rim + 0.9 * radii[2]), radii, 150, 0.03, palette, rng))
        parts.append(blossoms((x, 0.0, rim + radii[2]), radii, 26, 0.013, style.blossoms[column % 3], rng))
    return join(parts)


def potted(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a large pot with a bush in it."""
    radius, height = size[0] / 2, 0.5 * size[2]
    up = 0.5 * (size[2] - height)
    parts = [
        pot((0.0, 0.0, 0.0), 0.9 * radius, height, style.paint[0], rng, 0.021),
        shrub((0.0, 0.0, height + 0.9 * up), (1.1 * radius, 1.1 * radius, 1.1 * up), 620, 0.026, style.leaves[1], rng),
        blossoms((0.0, 0.0, height + up), (1.1 * radius, 1.1 * radius, up), 130, 0.013, style.blossoms[0], rng),
    ]
    return join(parts)


def bush(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a round bush that grows from the ground."""
    radii = (size[0] / 2, size[1] / 2, size[2] / 2)
    green = shrub((0.0, 0.0, 0.48 * size[2]), radii, 900, 0.042, style.leaves[0], rng)
    if rng.random() < 0.4:
        return green
    return join([green, blossoms((0.0, 0.0, 0.52 * size[2]), radii, 120, 0.022, style.blossoms[1], rng)])


def screen(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a fence of slats with a climbing plant on it."""
    solid = box("screen", size)
    parts = [boards(face, rng, style.wood, 0.09, (0.03, 0.05), upright=False) for face in faces(solid.low, solid.high)]
    count = round(260 * size[0])
    along = rng.normal(0.3 * size[0], 0.22 * size[0], count).clip(0.03 - size[0] / 2, size[0] / 2 - 0.03)
    side = np.where(rng.random(count) < 0.5, -1.0, 1.0)
    up = size[2] * rng.random(count) ** 0.8
    points = np.stack([along, side * (size[1] / 2 + 0.004 * rng.random(count)), up], -1)
    outward = np.stack([0 * side, side, 0 * side], -1)
    return join([*parts, leaves(points, outward, rng.random(count) * 0.6, 0.03, style.leaves[0], rng)])
