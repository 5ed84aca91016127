"""A robot's senses: rendered views of the scene and additional sensor readings."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.collision.base import Checker
from splatrl.envs.drawing.base import Drawing, Shot, View
from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, Sensor
from splatrl.envs.tasks.base import Memory, Task
from splatrl.renderers.parts import in_scenes


class Standing(NamedTuple):
    """N robots at their current poses.

    Attributes:
        task: the task, with the values of each robot's scene.
        checker: the collision checker for those scenes.
        scene: [N] int64, scene of each robot; None if there is only one.
        state: [N, ...] states of the motion.
        body_to_world: [N, 4, 4] float32, metres.
        memory: the task's memory of each robot as it is to be drawn, [N, ...] by key.
    """

    task: Task
    checker: Checker
    scene: Tensor | None
    state: Tensor
    body_to_world: Tensor
    memory: Memory


class Look:
    """What N robots see after a step, drawn once, and only if somebody looks.

    Args:
        draw: draws the views; its argument, [N] bool, says which ones, None all.
    """

    def __init__(self, draw: Callable[[Tensor | None], View]):
        self._draw = draw
        self._view: View | None = None

    def __call__(self) -> View:
        """Return all views."""
        if self._view is None:
            self._view = self._draw(None)
        return self._view

    def of(self, only: Tensor | None) -> View:
        """Return views of which only some rows are needed, [N] bool, or all; if none are drawn yet, others are zero."""
        return self() if only is None or self._view is not None else self._draw(only)


class Senses(NamedTuple):
    """The camera and sensors of a robot.

    Attributes:
        drawing: draws the pixels.
        robot: carries the camera.
        sensors: sensors other than the camera, by key.
    """

    drawing: Drawing
    robot: Robot
    sensors: Mapping[str, Sensor]

    def memory_spec(self) -> dict[str, TensorSpec]:
        """Return the specs of what sensors remember about one robot, by key."""
        found = [sensor.memory_spec(self.robot) for sensor in self.sensors.values()]
        return {key: spec for specs in found for key, spec in specs.items()}

    def view(self, robots: Standing, camera_offset: Tensor | None = None, only: Tensor | None = None) -> View:
        """Draw what robots see, with depth if a sensor needs it.

        Args:
            robots: N robots.
            camera_offset: [N, 6] float32, see ``Robot.cameras``.
            only: [N] bool, the rows to draw; None draws all.
        """
        cameras = self.robot.cameras(robots.body_to_world, camera_offset)
        parts = robots.task.parts(robots.state, robots.memory)
        if robots.scene is not None:
            parts = in_scenes(robots.scene, parts, robots.body_to_world)
        depth = any(sensor.needs_depth for sensor in self.sensors.values())
        return self.drawing.draw(Shot(cameras, robots.memory, parts, only, depth))

    def begin(
        self,
        robots: Standing,
        view: View,
        free_fraction: Tensor,
        kept: Mapping[str, Tensor] | TensorDictBase,
        only: Tensor | None,
    ) -> dict[str, Tensor]:
        """Return what sensors read and remember about robots whose episodes begin: [N, ...] by key.

        Args:
            robots: N robots.
            view: what they see.
            free_fraction: [N] float32, all 1.
            kept: given memory; where a key is present, it replaces what a sensor would remember.
            only: see ``view``.
        """
        if not self.sensors:
            return {}
        moment = self._moment(robots, view, free_fraction, robots.memory, only)
        begun = {key: value for sensor in self.sensors.values() for key, value in sensor.begin(moment).items()}
        begun |= {key: kept[key].clone() for key in begun if kept.get(key, None) is not None}
        return begun | self._readings(moment._replace(memory={**robots.memory, **begun}))

    def read(
        self, robots: Standing, view: View, free_fraction: Tensor, known: Memory, sensed: Tensor | None
    ) -> dict[str, Tensor]:
        """Return what sensors read after a step: [N, ...] by key.

        Args:
            robots: N robots.
            view: what they see.
            free_fraction: [N] float32, fraction of the move that was free.
            known: what task and sensors remember now.
            sensed: sensor output of the physics, see ``Moment``.
        """
        if not self.sensors:
            return {}
        return self._readings(self._moment(robots, view, free_fraction, known, None)._replace(sensed=sensed))

    def _readings(self, moment: Moment) -> dict[str, Tensor]:
        return {key: sensor.read(moment) for key, sensor in self.sensors.items()}

    def _moment(
        self, robots: Standing, view: View, free_fraction: Tensor, known: Memory, only: Tensor | None
    ) -> Moment:
        motion, poses = robots.task.motion, robots.body_to_world
        look = partial(self._look, robots, only)
        return Moment(
            motion.planar(robots.state),
            poses,
            free_fraction,
            known,
            view.depth,
            robots.checker,
            look,
            robots.state,
            motion,
        )

    def _look(self, robots: Standing, only: Tensor | None, state: Tensor) -> Tensor:
        """Draw what robots would see in other states."""
        there = robots._replace(state=state, body_to_world=robots.task.motion.body_to_world(state))
        return self.view(there, None, only).pixels
