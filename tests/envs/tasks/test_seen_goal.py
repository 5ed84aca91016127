"""Goals that depend on what the image shows."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from splatrl.envs import SplatEnv
from splatrl.envs.tasks import Outcome, Rewards
from tests.envs.contract import base_env
from tests.envs.rooms import PLACE, coarse_apple, painted_env

FORWARD, BACK, LEFT, RIGHT = range(4)
EAST, NORTH, WEST, SOUTH = (0.25 * turn for turn in range(4))
SEEN = [0.25, 1.0, EAST]
"""A state from which one step forward sees the apple from 0.25 m."""


def begin(env: SplatEnv, states: list[list[float]]) -> TensorDictBase:
    """Place robots, x and y in metres and the heading in turns, in an episode that the curriculum counts."""
    state = torch.tensor(states) * torch.tensor([1.0, 1.0, torch.pi * 2])
    td = env.reset(TensorDict({"state": state}, [len(states)]), set_state=True)
    base_env(env).curriculum.begin(torch.ones(len(states), dtype=torch.bool))
    return td.set("level", torch.zeros_like(td["level"]))


def step_from(states: list[list[float]], actions: list[int], **settings: Any) -> TensorDictBase:
    """Take one step with robots placed by hand."""
    env = painted_env(coarse_apple(**settings), len(states))
    return env.step(begin(env, states).set("action", torch.tensor(actions)))["next"]


def column(td: TensorDictBase, key: str) -> list[Any]:
    return td[key].flatten().tolist()


def test_a_goal_that_is_seen_ends_the_episode_with_the_tasks_reward() -> None:
    near_but_blind, far_but_red = [0.25, 1.0, NORTH], [-1.0, 1.0, EAST]
    blind = [0.5, 1.0, EAST]
    states = [SEEN, near_but_blind, far_but_red, blind]
    after = step_from(states, [FORWARD, RIGHT, FORWARD, LEFT], rewards=Rewards(goal=7.0, step=-0.5))
    # the second turns to the east, but two steps away; the last turns away from what it saw
    assert column(after, "outcome") == [Outcome.GOAL, Outcome.RUNNING, Outcome.RUNNING, Outcome.RUNNING]
    assert column(after, "reward") == [7.0, -0.5, -0.5, -0.5] and after["reward"].dtype == torch.float32
    assert column(after, "terminated") == column(after, "done") == [True, False, False, False]
    assert not after["truncated"].any()
    assert torch.equal(after["target"], torch.tensor([PLACE] * 4))


def test_turning_towards_a_near_goal_is_enough() -> None:
    after = step_from([[0.5, 1.0, NORTH], [0.5, 0.75, NORTH]], [RIGHT, RIGHT])
    # from (0.5, 0.75) the apple is 0.35 m away, farther than 1.1 steps
    assert column(after, "outcome") == [Outcome.GOAL, Outcome.RUNNING]


def test_the_return_is_the_sum_of_the_rewards_that_were_given() -> None:
    env = painted_env(coarse_apple(), 2)
    td, total = begin(env, [[0.0, 1.0, EAST], [-1.0, 0.5, WEST]]), torch.zeros(2, 1)
    for actions in ([FORWARD, LEFT], [FORWARD, LEFT]):
        after = env.step(td.set("action", torch.tensor(actions)))
        total += after["next", "reward"]
        assert torch.equal(after["next", "episode_return"], total)
        td = env.step_mdp(after)
    assert total.flatten().tolist() == pytest.approx([49.8, -0.4])
    assert column(td, "outcome") == [Outcome.GOAL, Outcome.RUNNING]


def test_a_goal_in_the_last_step_takes_precedence_over_the_time_limit() -> None:
    after = step_from([SEEN, [-1.0, 1.0, WEST]], [FORWARD, LEFT], max_steps=1)
    assert column(after, "outcome") == [Outcome.GOAL, Outcome.TIMEOUT]
    assert column(after, "terminated") == [True, False] and column(after, "truncated") == [False, True]
    assert after["done"].all() and column(after, "reward") == pytest.approx([50.0, -0.2])


def test_a_collision_or_leaving_the_bounds_is_never_turned_into_a_goal() -> None:
    """Both robots stand at the apple and see red while they run into something."""
    block, east_of_it = [-0.5, 0.0, EAST], (-0.25, 0.0, 0.5)
    env = painted_env(coarse_apple(), 2)
    td = begin(env, [block, [1.0, 1.0, EAST]])
    td["target"] = torch.tensor([east_of_it, PLACE])
    after = env.step(td.set("action", torch.tensor([FORWARD, FORWARD])))["next"]
    task = base_env(env).task
    assert task.seen(after["state"], after["target"], after["pixels"]).all()
    assert column(after, "outcome") == [Outcome.COLLISION, Outcome.OUT_OF_BOUNDS]
    assert column(after, "reward") == [-10.0, -10.0] == column(after, "episode_return")
    assert after["terminated"].all() and not after["truncated"].any()


def test_the_curriculum_counts_each_finished_episode_once() -> None:
    env = painted_env(coarse_apple(max_steps=2), 4, first=2, window=6, threshold=0.5)
    progress = base_env(env).curriculum
    td = begin(env, [SEEN, [0.0, 1.0, EAST], [1.0, 1.0, EAST], [-1.0, 0.5, WEST]])
    after = env.step(td.set("action", torch.tensor([FORWARD, FORWARD, FORWARD, LEFT])))
    assert column(after["next"], "outcome") == [Outcome.GOAL, Outcome.RUNNING, Outcome.OUT_OF_BOUNDS, Outcome.RUNNING]
    assert progress.progress.tolist() == [0, 2, 1]
    td = env.maybe_reset(env.step_mdp(after))
    assert progress.progress.tolist() == [0, 2, 1]  # a reset does not end an episode
    td["level"][0] = td["level"][2] = -1  # episodes placed by hand do not count
    after = env.step(td.set("action", torch.tensor([LEFT, FORWARD, LEFT, LEFT])))["next"]
    assert column(after, "outcome")[1] == Outcome.GOAL and column(after, "outcome")[3] == Outcome.TIMEOUT
    assert progress.progress.tolist() == [0, 4, 2]


def test_seen_goals_advance_the_curriculum() -> None:
    env = painted_env(coarse_apple(), 2, first=2, window=2, threshold=1.0)
    td = begin(env, [SEEN, SEEN])
    env.step(td.set("action", torch.tensor([FORWARD, FORWARD])))
    assert base_env(env).curriculum.progress.tolist() == [1, 0, 0]
    assert (env.reset()["level"] == 1).all()
