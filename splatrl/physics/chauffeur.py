"""A scripted driver of a car that knows where it is and where it is to go, and so shows that a route can be driven."""

import math

import torch
from torch import Tensor

SPEED = 0.7
"""Metres per second, at most."""
SLOWEST = 0.3
"""Share of the speed that is left where the waypoint is far aside."""
LOOK_AHEAD = 0.4
"""Metres along the way from beside the car to the point that it steers for."""
ASIDE = math.radians(80.0)
"""Angle to the waypoint beyond which a car backs up to turn."""


def drive_to(robot: Tensor, last: Tensor, waypoint: Tensor, wheelbase: float, limits: Tensor) -> Tensor:
    """The speed and steering angle by which cars drive to waypoints: pure pursuit (Coulter 1992) of the straight way.

    Args:
        robot: [B, 3] float64, x and y in metres and yaw in radians.
        last: [B, 2] float64, where the way to the waypoint begins, metres.
        waypoint: [B, 2] float64, metres.
        wheelbase: metres.
        limits: [2, 2] lowest and highest actions.

    Returns:
        [B, 2] float32, metres per second and radians.
    """
    way = waypoint - last
    along = ((robot[:, :2] - last) * way).sum(1) / (way * way).sum(1).clamp_min(1e-9)
    share = (along + LOOK_AHEAD / way.norm(dim=1).clamp_min(1e-9)).clamp(0.0, 1.0)
    away = last + share.unsqueeze(1) * way - robot[:, :2]
    off = torch.atan2(away[:, 1], away[:, 0]) - robot[:, 2]
    off = torch.atan2(off.sin(), off.cos())
    curvature = 2.0 * off.sin() / away.norm(dim=1).clamp_min(0.5 * LOOK_AHEAD)
    steering = torch.atan(wheelbase * curvature)
    speed = SPEED * (SLOWEST + (1.0 - SLOWEST) * off.cos().clamp_min(0.0))
    behind = off.abs() > ASIDE
    steering = torch.where(behind, -torch.sign(off) * limits[1, 1], steering)
    speed = torch.where(behind, -0.5 * SPEED, speed)
    action = torch.stack([speed, steering], 1)
    return action.clamp(limits[0].to(action), limits[1].to(action)).float()
