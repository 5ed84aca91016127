"""Where there is room in a scene for what tasks place in it."""

import json
import math
from collections.abc import Callable, Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatrl.files import digest_of
from splatrl.physics.terrain import Terrain
from splatrl.scenes.cache import cached_arrays

Floats = NDArray[np.float64]

SAMPLES = 0.1
"""Metres between the points of a way at which it must be free."""


class Room:
    """The free space of a terrain between bounds.

    Args:
        terrain: ground and boxes.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        ceiling: height above the ground, metres.
    """

    def __init__(self, terrain: Terrain, lower: Sequence[float], upper: Sequence[float], ceiling: float):
        self.plane, self.boxes = terrain.plane.numpy(), terrain.boxes.numpy()
        self.lower, self.upper, self.ceiling = np.array(lower, np.float64), np.array(upper, np.float64), ceiling

    def ground(self, x: float, y: float) -> float:
        """Height of the ground, metres."""
        return float((self.plane[3] - self.plane[0] * x - self.plane[1] * y) / self.plane[2])

    def free(self, points: Floats, margin: float) -> NDArray[np.bool_]:
        """Whether points are at least ``margin`` from bounds, ground, ceiling and boxes: [P, 3] -> [P]."""
        above = points @ self.plane[:3] - self.plane[3]
        return (above >= margin) & (above <= self.ceiling - margin) & self.beside(points, margin)

    def beside(self, points: Floats, margin: float) -> NDArray[np.bool_]:
        """Whether points are inside the bounds and at least ``margin`` from boxes: [P, 3] -> [P]."""
        inside = ((points[:, :2] >= self.lower) & (points[:, :2] <= self.upper)).all(1)
        if len(self.boxes):
            outside = np.maximum(np.abs(points[:, None] - self.boxes[:, :3]) - self.boxes[:, 3:], 0.0)
            inside &= np.linalg.norm(outside, axis=2).min(1) >= margin
        return np.asarray(inside)


def ahead(yaw: float) -> Floats:
    """The level direction of a yaw: [3]."""
    return np.array([math.cos(yaw), math.sin(yaw), 0.0])


def between(start: Floats, end: Floats) -> Floats:
    """Points of a straight way, both ends among them: [P, 3]."""
    steps = max(2, math.ceil(float(np.linalg.norm(end - start)) / SAMPLES) + 1)
    return start + np.linspace(0.0, 1.0, steps)[:, None] * (end - start)


def drawn_each(
    count: int, seed: int, tries: int, draw: Callable[[np.random.Generator], Floats | None], complaint: str
) -> Floats:
    """Draw some things, each of which depends on the seed and its own number alone: [N, ...].

    Args:
        count: how many, N.
        seed: of all of them.
        tries: how often each is tried, at most.
        draw: draws one, or None where what came does not fit.
        complaint: what to say where none fits.

    Raises:
        ValueError: where none fits.
    """
    found = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        one = next((each for _ in range(tries) if (each := draw(rng)) is not None), None)
        if one is None:
            raise ValueError(complaint)
        found.append(one)
    return np.stack(found)


def drawn_once(kind: str, terrain: Terrain, settings: Sequence[Any], build: Callable[[], Floats]) -> Floats:
    """What is drawn in a terrain by some settings, from the cache where it was drawn before.

    Args:
        kind: the module that draws it, in this package.
        terrain: where.
        settings: all else that it depends on, as JSON can write it.
        build: draws it.
    """
    code = digest_of([Path(__file__), Path(__file__).with_name(f"{kind}.py")])
    digest = blake2b(json.dumps([list(settings), code], default=list).encode(), digest_size=16)
    for part in (terrain.plane, terrain.boxes):
        digest.update(part.numpy().tobytes())
    return cached_arrays(f"{kind}-{digest.hexdigest()}", lambda: {kind: build()})[kind]
