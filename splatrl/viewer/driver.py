"""A robot driven by a person."""

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from splatrl.datasets.recorder import recorded
from splatrl.envs.tasks.base import Outcome
from splatrl.envs.world import World


class Driver:
    """A single robot in its own env, driven one action at a time, with the env's collisions and outcomes.

    Args:
        world: scene and task.
        seed: seed of starts and noise.
        kept: called with each successful episode: frames [T] in the form that ``planner_episodes`` records.
    """

    def __init__(self, world: World, seed: int = 0, kept: Callable[[TensorDictBase], object] = lambda frames: None):
        self.world, self.kept = world, kept
        self.env: EnvBase = world.env(1, seed=seed)
        self._told = world.told
        self.begin()

    @torch.no_grad()
    def begin(self) -> None:
        """Begin a new episode at another start."""
        self._begin(self.env.reset())

    @torch.no_grad()
    def again(self) -> None:
        """Restart the episode from the same start."""
        first = self._first.select("state", *self._told)
        self._begin(self.env.reset(first.clone(), set_state=True))

    def _begin(self, now: TensorDictBase) -> None:
        self.now, self._first, self._frames = now, now, list[TensorDictBase]()
        self.outcome, self.reward, self.free = Outcome.RUNNING, 0.0, 1.0
        self.done = self.succeeded = False

    @torch.no_grad()
    def act(self, action: Tensor) -> None:
        """Take an action, or, if the episode has ended, begin a new one instead.

        Args:
            action: action of a single robot, without a batch dimension.
        """
        if self.done:
            self.begin()
            return
        self.now["action"] = action.unsqueeze(0).to(self.env.device)
        step = self.env.step(self.now)
        frame = recorded(step, self._told)
        self._frames.append(frame)
        self.outcome = Outcome(int(frame["next", "outcome"]))
        self.reward, self.free = float(frame["next", "reward"]), float(step["next", "free_fraction"])
        self.done = bool(frame["next", "done"])
        self.succeeded = self.done and bool(step["next", "success"])
        self.now = self.env.step_mdp(step)
        if self.succeeded:
            self.kept(torch.stack(self._frames, 1)[0])

    @property
    def steps(self) -> int:
        """Steps of the episode so far."""
        return len(self._frames)

    @property
    def episode_return(self) -> float:
        """Sum of the episode's rewards so far."""
        return float(sum(float(frame["next", "reward"]) for frame in self._frames))

    @property
    def pixels(self) -> Tensor:
        """The robot's current view: [H, W, 3] uint8."""
        return self.now["pixels"][0, ..., -3:].cpu()

    @property
    def state(self) -> Tensor:
        """The robot's state: [1, ...]."""
        return self.now["state"]
