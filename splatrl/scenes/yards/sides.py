"""The sides of a generated yard, which are hedges, fences, walls and fronts of houses, and the houses beyond.

A side is built along x from 0 to its length; the yard lies at y < 0, and the side is solid from y = 0 outwards.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatrl.scenes.yard.enclosure import cut, framed, panel
from splatrl.scenes.yard.furniture import roof
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.materials import Color, Rng, boards, brickwork, plaster
from splatrl.scenes.yard.surfels import Rectangle, Surfels, faces, join
from splatrl.scenes.yards.buildings import gable
from splatrl.scenes.yards.greenery import greenery
from splatrl.scenes.yards.solids import box
from splatrl.scenes.yards.style import Style

Build = Callable[[Solid, Style, Rng], Surfels]


def hedge(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build a clipped hedge."""
    front = greenery(solid, style.hedge, 0.075, rng, 400, "-y")
    return join([front, greenery(solid, style.hedge, 0.085, rng, 220, "+z+x-x"), *backs(solid, style.hedge[0], rng)])


def backs(solid: Solid, color: Color, rng: Rng, sides: str = "+y+x-x") -> list[Surfels]:
    """Build coarse faces for what is seen only from outside."""
    return [plaster(face, rng, color, 0.25) for face in faces(solid.low, solid.high, sides)]


