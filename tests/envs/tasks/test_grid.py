"""The grid task."""

import math
from typing import Any

import pytest
import torch

from splatrl.envs.tasks import Grid, Outcome, Rewards
from tests.envs.tasks.steps import judged
from tests.tiny import tiny_motion, tiny_task


def test_the_goal_covers_27_lattice_poses() -> None:
    task = tiny_task()
    states = task.motion.states()
    reached = states[task.reached(states)]
    assert len(reached) == 27
    assert sorted({int(i) for i in reached[:, 0]}) == [2, 3, 4]
    assert sorted({int(i) for i in reached[:, 1]}) == [4, 5, 6]
    assert sorted({int(i) for i in reached[:, 2]}) == [0, 1, 7]


@pytest.mark.parametrize("goal", [(0.25, 0.75, 22.5), (0.45, 0.95, 4.5), (0.55, 1.05, -4.5)])
def test_a_goal_between_lattice_poses_covers_8_of_them(goal: tuple[float, float, float]) -> None:
    task = Grid(tiny_motion(), goal)
    assert task.reached(task.motion.states()).sum() == 2 * 2 * 2


@pytest.mark.parametrize("turns", [-720, -360, 360, 1080])
def test_whole_turns_do_not_move_the_goal(turns: int) -> None:
    states = tiny_motion().states()
    for yaw in (0.0, 45.0, 170.0, -10.0):
        plain, turned = (Grid(tiny_motion(), goal=(0.5, 1.0, yaw + extra)) for extra in (0, turns))
        assert torch.equal(plain.reached(states), turned.reached(states))
        assert plain.reached(states).any()


@pytest.mark.parametrize(
    ("next_state", "hit", "outcome", "reward"),
    [
        ([0, 0, 0], False, Outcome.RUNNING, -1.0),
        ([3, 5, 0], False, Outcome.GOAL, 5.0),
        ([3, 5, 0], True, Outcome.COLLISION, -2.0),  # takes precedence over the goal
        ([1, 3, 0], True, Outcome.COLLISION, -2.0),
        ([5, 5, 0], False, Outcome.OUT_OF_BOUNDS, -3.0),
        ([5, 5, 0], True, Outcome.COLLISION, -2.0),  # takes precedence over the bounds
        ([-1, 2, 4], False, Outcome.OUT_OF_BOUNDS, -3.0),
    ],
)
def test_a_step_is_judged_by_collision_then_bounds_then_goal(
    next_state: list[int], hit: bool, outcome: Outcome, reward: float
) -> None:
    task = Grid(
        tiny_motion(), (0.75, 1.0, 0.0), rewards=Rewards(goal=5.0, step=-1.0, collision=-2.0, out_of_bounds=-3.0)
    )
    verdict = judged(task, torch.tensor([next_state]), torch.tensor([hit]))
    assert verdict.outcome.tolist() == [[outcome]]
    assert verdict.reward.tolist() == [[reward]] and verdict.reward.dtype == torch.float32
    assert verdict.terminated.tolist() == [[outcome != Outcome.RUNNING]]


def test_out_of_bounds_takes_precedence_over_a_goal_that_the_step_would_reach() -> None:
    task = Grid(tiny_motion(), (1.0, 1.0, 0.0))
    ahead = torch.tensor([[5, 5, 0]])
    assert task.reached(ahead).all()
    assert judged(task, ahead, torch.tensor([False])).outcome.tolist() == [[Outcome.OUT_OF_BOUNDS]]


def test_the_published_rewards_are_the_defaults() -> None:
    states = torch.tensor([[0, 0, 0], [3, 5, 0], [0, 0, 0], [-1, 0, 0]])
    hit = torch.tensor([False, False, True, False])
    verdict = judged(tiny_task(), states, hit)
    torch.testing.assert_close(verdict.reward, torch.tensor([[-0.2], [50.0], [-10.0], [-10.0]]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal": (0.0, 1.0)}, r"task\.goal: expected finite x, y \(metres\) and yaw \(degrees\), got \(0\.0, 1\.0\)"),
        ({"goal": 5}, r"task\.goal: expected finite .* got 5; type another landmarks\.goal"),
        ({"goal": (".nan", 0.4, 0.0)}, r"task\.goal: expected finite .* got \('\.nan', 0\.4, 0\.0\)"),
        ({"goal": (0.0, math.inf, 0.0)}, r"task\.goal"),
        ({"max_steps": 0}, r"task\.max_steps: expected a whole number of at least 1, got 0"),
    ],
)
def test_an_invalid_goal_or_limit_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Grid(tiny_motion(), **{"goal": (0.0, 0.0, 0.0), **change})
