"""Frame skip: observations, rewards and outcomes when actions are repeated."""

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, EnvBase, RewardScaling, SerialEnv, TransformedEnv

from splatrl.building import make_env
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks import Outcome
from splatrl.envs.transforms import FrameSkip, FrameStack, Latency, PoseNoise
from splatrl.training.collectors import HostCollector
from tests.envs.contract import EnvContract, assert_same, base_env, seeded_rollout
from tests.envs.rooms import coarse_apple, painted_env
from tests.envs.transforms.views import seeing_env
from tests.tiny import CountingRenderer, tiny_env, tiny_overrides

FORWARD_X, BACK_X, LEFT_Y, RIGHT_Y, SPIN, SPIN_BACK = range(6)


class TestContract(EnvContract):
    """The env contract with two steps per action."""

    steps = 16

    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        return StatefulEnv(tiny_env(batch_size, seed, max_steps=15, first=3, threshold=0.01, window=5), FrameSkip(2))


def placed(env: EnvBase, states: list[list[int]]) -> TensorDictBase:
    return env.reset(TensorDict({"state": torch.tensor(states)}, [len(states)]), set_state=True)


def skipping(steps: int, count: int, **settings: int) -> StatefulEnv:
    return StatefulEnv(tiny_env((count,), **settings), FrameSkip(steps))


def test_an_action_is_carried_out_several_times() -> None:
    env = skipping(3, 2)
    after = env.step(placed(env, [[0, 0, 0], [0, 1, 0]]).set("action", torch.tensor([SPIN, FORWARD_X])))["next"]
    assert after["state"].tolist() == [[0, 0, 3], [3, 1, 0]]
    assert after["reward"].flatten().tolist() == pytest.approx([-0.6, -0.6])
    assert after["step_count"].flatten().tolist() == [3, 3]
    shown = placed(tiny_env((2,)), [[0, 0, 3], [3, 1, 0]])
    assert torch.equal(after["pixels"], shown["pixels"])


def test_a_robot_stops_where_its_episode_ends() -> None:
    env, single = skipping(3, 3), tiny_env((3,))
    starts = [[1, 5, 0], [3, 0, 0], [0, 0, 0]]  # one step to the goal, two to the bounds, and free
    actions = torch.tensor([FORWARD_X, FORWARD_X, SPIN])
    after = env.step(placed(env, starts).set("action", actions))["next"]
    assert after["outcome"].flatten().tolist() == [Outcome.GOAL, Outcome.OUT_OF_BOUNDS, Outcome.RUNNING]
    assert after["reward"].flatten().tolist() == pytest.approx([50.0, -10.2, -0.6])
    assert after["step_count"].flatten().tolist() == [1, 2, 3]
    assert after["done"].flatten().tolist() == [True, True, False]
    first = single.step(placed(single, starts).set("action", actions))["next"]
    for key in ("state", "pixels", "episode_return", "terminated", "free_fraction"):
        assert torch.equal(after[key][0], first[key][0]), key


def test_an_episode_that_ends_during_a_repeated_action_counts_once() -> None:
    env = skipping(4, 1, first=1, window=100)
    td = placed(env, [[1, 5, 0]])
    td["level"] = torch.zeros_like(td["level"])
    base_env(env).curriculum.begin(torch.tensor([True]))
    after = env.step(td.set("action", torch.tensor([FORWARD_X])))["next"]
    assert base_env(env).curriculum.progress.tolist() == [0, 1, 1] and after["level"].tolist() == [[0]]


def test_the_step_limit_counts_env_steps() -> None:
    env = skipping(4, 1, max_steps=6)
    rollout = env.rollout(
        2, lambda td: td.set("action", torch.tensor([SPIN])), auto_reset=False, tensordict=placed(env, [[0, 0, 0]])
    )
    assert rollout["next", "truncated"].flatten().tolist() == [False, True]
    assert rollout["next", "step_count"].flatten().tolist() == [4, 6]


def views_drawn(env: StatefulEnv, states: list[list[float]], actions: list[int]) -> int:
    base = base_env(env)
    td = placed(env, states).set("action", torch.tensor(actions))
    base.drawing.renderer = counting = CountingRenderer(base.drawing.renderer)
    env.step(td)
    return counting.rendered


def test_only_views_that_somebody_sees_are_drawn() -> None:
    states, actions = [[1, 5, 0], [3, 0, 0], [0, 0, 0]], [FORWARD_X, FORWARD_X, SPIN]  # two episodes end early
    assert views_drawn(skipping(4, 3), states, actions) == 3
    assert views_drawn(StatefulEnv(seeing_env((3,)), PoseNoise(x=0.01), FrameSkip(4)), states, actions) == 3
    assert views_drawn(StatefulEnv(tiny_env((3,)), Latency((2, 2), (0, 0)), FrameSkip(4)), states, actions) == 4 * 3