def close_boards(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build a fence of upright boards side by side on two rails."""
    front, back = faces(solid.low, solid.high, "-y+y")
    parts = [boards(front, rng, style.wood, 0.125, (0.042, 0.11)), boards(back, rng, style.wood, 0.125, (0.13, 0.2))]
    for height in (0.2 * front.height, 0.8 * front.height):
        rail = panel(front, (0.0, height), (front.width, 0.09), 0.03)
        parts.append(boards(rail, rng, style.wood, 0.09, (0.045, 0.1), upright=False, contrast=0.7))
    return join(parts)


def slats(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build a fence of horizontal boards between posts."""
    front, back = faces(solid.low, solid.high, "-y+y")
    parts = [boards(face, rng, style.wood, 0.14, (0.047, 0.12), upright=False) for face in (front, back)]
    for along in np.arange(0.0, front.width, 1.6):
        post = Solid("post", (float(along), -0.05, 0.0), (float(along) + 0.09, 0.0, solid.high[2] + 0.06))
        parts += [
            boards(face, rng, style.paint[1], 0.09, (0.045, 0.07)) for face in faces(post.low, post.high, "-y+x-x+z")
        ]
    return join(parts)


def pickets(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build a white picket fence in front of a hedge that closes its gaps."""
    behind = Solid("hedge", (solid.low[0], 0.18, 0.0), (solid.high[0], solid.high[1], solid.high[2]))
    parts = [hedge(behind, style, rng)]
    front = Rectangle((0.0, 0.02, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), solid.high[0], 0.95)
    for along in np.arange(0.03, front.width - 0.08, 0.16):
        picket = panel(front, (float(along), 0.04), (0.085, 0.85 + 0.05 * float(np.cos(along * 4))), 0.02)
        parts.append(boards(picket, rng, (0.90, 0.90, 0.87), 0.085, (0.043, 0.08), contrast=0.3))
    for height in (0.2, 0.66):
        rail = panel(front, (0.0, height), (front.width, 0.07), 0.0)
        parts.append(boards(rail, rng, (0.84, 0.84, 0.82), 0.07, (0.04, 0.1), upright=False, contrast=0.3))
    return join(parts)


def bricks(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build a brick wall capped with slabs."""
    front, top = faces(solid.low, solid.high, "-y+z")
    wall = brickwork(front, rng, (0.25, 0.09), (2, 1), style.brick, (0.62, 0.57, 0.52))
    return join([wall, plaster(top, rng, style.stone, 0.1), *backs(solid, style.brick[0], rng)])


def rendered(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build a plastered wall capped with a row of tiles."""
    front, top = faces(solid.low, solid.high, "-y+z")
    cap = Rectangle((0.0, -0.06, solid.high[2]), (1.0, 0.0, 0.0), (0.0, 0.9, 0.436), solid.high[0], 0.3)
    return join(
        [
            plaster(front, rng, style.plaster[1], 0.09, 0.07),
            plaster(top, rng, style.plaster[1], 0.1),
            roof(cap, rng, style.roof, (0.12, 0.1)),
            *backs(solid, style.plaster[1], rng),
        ]
    )


def rubble(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build a dry-stone wall of field stones."""
    front, top = faces(solid.low, solid.high, "-y+z")
    darker = tuple(0.72 * v for v in style.stone)
    return join(
        [
            brickwork(
                front, rng, (0.34, 0.17), (3, 2), ((darker[0], darker[1], darker[2]), style.stone), (0.24, 0.22, 0.20)
            ),
            plaster(top, rng, style.stone, 0.1, 0.15),
            *backs(solid, style.stone, rng),
        ]
    )


def facade(solid: Solid, style: Style, rng: Rng) -> Surfels:
    """Build the front of a house: plaster or brick, windows, a door, and the edge of a roof."""
    (front,) = faces(solid.low, solid.high, "-y")
    if rng.random() < 0.35:
        wall = brickwork(front, rng, (0.30, 0.11), (2, 1), style.brick, (0.66, 0.62, 0.57))
    else:
        wall = plaster(front, rng, style.plaster[0], 0.1, 0.04)
    parts: list[Surfels] = []
    bays = max(2, round(front.width / 1.9))
    door = int(rng.integers(bays))
    for bay in range(bays):
        along = (bay + 0.5) * front.width / bays
        if bay == door:
            hole = panel(front, (along - 0.45, 0.02), (0.9, 2.0))
            wall = cut(wall, hole)
            parts.append(boards(hole, rng, style.paint[0], 0.18, (0.03, 0.09), contrast=0.35))
            parts.append(plaster(panel(hole, (0.2, 1.25), (0.5, 0.5), 0.01), rng, (0.36, 0.46, 0.55), 0.06, 0.1))
            continue
        window = ((along - 0.5, 0.95), (1.0, 1.05))
        wall = cut(wall, panel(front, *window))
        parts += framed(front, *window, rng, 0.08)
        sill = panel(front, (along - 0.56, 0.88), (1.12, 0.07), 0.05)
        parts.append(plaster(sill, rng, style.stone, 0.05))
    height, reach = solid.high[2], 1.9
    eaves = Rectangle((-0.2, -0.35, height - 0.12), (1.0, 0.0, 0.0), (0.0, 0.85, 0.527), front.width + 0.4, reach)
    gutter = Rectangle((-0.2, -0.36, height - 0.26), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), front.width + 0.4, 0.16)
    under = Rectangle((-0.2, 0.0, height - 0.14), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), front.width + 0.4, 0.35)
    parts += [wall, roof(eaves, rng, style.roof, (0.16, 0.16)), plaster(gutter, rng, (0.84, 0.83, 0.80), 0.09)]
    parts.append(plaster(under, rng, (0.80, 0.78, 0.74), 0.12))
    ends = faces(solid.low, solid.high, "-x+x")
    return join([*parts, *(plaster(face, rng, style.plaster[0], 0.2) for face in ends)])


@dataclass(frozen=True)
class SideKind:
    """A kind of side.

    Attributes:
        build: function that builds its surfels from its box.
        heights: minimum and maximum height, metres.
        depth: depth, metres.
    """

    build: Build
    heights: tuple[float, float]
    depth: float


SIDES = {
    "hedge": SideKind(hedge, (1.4, 2.2), 0.6),
    "close boards": SideKind(close_boards, (1.5, 1.9), 0.05),
    "slats": SideKind(slats, (1.4, 1.9), 0.05),
    "pickets": SideKind(pickets, (1.1, 1.6), 0.6),
    "bricks": SideKind(bricks, (1.5, 2.2), 0.2),
    "rendered": SideKind(rendered, (1.5, 2.1), 0.2),
    "rubble": SideKind(rubble, (1.2, 1.7), 0.3),
    "facade": SideKind(facade, (2.6, 3.0), 0.3),
}


def neighbour(size: tuple[float, float, float], style: Style, rng: Rng, walls: Color) -> Surfels:
    """Build a house beyond the yard, with windows under a gable that faces -y."""
    wide, deep, height = size
    solid = box("house", size)
    front, *others = faces(solid.low, solid.high, "-y+x-x")
    wall = plaster(front, rng, walls, 0.24, 0.03)
    parts = [plaster(face, rng, walls, 0.3, 0.03) for face in others]
    for level in np.arange(0.9, height - 1.2, 2.5):
        for along in np.arange(0.7, wide - 1.3, 2.0):
            window = ((float(along), float(level)), (1.0, 1.2))
            wall = cut(wall, panel(front, *window))
            parts += framed(front, *window, rng, 0.14)
    parts += gable((wide, deep), height, 0.36 * wide, style.roof, walls, rng, (0.3, 0.3))
    return join([wall, *parts])
