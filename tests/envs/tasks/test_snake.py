"""The snake task."""

from itertools import pairwise

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from splatrl.envs import SplatEnv
from splatrl.envs.drawing import View
from splatrl.envs.tasks import Outcome, Snake, Step
from splatrl.envs.tasks.base import Anywhere
from splatrl.evaluation import run_episodes, summarise
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
    memory = task.begin(state, Anywhere(lambda: state, torch.Generator()))
    verdict = task.judge(
        Step(state, torch.zeros(3, dtype=torch.int64), move, memory, lambda: View(grey, {})),
        Anywhere(lambda: state, torch.Generator()),
    )
    assert not verdict.terminated.any()
    assert verdict.outcome.flatten().tolist() == [Outcome.RUNNING, Outcome.COLLISION, Outcome.OUT_OF_BOUNDS]
    assert verdict.reward.flatten().tolist() == pytest.approx([-0.2, -10.0, -10.0])
    assert torch.equal(verdict.memory["target"], memory["target"])


def test_a_map_shows_the_current_apple_of_an_episode_and_otherwise_none() -> None:
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


def test_a_long_walk_is_truncated_and_never_terminated() -> None:
    env = painted_env(snake(max_steps=50), 20)
    torch.manual_seed(0)
    batch = env.rollout(50, break_when_any_done=False)
    assert not batch["next", "terminated"].any() and batch["next", "truncated"].sum() == 20
    assert batch["next", "outcome"].max() == Outcome.TIMEOUT and (batch["next", "outcome"] == Outcome.GOAL).any()
    assert base_env(env).checker.collides(coarse_forward().body_to_world(batch["state"].flatten(0, 1))).sum() == 0


def eats(env: SplatEnv, apples: int) -> TensorDictBase:
    """Take a step with three robots, of which the first eats its ``apples``-th apple."""
    states = [SEEN, [-1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]]
    td = env.reset(placed(states, [list(PLACE)] * 3), set_state=True)
    td["goals"] = torch.tensor([[apples - 1], [0], [apples]])
    return env.step(td.set("action", torch.tensor([FORWARD, LEFT, LEFT])))["next"]


@pytest.mark.parametrize("enough", [1, 3])
def test_apples_are_counted_and_enough_of_them_are_a_success(enough: int) -> None:
    after = eats(painted_env(Snake(coarse_forward(), PLACE, apples=enough), 3), enough)
    assert column(after, "goals") == [enough, 0, enough] and column(after, "success") == [True, False, True]
    short = eats(painted_env(Snake(coarse_forward(), PLACE, apples=enough + 1), 3), enough)
    assert column(short, "goals") == [enough, 0, enough] and not short["success"].any()


def test_an_episode_counts_its_own_apples() -> None:
    env = painted_env(snake(max_steps=20), 16)
    torch.manual_seed(0)
    batch = env.rollout(60, break_when_any_done=False)
    eaten = (batch["next", "reward"] == 50.0).long()
    begins = batch["step_count"] == 0
    expected = torch.zeros(16, 1, dtype=torch.int64)
    for step in range(60):
        expected = torch.where(begins[:, step], 0, expected) + eaten[:, step]
        assert torch.equal(batch["next", "goals"][:, step], expected)
    assert torch.equal(batch["next", "success"], batch["next", "goals"] >= 1) and expected.max() > 0


def test_the_curriculum_advances_with_apples_eaten() -> None:
    env = painted_env(snake(max_steps=1), 3, first=1, window=1, threshold=0.3)
    td = env.reset(placed([SEEN, [-1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]], [list(PLACE)] * 3), set_state=True)
    td["level"] = torch.zeros_like(td["level"])
    env.curriculum.begin(torch.ones(3, dtype=torch.bool))
    env.step(td.set("action", torch.tensor([FORWARD, LEFT, LEFT])))
    assert env.curriculum.level == 1


class Straight:
    """A policy that always walks forward."""

    def __call__(self, td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.full(td.batch_size, FORWARD))


def test_an_evaluation_reports_apples_per_episode() -> None:
    env = painted_env(snake(max_steps=5), 2)
    starts = torch.tensor([SEEN, [-1.0, -1.0, 0.0], SEEN])
    episodes = run_episodes(env, Straight(), starts, seed=0)
    summary = summarise(episodes, episodes, None)
    assert summary["mean_goals"] == episodes.goals.double().mean() and "step_spl" not in summary
    assert summary["success_rate"] == (episodes.goals > 0).double().mean()
    assert (episodes.outcome == Outcome.TIMEOUT).all()


@pytest.mark.parametrize("apples", [0, 1.5])
def test_an_invalid_number_of_apples_is_refused(apples: float) -> None:
    with pytest.raises(ValueError, match=r"task\.apples: expected a whole number of at least 1"):
        Snake(coarse_forward(), PLACE, apples=apples)  # type: ignore[arg-type]
