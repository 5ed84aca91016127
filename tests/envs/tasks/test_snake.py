"""The snake task."""

from itertools import pairwise

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from splatrl.envs.tasks import Outcome, Snake, Step
from splatrl.motions import Move
from tests.envs.contract import base_env
from tests.envs.rooms import PLACE, apple_plan, coarse_forward, painted_env
from tests.tiny import HEIGHT

FORWARD, BACK, LEFT, RIGHT = range(4)
SEEN = [0.25, 1.0, 0.0]


def snake(max_steps: int = 200) -> Snake:
    return Snake(coarse_forward(), PLACE, max_steps=max_steps)


def placed(states: list[list[float]], targets: list[list[float]]) -> TensorDict:
    return TensorDict({"state": torch.tensor(states), "target": torch.tensor(targets)}, [len(states)])


def column(td: TensorDict, key: str) -> list[float]:
    return td[key].flatten().tolist()


def test_nothing_that_a_robot_does_ends_the_episode() -> None:
    task = snake()
    state = torch.tensor([[0.5, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    free, inside = torch.tensor([1.0, 0.5, 1.0]), torch.tensor([True, True, False])
    move = Move(state, task.motion.body_to_world(state), free, inside)
    grey = torch.zeros(3, 2, 5, 3, dtype=torch.uint8)
    memory = task.begin(state, lambda: state)
    verdict = task.judge(Step(state, torch.zeros(3, dtype=torch.int64), move, memory, grey), lambda: state)
    assert not verdict.terminated.any()
    assert verdict.outcome.flatten().tolist() == [Outcome.RUNNING, Outcome.COLLISION, Outcome.OUT_OF_BOUNDS]
    assert verdict.reward.flatten().tolist() == pytest.approx([-0.2, -10.0, -10.0])
    assert torch.equal(verdict.memory["target"], memory["target"])


def test_a_map_shows_the_apple_that_stands_now_and_none_for_all_episodes() -> None:
    assert snake().marks() == []
    (mark,) = snake().marks({"target": torch.tensor([0.25, -0.5, HEIGHT])})
    assert mark.planar[:2].tolist() == [0.25, -0.5]


def test_a_blocked_robot_stays_and_goes_on() -> None:
    env = painted_env(snake(), 2)
    far = [-0.75, -1.0, HEIGHT]
    td = env.reset(placed([[-0.5, 0.0, 0.0], [1.0, 0.0, 0.0]], [far, far]), set_state=True)
    step = env.step(td.set("action", torch.tensor([FORWARD, FORWARD])))
    after = step["next"]
    assert torch.equal(after["state"], td["state"]) and column(after, "reward") == [-10.0, -10.0]
    assert not after["done"].any() and column(after, "outcome") == [Outcome.COLLISION, Outcome.OUT_OF_BOUNDS]
    goes_on = env.step(env.step_mdp(step).set("action", torch.tensor([BACK, BACK])))["next"]
    torch.testing.assert_close(goes_on["state"][:, 0], torch.tensor([-0.75, 0.75]))
    assert column(goes_on, "episode_return") == pytest.approx([-10.2, -10.2])


def test_a_robot_that_runs_into_something_gets_no_apple_for_it() -> None:
    env = painted_env(snake(), 1)
    td = env.reset(placed([[1.0, 1.0, 0.0]], [[1.0, 1.0, HEIGHT]]), set_state=True)  # at the bound, on the apple
    after = env.step(td.set("action", torch.tensor([FORWARD])))["next"]
    assert column(after, "outcome") == [Outcome.OUT_OF_BOUNDS] and column(after, "reward") == [-10.0]
    assert torch.equal(after["target"], td["target"])


def test_the_target_moves_on_in_exactly_the_step_that_reaches_it() -> None:
    env = painted_env(snake(), 3)
    before = [list(PLACE), list(PLACE), list(PLACE)]
    td = env.reset(placed([SEEN, [0.0, 1.0, 0.0], [-1.0, -1.0, 0.0]], before), set_state=True)
    assert td["target"].tolist() == [pytest.approx(row) for row in before]
    seen: list[Tensor] = [td["target"]]
    rewards, outcomes = [], []
    for actions in ([FORWARD] * 3, [FORWARD] * 3):
        step = env.step(td.set("action", torch.tensor(actions)))
        seen.append(step["next", "target"])
        rewards.append(column(step["next"], "reward"))
        outcomes.append(column(step["next"], "outcome"))
        assert torch.equal(step["target"], seen[-2])  # the input of the step is unchanged
        td = env.step_mdp(step)
        assert not td["done"].any()
    moved = [(a != b).any(1).tolist() for a, b in pairwise(seen)]
    assert moved == [[True, False, False], [False, True, False]]
    assert rewards[0] == pytest.approx([50.0, -0.2, -0.2]) and rewards[1][1:] == pytest.approx([50.0, -0.2])
    assert outcomes[0] == [Outcome.GOAL, Outcome.RUNNING, Outcome.RUNNING]
    assert outcomes[1][1:] == [Outcome.GOAL, Outcome.RUNNING]


def test_apples_stand_at_free_places_all_over_the_start_set() -> None:
    env = painted_env(snake(), 500)
    targets = env.reset()["target"]
    plan = apple_plan()
    starts = {tuple(row) for row in plan.states[plan.start_rows][:, :2].tolist()}
    places = {tuple(row) for row in targets[:, :2].tolist()}
    assert places <= starts and len(places) > 80  # of 9 × 13 places, without those in the block
    assert targets[:, 2].unique().tolist() == [HEIGHT]


def test_an_episode_ends_at_its_limit_and_the_last_apple_still_counts() -> None:
    env = painted_env(snake(max_steps=1), 2)
    td = env.reset(placed([SEEN, [-1.0, -1.0, 0.0]], [list(PLACE)] * 2), set_state=True)
    after = env.step(td.set("action", torch.tensor([FORWARD, LEFT])))["next"]
    assert after["truncated"].all() and after["done"].all() and not after["terminated"].any()
    assert column(after, "outcome") == [Outcome.TIMEOUT] * 2
    assert column(after, "reward") == pytest.approx([50.0, -0.2])


def test_a_given_target_is_kept_and_another_is_drawn_where_none_is_given() -> None:
    env = painted_env(snake(), 2)
    state = torch.tensor([SEEN, SEEN])
    given = torch.tensor([[0.1, 0.2, 0.5], [0.3, 0.4, 0.5]])
    td = TensorDict({"state": state, "target": given}, [2])
    assert torch.equal(env.reset(td.clone(), set_state=True)["target"], given)
    drawn = env.reset(td.select("state"), set_state=True)["target"]
    assert (drawn != given).any() and (drawn[:, 2] == HEIGHT).all()


def test_walking_without_end_never_terminates() -> None:
    env = painted_env(snake(max_steps=50), 20)
    torch.manual_seed(0)
    batch = env.rollout(50, break_when_any_done=False)
    assert not batch["next", "terminated"].any() and batch["next", "truncated"].sum() == 20
    assert batch["next", "outcome"].max() == Outcome.TIMEOUT and (batch["next", "outcome"] == Outcome.GOAL).any()
    assert base_env(env).checker.collides(coarse_forward().body_to_world(batch["state"].flatten(0, 1))).sum() == 0