def test_an_entry_called_draw_that_a_policy_writes_changes_no_view() -> None:
    env = skipping(4, 2)
    td = placed(env, [[1, 5, 0], [0, 0, 0]]).set("action", torch.tensor([FORWARD_X, SPIN]))
    seen, also = (env.step(each)["next", "pixels"] for each in (td.clone(), td.clone().set("draw", torch.zeros(2, 1))))
    assert torch.equal(seen, also)


def test_every_view_is_drawn_for_a_task_that_judges_by_it() -> None:
    env = StatefulEnv(painted_env(coarse_apple(), 2), FrameSkip(3))
    assert views_drawn(env, [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]], [2, 3]) == 3 * 2


def test_transforms_inside_act_in_every_step_and_those_outside_once_per_action() -> None:
    inside = StatefulEnv(tiny_env((1,)), RewardScaling(1.0, 1.0), FrameSkip(3))
    outside = StatefulEnv(tiny_env((1,)), FrameSkip(3), RewardScaling(1.0, 1.0))
    paid = []
    for env in (inside, outside):
        after = env.step(placed(env, [[0, 0, 0]]).set("action", torch.tensor([SPIN])))["next"]
        paid.append(after["reward"].item())
    assert paid == pytest.approx([3 - 0.6, 1 - 0.6])
    stacked = StatefulEnv(tiny_env((1,)), FrameSkip(3), FrameStack(2))
    after = stacked.step(placed(stacked, [[0, 0, 0]]).set("action", torch.tensor([SPIN])))["next"]
    views = [placed(tiny_env((1,)), [[0, 0, heading]])["pixels"] for heading in (0, 3)]
    assert torch.equal(after["pixels"], torch.cat(views, -1))


def test_the_camera_shakes_in_every_step() -> None:
    """As many random numbers are drawn as without frame skip, so the last view is the same."""
    noise = {"x": 0.01, "smooth": 3.0}
    skips = StatefulEnv(seeing_env((2,)), PoseNoise(**noise), FrameSkip(3))
    steps = StatefulEnv(seeing_env((2,)), PoseNoise(**noise))
    seen = []
    for env, repeats in ((skips, 1), (steps, 3)):
        env.set_seed(4)
        td = placed(env, [[0, 0, 0], [0, 1, 0]])
        for _ in range(repeats):
            td = env.step_mdp(env.step(td.set("action", torch.tensor([SPIN, SPIN]))))
        seen.append(td.select("pixels", "camera_offset", "state"))
    assert_same(*seen)


def test_action_transforms_are_applied_once_per_step() -> None:
    class Reversed(PoseNoise):
        """An action transform, nearer to the env, that reverses turns."""

        def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
            action = tensordict["action"]
            return tensordict.set("action", torch.where(action >= SPIN, 9 - action, action))

        def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
            return next_tensordict.set("camera_offset", torch.zeros(1, 6))

    env = StatefulEnv(tiny_env((1,)), Reversed(), FrameSkip(2))
    after = env.step(placed(env, [[0, 0, 4]]).set("action", torch.tensor([SPIN])))["next"]
    assert after["state"].tolist() == [[0, 0, 2]]


def test_it_works_around_a_serial_env_and_when_nested() -> None:
    serial = TransformedEnv(SerialEnv(2, lambda: tiny_env((3,))), FrameSkip(3))
    nested = TransformedEnv(StatefulEnv(tiny_env((3,))), Compose(FrameSkip(3)))
    plain = StatefulEnv(tiny_env((3,)), FrameSkip(3))
    runs = []
    for env in (nested, plain):
        runs.append(seeded_rollout(env, 6, 3))
    assert_same(*runs)
    batch = serial.rollout(4, break_when_any_done=False)
    assert batch.shape == (2, 3, 4) and (batch["next", "step_count"] - batch["step_count"]).max() == 3
    serial.close()


def test_it_is_chosen_on_the_command_line(tmp_path: Path) -> None:
    env = make_env([*tiny_overrides(tmp_path), "transforms/skip=four", "transforms.skip.steps=2"], [2])
    assert [type(part) for part in env.transform] == [FrameSkip] and env.transform[0].steps == 2
    batch = HostCollector(env, lambda td: td.set("action", torch.full((2,), SPIN)), 3).collect()
    taken, ended = (batch["next", "step_count"] - batch["step_count"]), batch["next", "done"]
    assert (taken[~ended] == 2).all() and (taken[ended] <= 2).all() and not ended.all()


@pytest.mark.parametrize("steps", [0, 1.5, -1])
def test_an_invalid_number_of_steps_is_refused(steps: float) -> None:
    with pytest.raises(ValueError, match=r"skip\.steps: expected a whole number of at least 1"):
        FrameSkip(steps)  # type: ignore[arg-type]


def test_it_needs_a_parent_env() -> None:
    with pytest.raises(RuntimeError, match="FrameSkip: expected a parent env"):
        FrameSkip(2)(TensorDict({"pixels": torch.zeros(2, 3)}, [2]))
