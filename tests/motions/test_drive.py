"""The motion of a differential drive."""

import math
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from splatrl.motions import DriveMotion
from tests.tiny import HEIGHT


def drive(motion: DriveMotion, state: list[float], linear: float, angular: float) -> Tensor:
    """Return the state that one action leads to: [3]."""
    return motion.advance(torch.tensor([state]), torch.tensor([[linear, angular]]))[0]


def euler(state: list[float], linear: float, angular: float, seconds: float, parts: int = 20000) -> Tensor:
    """Return the same state by integrating many small straight moves in double precision: [3]."""
    yaw = state[2] + angular * seconds / parts * (torch.arange(parts, dtype=torch.float64) + 0.5)
    length = linear * seconds / parts
    x, y = state[0] + length * yaw.cos().sum(), state[1] + length * yaw.sin().sum()
    return torch.stack([x, y, torch.tensor((state[2] + angular * seconds) % math.tau)]).float()


@given(st.floats(-0.25, 0.5), st.floats(-1.5, 1.5), st.floats(0, 6.2), st.sampled_from([0.2, 1.0]))
def test_the_path_is_the_exact_arc(linear: float, angular: float, yaw: float, seconds: float) -> None:
    state = [0.3, -0.2, yaw]
    found = drive(DriveMotion(HEIGHT, seconds), state, linear, angular)
    expected = euler(state, linear, angular, seconds)
    torch.testing.assert_close(found[:2], expected[:2], atol=2e-6, rtol=0)
    assert abs(math.remainder(float(found[2] - expected[2]), math.tau)) < 2e-6


def test_a_quarter_circle_ends_beside_its_centre() -> None:
    motion = DriveMotion(HEIGHT, time_step=1.0)  # at 90° per second
    radius = 0.5 / (math.pi / 2)
    left = drive(motion, [0.0, 0.0, 0.0], 0.5, math.pi / 2)
    torch.testing.assert_close(left, torch.tensor([radius, radius, math.pi / 2]), atol=1e-6, rtol=0)
    right = drive(motion, [0.0, 0.0, 0.0], 0.5, -math.pi / 2)
    torch.testing.assert_close(right, torch.tensor([radius, -radius, 1.5 * math.pi]), atol=1e-6, rtol=0)
    astern = drive(motion, [0.1, 0.2, math.pi / 2], -0.25, math.pi / 2)
    torch.testing.assert_close(astern, torch.tensor([0.1 + radius / 2, 0.2 - radius / 2, math.pi]), atol=1e-6, rtol=0)


def test_without_turning_the_path_is_straight() -> None:
    found = drive(DriveMotion(HEIGHT), [0.3, -0.2, math.pi / 6], 0.5, 0.0)
    expected = [0.3 + 0.1 * math.cos(math.pi / 6), -0.2 + 0.05, math.pi / 6]
    torch.testing.assert_close(found, torch.tensor(expected), atol=1e-6, rtol=0)


def test_without_driving_it_turns_on_the_spot() -> None:
    found = drive(DriveMotion(HEIGHT), [0.3, -0.2, 0.1], 0.0, -1.0)
    torch.testing.assert_close(found, torch.tensor([0.3, -0.2, math.tau - 0.1]), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("asked", "given_"),
    [((3.0, 0.0), (0.5, 0.0)), ((-3.0, 0.1), (-0.25, 0.1)), ((0.2, 9.0), (0.2, 1.5708)), ((0.2, -9.0), (0.2, -1.5708))],
)
def test_velocities_beyond_the_limits_are_clamped(asked: tuple[float, float], given_: tuple[float, float]) -> None:
    motion, state = DriveMotion(HEIGHT), [0.3, -0.2, 0.7]
    torch.testing.assert_close(drive(motion, state, *asked), drive(motion, state, *given_), atol=1e-5, rtol=0)


def test_an_action_is_a_linear_and_an_angular_velocity() -> None:
    spec = DriveMotion(HEIGHT, linear=(-0.1, 0.4), angular_deg=45.0).action_spec
    assert spec.shape == (2,) and spec.dtype == torch.float32
    torch.testing.assert_close(spec.low, torch.tensor([-0.1, -math.pi / 4]))
    torch.testing.assert_close(spec.high, torch.tensor([0.4, math.pi / 4]))
    motion = DriveMotion(HEIGHT)
    assert motion.step == pytest.approx(0.1) and motion.angle_step == pytest.approx(math.radians(18))


@pytest.mark.parametrize(("linear", "count"), [((-0.25, 0.5), 8), ((0.0, 0.5), 5)])
def test_planned_actions_are_distinct_within_the_limits_and_never_stand_still(
    linear: tuple[float, float], count: int
) -> None:
    motion = DriveMotion(HEIGHT, linear=linear)
    actions = motion.actions()
    assert len(actions.unique(dim=0)) == len(actions) == count
    assert actions.abs().sum(1).min() > 0
    assert all(motion.action_spec.is_in(action) for action in actions)


def test_episodes_begin_on_a_lattice_of_places_and_headings() -> None:
    motion = DriveMotion(HEIGHT, lower=(-1.0, -1.5), upper=(1.0, 1.5), spacing=0.5, headings=6)
    states = motion.states()
    assert states.shape == (5 * 7 * 6, 3) and motion.inside(states).all()
    torch.testing.assert_close(states[:, 2].unique(), torch.arange(6) * (math.tau / 6))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_step": 0.0}, r"task\.motion\.time_step: expected a number of seconds above 0\.0, got 0\.0"),
        ({"linear": (0.1, 0.5)}, r"task\.motion: expected linear = .* got \[0\.1, 0\.5\] and 90\.0"),
        ({"linear": (-0.2, 0.0)}, r"task\.motion: expected linear"),
        ({"linear": (0.5,)}, r"task\.motion: expected linear"),
        ({"angular_deg": 0.0}, r"task\.motion: expected linear .* angular_deg > 0"),
        ({"headings": 0}, r"task\.motion: expected spacing > 0 and headings ≥ 1, got 0\.1 and 0"),
        ({"lower": (1.0, -1.0)}, r"task\.motion: expected lower < upper"),
        (
            {"time_step": 1e-320},
            r"task\.motion: expected a turn of at least 1e-06 radians within time_step",
        ),
        ({"angular_deg": math.inf}, r"task\.motion: expected a turn of at least"),
    ],
)
def test_invalid_settings_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DriveMotion(HEIGHT, **change)


def test_paths_in_a_large_place_whose_starts_lie_far_apart_take_no_more_nodes_than_in_a_small_one() -> None:
    small, large = (DriveMotion(HEIGHT, upper=(x, 1.0), spacing=0.1 * x) for x in (1.0, 7.0))
    assert len(large.nodes()) < len(small.nodes())
    assert (small.cell, large.cell) == (0.05, pytest.approx(0.15))


def test_more_poses_for_shortest_paths_than_fit_into_memory_are_refused() -> None:
    motion = DriveMotion(HEIGHT, lower=(-100.0, -100.0), upper=(100.0, 100.0), spacing=0.4)
    with pytest.raises(ValueError, match=r"at most 16,777,216 poses for shortest paths, .* in steps of 0\.1 m"):
        motion.nodes()
