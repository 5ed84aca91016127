import math
import runpy

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from splatrl import geometry
from splatrl.geometry import (
    CAMERA_TO_BODY,
    along_heading,
    atan2,
    axis_rotations,
    azimuths,
    invert_rigid,
    multiply_quats,
    quat_yaws,
    quats_to_rotations,
    rigid,
    rotations_to_quats,
    wrapped,
    yaw_quat,
)

seeds = st.integers(0, 2**31)


def random_quats(seed: int, *shape: int) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(*shape, 4, generator=g, dtype=torch.float64), dim=-1)


@given(seeds)
def test_a_rotation_survives_conversion_to_a_quaternion_and_back(seed: int) -> None:
    rotations = quats_to_rotations(random_quats(seed, 3, 5))
    quats = rotations_to_quats(rotations)
    assert quats.shape == (3, 5, 4)
    assert (quats[..., 0] >= 0).all()
    torch.testing.assert_close(quats_to_rotations(quats), rotations, atol=1e-12, rtol=0)


@pytest.mark.parametrize("quat", [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0], [1e-9, 1, -1, 1]])
def test_half_turns_keep_their_quaternion(quat: list[float]) -> None:
    expected = torch.nn.functional.normalize(torch.tensor(quat, dtype=torch.float64), dim=0)
    torch.testing.assert_close(rotations_to_quats(quats_to_rotations(expected)), expected)


@given(seeds)
def test_a_quaternion_of_any_length_gives_a_rotation(seed: int) -> None:
    rotations = quats_to_rotations(7.5 * random_quats(seed, 4))
    identity = torch.eye(3, dtype=torch.float64).expand(4, 3, 3)
    torch.testing.assert_close(rotations @ rotations.mT, identity, atol=1e-12, rtol=0)
    torch.testing.assert_close(rotations.det(), torch.ones(4, dtype=torch.float64))


@given(seeds)
def test_the_yaw_of_a_quaternion_is_that_of_its_x_axis(seed: int) -> None:
    quats = random_quats(seed, 3, 5)
    torch.testing.assert_close(quat_yaws(quats), azimuths(quats_to_rotations(quats)[..., 0]))


def test_a_quaternion_about_z_turns_x_towards_y() -> None:
    quat = torch.tensor([math.cos(math.pi / 6), 0.0, 0.0, math.sin(math.pi / 6)])  # 60 degrees
    turned = quats_to_rotations(quat) @ torch.tensor([1.0, 0.0, 0.0])
    torch.testing.assert_close(turned, torch.tensor([0.5, math.sqrt(3) / 2, 0.0]))


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5, 4.0])
def test_the_quaternion_of_a_yaw_turns_counter_clockwise_about_z(yaw: float) -> None:
    quat, angle = torch.tensor(yaw_quat(yaw), dtype=torch.float64), torch.tensor(yaw, dtype=torch.float64)
    torch.testing.assert_close(quats_to_rotations(quat), axis_rotations(2, angle), atol=1e-12, rtol=0)


@given(seeds)
def test_the_product_of_quaternions_is_the_product_of_rotations(seed: int) -> None:
    a, b = random_quats(seed, 6), random_quats(seed + 1, 6)
    expected = quats_to_rotations(a) @ quats_to_rotations(b)
    torch.testing.assert_close(quats_to_rotations(multiply_quats(a, b)), expected)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_axis_rotations_are_right_handed_and_keep_their_axis_fixed(axis: int) -> None:
    rotation = axis_rotations(axis, torch.tensor([math.pi / 2]))[0]
    basis = torch.eye(3)
    torch.testing.assert_close(rotation @ basis[axis], basis[axis])
    torch.testing.assert_close(rotation @ basis[(axis + 1) % 3], basis[(axis + 2) % 3], atol=1e-7, rtol=0)


def test_axis_rotations_keep_the_shape_and_type_of_the_angles() -> None:
    rotations = axis_rotations(1, torch.zeros(2, 5, dtype=torch.float64))
    assert rotations.shape == (2, 5, 3, 3) and rotations.dtype == torch.float64


