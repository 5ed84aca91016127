"""Things that stand in the yard: garden wall, table, pots, wood pile, barrel, bench and the egg."""

import numpy as np

from splatrl.scenes.yard.clutter import BELONGS_TO, Shift, clutter_moves, moved
from splatrl.scenes.yard.layout import (
    BENCH,
    EGG,
    EGG_BOX,
    EGG_RADII,
    EGG_STONE,
    GARDEN_WALL,
    RAIN_BARREL,
    SHRUB_POT,
    TABLE_POTS,
    TABLE_TOP,
    WOOD_PILE,
    Solid,
    table_legs,
)
from splatrl.scenes.yard.materials import Color, Rng, boards, brickwork, plaster, shades, waves
from splatrl.scenes.yard.plants import blossoms, shrub
from splatrl.scenes.yard.surfels import Array, Rectangle, Surfels, faces, join, lathe, painted

SAND = ((0.72, 0.58, 0.43), (0.83, 0.72, 0.55))
PINE = (0.70, 0.53, 0.33)


def garden_wall(rng: Rng, solid: Solid = GARDEN_WALL, palette: tuple[Color, Color] = SAND) -> Surfels:
    """Build a free-standing wall along y, one brick thick, capped with stone slabs."""
    low, high = solid.low, solid.high
    under = (high[0], high[1], high[2] - 0.045)
    long, short = faces(low, under, "+x-x"), faces(low, under, "+y-y")
    sides = [brickwork(face, rng, (0.145, 0.0575), (4, 2), palette) for face in long]
    ends = [boards(face, rng, palette[1], 0.0575, (0.019, 0.0175), upright=False) for face in short]
    cap_low = (low[0] - 0.005, low[1] - 0.005, under[2])
    cap_high = (high[0] + 0.005, high[1] + 0.005, high[2])
    cap = [plaster(face, rng, (0.70, 0.69, 0.66), 0.0155) for face in faces(cap_low, cap_high)]
    return join(sides + ends + cap)


def table(rng: Rng) -> Surfels:
    """Build a low garden table of painted wood."""
    paint = (0.86, 0.86, 0.82)
    top, *rims = faces(TABLE_TOP.low, TABLE_TOP.high, "+z+x-x+y-y-z")
    parts = [boards(top, rng, paint, 0.07, (0.018, 0.028), upright=False, contrast=0.35)]
    parts += [plaster(rim, rng, paint, 0.02, stain=0.04) for rim in rims]
    for leg in table_legs():
        parts += [plaster(face, rng, paint, 0.02, stain=0.05) for face in faces(leg.low, leg.high, "+x-x+y-y")]
    return join(parts)


def table_pots(rng: Rng) -> Surfels:
    """Build two flower pots on the table."""
    parts = []
    x, y, z = TABLE_TOP.low[0], TABLE_TOP.low[1], TABLE_TOP.high[2]
    parts.append(pot((x + 0.13, y + 0.13, z), 0.065, 0.11, (0.25, 0.42, 0.62), rng, 0.014))
    parts.append(
        shrub((x + 0.13, y + 0.13, z + 0.18), (0.1, 0.1, 0.09), 130, 0.028, ((0.2, 0.4, 0.16), (0.42, 0.6, 0.26)), rng)
    )
    parts.append(blossoms((x + 0.13, y + 0.13, z + 0.19), (0.1, 0.1, 0.09), 34, 0.011, (0.96, 0.82, 0.25), rng))
    parts.append(pot((x + 0.35, y + 0.14, z), 0.05, 0.085, (0.72, 0.45, 0.30), rng, 0.014))
    parts.append(
        shrub((x + 0.35, y + 0.14, z + 0.13), (0.07, 0.07, 0.06), 90, 0.022, ((0.25, 0.4, 0.3), (0.5, 0.6, 0.45)), rng)
    )
    return join(parts)


