"""What a generated yard consists of: its things, egg, enclosure and houses, each with its place.

World frame, metres, ground at z = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from splatrl.scenes.yard.ground import Rect
from splatrl.scenes.yard.layout import Solid, Tree
from splatrl.scenes.yards.ground import Laid
from splatrl.scenes.yards.kinds import Kind
from splatrl.scenes.yards.sides import SIDES
from splatrl.scenes.yards.solids import Size
from splatrl.scenes.yards.solvable import Cells
from splatrl.scenes.yards.turning import turned_solid

EGG_HEIGHT = 0.41
"""Height of the egg's centre, level with the robots' cameras, metres."""


@dataclass(frozen=True)
class Piece:
    """A thing and its place.

    Attributes:
        kind: kind of the thing.
        size: extent before it is turned, metres.
        x: x of its centre, metres.
        y: y of its centre, metres.
        quarters: number of counter-clockwise quarter turns from facing -y.
    """

    kind: Kind
    size: Size
    x: float
    y: float
    quarters: int

    @property
    def solids(self) -> list[Solid]:
        """Its solid parts, world frame."""
        return [turned_solid(solid, self.x, self.y, self.quarters) for solid in self.kind.solids(self.size)]

    @property
    def rect(self) -> Rect:
        """Rectangle of ground that it covers, including the padding of its kind."""
        wide, deep = (across + 2 * self.kind.pad for across in self.size[:2])
        if self.quarters % 2:
            wide, deep = deep, wide
        return self.x - wide / 2, self.y - deep / 2, self.x + wide / 2, self.y + deep / 2


@dataclass(frozen=True)
class Egg:
    """The egg and its support.

    Attributes:
        x: x of its centre, metres.
        y: y of its centre, metres.
        radii: half extents of the egg, metres.
        under: index of the support in ``UNDER_THE_EGG``.
    """

    x: float
    y: float
    radii: tuple[float, float, float]
    under: int

    @property
    def foot(self) -> float:
        """Height of the support, which ends slightly inside the egg, metres."""
        return EGG_HEIGHT - self.radii[2] + 0.01

    @property
    def center(self) -> tuple[float, float, float]:
        """Centre of the egg, metres."""
        return self.x, self.y, EGG_HEIGHT

    @property
    def solid(self) -> Solid:
        """Bounding box of the egg and its support."""
        reach = max(self.radii[0], 0.13)
        top = EGG_HEIGHT + self.radii[2]
        return Solid("egg", (self.x - reach, self.y - reach, 0.0), (self.x + reach, self.y + reach, top))


@dataclass(frozen=True)
class Side:
    """One of the four sides that enclose a yard.

    Attributes:
        name: name of its kind in ``SIDES``.
        length: length, metres.
        height: height, metres.
        x: x of its left end, seen from inside, metres.
        y: y of its left end, seen from inside, metres.
        quarters: number of counter-clockwise quarter turns from facing -y.
    """

    name: str
    length: float
    height: float
    x: float
    y: float
    quarters: int

    @property
    def box(self) -> Solid:
        """Its bounding box before it is turned and shifted."""
        return Solid(self.name, (0.0, 0.0, 0.0), (self.length, SIDES[self.name].depth, self.height))

    @property
    def solid(self) -> Solid:
        """Its bounding box, world frame."""
        return turned_solid(self.box, self.x, self.y, self.quarters)


@dataclass(frozen=True)
class House:
    """A house beyond the yard.

    Attributes:
        size: extent of its walls before it is turned, metres.
        x: x of its centre, metres.
        y: y of its centre, metres.
        quarters: number of counter-clockwise quarter turns from facing -y.
    """

    size: Size
    x: float
    y: float
    quarters: int

    @property
    def solid(self) -> Solid:
        """Bounding box of its walls, world frame."""
        wide, deep, height = self.size
        walls = Solid("house", (-wide / 2, -deep / 2, 0.0), (wide / 2, deep / 2, height))
        return turned_solid(walls, self.x, self.y, self.quarters)


@dataclass(frozen=True)
class Layout:
    """The places of everything in a yard.

    Attributes:
        goal: x and y in metres and yaw in degrees of a pose that looks straight at the egg.
        egg: the egg.
        core: things in the robots' way.
        sides: sides that enclose the yard: north, west, south, east.
        edge: things at the edge.
        beds: strips of flowers.
        trees: trees in the yard, then those beyond it.
        inside: number of the trees that are in the yard.
        houses: houses beyond the yard.
        laid: layout of the ground's surfaces.
    """

    goal: tuple[float, float, float]
    egg: Egg
    core: tuple[Piece, ...]
    sides: tuple[Side, ...]
    edge: tuple[Piece, ...]
    beds: tuple[Rect, ...]
    trees: tuple[Tree, ...]
    inside: int
    houses: tuple[House, ...]
    laid: Laid

    @property
    def outline(self) -> Rect:
        """Rectangle of ground inside the sides."""
        return self.laid.outline

    @property
    def trunks(self) -> list[Solid]:
        """Trunks of the trees in the yard."""
        return [
            Solid(
                "trunk",
                (t.x - t.trunk_radius, t.y - t.trunk_radius, 0),
                (t.x + t.trunk_radius, t.y + t.trunk_radius, 1.4),
            )
            for t in self.trees[: self.inside]
        ]

    def cells(self, slack: float = 0.0) -> Cells:
        """Return what is solid at the height of the robots' bodies, with round things smaller by ``slack`` metres."""
        x0, y0, x1, y1 = self.outline
        cells = Cells.empty((x0, y0), (x1, y1))
        fill(cells, self.core + self.edge, [self.egg.solid, *self.trunks], slack)
        return cells


def fill(cells: Cells, pieces: Sequence[Piece], rounds: list[Solid], slack: float = 0.0) -> None:
    """Mark the cells of things, and of further round solids, as solid."""
    for piece in pieces:
        for solid in piece.solids:
            cells.fill(solid, piece.kind.pad - slack * piece.kind.round, piece.kind.round)
    for solid in rounds:
        cells.fill(solid, 0.015 - slack, round_=True)
