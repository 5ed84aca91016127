import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.collision.displacement import Displacement, checked_poses
from splatrl.geometry import axis_rotations, quats_to_rotations, rigid


def random_poses(count: int, seed: int, reach: float = 1.0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    quats = torch.randn(count, 4, generator=generator, dtype=torch.float64)
    places = (torch.rand(count, 3, generator=generator, dtype=torch.float64) * 2 - 1) * reach
    return rigid(quats_to_rotations(quats), places)


def path(move: Displacement, row: int) -> torch.Tensor:
    """Return all poses of one row: [steps + 1, 4, 4]."""
    return torch.cat([move.at(torch.tensor([row]), torch.tensor([index])) for index in range(int(move.steps[row]) + 1)])


def test_rigid_poses_are_returned_as_float64():
    poses = random_poses(5, 0).float()
    checked = checked_poses("start", poses)
    assert checked.dtype == torch.float64
    assert torch.equal(checked.float(), poses)
    assert checked_poses("start", poses[:0]).shape == (0, 4, 4)


def spoil(pose: torch.Tensor, fault: str) -> None:
    match fault:
        case "nan":
            pose[0, 3] = math.nan
        case "infinite":
            pose[1, 3] = math.inf
        case "scaled":
            pose[:3, :3] *= 1.01
        case "sheared":
            pose[0, :3] += 0.1
        case "mirrored":
            pose[:3, 0] *= -1.0
        case "projective":
            pose[3, 1] = 0.5


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("nan", "finite numbers"),
        ("infinite", "finite numbers"),
        ("scaled", "an orthonormal rotation"),
        ("sheared", "an orthonormal rotation"),
        ("mirrored", "a rotation, not a reflection"),
        ("projective", "a bottom row of 0, 0, 0, 1"),
    ],
)
def test_the_first_pose_that_is_not_rigid_is_named(fault, expected):
    poses = random_poses(6, 1)
    for row in (3, 5):
        spoil(poses[row], fault)
    with pytest.raises(ValueError, match=f"start: expected {expected}, got .* in row 3"):
        checked_poses("start", poses)


def test_poses_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"end: expected shape \[B, 4, 4\], got \[4, 4\]"):
        checked_poses("end", torch.eye(4))


def test_a_move_starts_and_ends_exactly_where_it_should():
    start, end = random_poses(20, 2), random_poses(20, 3)
    move = Displacement(start, end, 0.5, 0.1)
    for row in range(20):
        poses = path(move, row)
        assert torch.equal(poses[0], start[row])
        assert torch.equal(poses[-1], end[row])


def test_the_origin_moves_straight_and_the_body_turns_at_a_constant_rate():
    start = torch.eye(4, dtype=torch.float64)[None]
    turn = axis_rotations(2, torch.tensor([1.2], dtype=torch.float64))
    end = rigid(turn, torch.tensor([[0.6, -0.3, 0.0]], dtype=torch.float64))
    poses = path(Displacement(start, end, 0.5, 0.1), 0)
    steps = len(poses) - 1
    assert steps == math.ceil((math.hypot(0.6, 0.3) + 0.5 * 1.2) / 0.1)
    shares = torch.linspace(0, 1, steps + 1, dtype=torch.float64)
    torch.testing.assert_close(poses[:, :3, 3], shares[:, None] * end[0, :3, 3])
    torch.testing.assert_close(poses[:, :3, :3], axis_rotations(2, 1.2 * shares))


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), max_travel=st.floats(0.05, 0.5), radius=st.floats(0.05, 1.0))
def test_no_point_of_the_body_travels_further_than_allowed_between_two_poses(seed, max_travel, radius):
    move = Displacement(random_poses(3, seed), random_poses(3, seed + 1), radius, max_travel)
    surface = torch.nn.functional.normalize(
        torch.randn(50, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64), dim=1
    )
    for row in range(3):
        poses = path(move, row)
        points = radius * surface @ poses[:, :3, :3].mT + poses[:, None, :3, 3]
        assert points.diff(dim=0).norm(dim=2).max() <= max_travel + 1e-12


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000))
def test_a_move_and_its_reverse_have_bitwise_equal_poses(seed):
    start, end = random_poses(4, seed), random_poses(4, seed + 1)
    end[2] = start[2].clone()
    end[3, :3, :3] = start[3, :3, :3] @ axis_rotations(0, torch.tensor(math.pi, dtype=torch.float64))
    forth, back = Displacement(start, end, 0.4, 0.1), Displacement(end, start, 0.4, 0.1)
    assert torch.equal(forth.steps, back.steps)
    for row in range(4):
        assert torch.equal(path(forth, row), path(back, row).flip(0))


def test_a_pure_translation_keeps_the_given_rotation():
    start = random_poses(2, 5)
    end = start.clone()
    end[:, :3, 3] += torch.tensor([0.3, 0.1, 0.0])
    poses = path(Displacement(start, end, 0.4, 0.05), 1)
    assert len(poses) > 5
    assert torch.equal(poses[:, :3, :3], start[1, :3, :3].expand(len(poses), 3, 3))


def test_the_body_turns_the_shorter_way_round():
    start = torch.eye(4, dtype=torch.float64)[None]
    end = rigid(axis_rotations(2, torch.tensor([3.5], dtype=torch.float64)), torch.zeros(1, 3, dtype=torch.float64))
    poses = path(Displacement(start, end, 1.0, 0.1), 0)
    assert len(poses) - 1 == math.ceil((2 * math.pi - 3.5) / 0.1)
    assert (poses[1:-1, 1, 0] < 0).all()


def test_a_turn_across_180_degrees_goes_the_shorter_way_too():
    yaw = torch.tensor([2.9, -2.9], dtype=torch.float64)
    start, end = rigid(axis_rotations(2, yaw), torch.zeros(2, 3, dtype=torch.float64)).split(1)
    poses = path(Displacement(start, end, 1.0, 0.1), 0)
    assert len(poses) - 1 == math.ceil((2 * math.pi - 5.8) / 0.1)
    assert (poses[:, 0, 0] <= math.cos(2.9) + 1e-12).all()


def test_batches_of_different_length_are_refused():
    with pytest.raises(ValueError, match="end: expected 3 poses, as many as in start, got 2"):
        Displacement(random_poses(3, 0), random_poses(2, 0), 0.1, 0.1)
