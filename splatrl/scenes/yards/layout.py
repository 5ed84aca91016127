"""The layout of a generated yard, drawn from its seed.

World frame, metres, ground at z = 0. Robots walk around the origin; the core, a square of 2 × 2 m, is as hard as that
of the backyard. The extent of the yard beyond the core and its enclosure differ on every side.
"""

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.yard.ground import Rect
from splatrl.scenes.yard.layout import Solid, Tree
from splatrl.scenes.yard.materials import Rng
from splatrl.scenes.yards.ground import Laid
from splatrl.scenes.yards.kinds import AT_THE_EDGE, IN_THE_WAY, Kind
from splatrl.scenes.yards.pedestals import UNDER_THE_EGG
from splatrl.scenes.yards.pieces import Egg, House, Layout, Piece, Side, fill
from splatrl.scenes.yards.sides import SIDES
from splatrl.scenes.yards.solids import Size
from splatrl.scenes.yards.solvable import BLOCKED, CELL, HALF, Cells, difficulty, solvable
from splatrl.scenes.yards.turning import QUARTERS

LONG = ("wall", "clipped", "screen", "bench", "planter")
"""Long kinds, one of which is tried first, near the middle, as a barrier that robots must go around."""
FRINGE = 1.4
"""Half width of the square in which the things of the core stand, metres; those at the edge stay outside."""


def drawn_core(rng: Rng) -> tuple[tuple[float, float, float], Egg, list[Piece]]:
    """Draw the goal, the egg and the things in the robots' way."""
    quarter = int(rng.integers(4))
    (ahead_x, ahead_y), across = (
        QUARTERS[quarter],
        0.2 * int(rng.choice([-3, -2, -1, 1, 2, 3], p=[0.3, 0.15, 0.05, 0.05, 0.15, 0.3])),
    )
    along = 0.2 * int(rng.integers(2, 4))
    goal = (round(ahead_x * along - ahead_y * across, 3), round(ahead_y * along + ahead_x * across, 3))
    away, scale = rng.uniform(0.62, 0.72), rng.uniform(0.9, 1.12)
    radii = (0.12 * scale, 0.12 * scale, 0.16 * scale * rng.uniform(0.94, 1.06))
    egg = Egg(goal[0] + away * ahead_x, goal[1] + away * ahead_y, radii, int(rng.integers(len(UNDER_THE_EGG))))
    x, y = goal
    kept = [(x - 0.5, y - 0.5, x + 0.5, y + 0.5), (egg.x - 0.3, egg.y - 0.3, egg.x + 0.3, egg.y + 0.3)]
    pieces: list[Piece] = []
    shut, target = shut_places(kept[1]), rng.uniform(0.20, 0.28)
    barrier = LONG[int(rng.integers(len(LONG)))]
    for name in (barrier, *(str(other) for other in rng.permutation(list(IN_THE_WAY)) if other != barrier)):
        kind = IN_THE_WAY[name]
        for _ in range(8):
            piece = drawn_piece(kind, rng, 12 if name == barrier and not pieces else 26)
            more = shut | shut_places(piece.rect)
            worth = more.sum() >= shut.sum() + 3 and more.mean() <= BLOCKED[1]
            if worth and within_square(piece.rect, FRINGE) and off_lattice(piece.rect) and fits(piece.rect, kept, 0.04):
                pieces.append(piece)
                kept.append(piece.rect)
                shut = more
                break
        if shut.mean() >= target:
            break
    return (*goal, 90.0 * quarter), egg, pieces


def shut_places(rect: Rect) -> NDArray[np.bool_]:
    """Return a mask of the lattice's places where a rectangle blocks an axis-aligned body: [11, 11]."""
    at = np.round(0.2 * np.arange(-5, 6), 1)
    x0, y0, x1, y1 = rect
    x, y = (at > x0 - HALF) & (at < x1 + HALF), (at > y0 - HALF) & (at < y1 + HALF)
    return x[:, None] & y[None]


def drawn_piece(kind: Kind, rng: Rng, reach: int) -> Piece:
    """Draw a thing in the core whose centre is at most about ``reach`` cells from the origin along x and y.

    Its surfels fill whole cells, so that no move of a robot depends on a hair's breadth.
    """
    wide, deep, height = drawn_size(kind, rng)
    cells, pads = [max(1, round((across + 2 * kind.pad) / CELL)) for across in (wide, deep)], 2 * kind.pad
    quarters = int(rng.integers(4))
    odd = [0.5 * (count % 2) for count in (cells if quarters % 2 == 0 else cells[::-1])]
    x, y = (CELL * (int(value) + half) for value, half in zip(rng.integers(-reach, reach + 1, 2), odd, strict=True))
    size = (CELL * cells[0] - pads, CELL * cells[1] - pads, height)
    return Piece(kind, size, float(x), float(y), quarters)


def drawn_size(kind: Kind, rng: Rng) -> Size:
    """Draw the size of a thing."""
    least, most = np.array(kind.least), np.array(kind.most)
    wide, deep, height = (float(v) for v in least + (most - least) * rng.random(3))
    return (wide, wide if kind.round else deep, height)


