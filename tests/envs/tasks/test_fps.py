"""The fps task."""

import math
from typing import Any

import pytest
import torch

from splatrl.envs.tasks import Fps, Outcome, Rewards
from splatrl.motions import ForwardMotion
from tests.envs.tasks.steps import judged
from tests.tiny import HEIGHT

EDGE = 0.6


def fps(goal: tuple[float, ...] = (0.5, -0.2, 0.0), **settings: Any) -> Fps:
    """Make the fps task with steps of 0.1 m and 10° in the square of ±0.6 m."""
    return Fps(ForwardMotion(HEIGHT, lower=(-EDGE, -EDGE), upper=(EDGE, EDGE)), goal, **settings)


def reached(task: Fps, x: float, y: float, yaw_deg: float) -> bool:
    return bool(task.reached(torch.tensor([[x, y, math.radians(yaw_deg)]])))


@pytest.mark.parametrize(
    ("x", "y", "yaw_deg", "there"),
    [
        (0.5, -0.2, 0.0, True),
        (0.6, -0.2, 0.0, True),  # each limit is part of the goal
        (0.4, -0.2, 0.0, True),
        (0.6001, -0.2, 0.0, False),
        (0.3999, -0.2, 0.0, False),
        (0.5, -0.1, 0.0, True),
        (0.5, -0.3, 0.0, True),
        (0.5, -0.0999, 0.0, False),
        (0.5, -0.3001, 0.0, False),
        (0.5, -0.2, 10.0, True),
        (0.5, -0.2, 350.0, True),  # angles wrap
        (0.5, -0.2, 10.1, False),
        (0.5, -0.2, 349.9, False),
        (0.5, -0.2, 180.0, False),
        (0.6, -0.1, 350.0, True),  # each limit separately: 0.14 m away
    ],
)
def test_the_goal_is_within_one_step_along_each_axis_and_one_turn(
    x: float, y: float, yaw_deg: float, there: bool
) -> None:
    assert reached(fps(), x, y, yaw_deg) is there


@pytest.mark.parametrize("turns", [-720.0, -360.0, 360.0])
def test_whole_turns_do_not_move_the_goal(turns: float) -> None:
    states = ForwardMotion(HEIGHT, lower=(-EDGE, -EDGE), upper=(EDGE, EDGE)).states()
    for yaw in (0.0, 45.0, 355.0):
        plain, turned = fps((0.2, 0.1, yaw)), fps((0.2, 0.1, yaw + turns))
        assert torch.equal(plain.reached(states), turned.reached(states)) and plain.reached(states).any()


@pytest.mark.parametrize(
    ("next_state", "hit", "outcome", "reward"),
    [
        ((0.0, 0.0, 0.0), False, Outcome.RUNNING, -1.0),
        ((0.5, -0.2, 0.0), False, Outcome.GOAL, 5.0),
        ((0.5, -0.2, 0.0), True, Outcome.COLLISION, -2.0),  # takes precedence over the goal
        ((0.0, 0.0, 0.0), True, Outcome.COLLISION, -2.0),
        ((0.605, -0.2, 0.0), False, Outcome.OUT_OF_BOUNDS, -3.0),  # takes precedence over the goal
        ((0.605, -0.2, 0.0), True, Outcome.COLLISION, -2.0),  # takes precedence over the bounds
        ((0.0, -0.7, 0.0), False, Outcome.OUT_OF_BOUNDS, -3.0),
    ],
)
def test_a_step_is_judged_by_collision_then_bounds_then_goal(
    next_state: tuple[float, ...], hit: bool, outcome: Outcome, reward: float
) -> None:
    task = fps((0.52, -0.2, 0.0), rewards=Rewards(goal=5.0, step=-1.0, collision=-2.0, out_of_bounds=-3.0))
    ahead = torch.tensor([next_state])
    assert task.reached(ahead).item() is (next_state[0] > 0.4)
    verdict = judged(task, ahead, torch.tensor([hit]))
    assert verdict.outcome.tolist() == [[outcome]] and verdict.terminated.tolist() == [[outcome != Outcome.RUNNING]]
    assert verdict.reward.tolist() == [[reward]] and verdict.reward.dtype == torch.float32


def test_the_published_rewards_and_limit_are_the_defaults() -> None:
    ahead = torch.tensor([[0.0, 0.0, 0.0], [0.5, -0.2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.9, 0.0]])
    hit = torch.tensor([False, False, True, False])
    verdict = judged(fps(), ahead, hit)
    torch.testing.assert_close(verdict.reward, torch.tensor([[-0.2], [50.0], [-10.0], [-10.0]]))
    assert fps().max_steps == 200


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal": (0.0, 1.0)}, r"task\.goal: expected finite x, y \(metres\) and yaw \(degrees\), got \(0\.0, 1\.0\)"),
        ({"goal": None}, r"task\.goal: .* got None"),
        ({"goal": (0.0, math.nan, 0.0)}, r"task\.goal"),
        ({"max_steps": 0}, r"task\.max_steps: expected a whole number of at least 1, got 0"),
    ],
)
def test_an_invalid_goal_or_limit_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fps(**change)
