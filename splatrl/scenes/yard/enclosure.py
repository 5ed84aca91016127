"""The enclosure of the yard and what rises above it: hedge, fence, brick wall, shed, garage and a house."""

from dataclasses import fields

import numpy as np

from splatrl.scenes.yard.furniture import roof
from splatrl.scenes.yard.layout import BRICK_WALL, FENCE, GARAGE, HEDGE, HOUSE, SHED, SOUTH_WALL, Solid
from splatrl.scenes.yard.materials import Color, Rng, boards, brickwork, plaster, shades
from splatrl.scenes.yard.plants import leaves
from splatrl.scenes.yard.surfels import Rectangle, Surfels, faces, join

BRICK = ((0.56, 0.33, 0.25), (0.69, 0.46, 0.35))
BLUE = (0.16, 0.33, 0.68)
GLASS = (0.36, 0.46, 0.55)


def panel(face: Rectangle, at: tuple[float, float], size: tuple[float, float], lift: float = 0.02) -> Rectangle:
    """Return a part of a face, slightly in front of it, given its lower left corner and size in metres on the face."""
    x, y, z = (float(v) for v in face.points(np.array([at]), lift)[0])
    return Rectangle((x, y, z), face.right, face.up, *size)


def cut(part: Surfels, hole: Rectangle) -> Surfels:
    """Remove the surfels of a face behind a panel, which would show through when the face is seen at a slant."""
    away = part.means - np.asarray(hole.corner)
    along, up = away @ np.asarray(hole.right), away @ np.asarray(hole.up)
    kept = ~((along > 0) & (along < hole.width) & (up > 0) & (up < hole.height))
    return Surfels(*(getattr(part, field.name)[kept] for field in fields(Surfels)))


def hedge(rng: Rng) -> Surfels:
    """Build a clipped hedge: leaves over dark faces."""
    side, top, far = faces(HEDGE.low, HEDGE.high, "-x+z+x")
    parts = []
    deep = Solid(
        "core", (HEDGE.low[0] + 0.09, HEDGE.low[1], 0.0), (HEDGE.high[0] - 0.09, HEDGE.high[1], HEDGE.high[2] - 0.07)
    )
    for face in faces(deep.low, deep.high, "-x+z+x"):
        st, size = face.cells(0.16)
        parts.append(face.surfels(st, size, shades((0.10, 0.17, 0.07), 0.2 * rng.normal(size=len(st)))))
    for face, count in ((side, 3400), (top, 600), (far, 300)):
        st = rng.uniform((0.0, 0.0), (face.width, face.height), (count, 2))
        depth = rng.random(count) ** 1.5
        bulge = 0.03 * np.sin(3.1 * st[:, 0]) * np.sin(2.3 * st[:, 1] + 1.0)
        outward = np.broadcast_to(np.cross(face.right, face.up), (count, 3))
        points = face.points(st, 0.02 + bulge - 0.1 * depth)
        parts.append(leaves(points, outward, depth, 0.075, ((0.13, 0.32, 0.11), (0.30, 0.50, 0.18)), rng))
    return join(parts)


def fence(rng: Rng) -> Surfels:
    """Build a fence: upright boards of honey-coloured wood on two rails."""
    (front, back) = faces(FENCE.low, FENCE.high, "-y+y")
    wood = (0.76, 0.55, 0.31)
    parts = [boards(front, rng, wood, 0.125, (0.042, 0.11)), boards(back, rng, wood, 0.125, (0.13, 0.2))]
    for height in (0.3, 1.3):
        rail = panel(front, (0.0, height), (front.width, 0.09), 0.03)
        parts.append(boards(rail, rng, (0.66, 0.46, 0.26), 0.09, (0.045, 0.1), upright=False))
    return join(parts)


def walls(rng: Rng) -> Surfels:
    """Build the brick wall in the west, and the pale wall and the garage in the south."""
    near, far, top = faces(BRICK_WALL.low, BRICK_WALL.high, "+x-x+z")
    parts = [
        brickwork(near, rng, (0.23, 0.08), (2, 1), BRICK, (0.60, 0.54, 0.49)),
        plaster(far, rng, BRICK[0], 0.25),
        plaster(top, rng, (0.62, 0.60, 0.57), 0.1),
        *(plaster(face, rng, (0.90, 0.80, 0.58), 0.1) for face in faces(GARAGE.low, GARAGE.high, "+y")),
        *(plaster(face, rng, (0.84, 0.74, 0.54), 0.2) for face in faces(GARAGE.low, GARAGE.high, "+z-x-y")),
        *(plaster(face, rng, (0.78, 0.79, 0.78), 0.1) for face in faces(SOUTH_WALL.low, SOUTH_WALL.high, "+y")),
        *(plaster(face, rng, (0.72, 0.73, 0.72), 0.14) for face in faces(SOUTH_WALL.low, SOUTH_WALL.high, "+z-y")),
    ]
    return join(parts)