def test_angles_wrap_to_at_most_half_a_turn() -> None:
    angles = torch.tensor([0.5, 2.0, 4.0, -4.0, 0.5 + 3 * math.tau], dtype=torch.float64)
    expected = torch.tensor([0.5, 2.0, 4.0 - math.tau, math.tau - 4.0, 0.5], dtype=torch.float64)
    torch.testing.assert_close(wrapped(angles), expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_angles_are_those_of_pytorch_with_the_same_bytes_in_any_batch(dtype: torch.dtype) -> None:
    y, x = torch.randn(2, 1001, generator=torch.Generator().manual_seed(0), dtype=dtype)
    y[:6], x[:6] = (torch.tensor(side) for side in ([0.0, 0.0, 1.0, -1.0, -0.0, 0.0], [1.0, -1.0, 0.0, 0.0, -1.0, 0.0]))
    torch.testing.assert_close(atan2(y, x), torch.atan2(y, x), atol=4 * torch.finfo(dtype).eps, rtol=0)
    assert torch.equal(atan2(y, x)[:6], torch.atan2(y, x)[:6])
    assert torch.equal(azimuths(torch.stack([x, y], 1)), atan2(y, x))
    assert torch.equal(torch.cat([atan2(*few) for few in zip(y.split(7), x.split(7), strict=True)]), atan2(y, x))
    assert torch.equal(torch.cat([wrapped(few) for few in (9.0 * x).split(7)]), wrapped(9.0 * x))


def test_azimuths_are_the_yaw_of_a_body_that_looks_along_the_vectors() -> None:
    yaw = torch.linspace(-3.0, 3.0, 7)
    torch.testing.assert_close(azimuths(axis_rotations(2, yaw)[:, :, 0]), yaw)


def test_a_heading_is_ahead_of_itself_and_a_quarter_turn_further_is_to_its_left() -> None:
    yaw = torch.linspace(-3.0, 3.0, 7)
    axes = axis_rotations(2, yaw)[:, :2]
    torch.testing.assert_close(along_heading(2.0 * axes[:, :, 0], yaw), torch.tensor([[2.0, 0.0]]).expand(7, 2))
    torch.testing.assert_close(along_heading(3.0 * axes[:, :, 1], yaw), torch.tensor([[0.0, 3.0]]).expand(7, 2))


@given(seeds)
def test_the_inverse_undoes_a_rigid_transform(seed: int) -> None:
    g = torch.Generator().manual_seed(seed)
    transform = rigid(quats_to_rotations(random_quats(seed, 2, 3)), torch.randn(2, 3, 3, generator=g).double())
    identity = torch.eye(4, dtype=torch.float64).expand(2, 3, 4, 4)
    torch.testing.assert_close(invert_rigid(transform) @ transform, identity, atol=1e-12, rtol=0)


def test_rigid_broadcasts_one_rotation_over_many_translations() -> None:
    translations = torch.arange(6.0).reshape(2, 3)
    transforms = rigid(torch.eye(3), translations)
    assert torch.equal(transforms[:, :3, 3], translations)
    assert torch.equal(transforms[:, 3], torch.tensor([[0.0, 0.0, 0.0, 1.0]] * 2))


def test_a_camera_on_a_body_looks_forward_with_its_right_to_the_bodys_right() -> None:
    camera_right, camera_down, camera_forward = CAMERA_TO_BODY[:3, :3].T
    assert camera_forward.tolist() == [1, 0, 0]  # the body's x
    assert camera_right.tolist() == [0, -1, 0]  # the body's y is left
    assert camera_down.tolist() == [0, 0, -1]
    assert CAMERA_TO_BODY.det() == 1


def test_the_module_can_be_imported_under_another_default_dtype() -> None:
    torch.set_default_dtype(torch.float64)
    try:
        imported = runpy.run_path(geometry.__file__)
    finally:
        torch.set_default_dtype(torch.float32)
    assert imported["CAMERA_TO_BODY"].dtype == torch.float32
