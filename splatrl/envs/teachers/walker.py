"""A scripted walker that knows the state and its mark, and so demonstrates that a legged robot can walk to it."""

import math

import torch
from torch import Tensor

from splatrl.geometry import azimuths, wrapped

SEEN = math.radians(40.0)
"""Angle between heading and mark within which the walker assumes that it is seen; beyond, it turns left, radians."""
SPEED = 0.75
"""Fraction of the top speed at which it walks straight ahead."""
BEND = 2.0
"""Gain of its steering: radians per second of turning per radian of heading error."""


def walk_to(robot: Tensor, mark: Tensor, limits: Tensor) -> Tensor:
    """Return the velocities with which robots walk to marks, or turn left while these are out of view.

    Args:
        robot: [B, 3] float64, x and y in metres and yaw in radians.
        mark: [B, 2] float64, metres.
        limits: [2, 2] lowest and highest actions.

    Returns:
        [B, 2] float32, metres per second ahead and radians per second to the left.
    """
    off = wrapped(azimuths(mark - robot[:, :2]) - robot[:, 2])
    seen, high = off.abs() < SEEN, limits[1].to(robot)
    speed = torch.where(seen, SPEED * high[0] * off.cos().square().square(), 0.0)
    turn = torch.where(seen, (BEND * off).clamp(-high[1], high[1]), high[1])
    return torch.stack([speed, turn], 1).float()
