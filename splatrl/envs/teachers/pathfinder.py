"""A scripted pathfinder for the navigation tasks, which descends the field of geodesic distances to the goal.

It is modelled on Habitat's ``ShortestPathFollower``. Among candidate directions around the robot it chooses the one
that ends at the smallest geodesic distance to the goal, with a small penalty for turning, which avoids needless turns,
and a large one where the body does not fit.
"""

import math

import torch
from torch import Tensor

from splatrl.curriculum.geodesics import Geodesics

TURNING = 0.05
"""Cost of turning by 1 rad, metres. For comparison, a 0.25 m step taken 30° off course gains 0.03 m less."""
BLOCKED = 10.0
"""Cost of a direction along which the body fits nowhere, metres."""


def lead(geodesics: Geodesics, robot: Tensor, goal: Tensor, reach: float, between: float) -> tuple[Tensor, Tensor]:
    """Return the direction that robots should take to reach their goals.

    Args:
        geodesics: distances to the goals.
        robot: [B, 3] float32, x and y in metres and yaw in radians.
        goal: [B] int64, rows of the goals in ``geodesics``.
        reach: distance to look ahead in each candidate direction, metres.
        between: angle between neighbouring candidate directions, radians; the first is straight ahead.

    Returns:
        Angle from the heading to the chosen direction, radians in [-π, π], [B] float32; whether no direction leads
        nearer, [B] bool.
    """
    count, place = round(math.tau / between), robot[:, :2]
    turns = torch.arange(count, device=robot.device) * between
    turns = torch.where(turns > math.pi + 1e-4, turns - math.tau, turns)
    points = max(2, math.ceil(reach / geodesics.cell))
    shares = torch.arange(1, points + 1, device=robot.device) / points
    yaw = robot[:, 2:] + turns
    way = reach * torch.stack([yaw.cos(), yaw.sin()], -1)
    on_way = place[:, None, None] + shares[:, None] * way.unsqueeze(2)  # [B, directions, points, 2]
    rows = goal.repeat_interleave(count * points)
    room = geodesics.room(on_way.reshape(-1, 2), rows).view(-1, count, points).mean(2)
    far = geodesics.distance(on_way[:, :, -1].reshape(-1, 2), goal.repeat_interleave(count)).view(-1, count)
    best = (far + BLOCKED * (1.0 - room) + TURNING * turns.abs()).argmin(1)
    nearer = far.gather(1, best.unsqueeze(1)).squeeze(1) < geodesics.distance(place, goal)
    return turns[best], ~nearer
