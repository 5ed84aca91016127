"""Motion by steps around an object and towards it."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from splatrl.geometry import invert_rigid
from splatrl.motions import OrbitMotion
from tests.tiny import tiny_robot

ORIGIN = (0.75, 1.0, 0.5)
PLUS_AZIMUTH, MINUS_AZIMUTH, PLUS_ELEVATION, MINUS_ELEVATION, PLUS_DISTANCE, MINUS_DISTANCE = range(6)


def hemisphere() -> OrbitMotion:
    """Make a motion with 12 azimuths, 5 distances and 4 elevations."""
    return OrbitMotion(ORIGIN, 30.0, 0.25, (0.5, 1.5), (0.0, 90.0))


def state_at(azimuth: int, distance: int, elevation: int) -> Tensor:
    return torch.tensor([[azimuth, distance, elevation]])


def test_the_origin_is_in_the_middle_of_every_image() -> None:
    motion = hemisphere()
    states = motion.states()
    cameras = tiny_robot().cameras(motion.body_to_world(states))
    origin = torch.tensor([*ORIGIN, 1.0])
    x, y, z, _ = (invert_rigid(cameras.camera_to_world) @ origin).unbind(1)
    assert len(states) == 12 * 5 * 4 and (z > 0.4).all()
    focal = cameras.K[:, 0, 0]
    torch.testing.assert_close(focal * x / z + cameras.K[:, 0, 2], torch.full_like(x, 8.0), atol=1e-4, rtol=0)
    torch.testing.assert_close(focal * y / z + cameras.K[:, 1, 2], torch.full_like(x, 6.0), atol=1e-4, rtol=0)
    torch.testing.assert_close(z, motion.sphere(states)[:, 1].float(), atol=1e-5, rtol=0)


def test_the_image_is_upright() -> None:
    motion = hemisphere()
    states = motion.states()
    states = states[states[:, 2] < 3]  # from straight above no direction is up
    poses = motion.body_to_world(states)
    assert (poses[:, 2, 2] > 0.4).all()
    assert poses[:, 2, 1].abs().max() < 1e-6  # the body's left is level
    rotation = poses[:, :3, :3]
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3).expand_as(rotation), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("state", "place", "forward"),
    [
        ((0, 0, 0), (1.25, 1.0, 0.5), (-1.0, 0.0, 0.0)),
        ((3, 4, 0), (0.75, 2.5, 0.5), (0.0, -1.0, 0.0)),  # a quarter turn counter-clockwise
        ((6, 2, 0), (-0.25, 1.0, 0.5), (1.0, 0.0, 0.0)),
        ((0, 2, 1), (0.75 + math.cos(math.pi / 6), 1.0, 1.0), (-math.cos(math.pi / 6), 0.0, -0.5)),
        ((5, 2, 3), (0.75, 1.0, 1.5), (0.0, 0.0, -1.0)),  # straight down
    ],
)
def test_poses_match_those_worked_out_by_hand(
    state: tuple[int, int, int], place: tuple[float, float, float], forward: tuple[float, float, float]
) -> None:
    pose = hemisphere().body_to_world(state_at(*state))[0]
    assert pose.dtype == torch.float32
    torch.testing.assert_close(pose[:3, 3], torch.tensor(place), atol=1e-6, rtol=0)
    torch.testing.assert_close(pose[:3, 0], torch.tensor(forward), atol=1e-6, rtol=0)


def test_planar_is_the_pose_seen_from_above() -> None:
    motion = hemisphere()
    states = motion.states()
    planar, pose = motion.planar(states), motion.body_to_world(states)
    torch.testing.assert_close(planar[:, :2].float(), pose[:, :2, 3], atol=1e-6, rtol=0)
    level = states[:, 2] < 3
    heading = torch.stack([planar[:, 2].cos(), planar[:, 2].sin()], 1)[level].float()
    torch.testing.assert_close(heading, torch.nn.functional.normalize(pose[level, :2, 0]), atol=1e-5, rtol=0)


def test_azimuths_wrap_around_and_distances_and_elevations_do_not() -> None:
    motion, corner = hemisphere(), state_at(11, 4, 3)
    assert motion.advance(corner, torch.tensor([PLUS_AZIMUTH])).tolist() == [[0, 4, 3]]
    assert motion.advance(state_at(0, 0, 0), torch.tensor([MINUS_AZIMUTH])).tolist() == [[11, 0, 0]]
    for state, action, ahead in (
        (corner, PLUS_ELEVATION, [11, 4, 4]),
        (corner, PLUS_DISTANCE, [11, 5, 3]),
        (state_at(0, 0, 0), MINUS_ELEVATION, [0, 0, -1]),
        (state_at(0, 0, 0), MINUS_DISTANCE, [0, -1, 0]),
    ):
        moved = motion.advance(state, torch.tensor([action]))
        assert moved.tolist() == [ahead] and not motion.inside(moved).any()
    assert motion.inside(motion.states()).all()


@pytest.mark.parametrize(
    ("distance", "elevation_deg", "names", "shape"),
    [
        ((0.75, 0.75), (0.0, 0.0), ("+azimuth", "-azimuth"), (12, 1, 1)),
        ((0.5, 1.5), (0.0, 0.0), ("+azimuth", "-azimuth", "+distance", "-distance"), (12, 5, 1)),
        (
            (0.5, 1.5),
            (0.0, 90.0),
            ("+azimuth", "-azimuth", "+elevation", "-elevation", "+distance", "-distance"),
            (12, 5, 4),
        ),
    ],
)
def test_exactly_the_coordinates_that_vary_have_actions(
    distance: tuple[float, float], elevation_deg: tuple[float, float], names: tuple[str, ...], shape: tuple[int, ...]
) -> None:
    motion = OrbitMotion(ORIGIN, 30.0, 0.25, distance, elevation_deg)
    assert motion.action_names == names and motion.action_spec.n == len(names) and motion.shape == shape
    before = state_at(1, 0, 0).expand(len(names), 3)
    change = motion.sphere(motion.advance(before, torch.arange(len(names)))) - motion.sphere(before)
    for row, name in enumerate(names):
        axis = ("azimuth", "distance", "elevation").index(name[1:])
        expected = [0.0, 0.0, 0.0]
        expected[axis] = float(f"{name[0]}1") * (0.25 if axis == 1 else math.pi / 6)
        assert change[row].tolist() == pytest.approx(expected)


def test_states_lists_each_state_once_and_index_finds_it() -> None:
    motion = hemisphere()
    states = motion.states()
    assert torch.equal(motion.index(states), torch.arange(len(states)))
    assert motion.state_spec.is_in(states[-1]) and not motion.state_spec.is_in(states[-1] + 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"origin": None}, r"task\.motion\.origin: expected x, y and z in metres, got None"),
        ({"origin": (0.0, 1.0)}, r"task\.motion\.origin"),
        ({"origin": (0.0, math.nan, 1.0)}, r"task\.motion\.origin"),
        ({"origin": (0.0, "a", 1.0)}, r"task\.motion\.origin"),
        ({"origin": 1.0}, r"task\.motion\.origin: expected x, y and z in metres, got 1\.0"),
        ({"distance": (0.5, math.inf)}, r"task\.motion\.distance: expected two finite numbers"),
        ({"distance": 0.5}, r"task\.motion\.distance: expected two finite numbers, .* got 0\.5"),
        (
            {"distance": (0.5, 1e6)},
            r"task\.motion: expected at most 16,777,216 states, got [\d,]+ \(12 × 3,999,999 × 4\)",
        ),
        ({"distance": (0.0, 1.0)}, r"task\.motion: expected 0 < distance\[0\]"),
        ({"distance": (1.5, 0.5)}, r"task\.motion: expected 0 < distance\[0\] ≤ distance\[1\]"),
        ({"elevation_deg": (0.0, 120.0)}, r"task\.motion: expected .* got \[0\.5, 1\.5\] and \[0\.0, 120\.0\]"),
        ({"elevation_deg": (30.0, 0.0)}, r"task\.motion: expected"),
        ({"angle_step_deg": 25.0}, r"task\.motion\.angle_step_deg: expected a whole number of steps of 25\.0 in 360"),
        ({"distance_step": 0.3}, r"task\.motion\.distance: expected a whole number of steps of 0\.3 in 1,"),
        ({"elevation_deg": (0.0, 85.0)}, r"task\.motion\.elevation_deg: expected a whole number of steps"),
    ],
)
def test_invalid_settings_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OrbitMotion(**{"origin": ORIGIN, "angle_step_deg": 30.0, "distance_step": 0.25, **change})
