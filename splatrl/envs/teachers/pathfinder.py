"""A scripted pathfinder for the navigation tasks, which descends the field of geodesic distances to the goal.

It is modelled on Habitat's ``ShortestPathFollower``. Among candidate directions around the robot it chooses the one
that ends at the smallest geodesic distance to the goal, with a small penalty for turning, which avoids needless turns.
Where obstacles are near, a short beam search over turns and steps finds directions that touch nothing.
"""

import math

import torch
from torch import Tensor

from splatrl.curriculum.geodesics import Geodesics
from splatrl.geometry import wrapped
from splatrl.motions.base import Steering

TURNING = 0.05
"""Cost of turning by 1 rad, metres. For comparison, a 0.25 m step taken 30° off course gains 0.03 m less."""
STEPPING = 0.02
"""Cost of a further step in a search, metres, so that a detour has to gain something."""
BLOCKED = 1000.0
"""Cost of a step that touches something, metres: it is taken only if there is no other."""
STUCK = 500.0
"""Cost of ending where the robot cannot turn round, and so might not get out again, metres."""
ROOM = 0.999
"""Interpolated room from which the body fits at all surrounding nodes."""
DEPTH = 4
"""Steps that a search looks ahead: enough to get through a lane as wide as the body and half a metre long."""
BEAM = 4
"""Paths that a search extends at each depth."""


def lead(geodesics: Geodesics, steering: Steering, robot: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
    """Return the direction that robots should take to reach their goals.

    Args:
        geodesics: distances to the goals.
        steering: how far to look ahead, and in which directions.
        robot: [B, 3] float32, x and y in metres and yaw in radians.
        goal: [B] int64, rows of the goals in ``geodesics``.

    Returns:
        Angle from the heading to the chosen direction, radians in [-π, π], [B] float32; whether no direction leads
        nearer, [B] bool.
    """
    reach, between = steering.reach, steering.angle_between
    place, yaw = robot.split((2, 1), 1)
    aside = torch.zeros_like(yaw)  # from the heading to the first direction
    if not steering.action_names:  # which turns by any angle: the directions to choose from stay as it turns
        aside = (yaw / between).round() * between - yaw
    robot = torch.cat([place, yaw + aside], 1)
    turns = torch.arange(round(math.tau / between), device=robot.device) * between
    turns = torch.where(turns > math.pi + 1e-4, turns - math.tau, turns)
    here = geodesics.distance(place, goal)
    far = _far(geodesics, _ahead(_headings(robot, turns), reach), goal)
    best = (far + TURNING * turns.abs()).argmin(1)
    tight = (~_roomy(geodesics, robot, turns[best], goal, reach)).nonzero().squeeze(1)
    if len(tight):
        best[tight] = _searched(geodesics, robot[tight], goal[tight], reach, turns)
    return wrapped(turns[best] + aside.squeeze(1)), far.gather(1, best.unsqueeze(1)).squeeze(1) >= here


def _roomy(geodesics: Geodesics, robot: Tensor, turn: Tensor, goal: Tensor, reach: float) -> Tensor:
    """Return whether the body fits at every heading where robots are and along a direction: [B] bool."""
    points = max(2, math.ceil(reach / geodesics.cell))
    way = _headings(robot, turn.unsqueeze(1))
    on_way = torch.stack([_ahead(way, reach * part / points) for part in range(points + 1)], 2)  # [B, 1, points, 3]
    room = geodesics.room(on_way.reshape(-1, 3)[:, :2], goal.repeat_interleave(points + 1))
    return (room.view(len(robot), -1) > ROOM).all(1)


def _searched(geodesics: Geodesics, robot: Tensor, goal: Tensor, reach: float, turns: Tensor) -> Tensor:
    """Return the first direction of the best path of up to ``DEPTH`` steps, as an index of ``turns``: [B] int64.

    It is the path that touches nothing and ends nearest to the goal, in a place where the robot can turn round.
    """
    ways = torch.arange(len(turns), device=robot.device)
    chosen, least = torch.zeros_like(goal), robot.new_full((len(robot),), math.inf)
    first, spent = ways.expand(len(robot), -1), robot.new_zeros(len(robot), 1)
    facing, turned, _ = _turned(geodesics, robot.unsqueeze(1), goal, turns)
    for _ in range(DEPTH):
        ends = _ahead(facing, reach)
        far = _far(geodesics, ends, goal)
        cost = (spent.unsqueeze(2) + STEPPING + TURNING * turns.abs()).flatten(1)  # of the paths, but for ``far``
        cost = torch.where(turned & geodesics.clear(facing, ends, goal), cost, cost + BLOCKED)
        kept = (cost + far).sort(dim=1, stable=True).indices[:, :BEAM]
        spent, far, first = cost.gather(1, kept), far.gather(1, kept), first.gather(1, kept)
        facing, turned, around = _turned(geodesics, ends.gather(1, kept.unsqueeze(2).expand(-1, -1, 3)), goal, turns)
        total, path = torch.where(around | (far < 0.5 * reach), spent + far, spent + far + STUCK).min(1)
        chosen = torch.where(total < least, first.gather(1, path.unsqueeze(1)).squeeze(1), chosen)
        least, first = torch.minimum(total, least), first.repeat_interleave(len(turns), 1)
    return chosen


def _turned(geodesics: Geodesics, robot: Tensor, goal: Tensor, turns: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Turn robots on the spot, the shorter way.

    Args:
        geodesics: knows what is free.
        robot: [B, N, 3] poses.
        goal: [B] int64.
        turns: [K] radians, in the order of ``lead``.

    Returns:
        Poses at all headings, [B, N · K, 3]; whether nothing is touched on the way to each, [B, N · K]; whether the
        robot can turn round, either way, [B, N].
    """
    facing = _headings(robot, turns)
    clear = torch.ones(facing.shape[:3], dtype=torch.bool, device=robot.device)  # from each heading to the next
    if not geodesics.round:
        clear = geodesics.clear(facing.flatten(1, 2), facing.roll(-1, 2).flatten(1, 2), goal).view(clear.shape)
    here = torch.ones_like(clear[..., :1])
    left = torch.cat([here, clear[..., :-1]], 2).cumprod(2).bool()
    right = clear.flip(2).cumprod(2).bool().flip(2)
    half = len(turns) // 2
    return facing.flatten(1, 2), torch.where(turns >= 0, left, right).flatten(1), left[..., half] | right[..., half]


def _headings(robot: Tensor, turns: Tensor) -> Tensor:
    """Return robots after turns on the spot: [..., 3] and [K], or [..., K], -> [..., K, 3]."""
    yaw = robot[..., 2:] + turns
    place = robot[..., None, :2].expand(*yaw.shape, 2)
    return torch.cat([place, yaw.unsqueeze(-1)], -1)


def _ahead(robot: Tensor, distance: float) -> Tensor:
    """Return robots after a step ahead: [..., 3] -> [..., 3]."""
    x, y, yaw = robot.unbind(-1)
    return torch.stack([x + distance * yaw.cos(), y + distance * yaw.sin(), yaw], -1)


def _far(geodesics: Geodesics, robot: Tensor, goal: Tensor) -> Tensor:
    """Return the distances to each row's goal: [B, N, 3] -> [B, N]."""
    count, number = robot.shape[:2]
    return geodesics.distance(robot[..., :2].flatten(0, 1), goal.repeat_interleave(number)).view(count, number)