def fits(rect: Rect, taken: list[Rect], gap: float) -> bool:
    """Return whether a rectangle keeps at least ``gap`` metres from all others."""
    x0, y0, x1, y1 = rect
    return all(x1 + gap <= a or c + gap <= x0 or y1 + gap <= b or d + gap <= y0 for a, b, c, d in taken)


def within_square(rect: Rect, half: float) -> bool:
    """Return whether a rectangle lies within the square of this half width around the origin."""
    return max(map(abs, rect)) <= half


def off_lattice(rect: Rect) -> bool:
    """Return whether an axis-aligned body on the lattice never just touches a rectangle."""
    return all(abs(edge / HALF - round(edge / HALF)) > 0.1 for edge in rect)  # the lattice's step is half the body


def drawn_outline(rng: Rng) -> Rect:
    """Draw the extent of the yard on each side of the core: x0, y0, x1, y1, metres."""
    x0, y0, x1, y1 = np.round(FRINGE + 0.3 + 2.3 * rng.random(4) ** 1.3, 1)
    return -float(x0), -float(y0), float(x1), float(y1)


def drawn_sides(outline: Rect, rng: Rng) -> tuple[Side, ...]:
    """Draw the sides that enclose the yard."""
    x0, y0, x1, y1 = outline
    corners = ((x0, y1, x1 - x0), (x0, y0, y1 - y0), (x1, y0, x1 - x0), (x1, y1, y1 - y0))
    names = [name for name in SIDES if name != "facade"]
    chosen = [names[i] for i in rng.choice(len(names), 4, replace=False)]
    if rng.random() < 0.7:
        chosen[int(rng.integers(4))] = "facade"
    if rng.random() < 0.5:  # opposite sides often have the same fence
        first = int(rng.integers(4))
        chosen[(first + 2) % 4] = chosen[first] if chosen[first] != "facade" else chosen[(first + 2) % 4]
    sides = []
    for quarters, ((x, y, length), name) in enumerate(zip(corners, chosen, strict=True)):
        sides.append(Side(name, length, float(rng.uniform(*SIDES[name].heights)), x, y, quarters))
    return tuple(sides)


def span(outline: Rect, quarters: int) -> tuple[float, float]:
    """Return the lower and upper coordinate of a side along itself; see ``beside``."""
    x0, y0, x1, y1 = outline
    return (x0, x1) if quarters % 2 == 0 else (y0, y1)


def beside(outline: Rect, quarters: int, along: float, inwards: float = 0.0) -> tuple[float, float]:
    """Return x and y of a point beside a side of a yard.

    Args:
        outline: extent of the yard.
        quarters: the side: 0 north, 1 west, 2 south, 3 east.
        along: coordinate of the point along the side, metres: its x beside north and south, its y beside west and east.
        inwards: distance of the point from the side, metres; negative for a point outside.
    """
    x0, y0, x1, y1 = outline
    return ((along, y1 - inwards), (x0 + inwards, along), (along, y0 + inwards), (x1 - inwards, along))[quarters]


def strip(outline: Rect, quarters: int, low: float, high: float, near: float, far: float) -> Rect:
    """Return the rectangle between two coordinates along a side and between two distances from it; see ``beside``."""
    (a, b), (c, d) = beside(outline, quarters, low, near), beside(outline, quarters, high, far)
    return min(a, c), min(b, d), max(a, c), max(b, d)


def drawn_edge(outline: Rect, taken: list[Rect], rng: Rng) -> list[Piece]:
    """Draw things with their backs to the sides."""
    x0, y0, x1, y1 = outline
    pieces: list[Piece] = []
    names = list(AT_THE_EDGE)
    for name in rng.choice(names, int(rng.integers(6, 11)), replace=False):
        kind = AT_THE_EDGE[str(name)]
        for _ in range(6):
            size, quarters = drawn_size(kind, rng), int(rng.integers(4))
            back = size[1] / 2 + rng.uniform(0.06, 0.3)
            middle = [rng.uniform(low + size[0] / 2, high - size[0] / 2) for low, high in ((x0, x1), (y0, y1))]
            x, y = beside(outline, quarters, middle[quarters % 2], back)
            piece = Piece(kind, size, float(x), float(y), quarters)
            a, b, c, d = piece.rect
            if a > x0 and b > y0 and c < x1 and d < y1 and fits(piece.rect, taken, 0.1):
                pieces.append(piece)
                taken.append(piece.rect)
                break
    return pieces


def drawn_beds(outline: Rect, taken: list[Rect], sides: tuple[Side, ...], rng: Rng) -> list[Rect]:
    """Draw strips of flowers in front of some of the sides, clear of what stands there."""
    beds = []
    for side in sides:
        if side.name == "facade" or rng.random() < 0.45:
            continue
        deep, (start, length) = rng.uniform(0.3, 0.45), (rng.uniform(0.05, 0.4), rng.uniform(0.35, 0.55))
        low, high = span(outline, side.quarters)
        first, last = low + start * (high - low), low + (start + length) * (high - low)
        rect = strip(outline, side.quarters, first, last, 0.03, deep)
        if fits(rect, taken, 0.02):
            beds.append(rect)
            taken.append(rect)
    return beds


