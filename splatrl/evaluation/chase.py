"""A chase camera that follows a robot, for videos of robots with visible bodies."""

import math

import torch
from torch import Tensor
from torch.nn.functional import avg_pool1d, max_pool1d, pad

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision.base import Checker
from splatrl.geometry import axis_rotations, rigid

AWAY = 5.0
"""Distance of the camera from the robot, in radii of its body."""
NEAREST = 0.35
"""Smallest fraction of that distance to which walls may push the camera towards the robot."""
ROOMY = 0.7
"""Fraction of that distance that must stay free throughout the episode; otherwise another side is tried."""
SIDES_DEG, ELEVATIONS_DEG = (0.0, 40.0, -40.0, 80.0, -80.0, 180.0), (25.0, 45.0, 65.0)
"""Candidate camera directions: azimuths from straight behind the robot, and elevations; the first with room wins."""
SMOOTH = 6
"""Half-width, in steps, of the window over which the camera's path is averaged."""
FOV_DEG = 60.0


def chase_cameras(
    planar: Tensor,
    place: Tensor,
    radius: float,
    checker: Checker,
    size: tuple[int, int],
    device: torch.device | str = "cpu",
) -> Cameras:
    """Place cameras that follow a robot smoothly through an episode, always from the same side.

    The cameras close in where walls would block the view.

    Args:
        planar: [T, 3] float64, the robot's x and y in metres and yaw in radians.
        place: [T, 3] float32, the robot's centre, world frame, metres.
        radius: radius of the robot's body, metres.
        checker: casts rays against what is solid.
        size: width and height of the images, pixels.
        device: device of the checker.

    Returns:
        T cameras, on the CPU.
    """
    aim, away = _averaged(place.float(), SMOOTH), AWAY * radius
    heading = torch.stack([planar[:, 2].sin(), planar[:, 2].cos()], 1).float()
    yaw = torch.atan2(*_averaged(heading, 2 * SMOOTH).unbind(1))
    level = rigid(axis_rotations(2, yaw), aim)
    beams = torch.tensor([_behind(side, up) for up in ELEVATIONS_DEG for side in SIDES_DEG])
    room = checker.ranges(level.to(device), beams.to(device), away + 0.5 * radius).cpu() - 0.5 * radius  # [T, R]
    least = room.amin(0)
    roomy = (least >= ROOMY * away).nonzero().flatten()
    beam = int(roomy[0]) if len(roomy) else int(least.argmax())
    window = 2 * SMOOTH + 1
    free = -max_pool1d(pad(-room[:, beam][None, None], (SMOOTH, SMOOTH), "replicate"), window, 1)[0, 0]
    distance = _averaged(free.clamp(NEAREST * away, away).unsqueeze(1), SMOOTH)
    eye = aim + distance * (level[:, :3, :3] @ beams[beam])
    return Cameras(look_at(eye, aim), intrinsics(math.radians(FOV_DEG), *size), *size)


def _behind(side_deg: float, up_deg: float) -> tuple[float, float, float]:
    side, up = math.radians(side_deg), math.radians(up_deg)
    return -math.cos(side) * math.cos(up), math.sin(side) * math.cos(up), math.sin(up)


def _averaged(values: Tensor, reach: int) -> Tensor:
    """Return the moving average over ``reach`` rows before and after each row: [T, D] -> [T, D]."""
    padded = pad(values.T[None], (reach, reach), "replicate")
    return avg_pool1d(padded, 2 * reach + 1, 1)[0].T
