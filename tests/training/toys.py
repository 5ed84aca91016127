"""Envs so simple that the best possible result is known: grey images of 8 × 8 pixels, and no scene."""

from abc import abstractmethod
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from splatrl.envs.tasks import Outcome


class Toy(EnvBase):
    """Shows a cue in the first image of an episode, and grey in all others.

    The cue is a uniform number in [0, 1], drawn by PyTorch's global generator; after ``steps`` steps the episode ends,
    and only the last action is judged.
    """

    batch_locked = True
    action: TensorSpec
    steps: int

    def __init__(self, robots: int):
        super().__init__(batch_size=torch.Size([robots]))
        column = {
            "step_count": torch.int64,
            "outcome": torch.int64,
            "goals": torch.int64,
            "success": torch.bool,
            "cue": torch.float32,
            "episode_return": torch.float32,
        }
        specs: dict[str, TensorSpec] = {key: Unbounded(shape=(robots, 1), dtype=dtype) for key, dtype in column.items()}
        state = {key: specs[key].clone() for key in ("step_count", "cue")}
        specs["pixels"] = Bounded(0, 255, shape=(robots, 8, 8, 3), dtype=torch.uint8)
        self.observation_spec = Composite(specs, shape=self.batch_size)
        self.state_spec = Composite(state, shape=self.batch_size)
        self.action_spec = self.action.expand(robots, *self.action.shape)
        self.reward_spec = Unbounded(shape=(robots, 1))

    @abstractmethod
    def judge(self, cue: Tensor, action: Tensor) -> Tensor:
        """Return the reward [B, 1] of the last action [B, ...] for a cue [B, 1]."""

    def _observe(self, cue: Tensor, step: Tensor, reward: Tensor) -> TensorDict:
        shown = torch.where(step == 0, 255 * cue, 127).to(torch.uint8)
        values = {
            "pixels": shown.view(-1, 1, 1, 1).expand(-1, 8, 8, 3).clone(),
            "outcome": torch.where(
                step < self.steps, Outcome.RUNNING, torch.where(reward > 0, Outcome.GOAL, Outcome.TIMEOUT)
            ),
            "episode_return": reward,
            "goals": (reward > 0).long(),
            "success": reward > 0,
        }
        return TensorDict({**values, "cue": cue, "step_count": step}, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        step = torch.zeros(*self.batch_size, 1, dtype=torch.int64)
        return self._observe(torch.rand(*self.batch_size, 1), step, torch.zeros(*self.batch_size, 1))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        step = tensordict["step_count"] + 1
        done = step >= self.steps
        reward = torch.where(done, self.judge(tensordict["cue"], tensordict["action"]), 0.0)
        flags = {"done": done, "terminated": done.clone(), "truncated": torch.zeros_like(done)}
        return self._observe(tensordict["cue"], step, reward).update({"reward": reward, **flags})

    def _set_seed(self, seed: int | None) -> None:
        pass


class Recall(Toy):
    """The last of three actions, 0 or 1, must say whether the cue was bright; chance is right half of the time."""

    action, steps = Categorical(2), 3

    def judge(self, cue: Tensor, action: Tensor) -> Tensor:
        return (action.view(-1, 1) == (cue > 0.5)).float()


class Match(Toy):
    """The one action, from −1 to 3, must lie within 0.4 of 4 · cue − 1; a policy that sees nothing wins one in five."""

    action, steps = Bounded(-1.0, 3.0, shape=(1,)), 1

    def judge(self, cue: Tensor, action: Tensor) -> Tensor:
        return ((action - (4 * cue - 1)).abs() < 0.4).float()
