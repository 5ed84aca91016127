"""A trot for a quadruped: the positions of its feet over time, and the joint angles that put them there.

Diagonal pairs of feet alternate between stance and swing. Relative to the body, a foot in stance moves opposite to the
commanded motion, as the ground below it does; a foot in swing is lifted and set down ahead. The gait knows nothing of
the robot's balance: a policy that adds small offsets to the joints can take care of that (Iscen et al. 2018, "Policies
Modulating Trajectory Generators"). All operations are element-wise in double precision, so a row has the same bytes in
any batch.
"""

import math

import torch
from torch import Tensor

from splatrl.geometry import atan2

THIGH, CALF, OFFSET = 0.213, 0.213, 0.08
"""Lengths of the thigh, the calf and the hip's sideways offset, metres, as in ``robots/quadruped.xml``."""
LEGS = ("front_left", "front_right", "rear_left", "rear_right")
HIPS = ((0.19, 0.05), (0.19, -0.05), (-0.19, 0.05), (-0.19, -0.05))
"""x and y of the hips of the legs, in the order of the joints."""
NAMES = tuple(f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf"))
"""Names of the joints whose angles a trot consists of."""
SIDES = (1.0, -1.0, 1.0, -1.0)
BEGINS = (0.0, 0.5, 0.5, 0.0)
"""Phase offset of each leg, as a fraction of a cycle."""
FREQUENCY = 3.0
"""Cycles per second."""
STANDING = 0.5
"""Duty factor: fraction of a cycle during which a foot stands."""
DEPTH = 0.27
"""Distance of a standing foot's centre below the hips, metres."""
LIFT = 0.07
"""Height to which a swinging foot is lifted, metres."""


def trot(time: Tensor, command: Tensor) -> Tensor:
    """Return the joint angles of a trot.

    Args:
        time: [B] float64, seconds since the start of some cycle.
        command: [B, 2] float64, metres per second ahead and radians per second to the left.

    Returns:
        [B, 12] float64, radians: hip, thigh and calf of each leg.
    """
    return leg_angles(feet(time, command), time.new_tensor(SIDES)).flatten(1)


def feet(time: Tensor, command: Tensor) -> Tensor:
    """Return the positions of a trot's feet relative to their hips: [B, 4, 3] float64, metres; see ``trot``."""
    (x, y), side = time.new_tensor(HIPS).T, time.new_tensor(SIDES)
    phase = (time.unsqueeze(1) * FREQUENCY + time.new_tensor(BEGINS)) % 1.0
    swing = ((phase - STANDING) / (1.0 - STANDING)).clamp(0.0, 1.0)
    back = torch.where(phase < STANDING, phase / STANDING, 0.5 * (1.0 + (math.pi * swing).cos()))
    stride = STANDING / FREQUENCY * (0.5 - back)  # lead of the foot, in seconds of commanded motion
    ahead = stride * (command[:, :1] - command[:, 1:] * (y + side * OFFSET))
    aside = stride * command[:, 1:] * x
    lift = LIFT * 0.5 * (1.0 - (2.0 * math.pi * swing).cos())
    return torch.stack([ahead, side * OFFSET + aside, lift - DEPTH], 2)


def leg_angles(foot: Tensor, side: Tensor) -> Tensor:
    """Return the joint angles of legs that put their feet at positions, or as near to them as the legs reach.

    Args:
        foot: [B, L, 3] float64, positions relative to the hips, metres: ahead, left and up.
        side: [L] float64, 1 for a leg on the left, −1 on the right.

    Returns:
        [B, L, 3] float64, radians: hip, thigh and calf.
    """
    x, y, z = foot.unbind(2)
    offset = side * OFFSET
    down = (y * y + z * z - offset * offset).clamp_min(1e-6).sqrt()
    hip = atan2(y, -z) - (offset / down).atan()  # as atan2, since down > 0
    cosine = (x * x + down * down - THIGH * THIGH - CALF * CALF) / (2.0 * THIGH * CALF)
    calf = -cosine.clamp(-0.999, 0.999).acos()
    thigh = (-x / down).atan() - atan2(CALF * calf.sin(), THIGH + CALF * calf.cos())
    return torch.stack([hip, thigh, calf], 2)
