"""Grants the goal of a task whose goal is in the image."""

import torch
from tensordict import TensorDictBase
from torchrl.envs import Transform

from splatrl.envs.layers import layers
from splatrl.envs.splat_env import SplatEnv
from splatrl.envs.tasks.base import Outcome, SeenGoal


class ImageGoal(Transform):
    """Asks the env's task whether the robots see their goal in ``pixels``, and makes that the outcome of the step.

    Stands behind the overlay. Where the goal is seen, the reward is the task's goal reward, and the outcome is GOAL;
    the episode ends if the task ends there, else the target moves to a fresh place. Returns, ``terminated``, ``done``
    and the curriculum follow, so to whoever looks at the env from outside, the reward is the env's own.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=["pixels", "state", "target"], out_keys=["reward", "outcome", "target"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        env = self._env()
        task = env.task
        assert isinstance(task, SeenGoal)
        after = next_tensordict
        state, target, pixels = after["state"], after["target"], after["pixels"]
        seen = task.seen(state, target, pixels).unsqueeze(1)
        open_ = (after["outcome"] == Outcome.RUNNING) | (after["outcome"] == Outcome.TIMEOUT)
        goal = seen & open_
        reward = torch.where(goal, task.goal_reward, after["reward"])
        after["episode_return"] = after["episode_return"] + (reward - after["reward"])
        after["reward"] = reward
        outcome = torch.where(goal, Outcome.GOAL, after["outcome"])
        if task.ends_at_goal:
            after["terminated"] = after["terminated"] | goal
            after["truncated"] = after["truncated"] & ~goal
            after["done"] = after["terminated"] | after["truncated"]
        else:
            outcome = torch.where(after["truncated"], after["outcome"], outcome)
            after["target"] = torch.where(goal, env.fresh_targets(len(goal)), target)
        after["outcome"] = outcome
        success = outcome == Outcome.GOAL
        env.curriculum.record(after["level"].flatten(), after["done"].flatten(), success.flatten())
        return after

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset

    def _env(self) -> SplatEnv:
        """The env that it stands around.

        Raises:
            ValueError: where that is not a ``SplatEnv`` whose task has such a goal.
        """
        around = self.container
        env = None if around is None else layers(around)[0]
        if not isinstance(env, SplatEnv) or env.seen_goal is None:
            raise ValueError("ImageGoal: expected to stand around a SplatEnv whose task has a goal that must be seen")
        return env
