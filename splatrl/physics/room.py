"""Free space in a scene, in which tasks can place things."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splatrl.physics.terrain import Terrain

Floats = NDArray[np.float64]

SAMPLES = 0.1
"""Maximum distance between the points at which a path must be free, metres."""


class Room:
    """The free space of a terrain within bounds.

    Args:
        terrain: ground and boxes.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        ceiling: height of the ceiling above the ground, metres.
    """

    def __init__(self, terrain: Terrain, lower: Sequence[float], upper: Sequence[float], ceiling: float):
        self.plane, self.boxes = terrain.plane.numpy(), terrain.boxes.numpy()
        self.lower, self.upper, self.ceiling = np.array(lower, np.float64), np.array(upper, np.float64), ceiling

    def ground(self, x: float, y: float) -> float:
        """Return the height of the ground at a place, metres."""
        return float((self.plane[3] - self.plane[0] * x - self.plane[1] * y) / self.plane[2])

    def free(self, points: Floats, margin: float) -> NDArray[np.bool_]:
        """Return whether points lie in bounds and at least ``margin`` from ground, ceiling and boxes: [P, 3] -> [P]."""
        above = points @ self.plane[:3] - self.plane[3]
        return (above >= margin) & (above <= self.ceiling - margin) & self.beside(points, margin)

    def beside(self, points: Floats, margin: float) -> NDArray[np.bool_]:
        """Return whether points are inside the bounds and at least ``margin`` from boxes: [P, 3] -> [P]."""
        inside = ((points[:, :2] >= self.lower) & (points[:, :2] <= self.upper)).all(1)
        if len(self.boxes):
            outside = np.maximum(np.abs(points[:, None] - self.boxes[:, :3]) - self.boxes[:, 3:], 0.0)
            inside &= np.linalg.norm(outside, axis=2).min(1) >= margin
        return np.asarray(inside)


def ahead(yaw: float) -> Floats:
    """Return the horizontal unit vector of a yaw: [3]."""
    return np.array([math.cos(yaw), math.sin(yaw), 0.0])


def between(start: Floats, end: Floats) -> Floats:
    """Sample points on a straight path, both ends included: [P, 3]."""
    steps = max(2, math.ceil(float(np.linalg.norm(end - start)) / SAMPLES) + 1)
    return start + np.linspace(0.0, 1.0, steps)[:, None] * (end - start)
