import math

import pytest
import torch

from splatrl.cameras import Cameras, depths_at, intrinsics, look_at, pixel_places


def test_the_edge_of_the_image_is_half_the_field_of_view_from_the_axis() -> None:
    K = intrinsics(1.2, 64, 48)
    ray = torch.linalg.solve(K, torch.tensor([64.0, 24.0, 1.0]))
    assert math.atan2(ray[0], ray[2]) == pytest.approx(0.6, rel=1e-5)
    assert K[0, 0] == K[1, 1] and K[0, 2] == 32 and K[1, 2] == 24


@pytest.mark.parametrize("fov", [0.0, -1.0, math.pi, math.nan])
def test_a_field_of_view_that_no_pinhole_camera_has_is_refused(fov: float) -> None:
    with pytest.raises(ValueError, match=r"fov: expected an angle in \(0, π\) radians"):
        intrinsics(fov, 8, 8)


def test_look_at_points_z_forward_x_right_and_y_down() -> None:
    camera_to_world = look_at([1.0, 2.0, 3.0], [1.0, 7.0, 3.0])
    right, down, forward, position = camera_to_world[:3].T
    assert forward.tolist() == pytest.approx([0, 1, 0])
    assert right.tolist() == pytest.approx([1, 0, 0])
    assert down.tolist() == pytest.approx([0, 0, -1])
    assert position.tolist() == [1, 2, 3]


@pytest.mark.parametrize("target", [[0.0, 0.0, 5.0], [0.0, 0.0, -5.0], [3.0, -4.0, 2.0]])
def test_look_at_is_a_rotation_even_straight_up_and_down(target: list[float]) -> None:
    rotation = look_at([0.0, 0.0, 0.0], target)[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3), atol=1e-6, rtol=0)
    assert rotation.det() == pytest.approx(1, abs=1e-5)


def test_look_at_broadcasts_many_positions_over_one_target() -> None:
    positions = torch.tensor([[1.0, 0.0, 0.0], [0.0, 2.0, 0.5], [-1.0, -1.0, 3.0]])
    poses = look_at(positions, [0.0, 0.0, 0.0])
    assert poses.shape == (3, 4, 4)
    torch.testing.assert_close(poses[:, :3, 2], -torch.nn.functional.normalize(positions, dim=1))


def test_one_set_of_intrinsics_is_shared_by_the_batch() -> None:
    cameras = Cameras(torch.eye(4).repeat(3, 1, 1), intrinsics(1.0, 8, 6), 8, 6)
    assert cameras.K.shape == (3, 3, 3)
    assert len(cameras) == 3


def test_rows_are_taken_by_slice_mask_and_index() -> None:
    poses = torch.eye(4).repeat(4, 1, 1)
    poses[:, 0, 3] = torch.arange(4.0)
    cameras = Cameras(poses, intrinsics(1.0, 8, 6), 8, 6)
    for rows, expected in (
        (slice(1, 3), [1, 2]),
        (torch.tensor([True, False, False, True]), [0, 3]),
        (torch.tensor([2, 2, 0]), [2, 2, 0]),
    ):
        taken = cameras[rows]
        assert taken.camera_to_world[:, 0, 3].tolist() == expected
        assert (len(taken.K), taken.width, taken.height) == (len(expected), 8, 6)


def test_wrong_shapes_are_refused_by_name() -> None:
    poses, K = torch.eye(4).repeat(3, 1, 1), intrinsics(1.0, 8, 6)
    with pytest.raises(ValueError, match=r"camera_to_world: expected shape \[B, 4, 4\], got \[4, 4\]"):
        Cameras(torch.eye(4), K, 8, 6)
    with pytest.raises(ValueError, match="camera_to_world: expected a tensor, got 1"):
        Cameras(1, 2, 3, 4)
    with pytest.raises(ValueError, match="K: expected a tensor, got None"):
        Cameras(poses, None, 8, 6)
    with pytest.raises(ValueError, match=r"K: expected shape \[3, 3, 3\]"):
        Cameras(poses, K.repeat(2, 1, 1), 8, 6)
    with pytest.raises(ValueError, match="height: expected a whole number of pixels from 1 to 65536"):
        Cameras(poses, K, 8, 0)


K = torch.tensor([[4.0, 0.0, 2.2], [0.0, 6.0, 1.3], [0.0, 0.0, 1.0]], dtype=torch.float64)
POSE = look_at([1.0, 2.0, 3.0], [2.0, 5.0, 2.0]).double()
DEPTH = 1.0 + torch.rand(3, 5, generator=torch.Generator().manual_seed(0))


def test_a_pixel_is_unprojected_along_the_ray_through_its_centre() -> None:
    places = pixel_places(DEPTH, POSE, K).view(3, 5, 3)
    ray = torch.tensor([(3.5 - 2.2) / 4.0, (1.5 - 1.3) / 6.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(places[1, 3], POSE[:3, :3] @ (DEPTH[1, 3] * ray) + POSE[:3, 3])


def test_unprojected_pixels_are_as_deep_as_their_image_says() -> None:
    deep, told = depths_at(pixel_places(DEPTH, POSE, K), DEPTH, POSE, K, 0.0)
    torch.testing.assert_close(deep, DEPTH.flatten().double(), atol=1e-6, rtol=0)
    assert torch.equal(told, DEPTH.flatten().double())


def test_an_image_tells_nothing_of_points_beyond_its_edges_or_too_near() -> None:
    pixels = [(-0.1, 1.0), (0.1, 1.0), (4.9, 1.0), (5.1, 1.0), (2.0, -0.1), (2.0, 0.1), (2.0, 2.9), (2.0, 3.1)]
    rays = torch.tensor([[(u - 2.2) / 4.0, (v - 1.3) / 6.0, 1.0] for u, v in pixels], dtype=torch.float64)
    for deep, seen in ((2.0, [False, True, True, False] * 2), (0.4, [False] * 8), (-2.0, [False] * 8)):
        z, told = depths_at(deep * rays @ POSE[:3, :3].T + POSE[:3, 3], DEPTH, POSE, K, 0.5)
        torch.testing.assert_close(z, torch.full((8,), deep, dtype=torch.float64), atol=1e-6, rtol=0)
        assert (told > 0).tolist() == seen
