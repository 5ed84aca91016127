"""Things that stand about in generated yards, each in its own frame: origin at the centre of its base, facing -y."""

from dataclasses import replace

import numpy as np

from splatrl.scenes.yard.furniture import pot, rain_barrel, wood_pile
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.materials import Rng, boards, plaster, shades, waves
from splatrl.scenes.yard.plants import blossoms, shrub
from splatrl.scenes.yard.surfels import Rectangle, Surfels, faces, join, lathe, painted
from splatrl.scenes.yards.solids import Size, Solids, box
from splatrl.scenes.yards.style import Style
from splatrl.scenes.yards.turning import turned


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
