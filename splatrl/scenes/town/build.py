"""Builds the blocks of a generated town: streets, houses, yards and light."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.town.plan import ROADWAY, SIZE, STREET, Plot, drawn_plot, house_solids, neighbours
from splatrl.scenes.yard.enclosure import cut, framed, panel
from splatrl.scenes.yard.furniture import eggshell
from splatrl.scenes.yard.generator import to_gaussians
from splatrl.scenes.yard.ground import bed, country
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.light import lit, occluders
from splatrl.scenes.yard.materials import Rng, boards, plaster, shades, waves
from splatrl.scenes.yard.plants import grass, lawn_colors, tree
from splatrl.scenes.yard.sky import RADIUS, sky
from splatrl.scenes.yard.surfels import Array, Rectangle, Surfels, faces, join
from splatrl.scenes.yards.buildings import gable
from splatrl.scenes.yards.ground import ground
from splatrl.scenes.yards.kinds import IN_THE_WAY
from splatrl.scenes.yards.pedestals import UNDER_THE_EGG
from splatrl.scenes.yards.pieces import EGG_HEIGHT, Egg, Piece
from splatrl.scenes.yards.sides import SIDES
from splatrl.scenes.yards.solids import Size, box
from splatrl.scenes.yards.style import Style
from splatrl.scenes.yards.turning import turned, turned_solid

STEP = 0.08
"""Spacing of the surfels of streets, metres; a block is a whole number of them wide."""
LAWN = 0.1
"""Spacing of the surfels of the ground around houses, metres."""
BLADES = 160
"""Blades of grass per square metre of the ground around houses."""
AT_ONCE = 16384
"""Surfels shaded per batch; bounds memory."""
EGG = Egg(1.2, 0.6, (0.12, 0.12, 0.16), 1)
"""The red egg, near the central crossing."""
CROSSING = (
    Piece(IN_THE_WAY["planter"], (0.95, 0.4, 0.55), 0.0, -0.75, 0),
    Piece(IN_THE_WAY["crates"], (0.4, 0.36, 0.56), -0.7, 0.0, 1),
    Piece(IN_THE_WAY["barrel"], (0.4, 0.4, 0.68), 0.55, 1.3, 0),
)
"""Things that stand at the central crossing, two of them across borders between blocks."""


def block_gaussians(seed: int, column: int, row: int) -> Gaussians:
    """Generate the Gaussians of a block: about 100,000, spherical harmonics of degree 0, world frame, metres."""
    plot = drawn_plot(seed, column, row)
    rng = np.random.default_rng([seed, 22, column + 500, row + 500])
    parts = [streets(plot, seed), lawn(plot, rng), *garden(plot, rng), *crossing(plot, seed)]
    for place in plot.houses:
        walls = plot.style.plaster[int(rng.integers(2))]
        parts.append(turned(house(place.size, plot.style, rng, walls), place.x, place.y, place.quarters))
    for spec in plot.trees:
        parts.append(tree(spec, 1500, plot.style.leaves[int(rng.integers(3))], rng))
    around = neighbours(seed, column, row)
    solids = [solid for other in around for solid in house_solids(other)] + things(plot)
    solids += [EGG.solid, *(solid for piece in CROSSING for solid in piece.solids)]
    trees = tuple(spec for other in around for spec in other.trees)
    blockers = occluders([solid for solid in solids if _near(plot, solid)], trees)
    whole = join(parts)
    pieces = [_rows(whole, slice(first, first + AT_ONCE)) for first in range(0, len(whole), AT_ONCE)]
    return to_gaussians(join([lit(piece, blockers, plot.style.light) for piece in pieces]))


def around_gaussians(seed: int, columns: Sequence[int], rows: Sequence[int]) -> Gaussians:
    """Generate the sky over the blocks of these columns and rows, and the countryside around them."""
    rng, style = np.random.default_rng([seed, 23]), drawn_plot(seed, 0, 0).style
    outline = (SIZE * columns[0], SIZE * rows[0], SIZE * (columns[-1] + 1), SIZE * (rows[-1] + 1))
    scale = max(1.0, 2.2 * max(map(abs, outline)) / RADIUS)
    x0, y0, x1, y1 = (edge / scale for edge in outline)
    land = country((min(x0, -0.1), min(y0, -0.1), x1, y1), rng, style.lawn, style.far)
    land = lit(land, occluders(_nothing(), ()), style.light)
    return to_gaussians(_grown(join([land, sky(rng, style.sky)]), scale))


def streets(plot: Plot, seed: int) -> Surfels:
    """Build the streets around a block up to their centre lines: marked roadways with crossings, and slab pavements."""
    rng = np.random.default_rng([seed, 24, round(plot.corner[0]) + 10**5, round(plot.corner[1]) + 10**5])
    common = np.random.default_rng([seed, 25])  # shared, so that stains continue across the borders of blocks
    whole = Rectangle((*plot.corner, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), SIZE, SIZE)
    st, size = whole.cells(STEP)
    off = np.minimum(st, SIZE - st)  # distance to the nearest centre line of a street along y, and along x
    st, off = st[off.min(1) < STREET], off[off.min(1) < STREET]
    points, away, along = whole.points(st), off.min(1), off.max(1)
    roadway = away < ROADWAY
    tone = 0.10 * rng.normal(size=len(st)) + 0.05 * waves(points, common, 2.6) + 0.04 * waves(points, common, 0.7)
    colors = shades((0.36, 0.36, 0.37), tone)
    joint = ((points[:, :2] / 0.5) % 1.0 < 0.17).any(1)
    slab = np.floor(points[:, :2] / 0.5) @ (0.7, 1.3)
    colors[~roadway] = shades((0.66, 0.63, 0.58), 0.4 * tone + 0.06 * np.sin(7.0 * slab) - 0.16 * joint)[~roadway]
    kerb = ~roadway & (away < ROADWAY + 0.16)
    colors[kerb] = shades((0.76, 0.75, 0.72), 0.4 * tone)[kerb]
    dash = (away < 0.06) & (along > 5.6) & (np.floor(along / 0.8) % 2 == 0)
    zebra = roadway & (along > 3.4) & (along < 5.0) & (np.floor(away / 0.42) % 2 == 0)
    painted = dash | zebra
    colors[painted] = shades((0.90, 0.90, 0.87), tone)[painted]
    return whole.surfels(st, 1.15 * np.asarray(size), colors)


def lawn(plot: Plot, rng: Rng) -> Surfels:
    """Build the ground of a plot around its houses and yard, with grass."""
    inner, style = SIZE - 2 * STREET, plot.style
    corner = (plot.corner[0] + STREET, plot.corner[1] + STREET)
    whole = Rectangle((*corner, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), inner, inner)
    st, size = whole.cells(LAWN)
    points = whole.points(st)
    open_ = _open(plot, points)
    st, points = st[open_], points[open_]
    colors = lawn_colors(points, rng, style.lawn) * rng.uniform(0.7, 0.95, (len(points), 1))
    feet = np.append(
        rng.uniform(corner, np.add(corner, inner), (round(BLADES * inner**2), 2)),
        np.zeros((round(BLADES * inner**2), 1)),
        1,
    )
    blades = grass(feet[_open(plot, feet)], 0.08, rng, style.lawn)
    return join([whole.surfels(st, 1.2 * np.asarray(size), colors), blades])


def garden(plot: Plot, rng: Rng) -> list[Surfels]:
    """Build the yard of a plot: its ground, its enclosure, and the things in it."""
    yard, style, (x, y) = plot.yard, plot.style, plot.garden
    parts = [ground(yard.laid, style, rng)]
    parts += [turned(SIDES[s.name].build(s.box, style, rng), s.x, s.y, s.quarters) for s in yard.sides]
    parts += [turned(p.kind.build(p.size, style, rng), p.x, p.y, p.quarters) for p in yard.pieces]
    for x0, y0, x1, y1 in yard.beds:
        count = max(2, round(max(x1 - x0, y1 - y0) / 0.27))
        parts.append(bed((x0, x1), (y0, y1), style.blossoms, count, rng))
    return [turned(join(parts), x, y)]


def house(size: Size, style: Style, rng: Rng, walls: tuple[float, float, float]) -> Surfels:
    """Build a house with windows on all sides and a door in its front, which faces -y."""
    wide, deep, height = size
    parts = list[Surfels]()
    for face in faces(*_corners(size), "-y+x+y-x"):
        wall, front = plaster(face, rng, walls, 0.11, 0.03), not parts
        for level in np.arange(0.9, height - 1.2, 2.5):
            for number, along in enumerate(np.arange(0.8, face.width - 1.3, 1.9)):
                if front and number == 1 and level < 1.0:
                    door = panel(face, (float(along), 0.02), (0.95, 2.05))
                    wall = cut(wall, door)
                    parts.append(boards(door, rng, style.paint[0], 0.19, (0.06, 0.12), contrast=0.35))
                    continue
                window = ((float(along), float(level)), (1.0, 1.2))
                wall = cut(wall, panel(face, *window))
                parts += framed(face, *window, rng, 0.09)
        parts.append(wall)
    return join([*parts, *gable((wide, deep), height, 0.36 * wide, style.roof, walls, rng, (0.16, 0.16))])


def crossing(plot: Plot, seed: int) -> list[Surfels]:
    """Build a block's part of the things on the central crossing: the surfels whose centres lie in the block."""
    if max(map(abs, plot.corner)) > SIZE:
        return []
    rng, style = np.random.default_rng([seed, 26]), drawn_plot(seed, 0, 0).style
    parts = [turned(piece.kind.build(piece.size, style, rng), piece.x, piece.y, piece.quarters) for piece in CROSSING]
    parts.append(UNDER_THE_EGG[EGG.under](EGG.x, EGG.y, EGG_HEIGHT - EGG.radii[2] + 0.01, style, rng))
    whole = join([*parts, eggshell(EGG.center, EGG.radii, style.light.sun, rng)])
    return [_rows(whole, (np.floor(whole.means[:, :2] / SIZE) == np.divide(plot.corner, SIZE)).all(1))]


