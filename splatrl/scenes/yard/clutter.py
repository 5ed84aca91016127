"""Where the small things of the backyard have been moved to, for a yard that nobody has trained in."""

from dataclasses import dataclass
from math import pi

import numpy as np

from splatrl.scenes.yard.surfels import Surfels


@dataclass(frozen=True)
class Shift:
    """How a thing has been moved from where ``layout`` puts it: turned about its own vertical, then shifted.

    Attributes:
        x: metres; so is ``y``.
        y: metres.
        turn: radians, counter-clockwise; only of things that still fill the same box.
    """

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


STEP = 0.05
"""Metres: things move by whole steps, so they fill voxels of that size as they did before."""
REACHES = {
    "wood pile": ((-10, -4), (-8, 10), (0.0, 0.0)),
    "shrub pot": ((-4, 10), (9, 14), (0.5, 2 * pi)),
    "pots on the table": ((0, 0), (0, 0), (pi, pi)),
    "rain barrel": ((-5, 10), (1, 8), (0.5, 2 * pi)),
    "bench": ((0, 2), (3, 12), (0.0, 0.0)),
}
"""Least and greatest x and y (steps) and turn (radians) of each thing that moves. None comes nearer to the robots'
bodies: pile and pot, which stand within their reach, leave it, and the pots on the table change places inside the box
that they fill."""
BELONGS_TO = {
    **{name: name for name in ("wood pile", "shrub pot", "rain barrel", "pots on the table")},
    "shrub": "shrub pot",
    "bench seat": "bench",
    "bench foot": "bench",
}
"""The thing with which each solid moves, by the solid's name."""


def clutter_moves(clutter: int) -> dict[str, Shift]:
    """How each thing in ``REACHES`` has been moved.

    Args:
        clutter: 0 leaves everything where ``layout`` puts it; every other number moves all of them elsewhere.

    Raises:
        ValueError: for a number below 0.
    """
    if clutter < 0:
        raise ValueError(f"clutter: expected a whole number of at least 0, got {clutter}")
    if clutter == 0:
        return {thing: Shift() for thing in REACHES}
    rng = np.random.default_rng([clutter, 2])
    moves = {}
    for thing, (*shifts, turn) in REACHES.items():
        x, y = (STEP * int(rng.integers(*ends, endpoint=True)) for ends in shifts)
        moves[thing] = Shift(x, y, float(rng.uniform(*turn)))
    return moves


def moved(part: Surfels, center: tuple[float, float], move: Shift) -> Surfels:
    """The surfels of a thing where it has been moved to.

    Args:
        part: surfels of the thing, before light falls on them.
        center: x and y about which it turns, metres.
        move: how.
    """
    if move == Shift():
        return part  # to the byte
    cos, sin = np.cos(move.turn), np.sin(move.turn)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middle = np.array([*center, 0.0])
    means = (part.means - middle) @ turn.T + middle + np.array([move.x, move.y, 0.0])
    return Surfels(means, turn @ part.axes, part.scales, part.colors, part.normals @ turn.T, part.opacities)
