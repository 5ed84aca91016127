"""A camera that follows a robot, for videos of those that have bodies to be seen."""

import math

import torch
from torch import Tensor
from torch.nn.functional import avg_pool1d, max_pool1d, pad

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision.base import Checker
from splatrl.geometry import axis_rotations, rigid

AWAY = 5.0
"""Distance of the camera from the robot, radii of its body."""
NEAREST = 0.35
"""Share of that distance to which walls behind the robot may push the camera."""
ROOMY = 0.7
"""Share of that distance for which there must be room all along, or else another side is tried."""
SIDES_DEG, ELEVATIONS_DEG = (0.0, 40.0, -40.0, 80.0, -80.0, 180.0), (25.0, 45.0, 65.0)
"""Where the camera may be: angles off straight behind the robot, and above it; the first that has room is taken."""
SMOOTH = 6
"""Steps before and after one over whose poses the camera's way is averaged."""
FOV_DEG = 60.0


def chase_cameras(
    planar: Tensor,
    place: Tensor,
    radius: float,
    checker: Checker,
    size: tuple[int, int],
    device: torch.device | str = "cpu",
) -> Cameras:
    """Cameras that follow a robot smoothly through an episode, always from the same side, in front of what is solid.

    Args:
        planar: [T, 3] float64 x and y in metres and yaw in radians of the robot.
        place: [T, 3] float32 its centre, world, metres.
        radius: of its body, metres.
        checker: knows what is solid.
        size: width and height of the images, pixels.
        device: on which the checker works.

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
    """Means over as many rows before and after each: [T, D] -> [T, D]."""
    padded = pad(values.T[None], (reach, reach), "replicate")
    return avg_pool1d(padded, 2 * reach + 1, 1)[0].T