def pot(foot: tuple[float, float, float], radius: float, height: float, color: Color, rng: Rng, step: float) -> Surfels:
    """Build a flower pot with a rim, filled with soil."""
    rim, base = 0.16 * height, 0.74 * radius
    outline = [
        (base, 0.0),
        (0.93 * radius, height - rim),
        (radius, height - rim),
        (radius, height),
        (0.88 * radius, height),
    ]
    clay = lathe(foot, outline, step)
    tone = 0.07 * waves(clay.means, rng, 0.7 * height) + 0.04 * rng.normal(size=len(clay))
    soil = lathe(foot, [(0.88 * radius, height - 0.3 * rim), (0.002, height - 0.3 * rim)], step)
    dirt = shades((0.24, 0.18, 0.13), 0.2 * rng.normal(size=len(soil)))
    return join([painted(clay, shades(color, tone)), painted(soil, dirt)])


def shrub_pot(rng: Rng) -> Surfels:
    """Build a large blue pot with a lavender bush that hides what is behind it."""
    (x0, y0, _), (x1, y1, height) = SHRUB_POT.low, SHRUB_POT.high
    x, y, radius = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2
    green = ((0.30, 0.42, 0.28), (0.52, 0.62, 0.42))
    return join(
        [
            pot((x, y, 0.0), radius - 0.005, height, (0.22, 0.40, 0.66), rng, 0.021),
            shrub((x, y, height + 0.14), (0.16, 0.16, 0.19), 700, 0.024, green, rng),
            blossoms((x, y, height + 0.17), (0.16, 0.16, 0.19), 150, 0.012, (0.56, 0.42, 0.80), rng),
        ]
    )


def wood_pile(rng: Rng, solid: Solid = WOOD_PILE) -> Surfels:
    """Build a stack of split logs whose pale ends face into the yard."""
    (x0, y0, _), (x1, y1, z1) = solid.low, solid.high
    inside = ((x0 + 0.01, y0 + 0.035, 0.0), (x1 - 0.03, y1 - 0.035, z1 - 0.05))
    dark = (0.20, 0.14, 0.10)
    parts = [boards(face, rng, dark, 0.08, (0.03, 0.05)) for face in faces(*inside, "+x-x")]
    for face in faces(*inside, "+y-y+z"):
        parts.append(boards(face, rng, (0.40, 0.30, 0.21), 0.075, (0.025, 0.05), upright=False, contrast=1.6))
    columns = max(1, round((y1 - y0) / 0.088))
    radius = (y1 - y0) / (2 * columns)
    rows = round((z1 - 2 * radius) / (1.74 * radius)) + 1
    for row in range(rows):
        shift = radius * (row % 2)
        for column in range(columns - row % 2):
            size = radius * rng.uniform(0.85, 0.99)
            y = y0 + radius + shift + 2 * radius * column + 0.003 * rng.normal()
            z = radius + 1.74 * radius * row
            parts.append(log((x1 - 0.05 - 0.012 * rng.random(), y, z), size, 0.05, rng))
    return join(parts)


def log(foot: tuple[float, float, float], radius: float, length: float, rng: Rng) -> Surfels:
    """Build the end of a log that points along +x: bark around pale, ringed wood."""
    bark = lathe(foot, [(radius, 0.0), (radius, length)], 0.024, lying=True)
    end = lathe(foot, [(radius, length), (0.001, length)], 0.014, lying=True)
    out = np.linalg.norm(end.means[:, 1:] - np.asarray(foot)[1:], axis=1) / radius
    tone = 0.1 * rng.normal() + 0.05 * rng.normal(size=len(end)) + 0.08 * np.cos(out * 17.0) - 0.5 * (out > 0.9)
    rough = 0.25 * rng.normal(size=len(bark))
    return join([painted(bark, shades((0.30, 0.22, 0.16), rough)), painted(end, shades((0.95, 0.79, 0.56), tone))])


def egg(rng: Rng) -> Surfels:
    """Build the goal: a red egg with a soft highlight, on a grey stone."""
    shell = eggshell(EGG, EGG_RADII, np.array([-0.75, -0.25, 0.6]), rng)
    (x0, y0, _), (x1, y1, height) = EGG_STONE.low, EGG_STONE.high
    return join([shell, plinth((x0 + x1) / 2, (y0 + y1) / 2, height, (0.62, 0.61, 0.58), rng)])


