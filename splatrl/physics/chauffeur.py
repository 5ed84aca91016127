"""A scripted car driver that knows the state and its waypoint, and so demonstrates that a route can be driven."""

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
"""Angle to the target point beyond which a car backs up to turn."""


def drive_to(robot: Tensor, last: Tensor, waypoint: Tensor, wheelbase: float, limits: Tensor) -> Tensor:
    """Return the speed and steering angle that drive cars to waypoints: pure pursuit (Coulter 1992) of a straight path.

    Args:
        robot: [B, 3] float64, x and y in metres and yaw in radians.
        last: [B, 2] float64, start of the path to the waypoint, metres.
        waypoint: [B, 2] float64, metres.
        wheelbase: distance between the axles, metres.
        limits: [2, 2] lowest and highest actions.

    Returns:
        [B, 2] float32, metres per second and radians.
    """
    way = waypoint - last
    along = ((robot[:, :2] - last) * way).sum(1) / (way * way).sum(1).clamp_min(1e-9)
    share = (along + LOOK_AHEAD / way.norm(dim=1).clamp_min(1e-9)).clamp(0.0, 1.0)
    away = last + share.unsqueeze(1) * way - robot[:, :2]
    off = wrapped(azimuths(away) - robot[:, 2])
    curvature = 2.0 * off.sin() / away.norm(dim=1).clamp_min(0.5 * LOOK_AHEAD)
    steering = torch.atan(wheelbase * curvature)
    speed = SPEED * (SLOWEST + (1.0 - SLOWEST) * off.cos().clamp_min(0.0))
    behind = off.abs() > ASIDE
    steering = torch.where(behind, -torch.sign(off) * limits[1, 1], steering)
    speed = torch.where(behind, -0.5 * SPEED, speed)
    action = torch.stack([speed, steering], 1)
    return action.clamp(limits[0].to(action), limits[1].to(action)).float()
