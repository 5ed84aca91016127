"""Finds the direction of the walls in a place seen from above."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CELLS = 200
"""Cells of the histogram of coordinates along an axis."""
CLEAR = 0.6
"""Minimum gap between the least and the median entropy of a place with clear walls. Rooms, streets and yards have 0.8
or more, a single thing and its surroundings 0.5 or less."""
FEWEST = 10
"""Minimum number of points among which walls are sought."""
_TURNS = np.radians(np.arange(0.0, 90.0, 0.5))


class Walls(NamedTuple):
    """The direction of the walls of a place.

    Attributes:
        yaw: direction of the longest wall, radians in (−π/2, π/2].
        gap: by how much sharper the histograms of the points' coordinates are along the walls than along the median
            direction, as a difference of entropies.
    """

    yaw: float
    gap: float


def entropy(values: Floats) -> float:
    """Return the entropy of the histogram of coordinates [N] in [−1, 1] along an axis: the less, the sharper."""
    cells = np.clip((values + 1.0) * (CELLS / 2), 0, CELLS - 1).astype(int)
    shares = np.bincount(cells, minlength=CELLS) / len(values)
    return float(-(shares * np.log(np.maximum(shares, 1e-12))).sum())


def find_walls(places: Floats) -> Walls:
    """Find the direction of the walls of a place.

    Walls at right angles make the two histograms of the points' coordinates sharp: the rotation with the least entropy
    is taken, and of its two directions the one in which the points reach farther.

    Args:
        places: [P, 2] positions of points on walls and things.
    """
    if len(places) < FEWEST:
        return Walls(0.0, 0.0)
    low, high = np.quantile(places, [0.02, 0.98], axis=0)
    places = places[((places >= low) & (places <= high)).all(1)]
    size = float(np.linalg.norm(high - low)) or 1.0
    middle = np.median(places, 0)

    def spread(yaw: float) -> float:
        along = (places - middle) @ np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        return sum(entropy(2.0 * along[:, axis] / size) for axis in (0, 1))

    spreads = [spread(yaw) for yaw in _TURNS]
    fine = _TURNS[int(np.argmin(spreads))] + np.radians(np.arange(-0.5, 0.51, 0.1))
    yaw = float(fine[int(np.argmin([spread(turn) for turn in fine]))])
    first = np.quantile(places @ [math.cos(yaw), math.sin(yaw)], [0.05, 0.95])
    second = np.quantile(places @ [-math.sin(yaw), math.cos(yaw)], [0.05, 0.95])
    if second[1] - second[0] > first[1] - first[0]:
        yaw += 0.5 * math.pi
    return Walls(yaw - math.pi if yaw > 0.5 * math.pi else yaw, float(np.median(spreads)) - min(spreads))
