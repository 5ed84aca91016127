"""Draws routes of waypoints on the ground."""

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from splatrl.physics.courses import CourseSettings
from splatrl.physics.room import Floats, Room, ahead, between

BRANCHES = 4
"""Number of places tried for each waypoint."""
ABOVE = 0.1
"""Height above the ground at which a path must be free, metres."""


@dataclass(frozen=True)
class RouteSettings(CourseSettings):
    """Settings of routes.

    A route begins at a free place, facing its first waypoint; the straight paths from one waypoint to the next are
    free. Waypoints are on the ground, and the yaw of each is that of the path to it.

    Attributes:
        waypoints: number of waypoints.
        distance: shortest and longest distance from one waypoint to the next, metres.
        turn_deg: maximum turn of the path at a waypoint, degrees.
        clearance: minimum distance between the path and anything solid, metres.

    Raises:
        ValueError: for a number out of range.
    """

    waypoints: int = 5
    distance: Sequence[float] = (0.7, 1.3)
    turn_deg: float = 75.0
    clearance: float = 0.25

    tries = 20_000
    places = "waypoints"

    def drawn(self, room: Room, draw: np.random.Generator) -> Iterator[Floats | None]:
        """Draw starts, and routes from each; see ``CourseSettings.drawn``. Every waypoint is a draw."""
        while True:
            x, y = draw.uniform(room.lower + self.clearance, room.upper - self.clearance)
            route = [np.array([x, y, room.ground(x, y), draw.uniform(-math.pi, math.pi)])]
            yield np.stack(route) if (yield from self._led_on(route, room, draw)) else None

    def _led_on(self, route: list[Floats], room: Room, draw: np.random.Generator) -> Generator[None, None, bool]:
        """Complete a route by depth-first search; if no attempt succeeds, return False and leave it as it was.

        Yields None after each waypoint that leads nowhere.
        """
        if len(route) > self.waypoints:
            return True
        begin, heading = route[-1][:3], route[-1][3]
        turn = math.radians(self.turn_deg) if len(route) > 1 else 0.0
        for _ in range(BRANCHES):
            yaw = heading + draw.uniform(-turn, turn)
            end = begin + draw.uniform(self.distance[0], self.distance[1]) * ahead(yaw)
            inside = (end[:2] >= room.lower + self.clearance) & (end[:2] <= room.upper - self.clearance)
            way = between(begin, end) + np.array([0.0, 0.0, ABOVE])
            if inside.all() and room.beside(way, self.clearance).all():
                route.append(np.array([*end[:2], room.ground(*end[:2]), yaw]))
                if (yield from self._led_on(route, room, draw)):
                    return True
                route.pop()
            yield None
        return False
