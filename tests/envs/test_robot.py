"""The robot's camera."""

import math

import pytest
import torch
from torch import Tensor

from splatrl.bodies import Sphere
from splatrl.envs import Robot
from splatrl.geometry import axis_rotations, rigid

ROOT = math.sqrt(0.5)


def body_at(yaw: float) -> Tensor:
    """Return a ``body_to_world`` [1, 4, 4] away from the origin."""
    return rigid(axis_rotations(2, torch.tensor([yaw])), torch.tensor([[1.0, 2.0, 0.7]]))


def robot(pitch_deg: float = 0.0) -> Robot:
    return Robot(Sphere(0.1), 0.7, pitch_deg, fov_deg=60.0, image_width=20, image_height=10)


def axes(camera_to_world: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the camera's right, down and forward directions in the world."""
    right, down, forward = camera_to_world[0, :3, :3].unbind(1)
    return right, down, forward


def test_the_camera_looks_along_the_bodys_x_with_the_image_upright() -> None:
    cameras = robot().cameras(body_at(math.pi / 2))
    right, down, forward = axes(cameras.camera_to_world)
    torch.testing.assert_close(forward, torch.tensor([0.0, 1.0, 0.0]))
    torch.testing.assert_close(right, torch.tensor([1.0, 0.0, 0.0]))
    torch.testing.assert_close(down, torch.tensor([0.0, 0.0, -1.0]))
    torch.testing.assert_close(cameras.camera_to_world[0, :3, 3], torch.tensor([1.0, 2.0, 0.7]))


def test_pitch_looks_down_and_keeps_the_horizon_level() -> None:
    right, down, forward = axes(robot(pitch_deg=45.0).cameras(body_at(math.pi / 2)).camera_to_world)
    torch.testing.assert_close(forward, torch.tensor([0.0, ROOT, -ROOT]))
    torch.testing.assert_close(right, torch.tensor([1.0, 0.0, 0.0]))
    torch.testing.assert_close(down, torch.tensor([0.0, -ROOT, -ROOT]))


def test_the_field_of_view_spans_the_width_of_the_image() -> None:
    cameras = robot().cameras(body_at(0.0))
    assert (cameras.width, cameras.height) == (20, 10)
    focal = 10 / math.tan(math.radians(30))
    torch.testing.assert_close(cameras.K[0], torch.tensor([[focal, 0, 10], [0, focal, 5], [0, 0, 1.0]]))


@pytest.mark.parametrize(
    ("offset", "forward", "down"),
    [
        ([0, 0, 0, 0, 0, 0], (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
        ([0, 0, 0, math.pi / 4, 0, 0], (0.0, ROOT, ROOT), (0.0, ROOT, -ROOT)),  # about right: looks up
        ([0, 0, 0, 0, math.pi / 4, 0], (0.0, 1.0, 0.0), (-ROOT, 0.0, -ROOT)),  # about forward: leans right
        ([0, 0, 0, 0, 0, math.pi / 4], (ROOT, ROOT, 0.0), (0.0, 0.0, -1.0)),  # about down: turns right
        ([0, 0, 0, math.pi / 2, 0, math.pi / 2], (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # pitch first, then its own yaw
    ],
)
def test_an_offset_turns_about_the_cameras_own_axes(
    offset: list[float], forward: tuple[float, ...], down: tuple[float, ...]
) -> None:
    cameras = robot().cameras(body_at(math.pi / 2), torch.tensor([offset], dtype=torch.float32))
    _, seen_down, seen_forward = axes(cameras.camera_to_world)
    torch.testing.assert_close(seen_forward, torch.tensor(forward), atol=1e-6, rtol=0)
    torch.testing.assert_close(seen_down, torch.tensor(down), atol=1e-6, rtol=0)


def test_an_offset_moves_along_the_worlds_axes_whatever_the_heading() -> None:
    poses = torch.cat([body_at(0.3), body_at(2.0)])
    offset = torch.tensor([[0.1, -0.2, 0.3, 0.0, 0.0, 0.0]]).expand(2, 6)
    still = robot(20.0).cameras(poses).camera_to_world
    moved = robot(20.0).cameras(poses, offset).camera_to_world
    torch.testing.assert_close(moved[:, :3, 3] - still[:, :3, 3], offset[:, :3])
    assert torch.equal(moved[:, :3, :3], still[:, :3, :3])


def test_a_height_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match=r"robot\.height: expected a number from .*, got nan"):
        Robot(Sphere(0.1), math.nan)


def test_a_body_that_is_no_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^robot\.body: expected a Box, Sphere or Capsule, got 1$"):
        Robot(1, 1.0)
