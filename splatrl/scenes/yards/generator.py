"""Assembles a generated yard: a style, a solvable layout, things, light and sky."""

from dataclasses import dataclass, replace

import numpy as np

from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.yard.furniture import eggshell
from splatrl.scenes.yard.generator import to_gaussians
from splatrl.scenes.yard.ground import bed, country
from splatrl.scenes.yard.layout import Tree
from splatrl.scenes.yard.light import Occluders, lit, occluders
from splatrl.scenes.yard.materials import Color, Rng
from splatrl.scenes.yard.plants import BARK, tree
from splatrl.scenes.yard.sky import sky
from splatrl.scenes.yard.surfels import Surfels, join
from splatrl.scenes.yards.ground import ground
from splatrl.scenes.yards.layout import drawn_layout
from splatrl.scenes.yards.pedestals import UNDER_THE_EGG
from splatrl.scenes.yards.pieces import Layout
from splatrl.scenes.yards.sides import SIDES, neighbour
from splatrl.scenes.yards.solvable import Difficulty, difficulty, place_near, solvable
from splatrl.scenes.yards.style import LEAVES, Style, drawn_style
from splatrl.scenes.yards.turning import turned

ATTEMPTS = 4000
"""Maximum number of layouts drawn for a seed; about one in six is solvable."""
SLACK = 0.035
"""Amount by which round things may turn out smaller than their boxes, metres."""
BARKS: tuple[Color, ...] = (BARK, (0.80, 0.79, 0.75), (0.33, 0.27, 0.22))


@dataclass(frozen=True, eq=False)
class Made:
    """A generated yard.

    Attributes:
        gaussians: its Gaussians, in the world frame.
        layout: its layout.
        hanging: x and y of a free place to hang an object, metres.
        found: its measured difficulty.
    """

    gaussians: Gaussians
    layout: Layout
    hanging: tuple[float, float]
    found: Difficulty


def made_yard(seed: int) -> Made:
    """Generate the yard of a seed; the same seed gives the same bytes.

    Layouts are drawn until one is as hard as the backyard and solvable from everywhere. This must hold for the boxes of
    its things, also with round things slightly smaller; then for these boxes together with every surfel; and then for
    surfels alone, counting only cells that hold several.

    Raises:
        RuntimeError: if none of ``ATTEMPTS`` layouts is solvable.
    """
    style = drawn_style(np.random.default_rng([seed, 10]))
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 11, attempt])
        layout = drawn_layout(rng)
        if layout is None:
            continue
        cells = layout.cells()
        if not all(solvable(difficulty(each, layout.goal)) for each in (cells, layout.cells(SLACK))):
            continue
        things = built(layout, style, rng)
        shells = replace(cells, solid=np.zeros_like(cells.solid))
        cells.fill_surfels(things, 1)
        shells.fill_surfels(things, 4)
        found = difficulty(cells, layout.goal)
        if solvable(found) and solvable(difficulty(shells, layout.goal)):
            whole = join([lit(things, blockers(layout), style.light), sky(rng, style.sky)])
            return Made(to_gaussians(whole), layout, place_near(cells, layout.goal, rng), found)
    raise RuntimeError(f"yard {seed}: none of {ATTEMPTS} layouts can be solved")


def blockers(layout: Layout) -> Occluders:
    """Return everything in a layout that casts shadows."""
    solids = [solid for piece in layout.core + layout.edge for solid in piece.solids]
    solids += [layout.egg.solid, *layout.trunks, *(side.solid for side in layout.sides)]
    return occluders([*solids, *(house.solid for house in layout.houses)], layout.trees)


def built(layout: Layout, style: Style, rng: Rng) -> Surfels:
    """Build all surfels of a yard except the sky, before lighting."""
    parts = [ground(layout.laid, style, rng), country(layout.outline, rng, style.lawn, style.far)]
    for side in layout.sides:
        parts.append(turned(SIDES[side.name].build(side.box, style, rng), side.x, side.y, side.quarters))
    for piece in layout.core + layout.edge:
        parts.append(turned(piece.kind.build(piece.size, style, rng), piece.x, piece.y, piece.quarters))
    for rect in layout.beds:
        x0, y0, x1, y1 = rect
        count = max(2, round(max(x1 - x0, y1 - y0) / 0.27))
        parts.append(bed((x0, x1), (y0, y1), style.blossoms, count, rng))
    for house in layout.houses:
        walls = neighbour(house.size, style, rng, style.plaster[int(rng.integers(2))])
        parts.append(turned(walls, house.x, house.y, house.quarters))
    egg = layout.egg
    parts.append(UNDER_THE_EGG[egg.under](egg.x, egg.y, egg.foot, style, rng))
    parts.append(eggshell(egg.center, egg.radii, style.light.sun, rng))
    return join([*parts, *orchard(layout.trees, layout.inside, style, rng)])


def orchard(trees: tuple[Tree, ...], inside: int, style: Style, rng: Rng) -> list[Surfels]:
    """Build the trees in the yard and those beyond it."""
    parts = []
    for index, spec in enumerate(trees):
        far = index >= inside
        palette = LEAVES[int(rng.integers(4))] if far else style.leaves[index % 3]
        parts.append(tree(spec, 420 if far else 1700, palette, rng, BARKS[int(rng.integers(len(BARKS)))]))
    return parts
