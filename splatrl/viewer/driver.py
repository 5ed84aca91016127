"""One robot that a person drives, and the episodes that come of it."""

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from splatrl.datasets import Demonstrations
from splatrl.datasets.demonstrations import joined
from splatrl.datasets.recorder import recorded
from splatrl.envs.tasks.base import Outcome
from splatrl.envs.world import World


class Driver:
    """A robot in an env of its own, which takes one action at a time, with collisions and outcomes as the env has them.

    Args:
        world: scene and task.
        seed: of starts and noise.
        kept: called with each episode that succeeded: frames [T] as ``planner_episodes`` records them.
    """

    def __init__(self, world: World, seed: int = 0, kept: Callable[[TensorDictBase], object] = lambda frames: None):
        self.world, self.kept = world, kept
        self.env: EnvBase = world.env(1, seed=seed)
        self._told = world.told
        self.begin()

    @torch.no_grad()
    def begin(self) -> None:
        """Begin an episode at another start."""
        self._begin(self.env.reset())

    @torch.no_grad()
    def again(self) -> None:
        """Begin the episode again, from where it began."""
        first = self._first.select("state", *self._told)
        self._begin(self.env.reset(first.clone(), set_state=True))

    def _begin(self, now: TensorDictBase) -> None:
        self.now, self._first, self._frames = now, now, list[TensorDictBase]()
        self.outcome, self.reward, self.free = Outcome.RUNNING, 0.0, 1.0
        self.done = self.succeeded = False

    @torch.no_grad()
    def act(self, action: Tensor) -> None:
        """Take an action; after the end of an episode begin another one in its place.

        Args:
            action: one robot's.
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
        """Its rewards so far."""
        return float(sum(float(frame["next", "reward"]) for frame in self._frames))

    @property
    def pixels(self) -> Tensor:
        """What the robot sees: [H, W, 3] uint8."""
        return self.now["pixels"][0, ..., -3:].cpu()

    @property
    def state(self) -> Tensor:
        """Where it is: [1, ...]."""
        return self.now["state"]


class Takes:
    """Episodes that a person showed, as demonstrations.

    Args:
        world: in which they are shown.
    """

    def __init__(self, world: World):
        self.world = world
        self.episodes: list[TensorDictBase] = []

    def add(self, frames: TensorDictBase) -> None:
        """Keep an episode: frames [T]."""
        self.episodes.append(frames)

    def discard(self) -> bool:
        """Drop the last one; whether there was one."""
        return bool(self.episodes) and bool(len(self.episodes.pop()))

    def demonstrations(self) -> Demonstrations:
        """All that was kept.

        Raises:
            ValueError: for nothing.
        """
        if not self.episodes:
            raise ValueError("by=keys: expected at least one episode that reached the goal, got none")
        return Demonstrations(joined(self.episodes), tuple(self.world.task.motion.action_names))
