"""A teacher for the navigation tasks: it knows how far the goal is from anywhere, and goes where that becomes less.

Habitat's ``ShortestPathFollower`` is its model. Among some ways around the robot it takes the one at whose end the
shortest way to the goal is shortest, where a little is added for each angle to turn by, so that it does not turn for
nothing, and much where the body does not fit.
"""

import math

import torch
from torch import Tensor

from splatrl.curriculum.geodesics import Geodesics

TURNING = 0.05
"""Metres that a turn of 1 rad costs. A step that is 0.25 m long, 30° aside, comes 0.03 m less far."""
BLOCKED = 10.0
"""Metres that a way costs on which the body fits nowhere."""


def lead(geodesics: Geodesics, robot: Tensor, goal: Tensor, reach: float, between: float) -> tuple[Tensor, Tensor]:
    """The way that robots are to take to their goals.

    Args:
        geodesics: know the distances.
        robot: [B, 3] float32, x and y in metres and yaw in radians.
        goal: [B] int64, rows of goals.
        reach: length of the ways among which to choose, metres.
        between: angle from one of them to the next, radians; the first is straight ahead.

    Returns:
        Angle from the heading to the way, radians in [-π, π], [B] float32; whether none leads nearer, [B] bool.
    """
    count, place = round(math.tau / between), robot[:, :2]
    turns = torch.arange(count, device=robot.device) * between
    turns = torch.where(turns > math.pi + 1e-4, turns - math.tau, turns)
    points = max(2, math.ceil(reach / geodesics.cell))
    shares = torch.arange(1, points + 1, device=robot.device) / points
    yaw = robot[:, 2:] + turns
    way = reach * torch.stack([yaw.cos(), yaw.sin()], -1)
    on_way = place[:, None, None] + shares[:, None] * way.unsqueeze(2)  # [B, ways, points, 2]
    rows = goal.repeat_interleave(count * points)
    room = geodesics.room(on_way.reshape(-1, 2), rows).view(-1, count, points).mean(2)
    far = geodesics.distance(on_way[:, :, -1].reshape(-1, 2), goal.repeat_interleave(count)).view(-1, count)
    best = (far + BLOCKED * (1.0 - room) + TURNING * turns.abs()).argmin(1)
    nearer = far.gather(1, best.unsqueeze(1)).squeeze(1) < geodesics.distance(place, goal)
    return turns[best], ~nearer