def shed(rng: Rng) -> Surfels:
    """Build a white wooden shed with a blue door and a window under a dark roof."""
    white = (0.88, 0.88, 0.85)
    front, *sides = faces(SHED.low, SHED.high, "+y+x-x-y")
    door, window = panel(front, (1.25, 0.02), (0.75, 1.6)), ((0.3, 0.75), (0.6, 0.6))
    planks = boards(front, rng, white, 0.13, (0.065, 0.09), upright=False, contrast=0.3)
    parts = [cut(cut(planks, door), panel(front, *window))]
    parts += [boards(face, rng, white, 0.13, (0.13, 0.25), upright=False, contrast=0.3) for face in sides]
    parts.append(boards(door, rng, BLUE, 0.125, (0.042, 0.08), contrast=0.5))
    parts += framed(front, *window, rng)
    depth = SHED.high[1] - SHED.low[1] + 0.3
    rise = 0.45
    slope = float(np.hypot(depth, rise))
    low = (SHED.low[0] - 0.1, SHED.high[1] + 0.2, SHED.high[2] - 0.02)
    tilted = (0.0, -depth / slope, rise / slope)
    eaves = Rectangle(
        (SHED.high[0] + 0.1, low[1], low[2]), (-1.0, 0.0, 0.0), tilted, SHED.high[0] - SHED.low[0] + 0.2, slope
    )
    parts.append(roof(eaves, rng, (0.36, 0.35, 0.38), (0.12, 0.12)))
    return join(parts)


def framed(
    face: Rectangle, at: tuple[float, float], size: tuple[float, float], rng: Rng, step: float = 0.05
) -> list[Surfels]:
    """Build a window: dark glass with a frame and crossed glazing bars in front of it."""
    frame: Color = (0.93, 0.93, 0.91)
    glass = panel(face, at, size)
    bars = [
        panel(glass, (x, 0.0), (step, size[1]), 0.015)
        for x in (-0.5 * step, 0.5 * (size[0] - step), size[0] - 0.5 * step)
    ] + [
        panel(glass, (0.0, y), (size[0], step), 0.015)
        for y in (-0.5 * step, 0.5 * (size[1] - step), size[1] - 0.5 * step)
    ]
    return [plaster(glass, rng, GLASS, 1.2 * step, 0.15), *(plaster(bar, rng, frame, step, 0.02) for bar in bars)]


def house(rng: Rng) -> Surfels:
    """Build the neighbours' house behind the brick wall: plaster, windows and a tiled roof."""
    front, *sides = faces(HOUSE.low, HOUSE.high, "+x+y-y")
    wall, *parts = [plaster(face, rng, (0.93, 0.87, 0.72), 0.28, 0.03) for face in (front, *sides)]
    for along in (0.9, 3.2, 5.6):
        window = ((along, 2.1), (1.2, 1.1))
        wall = cut(wall, panel(front, *window))
        parts += framed(front, *window, rng, 0.16)
    parts.append(wall)
    length, rise = front.width + 0.6, 2.2
    reach = 0.5 * (HOUSE.high[0] - HOUSE.low[0]) + 0.3
    slope = float(np.hypot(reach, rise))
    corner = (HOUSE.high[0] + 0.3, HOUSE.low[1] - 0.3, HOUSE.high[2] - 0.1)
    tilted = (-reach / slope, 0.0, rise / slope)
    gutter = Rectangle((corner[0], corner[1], corner[2] - 0.22), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), length, 0.24)
    parts.append(plaster(gutter, rng, (0.86, 0.84, 0.80), 0.12))
    parts.append(roof(Rectangle(corner, (0.0, 1.0, 0.0), tilted, length, slope), rng, (0.55, 0.30, 0.22), (0.3, 0.3)))
    return join(parts)


def enclosure(rng: Rng) -> Surfels:
    """Build everything around the yard."""
    return join([build(rng) for build in (hedge, fence, walls, shed, house)])