def eggshell(
    center: tuple[float, float, float], radii: tuple[float, float, float], to_light: Array, rng: Rng
) -> Surfels:
    """Build a red egg, narrower at the top, with a soft highlight on the side of the light.

    Args:
        center: its centre, metres.
        radii: its half extents along x, y and z, metres.
        to_light: [3] direction to the light, of any length but zero.
        rng: generator of the colours' grain.
    """
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
    pointed = 1 - 0.13 * np.sin(angles)  # narrower at the top
    outline = [
        (max(0.002, radii[0] * float(np.cos(a) * p)), radii[2] * float(np.sin(a)))
        for a, p in zip(angles, pointed, strict=True)
    ]
    shell = lathe(center, outline, 0.0145)
    shine = np.clip(shell.normals @ (to_light / np.linalg.norm(to_light)), 0.0, 1.0) ** 14
    red = np.array([0.86, 0.05, 0.06]) * (1 + 0.03 * rng.normal(size=(len(shell), 1)))
    return painted(shell, red + 0.35 * shine[:, None])


def plinth(x: float, y: float, height: float, color: Color, rng: Rng) -> Surfels:
    """Build the stone under an egg."""
    stone = lathe(
        (x, y, 0.0),
        [(0.105, 0.0), (0.11, 0.5 * height), (0.09, height - 0.012), (0.07, height), (0.003, height)],
        0.021,
    )
    tone = 0.09 * waves(stone.means, rng, 0.08) + 0.05 * rng.normal(size=len(stone))
    return painted(stone, shades(color, tone))


def rain_barrel(rng: Rng, solid: Solid = RAIN_BARREL, color: Color = (0.16, 0.40, 0.36)) -> Surfels:
    """Build a barrel with dark hoops."""
    (x0, y0, _), (x1, y1, height) = solid.low, solid.high
    radius = (x1 - x0) / 2
    outline = [(0.86 * radius, 0.0), (radius, 0.5 * height), (0.86 * radius, height), (0.01, height)]
    barrel = lathe(((x0 + x1) / 2, (y0 + y1) / 2, 0.0), outline, 0.055)
    hoop = np.abs(np.abs(barrel.means[:, 2] / height - 0.5) - 0.3) < 0.05
    tone = 0.06 * rng.normal(size=len(barrel)) - 0.4 * hoop
    return painted(barrel, shades(color, tone))


def bench(rng: Rng) -> Surfels:
    """Build a pine bench along the brick wall."""
    parts = []
    for solid in BENCH:
        parts += [boards(face, rng, PINE, 0.1, (0.05, 0.06), upright=False) for face in faces(solid.low, solid.high)]
    return join(parts)


def furniture(rng: Rng, clutter: int = 0) -> Surfels:
    """Build everything that stands in the yard, in the places that ``clutter`` gives."""
    moves = clutter_moves(clutter)
    things = [
        (garden_wall, GARDEN_WALL),
        (table, TABLE_TOP),
        (table_pots, TABLE_POTS),
        (shrub_pot, SHRUB_POT),
        (wood_pile, WOOD_PILE),
        (egg, EGG_BOX),
        (rain_barrel, RAIN_BARREL),
        (bench, BENCH[0]),
    ]
    parts = []
    for build, solid in things:
        (x0, y0, _), (x1, y1, _) = solid.low, solid.high
        move = moves.get(BELONGS_TO.get(solid.name, ""), Shift())
        parts.append(moved(build(rng), ((x0 + x1) / 2, (y0 + y1) / 2), move))
    return join(parts)


def roof(eaves: Rectangle, rng: Rng, color: Color, step: tuple[float, float]) -> Surfels:
    """Build a roof: rows of tiles up a slope, every other row darker."""
    st, size = eaves.cells(step[0], step[1])
    row = (st[:, 1] / size[1]).astype(int)
    tone = 0.12 * rng.normal(size=len(st)) - 0.14 * (row % 2)
    return eaves.surfels(st, size, shades(color, tone))
