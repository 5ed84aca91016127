"""A trot for a quadruped: where its feet are at each moment, and the joint angles that put them there.

Diagonal pairs of feet stand and swing in turn. A foot that stands moves against the commanded motion of the ground
below it, one that swings is lifted and set down ahead. The gait knows nothing of the robot's balance: a policy that
moves its joints a little beside it can see to that (Iscen et al. 2018, "Policies Modulating Trajectory Generators").
Every operation works element by element in double precision, so a row has the same bytes in any batch.
"""

import math

import torch
from torch import Tensor

THIGH, CALF, OFFSET = 0.213, 0.213, 0.08
"""Lengths of the links of a leg and of its hip, metres, as in ``robots/quadruped.xml``."""
HIPS = ((0.19, 0.05), (0.19, -0.05), (-0.19, 0.05), (-0.19, -0.05))
"""x and y of the hips of the legs, in the order of the joints: front left, front right, rear left, rear right."""
SIDES = (1.0, -1.0, 1.0, -1.0)
BEGINS = (0.0, 0.5, 0.5, 0.0)
"""Share of a cycle by which each leg is ahead."""
FREQUENCY = 3.0
"""Cycles a second."""
STANDING = 0.5
"""Share of a cycle in which a foot stands."""
DEPTH = 0.27
"""Of a standing foot's centre below the hips, metres."""
LIFT = 0.07
"""Of a swinging foot, metres."""


def trot(time: Tensor, command: Tensor) -> Tensor:
    """The joint angles of a trot.

    Args:
        time: [B] float64, seconds since some cycle began.
        command: [B, 2] float64, metres per second ahead and radians per second to the left.

    Returns:
        [B, 12] float64, radians: hip, thigh and calf of each leg.
    """
    return torch.cat([leg_angles(foot, side) for foot, side in zip(feet(time, command), SIDES, strict=True)], 1)


def feet(time: Tensor, command: Tensor) -> list[Tensor]:
    """Where the feet of a trot are from their hips, [B, 3] float64 metres each; see ``trot``."""
    found = []
    for (x, y), side, begin in zip(HIPS, SIDES, BEGINS, strict=True):
        phase = (time * FREQUENCY + begin) % 1.0
        swing = ((phase - STANDING) / (1.0 - STANDING)).clamp(0.0, 1.0)
        back = torch.where(phase < STANDING, phase / STANDING, 0.5 * (1.0 + (math.pi * swing).cos()))
        stride = STANDING / FREQUENCY * (0.5 - back)  # seconds of the commanded motion by which the foot is ahead
        ahead = stride * (command[:, 0] - command[:, 1] * (y + side * OFFSET))
        aside = stride * command[:, 1] * x
        lift = LIFT * 0.5 * (1.0 - (2.0 * math.pi * swing).cos())
        found.append(torch.stack([ahead, side * OFFSET + aside, lift - DEPTH], 1))
    return found


def leg_angles(foot: Tensor, side: float) -> Tensor:
    """The angles of a leg's joints that put its foot somewhere, or as near as it reaches.

    Args:
        foot: [B, 3] float64, from the hip, metres: ahead, left and up.
        side: 1 for a leg on the left, −1 on the right.

    Returns:
        [B, 3] float64, radians: hip, thigh and calf.
    """
    x, y, z = foot.unbind(1)
    offset = side * OFFSET
    down = (y * y + z * z - offset * offset).clamp_min(1e-6).sqrt()
    hip = torch.atan2(y, -z) - torch.atan2(torch.full_like(down, offset), down)
    cosine = (x * x + down * down - THIGH * THIGH - CALF * CALF) / (2.0 * THIGH * CALF)
    calf = -cosine.clamp(-0.999, 0.999).acos()
    thigh = torch.atan2(-x, down) - torch.atan2(CALF * calf.sin(), THIGH + CALF * calf.cos())
    return torch.stack([hip, thigh, calf], 1)
