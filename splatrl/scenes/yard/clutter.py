"""Alternative places for the small things of the backyard, for a yard that no policy was trained in."""

from dataclasses import dataclass
from math import pi

import numpy as np

from splatrl.scenes.yard.surfels import Surfels


@dataclass(frozen=True)
class Shift:
    """A thing's displacement from its place in ``layout``: a turn about its own vertical axis, then a shift.

    Attributes:
        x: shift along x, metres.
        y: shift along y, metres.
        turn: angle in radians, counter-clockwise; used only for things that fill the same box afterwards.
    """

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


STEP = 0.05
"""Unit of movement, metres: things move by whole steps, so they fill voxels of that size in the same way as before."""
REACHES = {
    "wood pile": ((-10, -4), (-8, 10), (0.0, 0.0)),
    "shrub pot": ((-4, 10), (9, 14), (0.5, 2 * pi)),
    "pots on the table": ((0, 0), (0, 0), (pi, pi)),
    "rain barrel": ((-5, 10), (1, 8), (0.5, 2 * pi)),
    "bench": ((0, 2), (3, 12), (0.0, 0.0)),
}
"""Minimum and maximum x and y (steps) and turn (radians) of each thing that moves. None of them comes closer to the
robots' bodies: the pile and the pot, which stand within reach, move out of it, and the pots on the table swap places
inside the box that they fill."""
BELONGS_TO = {
    **{name: name for name in ("wood pile", "shrub pot", "rain barrel", "pots on the table")},
    "shrub": "shrub pot",
    "bench seat": "bench",
    "bench foot": "bench",
}
"""The thing with which each solid moves, by the solid's name."""


def clutter_moves(clutter: int) -> dict[str, Shift]:
    """Return the displacement of each thing in ``REACHES``.

    Args:
        clutter: 0 leaves everything where ``layout`` puts it; every other number moves all these things elsewhere.

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
    """Return the surfels of a thing after its displacement.

    Args:
        part: surfels of the thing, before lighting.
        center: x and y of the axis about which it turns, metres.
        move: the displacement.
    """
    if move == Shift():
        return part  # identical to the byte
    cos, sin = np.cos(move.turn), np.sin(move.turn)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middle = np.array([*center, 0.0])
    means = (part.means - middle) @ turn.T + middle + np.array([move.x, move.y, 0.0])
    return Surfels(means, turn @ part.axes, part.scales, part.colors, part.normals @ turn.T, part.opacities)