def drawn_trees(outline: Rect, taken: list[Rect], rng: Rng) -> tuple[list[Tree], list[Tree]]:
    """Draw trees in the yard and beyond it."""
    x0, y0, x1, y1 = outline
    inside, beyond = [], []
    for _ in range(int(rng.integers(0, 4))):
        for _ in range(8):
            x, y = rng.uniform((x0 + 0.5, y0 + 0.5), (x1 - 0.5, y1 - 0.5))
            trunk, crown = rng.uniform(0.06, 0.12), rng.uniform(0.7, 1.1)
            rect = (x - 0.2, y - 0.2, x + 0.2, y + 0.2)
            if fits(rect, taken, 0.1):
                inside.append(Tree(float(x), float(y), trunk, float(rng.uniform(1.9, 2.6)), crown))
                taken.append(rect)
                break
    for _ in range(int(rng.integers(5, 10))):
        side, off, crown = int(rng.integers(4)), rng.uniform(2.2, 6.0), rng.uniform(1.2, 1.9)
        place = rng.uniform((x0 - 3, y0 - 3), (x1 + 3, y1 + 3))
        x, y = beside(outline, side, float(place[side % 2]), -off)
        beyond.append(Tree(x, y, 0.2, float(rng.uniform(2.6, 4.2)), crown))
    return inside, beyond


def drawn_houses(outline: Rect, sides: tuple[Side, ...], rng: Rng) -> list[House]:
    """Draw up to two houses beyond sides that are not fronts of houses themselves."""
    houses = []
    for side in rng.permutation(4)[: int(rng.integers(1, 3))]:
        if sides[side].name == "facade":
            continue
        size = (float(rng.uniform(5.5, 8.0)), float(rng.uniform(5.0, 7.0)), float(rng.choice([2.9, 3.2, 5.4])))
        off, along = size[1] / 2 + rng.uniform(3.5, 7.0), rng.uniform(-2.5, 2.5)
        x, y = beside(outline, side, along, -off)
        houses.append(House(size, float(x), float(y), int(side)))
    return houses


def drawn_laid(outline: Rect, sides: tuple[Side, ...], rng: Rng) -> Laid:
    """Draw a path through the yard, and a terrace in front of the house."""
    terrace: Rect = (0.0, 0.0, 0.0, 0.0)
    house = [side.quarters for side in sides if side.name == "facade"]
    if house and rng.random() < 0.75:
        terrace = strip(outline, house[0], *span(outline, house[0]), 0.0, rng.uniform(0.9, 1.6))
    middle = rng.uniform(-0.7, 0.7, (2, 2))
    ends = [beside(outline, side, rng.uniform(*span(outline, side))) for side in range(4)]
    start, end = rng.choice(4, 2, replace=False)
    corners = np.array([ends[start], middle[0], middle[1], ends[end]])
    t = np.linspace(0.0, 1.0, 24)[:, None]
    path = (
        (1 - t) ** 3 * corners[0]
        + 3 * t * (1 - t) ** 2 * corners[1]
        + 3 * t**2 * (1 - t) * corners[2]
        + t**3 * corners[3]
    )
    width = 0.0 if rng.random() < 0.4 else float(rng.uniform(0.45, 0.8))
    return Laid(outline, terrace, path, width)


def drawn_layout(rng: Rng) -> Layout | None:
    """Draw a layout; return None if the things in its core make it too easy, too hard or impossible."""
    goal, egg, core = drawn_core(rng)
    cells = Cells.empty((-FRINGE - 0.1, -FRINGE - 0.1), (FRINGE + 0.1, FRINGE + 0.1))
    fill(cells, core, [egg.solid])
    if not solvable(difficulty(cells, goal)):
        return None
    outline = drawn_outline(rng)
    sides = drawn_sides(outline, rng)
    taken: list[Rect] = [(-FRINGE - 0.1, -FRINGE - 0.1, FRINGE + 0.1, FRINGE + 0.1)]
    for side in sides:
        if side.name == "facade":  # nothing stands in front of its door
            taken.append(strip(outline, side.quarters, *span(outline, side.quarters), 0.0, 0.7))
    edge = drawn_edge(outline, taken, rng)
    beds = drawn_beds(outline, taken, sides, rng)
    inside, beyond = drawn_trees(outline, taken, rng)
    houses = drawn_houses(outline, sides, rng)
    apart = [tree for tree in beyond if all(outside(tree, house.solid) for house in houses)]
    laid = drawn_laid(outline, sides, rng)
    return Layout(
        goal, egg, tuple(core), sides, tuple(edge), tuple(beds), tuple(inside + apart), len(inside), tuple(houses), laid
    )


def outside(tree: Tree, solid: Solid) -> bool:
    """Return whether a tree's crown stays out of a solid."""
    reach = 0.8 * tree.crown_radius
    (x0, y0, _), (x1, y1, _) = solid.low, solid.high
    return not (x0 - reach < tree.x < x1 + reach and y0 - reach < tree.y < y1 + reach)
