"""The layout of the backyard: where everything stands.

World frame, metres, ground at z = 0. The yard is 6 m wide, with a hedge in the east (+x), a wooden fence in the north
(+y), a brick wall in the west and a shed in the south. Robots stay within a metre of the centre along x and y, and
everything that they can touch there stands in the same place for every seed; only the trees move with the seed.
``clutter.py`` lists what ``clutter`` moves.
"""

from dataclasses import dataclass

import numpy as np

from splatrl.scenes.yard.clutter import BELONGS_TO, Shift, clutter_moves

EGG = (1.25, 0.4, 0.41)
"""Centre of the red egg on its stone, metres."""
EGG_RADII = (0.12, 0.12, 0.16)
"""Half extents of the egg, metres."""
HALF_WIDTH = 3.0
"""Distance from the centre to the enclosure of the yard, metres."""


@dataclass(frozen=True)
class Solid:
    """A solid thing, represented by its axis-aligned bounding box.

    Attributes:
        name: name of the thing.
        low: lower corner of the box, metres, world frame.
        high: upper corner of the box, metres, world frame.
    """

    name: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class Tree:
    """A tree.

    Attributes:
        x: x of the trunk, metres.
        y: y of the trunk, metres.
        trunk_radius: radius of the trunk, metres.
        crown_height: height of the crown's centre, metres.
        crown_radius: radius of the crown, metres.
    """

    x: float
    y: float
    trunk_radius: float
    crown_height: float
    crown_radius: float


GARDEN_WALL = Solid("garden wall", (-0.13, -0.01, 0.0), (-0.07, 1.42, 0.62))
TABLE_TOP = Solid("table", (0.08, -1.13, 0.38), (0.52, -0.87, 0.43))
WOOD_PILE = Solid("wood pile", (-1.45, 0.08, 0.0), (-1.14, 0.52, 0.57))
SHRUB_POT = Solid("shrub pot", (0.91, 0.91, 0.0), (1.19, 1.19, 0.4))
SHRUB = Solid("shrub", (0.88, 0.88, 0.4), (1.22, 1.22, 0.76))
TABLE_POTS = Solid("pots on the table", (0.09, -1.12, 0.43), (0.51, -0.88, 0.72))
EGG_STONE = Solid("egg stone", (1.14, 0.29, 0.0), (1.36, 0.51, 0.26))
EGG_BOX = Solid(
    "egg",
    (EGG[0] - EGG_RADII[0], EGG[1] - EGG_RADII[1], EGG[2] - EGG_RADII[2]),
    (EGG[0] + EGG_RADII[0], EGG[1] + EGG_RADII[1], EGG[2] + EGG_RADII[2]),
)
BRICK_WALL = Solid("brick wall", (-3.2, -3.2, 0.0), (-3.0, 3.2, 1.9))
FENCE = Solid("fence", (-3.0, 3.0, 0.0), (3.0, 3.05, 1.7))
HEDGE = Solid("hedge", (2.9, -3.2, 0.0), (3.6, 3.2, 1.55))
SHED = Solid("shed", (-1.7, -4.6, 0.0), (0.9, -2.9, 1.95))
GARAGE = Solid("garage", (0.9, -3.4, 0.0), (3.2, -3.0, 2.4))
SOUTH_WALL = Solid("south wall", (-3.2, -3.2, 0.0), (-1.7, -3.0, 1.4))
HOUSE = Solid("house", (-9.5, -3.0, 0.0), (-5.0, 5.0, 3.6))
RAIN_BARREL = Solid("rain barrel", (1.2, -2.9, 0.0), (1.7, -2.4, 0.85))
BENCH = (
    Solid("bench seat", (-2.95, -1.9, 0.39), (-2.55, -0.5, 0.45)),
    Solid("bench foot", (-2.95, -1.8, 0.0), (-2.55, -1.7, 0.39)),
    Solid("bench foot", (-2.95, -0.7, 0.0), (-2.55, -0.6, 0.39)),
)


def trees(seed: int) -> tuple[Tree, ...]:
    """Return two trees in corners of the yard, then six beyond it; each seed moves them slightly."""
    shift = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, (8, 3))
    yard = [(2.25, 2.2, 0.11, 2.3, 0.95), (-2.3, -2.2, 0.09, 2.1, 0.8)]
    beyond = [
        (5.6, 3.6, 0.2, 3.2, 1.7),
        (6.0, -2.2, 0.2, 2.8, 1.5),
        (0.8, 6.4, 0.2, 3.4, 1.6),
        (-3.6, 6.8, 0.2, 3.0, 1.5),
        (-1.0, -8.0, 0.2, 3.6, 1.7),
        (4.6, -6.4, 0.2, 3.9, 1.7),
    ]
    reach = [0.15] * len(yard) + [0.5] * len(beyond)
    return tuple(
        Tree(x + far * dx, y + far * dy, trunk, height + 0.3 * far * dz, crown)
        for (x, y, trunk, height, crown), (dx, dy, dz), far in zip(yard + beyond, shift, reach, strict=True)
    )


def table_legs() -> list[Solid]:
    """Return the four legs of the table."""
    (x0, y0, _), (x1, y1, z1) = TABLE_TOP.low, TABLE_TOP.high
    return [
        Solid("table leg", (x, y, 0.0), (x + 0.04, y + 0.04, z1 - 0.05))
        for x in (x0 + 0.02, x1 - 0.06)
        for y in (y0 + 0.02, y1 - 0.06)
    ]


def solids(seed: int, clutter: int = 0) -> list[Solid]:
    """Return everything solid in and around the yard, including the trunks of its trees but not the house."""
    moves = clutter_moves(clutter)
    trunks = [
        Solid(
            "trunk",
            (t.x - t.trunk_radius, t.y - t.trunk_radius, 0.0),
            (t.x + t.trunk_radius, t.y + t.trunk_radius, 1.4),
        )
        for t in trees(seed)[:2]
    ]
    near = [GARDEN_WALL, TABLE_TOP, *table_legs(), WOOD_PILE, SHRUB_POT, SHRUB, TABLE_POTS, EGG_STONE, EGG_BOX]
    around = [BRICK_WALL, FENCE, HEDGE, SHED, GARAGE, SOUTH_WALL, RAIN_BARREL, *BENCH]
    return [moved_solid(solid, moves) for solid in near + around] + trunks


def moved_solid(solid: Solid, moves: dict[str, Shift]) -> Solid:
    """Return the box of a solid after the displacement of the thing that it belongs to."""
    move = moves.get(BELONGS_TO.get(solid.name, ""), Shift())
    (x0, y0, z0), (x1, y1, z1) = solid.low, solid.high
    return Solid(solid.name, (x0 + move.x, y0 + move.y, z0), (x1 + move.x, y1 + move.y, z1))


def backyard_obstacles(
    seed: int = 0, clutter: int = 0
) -> list[tuple[str, tuple[float, float, float], tuple[float, float, float]]]:
    """Return the ground truth for collision: what is solid in ``backyard_gaussians(seed, clutter)``.

    Args:
        seed: seed that the scene was made with.
        clutter: clutter that the scene was made with.

    Returns:
        Name, and lower and upper corner of the bounding box, of each thing, metres, world frame. A thing fills its
        box; a round one fills the ellipse or ellipsoid in it. The ground and the grass are not in the list.
    """
    return [(solid.name, solid.low, solid.high) for solid in solids(seed, clutter)]
