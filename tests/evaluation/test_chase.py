"""The camera that follows a robot in videos."""

import math

import numpy as np
import torch
from torch import Tensor

from splatrl.bodies import Sphere
from splatrl.collision import NativeChecker, Occupancy
from splatrl.evaluation.chase import AWAY, chase_cameras

RADIUS, SIZE = 0.2, (32, 24)


def walk(steps: int = 40, turn: float = 0.0) -> tuple[Tensor, Tensor]:
    """Walk along +x with a heading that alternates by ``turn`` radians: planar [T, 3] and body positions [T, 3]."""
    along = torch.linspace(0.0, 2.0, steps)
    yaw = turn * (torch.arange(steps) % 2 - 0.5)
    planar = torch.stack([along, torch.zeros(steps), yaw], 1).double()
    return planar, torch.stack([along, torch.zeros(steps), torch.full((steps,), 0.3)], 1)


def boxes(*solid: tuple[tuple[float, float, float], tuple[float, float, float]]) -> NativeChecker:
    """Return a collision checker for solid boxes, each given by its lower and upper corner."""
    occupied = np.zeros((60, 60, 30), bool)
    for lower, upper in solid:
        low, high = (
            [round((at - origin) / 0.1) for at, origin in zip(corner, (-3.0, -3.0, 0.0), strict=True)]
            for corner in (lower, upper)
        )
        occupied[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
    return NativeChecker(Occupancy(occupied, (-30, -30, 0), 0.1), Sphere(RADIUS))


def test_the_camera_looks_at_the_robot_from_behind_and_above() -> None:
    planar, place = walk()
    cameras = chase_cameras(planar, place, RADIUS, boxes(), SIZE)
    assert len(cameras) == 40 and (cameras.width, cameras.height) == SIZE
    eye, ahead = cameras.camera_to_world[:, :3, 3], cameras.camera_to_world[:, :3, 2]
    middle = slice(10, 30)  # away from both ends, where the smoothed position is the robot's own
    way = place - eye
    assert torch.allclose(way[middle].norm(dim=1), torch.tensor(AWAY * RADIUS), atol=1e-4)
    assert torch.allclose(torch.nn.functional.normalize(way, dim=1)[middle], ahead[middle], atol=1e-4)
    assert (eye[middle, 0] < place[middle, 0]).all() and (eye[:, 2] > 0.5).all()


def test_a_swinging_heading_does_not_shake_the_camera() -> None:
    steady, shaken = (
        chase_cameras(*walk(turn=turn), RADIUS, boxes(), SIZE).camera_to_world[:, :3, 3]
        for turn in (0.0, math.radians(60.0))
    )
    assert (steady - shaken)[10:30].norm(dim=1).max() < 0.15  # fewer steps are averaged near both ends


def test_the_camera_stays_in_front_of_a_wall_behind_the_robot() -> None:
    planar, place = walk()
    wall = boxes(((-0.7, -3.0, 0.0), (-0.5, 3.0, 3.0)))
    eye = chase_cameras(planar, place, RADIUS, wall, SIZE).camera_to_world[:, :3, 3]
    assert (eye[:, 0] > -0.5).all()
    free = chase_cameras(planar, place, RADIUS, boxes(), SIZE).camera_to_world[:, :3, 3]
    assert (free[:, 0] < -0.5).any(), "without the wall, the camera is where the wall would be"


def test_the_camera_moves_to_another_side_where_there_is_no_room_behind() -> None:
    """A robot that moves along a wall with its back to it is seen from a side with room."""
    planar, place = walk()
    planar[:, 2] = math.pi / 2  # it moves sideways along the wall, its back to it
    wall = boxes(((-3.0, -0.5, 0.0), (3.0, -0.3, 3.0)))
    eye = chase_cameras(planar, place, RADIUS, wall, SIZE).camera_to_world[:, :3, 3]
    assert (eye[:, 1] > -0.3).all()
    assert ((eye - place).norm(dim=1)[10:30] > 0.6 * AWAY * RADIUS).all()
