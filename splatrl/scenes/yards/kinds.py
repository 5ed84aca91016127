"""Kinds of things in generated yards: those in the robots' way, and those at the edge.

Each is built in its own frame, with the origin at the centre of its base, and faces -y. The file is long because it
is a catalogue: a short function for every kind.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from splatrl.scenes.yard.enclosure import framed, panel
from splatrl.scenes.yard.furniture import garden_wall, log, plinth, pot, rain_barrel, roof, wood_pile
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.materials import Color, Rng, boards, brickwork, plaster, shades, waves
from splatrl.scenes.yard.plants import blossoms, leaves, shrub
from splatrl.scenes.yard.surfels import Rectangle, Surfels, faces, join, lathe, painted
from splatrl.scenes.yards.style import Style
from splatrl.scenes.yards.turning import turned

Size = tuple[float, float, float]
"""Extent along x, y and z, metres."""
Solids = tuple[Solid, ...]


def box(name: str, size: Size, below: float = 0.0) -> Solid:
    """Return a box centred on the vertical through the origin, from height ``below`` up to the height of ``size``."""
    return Solid(name, (-size[0] / 2, -size[1] / 2, below), (size[0] / 2, size[1] / 2, size[2]))


def whole(size: Size) -> Solids:
    """Return a single solid that fills the size."""
    return (box("thing", size),)


def wall(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a free-standing wall of bricks along x."""
    along = Solid("wall", (-size[1] / 2, -size[0] / 2, 0.0), (size[1] / 2, size[0] / 2, size[2]))
    return turned(garden_wall(rng, along, style.brick), quarters=1)


