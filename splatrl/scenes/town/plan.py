"""The layout of a block of a generated town, drawn from the town's seed and the block's position.

A block is 20 m wide. The centre lines of streets run along its borders; inside them lies a plot with two houses and a
yard, which is laid out by the code for generated yards. World frame, metres, ground at z = 0; the four central blocks
meet at the origin, where two streets cross.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from splatrl.scenes.yard.ground import Rect
from splatrl.scenes.yard.layout import Solid, Tree
from splatrl.scenes.yard.light import Light
from splatrl.scenes.yard.materials import Rng
from splatrl.scenes.yard.sky import SkyLook
from splatrl.scenes.yards.ground import Laid
from splatrl.scenes.yards.layout import FRINGE, drawn_beds, drawn_core, drawn_edge, drawn_laid, drawn_trees
from splatrl.scenes.yards.pieces import House, Piece, Side
from splatrl.scenes.yards.sides import SIDES
from splatrl.scenes.yards.style import MOODS, Style, drawn_style

SIZE = 20.0
"""Side of a block, metres."""
ROADWAY, STREET = 2.1, 3.0
"""Half the width of a roadway, and of a whole street with its pavements, metres."""
GATE = 1.4
"""Width of the gate of a yard, metres."""
GARDEN = (-2.6, 2.6)
"""Centre of the yard relative to the centre of the block, x and y, metres."""
SHIFTED = 500
"""Added to the column and row of a block in seeds, which must not be negative."""


@dataclass(frozen=True, eq=False)
class Yard:
    """The contents of a block's yard, in the yard's own frame.

    Attributes:
        sides: the enclosure, with a gate in the south.
        pieces: things in the yard.
        beds: strips of flowers.
        laid: layout of the ground's surfaces.
    """

    sides: tuple[Side, ...]
    pieces: tuple[Piece, ...]
    beds: tuple[Rect, ...]
    laid: Laid


@dataclass(frozen=True, eq=False)
class Plot:
    """The contents of a block.

    Attributes:
        corner: x and y of the block's lower left corner, world frame, metres.
        style: its materials, colours and light.
        yard: its yard.
        houses: its two houses, world frame.
        trees: trees in the yard and along the streets, world frame.
    """

    corner: tuple[float, float]
    style: Style
    yard: Yard
    houses: tuple[House, ...]
    trees: tuple[Tree, ...]

    @property
    def garden(self) -> tuple[float, float]:
        """Centre of the yard, world frame, metres."""
        return self.corner[0] + SIZE / 2 + GARDEN[0], self.corner[1] + SIZE / 2 + GARDEN[1]


def light_and_sky(seed: int) -> tuple[Light, SkyLook]:
    """Return a town's light and sky: noon under scattered clouds, with the direction of the sun drawn from the seed."""
    style = drawn_style(np.random.default_rng([seed, 20]))
    mood = MOODS[1]
    azimuth, elevation = np.arctan2(style.light.sun[1], style.light.sun[0]), np.radians(52.0)
    level = np.cos(elevation)
    sun = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    bounced = 0.3 * np.array([0.36, 0.38, 0.32]) * (np.array(mood.sun) + np.array(mood.open_sky))
    return Light(sun, np.array(mood.sun), np.array(mood.open_sky), bounced), mood.look


@cache
def drawn_plot(seed: int, column: int, row: int) -> Plot:
    """Draw the contents of a block.

    Args:
        seed: seed of the town, at least 0.
        column: column of the block, whose lower left corner is at x = 20 · column.
        row: row of the block, likewise along y.
    """
    rng = np.random.default_rng([seed, 21, column + SHIFTED, row + SHIFTED])
    light, sky = light_and_sky(seed)
    style = replace(drawn_style(rng), light=light, sky=sky)
    corner = (SIZE * column, SIZE * row)
    outline, trees = _outline(rng), list[Tree]()
    sides = _sides(outline, rng)
    taken: list[Rect] = [(-FRINGE - 0.1, -FRINGE - 0.1, FRINGE + 0.1, FRINGE + 0.1)]
    taken.append((-GATE, outline[1], GATE, outline[1] + 1.0))  # nothing stands in the gate
    pieces = [*drawn_core(rng)[2], *drawn_edge(outline, taken, rng)]
    beds = drawn_beds(outline, taken, sides, rng)
    yard = Yard(sides, tuple(pieces), tuple(beds), drawn_laid(outline, sides, rng))
    middle = corner[0] + SIZE / 2, corner[1] + SIZE / 2
    for tree in drawn_trees(outline, taken, rng)[0]:
        trees.append(replace(tree, x=tree.x + middle[0] + GARDEN[0], y=tree.y + middle[1] + GARDEN[1]))
    for x, y in ((-3.5, -7.45), (3.2, 7.45), (-7.45, 4.0), (7.45, -4.4)):  # trees on the pavements
        if rng.random() < 0.6:
            tall, crown = rng.uniform(2.6, 3.4), rng.uniform(0.9, 1.3)
            trees.append(Tree(middle[0] + x, middle[1] + y, float(rng.uniform(0.07, 0.11)), float(tall), float(crown)))
    return Plot(corner, style, yard, _houses(middle, rng), tuple(trees))


def neighbours(seed: int, column: int, row: int) -> list[Plot]:
    """Draw a block and the eight around it, in the town or not: their houses and trees cast shadows into the block."""
    return [drawn_plot(seed, column + x, row + y) for x in (-1, 0, 1) for y in (-1, 0, 1)]


def house_solids(plot: Plot) -> list[Solid]:
    """Return the bounding boxes of a block's houses, including about half of their roofs."""
    solids = [house.solid for house in plot.houses]
    return [replace(solid, high=(*solid.high[:2], solid.high[2] + 1.0)) for solid in solids]


def _outline(rng: Rng) -> Rect:
    left, bottom, right, top = rng.uniform(0.0, 0.8, 4).round(1)
    return float(left) - 4.0, float(bottom) - 3.8, 4.0 - float(right), 3.8 - float(top)


def _sides(outline: Rect, rng: Rng) -> tuple[Side, ...]:
    """Draw the enclosure of a yard: north, west, south on both sides of the gate, and east."""
    x0, y0, x1, y1 = outline
    names = [name for name in SIDES if name != "facade"]
    north, west, south, east = (names[i] for i in rng.choice(len(names), 4, replace=False))
    placed = (
        (north, x1 - x0, x0, y1, 0),
        (west, y1 - y0, x0, y0, 1),
        (south, x1 - GATE / 2, x1, y0, 2),
        (south, -GATE / 2 - x0, -GATE / 2, y0, 2),
        (east, y1 - y0, x1, y1, 3),
    )
    heights = {name: float(rng.uniform(*SIDES[name].heights)) for name in (north, west, south, east)}
    return tuple(Side(name, length, heights[name], x, y, quarters) for name, length, x, y, quarters in placed)


def _houses(middle: tuple[float, float], rng: Rng) -> tuple[House, ...]:
    """Draw two houses: one that faces the street in the south, and one that faces the street in the east."""
    heights = [float(height) for height in rng.choice([2.9, 3.2, 5.4, 5.6], 2)]
    south = (float(rng.uniform(6.4, 7.8)), float(rng.uniform(4.2, 4.7)), heights[0])
    east = (float(rng.uniform(6.8, 8.8)), float(rng.uniform(3.9, 4.3)), heights[1])
    x, y = middle
    return (
        House(south, x - 6.4 + south[0] / 2, y - 6.6 + south[1] / 2, 0),
        House(east, x + 6.6 - east[1] / 2, y + float(rng.uniform(-1.4, 1.4)), 1),
    )
