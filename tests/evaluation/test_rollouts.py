"""Running episodes from given starts."""

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from splatrl.curriculum import Plan, plan
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks import Outcome
from splatrl.envs.transforms import Appearance, FrameSkip, Latency
from splatrl.evaluation.rollouts import Episodes, run_episodes
from tests.tiny import BlockChecker, CountingRenderer, tiny_env, tiny_plan, tiny_task


class Planner:
    """Follows the shortest path, but takes a random action with probability ``slip``."""

    def __init__(self, slip: float = 0.0, found: Plan | None = None):
        self.plan, self.slip = found or tiny_plan(), slip

    def __call__(self, td: TensorDictBase) -> TensorDictBase:
        best = self.plan.optimal(td["state"]).int().argmax(1)
        slips = torch.rand(len(best)) < self.slip
        td["action"] = torch.where(slips, torch.randint(0, 6, best.shape), best)
        return td


def starts() -> torch.Tensor:
    plan = tiny_plan()
    return plan.states[plan.start_rows]


@pytest.mark.parametrize(("robots", "stride"), [(1, 12), (7, 3), (64, 3)])
def test_the_planner_reaches_the_goal_from_every_start_in_the_fewest_steps(robots: int, stride: int) -> None:
    plan = tiny_plan()
    some = starts()[::stride]
    shortest = plan.distance[plan.start_rows][::stride]
    finished = []
    episodes = run_episodes(tiny_env([robots], max_steps=50), Planner(), some, progress=finished.append)
    assert episodes.success.all()
    assert torch.equal(episodes.length, shortest)
    assert episodes.step_spl(shortest) == 1.0
    torch.testing.assert_close(episodes.episode_return, 50 - 0.2 * (shortest - 1).float())
    assert sum(finished) == len(some)


def test_episodes_that_all_end_together_count_in_part_while_they_run() -> None:
    counted: list[int] = []

    def stays(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.full((len(td),), 4))  # turns on the spot

    episodes = run_episodes(tiny_env([8], max_steps=16), stays, starts()[:16], progress=counted.append)
    assert (episodes.length == 16).all()
    assert len(counted) == 32 and min(counted) >= 0 and sum(counted) == 16
    assert np.abs(np.cumsum(counted) - np.linspace(0.5, 16, 32)).max() <= 1.0


def test_the_planner_with_repeated_actions_reaches_the_goal_in_the_fewest_steps() -> None:
    task = tiny_task()
    found = plan(task.motion, BlockChecker(), task.reached, repeats=2)
    shortest = found.distance[found.start_rows]
    env = StatefulEnv(tiny_env([64], max_steps=50), FrameSkip(2))
    episodes = run_episodes(env, Planner(found=found), found.starts)
    assert torch.equal(episodes.length, shortest) and episodes.step_spl(shortest) == 1.0
    assert set((shortest % 2).tolist()) == {0, 1}  # an action that reaches the goal may end after one step


def test_robots_without_a_start_are_not_rendered() -> None:
    plan, env = tiny_plan(), tiny_env([8], max_steps=50)
    order = plan.distance[plan.start_rows].argsort()
    some = starts()[torch.cat([order[:3], order[-1:]])]  # three short episodes and a long one, for eight robots
    shortest = torch.cat([plan.distance[plan.start_rows][order[:3]], plan.distance[plan.start_rows][order[-1:]]])
    env.drawing.renderer = counting = CountingRenderer(env.drawing.renderer)
    episodes = run_episodes(env, Planner(), some)
    assert torch.equal(episodes.length, shortest)
    assert counting.rendered == 8 + int(shortest.sum())


def test_a_step_is_read_from_the_device_once(monkeypatch: pytest.MonkeyPatch) -> None:
    env, steps, reads, read = tiny_env([16], max_steps=9), list[int](), list[int](), torch.Tensor.cpu
    monkeypatch.setattr(torch.Tensor, "cpu", lambda self: reads.append(self.numel()) or read(self))

    def counting(td: TensorDictBase) -> TensorDictBase:
        steps.append(len(td))
        return Planner(0.3)(td)

    run_episodes(env, counting, starts()[:40])
    assert reads == [6 * 16] * len(steps)


def test_every_outcome_is_assigned_to_its_own_start() -> None:
    some = starts()[:40]
    forward = run_episodes(tiny_env([6], max_steps=9), lambda td: td.set("action", torch.zeros(6).long()), some)
    alone = [
        run_episodes(tiny_env([1], max_steps=9), lambda td: td.set("action", torch.zeros(1).long()), start[None])
        for start in some
    ]
    assert forward.outcome.tolist() == [int(one.outcome) for one in alone]
    assert forward.length.tolist() == [int(one.length) for one in alone]
    assert len(set(forward.outcome.tolist())) > 2
    assert sum(forward.rate(outcome) for outcome in Outcome) == pytest.approx(1.0)


def test_a_seed_gives_the_same_episodes_and_leaves_the_global_generator_alone() -> None:
    torch.manual_seed(3)
    before = torch.get_rng_state()
    first, again, other = (
        run_episodes(tiny_env([8], max_steps=9), Planner(0.5), starts()[:50], seed=seed) for seed in (0, 0, 1)
    )
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(first.length, again.length) and torch.equal(first.outcome, again.outcome)
    assert not torch.equal(first.length, other.length)


def test_evaluation_episodes_do_not_advance_the_curriculum() -> None:
    env = tiny_env([4], first=1, window=1, threshold=0.01)
    run_episodes(env, Planner(), starts()[:20])
    assert env.curriculum.level == 0


def test_nothing_of_an_episode_reaches_the_next_one_of_its_robot() -> None:
    some = starts()[::9]
    late = {"camera": (0, 0), "action": (1, 1)}
    found = [
        run_episodes(StatefulEnv(tiny_env([robots], max_steps=9), Latency(**late)), Planner(), some)
        for robots in (1, 3, len(some))
    ]
    for one in found[1:]:
        assert torch.equal(one.outcome, found[0].outcome) and torch.equal(one.length, found[0].length)
    looks: list[float] = []

    def watching(td: TensorDictBase) -> TensorDictBase:
        looks.extend(td["appearance"][:, 0].tolist())
        return Planner()(td)

    run_episodes(StatefulEnv(tiny_env([3], max_steps=9), Appearance()), watching, some)
    assert len(set(looks)) == len(some)


def test_spl_weights_success_by_the_length_of_the_shortest_over_the_taken_path() -> None:
    outcome = torch.tensor([Outcome.GOAL, Outcome.GOAL, Outcome.TIMEOUT, Outcome.COLLISION])
    length = torch.tensor([4, 8, 20, 1])
    reached = outcome == Outcome.GOAL
    episodes = Episodes(torch.zeros(4, 3), outcome, length, torch.zeros(4), reached.long(), reached)
    assert episodes.step_spl(torch.tensor([4, 2, 5, 3])) == pytest.approx((1 + 2 / 8) / 4)
    assert episodes.step_spl(torch.tensor([5, 2, 5, 3])) == pytest.approx((1 + 2 / 8) / 4)  # each ratio is at most 1
    assert episodes.rate(Outcome.TIMEOUT) == 0.25