def clipped(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a clipped block of box or yew."""
    return greenery(box("block", size), style.hedge, 0.034, rng, 2600)


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


def table(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a low garden table with a pot on it."""
    wide, deep, height = size
    top = box("top", (wide, deep, height), height - 0.05)
    board, *rims = faces(top.low, top.high, "+z+x-x+y-y-z")
    parts = [boards(board, rng, style.wood, 0.07, (0.018, 0.028), upright=False, contrast=0.4)]
    parts += [plaster(rim, rng, style.wood, 0.02, stain=0.04) for rim in rims]
    for leg in legs(size):
        parts += [plaster(face, rng, style.wood, 0.02, stain=0.05) for face in faces(leg.low, leg.high, "+x-x+y-y")]
    x = rng.uniform(-0.3, 0.3) * wide
    parts.append(pot((x, 0.0, height), 0.06, 0.1, style.paint[1], rng, 0.014))
    parts.append(shrub((x, 0.0, height + 0.17), (0.1, 0.1, 0.09), 130, 0.026, style.leaves[2], rng))
    parts.append(blossoms((x, 0.0, height + 0.18), (0.1, 0.1, 0.09), 34, 0.012, style.blossoms[2], rng))
    return join(parts)


def legs(size: Size) -> Solids:
    """Return the four legs of a table."""
    x, y = size[0] / 2 - 0.04, size[1] / 2 - 0.04
    places = [(i * x, j * y) for i in (-1, 1) for j in (-1, 1)]
    return tuple(Solid("leg", (x - 0.02, y - 0.02, 0.0), (x + 0.02, y + 0.02, size[2] - 0.05)) for x, y in places)


def table_solids(size: Size) -> Solids:
    """Return the top and the legs of a table."""
    return (box("top", size, size[2] - 0.05), *legs(size))


def bench(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a bench with a back."""
    return join(
        boards(face, rng, style.wood, 0.09, (0.03, 0.05), upright=False)
        for solid in bench_solids(size)
        for face in faces(solid.low, solid.high)
    )


def bench_solids(size: Size) -> Solids:
    """Return the seat, the back and the two feet of a bench."""
    x, y, height = size[0] / 2, size[1] / 2, size[2]
    feet = [Solid("foot", (i - 0.04, -y + 0.04, 0.0), (i + 0.04, y, 0.37)) for i in (-x + 0.08, x - 0.08)]
    seat = Solid("seat", (-x, -y, 0.37), (x, y, 0.43))
    return (seat, Solid("back", (-x, y - 0.05, 0.43), (x, y, height)), *feet)


def pile(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a stack of split logs whose ends face -y."""
    along = Solid("pile", (-size[1] / 2, -size[0] / 2, 0.0), (size[1] / 2, size[0] / 2, size[2]))
    return turned(wood_pile(rng, along), quarters=3)


def crates(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build two wooden crates, one on top of the other."""
    parts = []
    half = size[2] / 2
    for level, shrink in ((0, 0.0), (1, 0.03)):
        crate = box("crate", (size[0] - shrink, size[1] - shrink, half * (level + 1)), half * level)
        color = style.wood if level else (0.70, 0.53, 0.33)
        parts += [
            boards(face, rng, color, 0.075, (0.025, 0.04), upright=False, contrast=1.4)
            for face in faces(crate.low, crate.high)
        ]
    return join(parts)


def boulder(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a rounded rock."""
    radius, height = size[0] / 2, size[2]
    outline = [(0.9, 0.0), (1.0, 0.3), (0.92, 0.6), (0.7, 0.85), (0.35, 0.98), (0.01, 1.0)]
    rock = lathe((0.0, 0.0, 0.0), [(r * radius, z * height) for r, z in outline], 0.034)
    bumps = 1 - 0.09 * np.abs(waves(rock.means, rng, 0.7 * height))[:, None]
    rock = replace(rock, means=rock.means * bumps, scales=1.15 * rock.scales)
    tone = 0.14 * waves(rock.means, rng, 0.16) + 0.08 * waves(rock.means, rng, 0.05) + 0.05 * rng.normal(size=len(rock))
    return painted(rock, shades(style.stone, tone))


def barrel(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a barrel."""
    return rain_barrel(rng, box("barrel", size), style.paint[1])


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


def column(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a bird bath: a bowl of water on a column."""
    radius, height = size[0] / 2, size[2]
    outline = [
        (0.8, 0.0),
        (0.8, 0.06),
        (0.42, 0.14),
        (0.36, 0.7),
        (0.9, 0.86),
        (1.0, 1.0),
        (0.88, 1.0),
        (0.85, 0.95),
    ]
    stone = lathe((0.0, 0.0, 0.0), [(r * radius, z * height) for r, z in outline], 0.024)
    tone = 0.09 * waves(stone.means, rng, 0.1) + 0.06 * rng.normal(size=len(stone))
    water = lathe((0.0, 0.0, 0.0), [(0.87 * radius, 0.95 * height), (0.002, 0.95 * height)], 0.03)
    return join([painted(stone, shades(style.stone, tone)), painted(water, (0.45, 0.60, 0.68))])


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


def sandbox(size: Size, style: Style, rng: Rng) -> Surfels:
    """Build a sandbox: a frame of boards around sand."""
    wide, deep, height = size
    parts = []
    for solid in sandbox_solids(size):
        parts += [
            boards(face, rng, style.wood, 0.12, (0.04, 0.06), upright=False) for face in faces(solid.low, solid.high)
        ]
    sand = Rectangle((-wide / 2, -deep / 2, 0.6 * height), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), wide, deep)
    parts.append(plaster(sand, rng, (0.86, 0.76, 0.56), 0.06, 0.12))
    return join(parts)


def sandbox_solids(size: Size) -> Solids:
    """Return the four boards of a sandbox."""
    x, y, height = size[0] / 2, size[1] / 2, size[2]
    return (
        Solid("board", (-x, -y, 0.0), (x, -y + 0.06, height)),
        Solid("board", (-x, y - 0.06, 0.0), (x, y, height)),
        Solid("board", (-x, -y + 0.06, 0.0), (-x + 0.06, y - 0.06, height)),
        Solid("board", (x - 0.06, -y + 0.06, 0.0), (x, y - 0.06, height)),
    )


@dataclass(frozen=True)
class Kind:
    """A kind of thing.

    Attributes:
        build: function that builds its surfels.
        least: smallest size, metres.
        most: largest size, metres.
        solids: function that returns the solid parts of a thing of a given size.
        round: whether it fills the ellipse in its box rather than the box; it is then as wide as it is deep.
        pad: distance by which its surfels reach beyond its size on each side, metres.
    """

    build: Callable[[Size, Style, Rng], Surfels]
    least: Size
    most: Size
    solids: Callable[[Size], Solids] = whole
    round: bool = False
    pad: float = 0.025


IN_THE_WAY = {
    "wall": Kind(wall, (0.8, 0.08, 0.5), (1.5, 0.1, 0.7)),
    "clipped": Kind(clipped, (0.6, 0.26, 0.55), (1.3, 0.36, 0.75), pad=0.085),
    "planter": Kind(planter, (0.5, 0.32, 0.56), (0.9, 0.42, 0.68), pad=0.04),
    "potted": Kind(potted, (0.3, 0.3, 0.66), (0.4, 0.4, 0.8), round=True, pad=0.05),
    "bush": Kind(bush, (0.5, 0.5, 0.55), (0.75, 0.75, 0.85), round=True, pad=0.05),
    "table": Kind(table, (0.45, 0.3, 0.43), (0.8, 0.4, 0.43), table_solids),
    "bench": Kind(bench, (0.7, 0.36, 0.75), (1.1, 0.42, 0.85), bench_solids, pad=0.045),
    "pile": Kind(pile, (0.44, 0.28, 0.5), (0.8, 0.32, 0.62), pad=0.02),
    "crates": Kind(crates, (0.34, 0.3, 0.5), (0.46, 0.4, 0.6)),
    "boulder": Kind(boulder, (0.4, 0.4, 0.5), (0.6, 0.6, 0.6), round=True),
    "barrel": Kind(barrel, (0.36, 0.36, 0.6), (0.46, 0.46, 0.75), round=True),
    "screen": Kind(screen, (0.8, 0.06, 0.9), (1.4, 0.08, 1.3), pad=0.045),
    "kennel": Kind(kennel, (0.46, 0.5, 0.6), (0.56, 0.6, 0.7)),
    "column": Kind(column, (0.32, 0.32, 0.48), (0.4, 0.4, 0.53), round=True, pad=0.015),
}
"""Kinds that stand where robots walk; each reaches the height of the robots' bodies."""
AT_THE_EDGE = {
    **{name: IN_THE_WAY[name] for name in ("planter", "potted", "bench", "pile", "boulder", "barrel", "crates")},
    "bush": Kind(bush, (0.7, 0.7, 0.7), (1.2, 1.2, 1.3), round=True, pad=0.05),
    "shed": Kind(shed, (1.3, 1.1, 1.7), (1.9, 1.5, 2.0)),
    "sandbox": Kind(sandbox, (1.0, 1.0, 0.2), (1.4, 1.2, 0.26), sandbox_solids),
    "big table": Kind(table, (1.1, 0.7, 0.7), (1.5, 0.85, 0.75), table_solids),
}


def stump(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build an upright log to put an egg on."""
    upright = log((0.0, 0.0, 0.0), 0.11, height, rng)
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # x becomes z
    return replace(
        upright,
        means=upright.means @ turn.T + np.array([x, y, 0.0]),
        axes=turn @ upright.axes,
        normals=upright.normals @ turn.T,
    )


def stone(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build a stone to put an egg on."""
    return plinth(x, y, height, style.stone, rng)


def upturned(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build an upside-down pot to put an egg on."""
    outline = [(0.125, 0.0), (0.125, 0.05), (0.112, 0.05), (0.085, height), (0.003, height)]
    clay = lathe((x, y, 0.0), outline, 0.018)
    return painted(
        clay, shades(style.paint[0], 0.06 * waves(clay.means, rng, 0.15) + 0.04 * rng.normal(size=len(clay)))
    )


def pillar(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build a pillar of four courses of bricks to put an egg on."""
    solid = Solid("pillar", (x - 0.1, y - 0.1, 0.0), (x + 0.1, y + 0.1, height))
    sides = [
        brickwork(face, rng, (0.1, height / 4), (3, 2), style.brick)
        for face in faces(solid.low, solid.high, "+x-x+y-y")
    ]
    return join([*sides, plaster(faces(solid.low, solid.high, "+z")[0], rng, style.stone, 0.02)])


UNDER_THE_EGG = (stump, stone, upturned, pillar)
