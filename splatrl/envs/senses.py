"""What robots see and sense: pictures of the scene, and what sensors read beside them."""

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.collision.base import Checker
from splatrl.envs.drawing.base import Drawing, View
from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, Sensor
from splatrl.envs.tasks.base import Memory, Task
from splatrl.renderers.parts import in_scenes


class Standing(NamedTuple):
    """Robots where they stand.

    Attributes:
        task: as it is in the scene of each robot.
        checker: what is solid there.
        scene: [N] int64, the scene of each; None for the only one.
        state: [N, ...] of the motion.
        body_to_world: [N, 4, 4] float32, metres.
        memory: what the task remembers of each as it is drawn, [N, ...] by key.
    """

    task: Task
    checker: Checker
    scene: Tensor | None
    state: Tensor
    body_to_world: Tensor
    memory: Memory


class Senses(NamedTuple):
    """The senses of a robot.

    Attributes:
        drawing: makes the pixels.
        robot: carries the camera.
        sensors: what is observed besides the pixels, by key.
    """

    drawing: Drawing
    robot: Robot
    sensors: Mapping[str, Sensor]

    def memory_spec(self) -> dict[str, TensorSpec]:
        """Specs of what sensors remember of one robot, by key."""
        found = [sensor.memory_spec(self.robot) for sensor in self.sensors.values()]
        return {key: spec for specs in found for key, spec in specs.items()}

    def view(self, robots: Standing, camera_offset: Tensor | None = None, only: Tensor | None = None) -> View:
        """What robots see, with the depth where a sensor needs it.

        Args:
            robots: N of them.
            camera_offset: [N, 6] float32, see ``Robot.cameras``.
            only: [N] bool, the rows that are to be drawn; None draws all.
        """
        cameras = self.robot.cameras(robots.body_to_world, camera_offset)
        parts = robots.task.parts(robots.state, robots.memory)
        if robots.scene is not None:
            parts = in_scenes(robots.scene, parts, robots.body_to_world)
        if any(sensor.needs_depth for sensor in self.sensors.values()):
            return self.drawing.draw(cameras, robots.memory, parts, only, depth=True)
        return self.drawing.draw(cameras, robots.memory, parts, only)

    def begin(
        self,
        robots: Standing,
        view: View,
        free_fraction: Tensor,
        kept: Mapping[str, Tensor] | TensorDictBase,
        only: Tensor | None,
    ) -> dict[str, Tensor]:
        """What sensors read, and remember from now on, of robots whose episodes begin: [N, ...] by key.

        Args:
            robots: N of them.
            view: what they see.
            free_fraction: [N] float32, 1.
            kept: what is remembered in place of what a sensor would, where it is there.
            only: as for ``view``.
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
        """What sensors read after a step: [N, ...] by key.

        Args:
            robots: N of them.
            view: what they see.
            free_fraction: [N] float32, how much of the move was free.
            known: what task and sensors remember now.
            sensed: what the physics said, see ``Moment``.
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

    def _look(self, robots: Standing, only: Tensor | None, body_to_world: Tensor) -> Tensor:
        """What robots would see at other poses."""
        return self.view(robots._replace(body_to_world=body_to_world), None, only).pixels