def things(plot: Plot) -> list[Solid]:
    """Return the solids in a block's yard and the trunks of its trees, world frame."""
    x, y = plot.garden
    yard = [side.solid for side in plot.yard.sides] + [each for piece in plot.yard.pieces for each in piece.solids]
    trunks = [
        Solid("trunk", (t.x - radius, t.y - radius, 0.0), (t.x + radius, t.y + radius, 1.4))
        for t in plot.trees
        for radius in [t.trunk_radius]
    ]
    return [turned_solid(solid, x, y) for solid in yard] + trunks


def _corners(size: Size) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    solid = box("house", size)
    return solid.low, solid.high


def _open(plot: Plot, points: Array) -> NDArray[np.bool_]:
    """Return a mask of the points of a plot that lie neither in its yard nor under its houses."""
    x0, y0, x1, y1 = plot.yard.laid.outline
    x, y = plot.garden
    rects = [(x0 + x, y0 + y, x1 + x, y1 + y)] + [
        (*place.solid.low[:2], *place.solid.high[:2]) for place in plot.houses
    ]
    inside = [(points[:, 0] > a) & (points[:, 0] < c) & (points[:, 1] > b) & (points[:, 1] < d) for a, b, c, d in rects]
    return ~np.any(inside, axis=0)


def _near(plot: Plot, solid: Solid, reach: float = 10.0) -> bool:
    """Return whether a solid is near enough to a block to cast a shadow into it."""
    return all(
        low < corner + SIZE + reach and high > corner - reach
        for low, high, corner in zip(solid.low, solid.high, plot.corner, strict=False)
    )


def _nothing() -> list[Solid]:
    """Return a solid below the ground, which shades nothing, for scenes without occluders."""
    return [Solid("nothing", (0.0, 0.0, -2.0), (0.1, 0.1, -1.9))]


def _rows(part: Surfels, rows: slice | NDArray[np.bool_]) -> Surfels:
    return Surfels(*(getattr(part, field.name)[rows] for field in fields(Surfels)))


def _grown(part: Surfels, scale: float) -> Surfels:
    return replace(part, means=scale * part.means, scales=scale * part.scales)
