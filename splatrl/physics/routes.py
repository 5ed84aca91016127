"""Routes of waypoints on the ground, drawn where a scene has room for a car."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from splatrl.physics.room import Floats, Room, ahead, between, drawn_each
from splatrl.physics.terrain import Terrain
from splatrl.values import require_number

TRIES = 2000
"""Routes that are begun for each that is asked for, at most."""
BRANCHES = 4
"""Places that are tried for each waypoint."""
ABOVE = 0.1
"""Metres above the ground at which a way must be free."""


@dataclass(frozen=True)
class RouteSettings:
    """What routes are like.

    Attributes:
        waypoints: number of waypoints.
        distance: shortest and longest way from one waypoint to the next, metres.
        turn_deg: the most that the way turns at a waypoint, degrees.
        clearance: between a way and what is solid, metres.

    Raises:
        ValueError: for a number out of range.
    """

    waypoints: int = 5
    distance: Sequence[float] = (0.7, 1.3)
    turn_deg: float = 75.0
    clearance: float = 0.25

    def __post_init__(self) -> None:
        require_number("task.route.waypoints", self.waypoints, 1, 64, whole=True)
        require_number("task.route.turn_deg", self.turn_deg, 0.0, 120.0)
        require_number("task.route.clearance", self.clearance, 0.0, 10.0)
        low, high = self.distance
        if not 0.0 < low <= high <= 1e3:
            raise ValueError(f"task.route.distance: expected 0 < lowest ≤ highest, got {list(self.distance)}")


def draw_routes(
    terrain: Terrain, lower: Sequence[float], upper: Sequence[float], settings: RouteSettings, count: int, seed: int
) -> Floats:
    """Draw routes between bounds; each one depends on the seed and its own number alone.

    A route begins at a free place, heading for its first waypoint; the straight ways from one to the next are free.

    Args:
        terrain: ground and boxes.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        settings: what routes are like.
        count: how many, N.
        seed: of what is drawn.

    Returns:
        [N, 1 + W, 3] float64: x and y in metres, world, and the yaw of the way to each; the start's is that of the way
        to the first waypoint.

    Raises:
        ValueError: where there is no room.
    """
    complaint = (
        f"task.route: expected room for {settings.waypoints} waypoints, found none in {TRIES} tries; "
        "type wider task.motion.lower and upper, or fewer task.route.waypoints"
    )
    return drawn_each(count, seed, TRIES, partial(_route, Room(terrain, lower, upper, math.inf), settings), complaint)


def _route(room: Room, settings: RouteSettings, draw: np.random.Generator) -> Floats | None:
    """A start and waypoints [1 + W, 3], or None where no way leads on."""
    x, y = draw.uniform(room.lower + settings.clearance, room.upper - settings.clearance)
    route = [np.array([x, y, draw.uniform(-math.pi, math.pi)])]
    return np.stack(route) if _led_on(route, room, settings, draw) else None


def _led_on(route: list[Floats], room: Room, settings: RouteSettings, draw: np.random.Generator) -> bool:
    """Lead a route on to its end, if one of the ways that are tried does, and else leave it as it was."""
    if len(route) > settings.waypoints:
        return True
    (x, y, heading), margin = route[-1].tolist(), settings.clearance
    turn = math.radians(settings.turn_deg) if len(route) > 1 else 0.0
    for _ in range(BRANCHES):
        yaw = heading + draw.uniform(-turn, turn)
        begin = np.array([x, y, room.ground(x, y) + ABOVE])
        end = begin + draw.uniform(settings.distance[0], settings.distance[1]) * ahead(yaw)
        inside = (end[:2] >= room.lower + margin) & (end[:2] <= room.upper - margin)
        if inside.all() and room.beside(between(begin, end), margin).all():
            route.append(np.append(end[:2], yaw))
            if _led_on(route, room, settings, draw):
                return True
            route.pop()
    return False
