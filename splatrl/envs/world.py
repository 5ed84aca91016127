"""What all envs of one scene and task share."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import torch
from torchrl.envs import EnvBase, Transform

from splatrl.collision.base import Checker
from splatrl.collision.occupancy import Occupancy
from splatrl.curriculum import Curriculum, Plan
from splatrl.envs.drawing.base import Drawing
from splatrl.envs.robot import Robot
from splatrl.envs.splat_env import SplatEnv
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks.base import Task
from splatrl.scenes.scene import Scene


@dataclass(frozen=True)
class World:
    """Everything that envs of one configuration share.

    Attributes:
        scene: Gaussians in the world frame.
        occupancy: what is solid.
        checker: tests the robot's body against it.
        drawing: makes the pixels; its renderer may cache them.
        robot: body and camera.
        task: motion, goals and rewards.
        plan: free poses and shortest paths.
        make_transforms: makes new transforms for an env, the innermost first.
        device: default device of its envs.
        made_by: makes the same world again, from names and paths. Pickles hold this in place of all the rest, so that
            processes are sent no scenes; None pickles everything.
    """

    scene: Scene
    occupancy: Occupancy
    checker: Checker
    drawing: Drawing
    robot: Robot
    task: Task
    plan: Plan
    make_transforms: Callable[[], list[Transform]]
    device: torch.device
    made_by: "Callable[[], World] | None" = None

    def __reduce__(self) -> tuple[Any, ...]:
        if self.made_by is None:
            return World, tuple(getattr(self, field.name) for field in fields(self))
        return _made, (self.made_by,)

    def __deepcopy__(self, memo: dict[int, Any]) -> "World":
        return self

    def env(
        self,
        num_envs: int,
        curriculum: Curriculum | None = None,
        seed: int | None = 0,
        device: torch.device | str | None = None,
    ) -> EnvBase:
        """A batch of robots in this world, under its transforms.

        Args:
            num_envs: number of robots.
            curriculum: decides where episodes begin; None lets them begin anywhere in the start set.
            seed: seed of the env's generator.
            device: device of its tensors; None takes the world's.
        """
        env = self.bare_env(num_envs, curriculum or Curriculum(self.plan, first=None), seed, device or self.device)
        transforms = self.make_transforms()
        return StatefulEnv(env, *transforms) if transforms else env

    def bare_env(self, num_envs: int, curriculum: Curriculum, seed: int | None, device: torch.device | str) -> SplatEnv:
        """A batch of robots without transforms, which is pickled as this world and these arguments; see ``env``."""
        env = SplatEnv(
            self.drawing,
            self.checker,
            self.robot,
            deepcopy(self.task),  # an env moves its task to its device; the plan's stays where it is
            curriculum,
            [num_envs],
            seed,
            device,
        )
        env.made_by = partial(self.bare_env, num_envs)
        return env


def _made(make: Callable[[], World]) -> World:
    """The world that a constructor makes."""
    return make()
