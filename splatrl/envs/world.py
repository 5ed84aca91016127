"""Worlds: what all envs of one configuration share, in one scene or in several."""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torchrl.envs import EnvBase, Transform

from splatrl.collision.base import Checker
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.several import SeveralCheckers
from splatrl.curriculum import Curriculum, Plan
from splatrl.envs.drawing.base import Drawing
from splatrl.envs.robot import Robot
from splatrl.envs.sensors import Sensor
from splatrl.envs.splat_env import SplatEnv
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks.base import Task
from splatrl.scenes.scene import Scene, content_of


class EnvMaker(ABC):
    """Makes envs of one configuration, in one scene or in several.

    Attributes:
        drawing: draws the pixels.
        checker: tests the robot's body for collisions.
        robot: body and camera.
        task: motion, goals and rewards.
        make_transforms: creates new transforms for an env, innermost first.
        device: default device of the envs.
        made_by: recreates the same object from names and paths. A pickle then holds only this function, so that no
            scenes are sent to other processes; None pickles everything.
        sensors: sensors other than the camera, by key.
    """

    drawing: Drawing
    checker: Checker | SeveralCheckers
    robot: Robot
    task: Task
    make_transforms: Callable[[], list[Transform]]
    device: torch.device
    made_by: "Callable[[], World | Worlds] | None"
    sensors: Mapping[str, Sensor]

    @property
    @abstractmethod
    def worlds(self) -> "tuple[World, ...]":
        """The world of each scene."""

    @property
    def digest(self) -> str:
        """Fingerprint of the scenes, in order."""
        return content_of(one.scene for one in self.worlds)

    @property
    def names(self) -> list[str]:
        """Names of the scenes; repeated names are numbered: garden, garden-2."""
        names: list[str] = []
        for world in self.worlds:
            numbered = itertools.chain([world.name], (f"{world.name}-{number}" for number in itertools.count(2)))
            names.append(next(name for name in numbered if name not in names))
        return names

    @property
    def planned(self) -> bool:
        """Whether episodes end at their goal and the planner knows shortest paths to it in every scene."""
        return all(one.plan.field is not None for one in self.worlds) and self.task.goals_for_success is None

    @property
    def repeats(self) -> int:
        """Number of times that a robot carries out each action, one after the other."""
        return self.worlds[0].plan.moves.repeats

    @property
    def told(self) -> tuple[str, ...]:
        """Keys of sensor readings, and of what task, sensors and transforms remember about each robot.

        A transform names its own in an attribute ``remembered``: what it drew for the episode, and whatever else its
        steps depend on.
        """
        remembered = [*self.task.memory_spec]
        for sensor in self.sensors.values():
            remembered += sensor.memory_spec(self.robot)
        for transform in self.make_transforms():
            remembered += getattr(transform, "remembered", ())
        return tuple(dict.fromkeys([*self.sensors, *remembered]))

    def __reduce__(self) -> tuple[Any, ...]:
        if self.made_by is None:
            return type(self), tuple(vars(self).values())  # in the order of the fields
        return _made, (self.made_by,)

    def __deepcopy__(self, memo: dict[int, Any]) -> "EnvMaker":
        return self

    def env(
        self,
        num_envs: int,
        curriculum: Curriculum | None = None,
        seed: int | None = 0,
        device: torch.device | str | None = None,
    ) -> EnvBase:
        """Create a batch of robots in the scenes, under the transforms.

        Args:
            num_envs: number of robots.
            curriculum: decides where episodes begin; with None they begin anywhere in the start set.
            seed: seed of the env's generator.
            device: device of the env's tensors; None uses the world's.
        """
        if curriculum is None:
            curriculum = Curriculum([one.plan for one in self.worlds], first=None)
        env = self.bare_env(num_envs, curriculum, seed, device or self.device)
        transforms = self.make_transforms()
        return StatefulEnv(env, *transforms) if transforms else env

    def bare_env(self, num_envs: int, curriculum: Curriculum, seed: int | None, device: torch.device | str) -> SplatEnv:
        """Create a batch of robots without transforms, pickled as this maker and its arguments; see ``env``."""
        env = SplatEnv(
            self.drawing,
            self.checker,
            self.robot,
            deepcopy(self.task),  # the env moves its task to its device; the plan's must stay
            curriculum,
            [num_envs],
            seed,
            device,
            self.sensors,
        )
        env.made_by = partial(self.bare_env, num_envs)
        return env


@dataclass(frozen=True)
class World(EnvMaker):
    """Everything that envs of one configuration in one scene share.

    Attributes:
        scene: Gaussians in the world frame.
        occupancy: the solid parts of the scene.
        checker: tests the robot's body against the occupancy.
        drawing: draws the pixels; its renderer may cache them.
        robot, task, make_transforms, device, made_by, sensors: see ``EnvMaker``.
        plan: free poses and shortest paths.
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
    made_by: "Callable[[], World | Worlds] | None" = None
    sensors: Mapping[str, Sensor] = field(default_factory=dict)

    @property
    def worlds(self) -> "tuple[World, ...]":
        """This world alone."""
        return (self,)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.scene.name


@dataclass(frozen=True)
class Worlds(EnvMaker):
    """Everything that envs of one configuration in several scenes share; each episode takes place in one of them.

    Attributes:
        places: the world of each scene; they share the renderer and the checkers.
        drawing: draws the pixels; its renderer's models are the scenes, in order.
        checker: tests the robot's body in each scene.
        task: motion, goals and rewards, with scene-specific tensors ``stacked``.
        robot, make_transforms, device, made_by, sensors: see ``EnvMaker``.
    """

    places: tuple[World, ...]
    drawing: Drawing
    checker: SeveralCheckers
    robot: Robot
    task: Task
    make_transforms: Callable[[], list[Transform]]
    device: torch.device
    made_by: "Callable[[], World | Worlds] | None" = None
    sensors: Mapping[str, Sensor] = field(default_factory=dict)

    @property
    def worlds(self) -> tuple[World, ...]:
        """The world of each scene, in order."""
        return self.places

    @property
    def name(self) -> str:
        """Names of the scenes."""
        return ", ".join(self.names)


def _made(make: Callable[[], World | Worlds]) -> World | Worlds:
    """Recreate a world when it is unpickled."""
    return make()
