"""A scripted driver that knows the state and its waypoint, and so demonstrates that a route can be driven."""

import math

import torch
from torch import Tensor

from splatrl.geometry import azimuths, wrapped

SPEED = 0.7
"""Maximum speed, metres per second."""
SLOWEST = 0.3
"""Fraction of the speed that remains when the car's target point is far to the side."""
LOOK_AHEAD = 0.4
"""Look-ahead distance: from the car's projection onto the path to the point that it steers for, metres."""
ASIDE = math.radians(80.0)
"""Angle to the target point beyond which a car backs up to turn, and other robots turn on the spot."""


def drive_to(robot: Tensor, last: Tensor, waypoint: Tensor, wheelbase: float | None, limits: Tensor) -> Tensor:
    """Return the actions that drive robots to waypoints: pure pursuit (Coulter 1992) of a straight path.

    Args:
        robot: [B, 3] float64, x and y in metres and yaw in radians.
        last: [B, 2] float64, start of the path to the waypoint, metres.
        waypoint: [B, 2] float64, metres.
        wheelbase: distance between the axles of cars, metres; None for robots that turn on the spot.
        limits: [2, 2] lowest and highest actions.

    Returns:
        [B, 2] float32: speed in metres per second, and the steering angle in radians, or without a wheelbase the turn
        rate in radians per second.
    """
    lowest, highest = limits.to(robot)
    way = waypoint - last
    along = ((robot[:, :2] - last) * way).sum(1) / (way * way).sum(1).clamp_min(1e-9)
    share = (along + LOOK_AHEAD / way.norm(dim=1).clamp_min(1e-9)).clamp(0.0, 1.0)
    away = last + share.unsqueeze(1) * way - robot[:, :2]
    off = wrapped(azimuths(away) - robot[:, 2])
    curvature = 2.0 * off.sin() / away.norm(dim=1).clamp_min(0.5 * LOOK_AHEAD)
    speed = SPEED * (SLOWEST + (1.0 - SLOWEST) * off.cos().clamp_min(0.0))
    speed = speed.clamp(lowest[0], highest[0])
    if wheelbase is None:
        turn, spin, back = speed * curvature, torch.sign(off) * highest[1], 0.0
    else:
        turn, spin, back = torch.atan(wheelbase * curvature), -torch.sign(off) * highest[1], -0.5 * SPEED
    behind = off.abs() > ASIDE
    action = torch.stack([torch.where(behind, back, speed), torch.where(behind, spin, turn)], 1)
    return action.clamp(lowest, highest).float()
