import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.geometry import axis_rotations
from splatrl.scenes import Gaussians, read_gaussians
from splatrl.scenes.frame import similarity
from splatrl.scenes.stated import StatedFrame
from splatrl.scenes.walls import CLEAR, find_walls
from tests.scenes.places import place
from tests.scenes.test_survey import corridor, lying, room


def turned(gaussians: Gaussians, degrees: float, axes: tuple[str, ...]) -> Gaussians:
    """Return an upright place in a file that has it turned about up, and whose axes are others."""
    yaw = math.radians(degrees)
    turn = torch.eye(4, dtype=torch.float64)
    turn[:2, :2] = torch.tensor([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    return lying(gaussians.transformed(turn), similarity(axes))


def frame_of(file: Gaussians, stated: StatedFrame | None = None, origin: tuple[float, ...] = (0.0, 0.0, 0.0)) -> dict:
    stated = stated or StatedFrame()
    return stated.frame(stated.guess(file, origin))


@pytest.mark.parametrize("yaw_deg", [-80.0, -30.0, 0.0, 12.5, 45.0, 90.0])
def test_the_longest_wall_of_a_room_is_found_whatever_its_direction(yaw_deg: float) -> None:
    generator = np.random.default_rng(0)
    along = generator.uniform(-1, 1, 900)
    wall = generator.normal(0, 0.01, 900)
    sides = np.concatenate([np.stack([3 * along, 1 + wall], 1), np.stack([3 * along, wall - 1], 1)])
    sides = np.concatenate([sides, np.stack([3 + wall[:300], along[:300]], 1)])
    yaw = math.radians(yaw_deg)
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    walls = find_walls(sides @ turn.T)
    off = (math.degrees(walls.yaw) - yaw_deg + 90.0) % 180.0 - 90.0
    assert abs(off) < 0.5 and walls.gap > CLEAR
    assert find_walls(sides[:5]) == (0.0, 0.0)
    assert find_walls(generator.normal(size=(900, 2))).gap < CLEAR


@pytest.mark.parametrize(("yaw", "lean"), [(31.0, 0.0), (-40.0, 8.0), (1.5, 8.0)])
@pytest.mark.parametrize("axes", [("x", "y", "z"), ("x", "-z", "y")])
@pytest.mark.parametrize("make", [room, corridor])
def test_a_place_is_turned_about_up_until_its_walls_run_along_x_and_y(
    make: Callable[[], Gaussians], axes: tuple[str, ...], yaw: float, lean: float
) -> None:
    upright = make()
    tilt = torch.eye(4, dtype=torch.float64)
    tilt[:3, :3] = axis_rotations(0, torch.tensor([math.radians(lean)], dtype=torch.float64))[0]
    file = turned(upright, yaw, axes).transformed(tilt)
    up = tilt[:3, :3] @ similarity(axes)[2, :3]
    moved = torch.eye(4, dtype=torch.float64)
    moved[:3, :3] = similarity(**frame_of(file, StatedFrame(rough_up=up.tolist())))[:3, :3]
    wall = file.transformed(moved).means[upright.means[:, 1] == upright.means[:, 1].min()]
    spread = wall.amax(0) - wall.amin(0)
    assert spread[:2].min() < 0.01 * spread[:2].max()


def test_straight_walls_and_places_without_clear_walls_keep_the_axes_of_their_file(shared_scenes: Path) -> None:
    kitchen = read_gaussians(shared_scenes / "kitchen" / "kitchen.spz")
    for file in (kitchen, turned(room(), 1.5, ("x", "y", "z")), turned(place("thing", 1), 31.0, ("x", "y", "z"))):
        assert "axes" in frame_of(file)


@pytest.mark.parametrize(
    "stated",
    [StatedFrame(axes=["x", "y", "z"]), StatedFrame(translation=[0.0, 0.0, 1.0]), StatedFrame(transform=torch.eye(4))],
)
def test_a_file_whose_axes_mean_something_is_not_turned(stated: StatedFrame) -> None:
    file = turned(room(), 31.0, ("x", "y", "z"))
    assert "matrix" in frame_of(file)
    rotation = similarity(**frame_of(file, stated))[:3, :3]
    torch.testing.assert_close(rotation, torch.eye(3, dtype=torch.float64))
    assert "axes" in frame_of(file, origin=(432_100.0, 5_412_345.0, 0.0))
    assert "walls" not in str(stated.guess(file)) and "walls       x and y run along them" in str(
        StatedFrame().guess(file)
    )
