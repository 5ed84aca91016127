"""The interface of every sensor other than the robot's camera."""

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.collision.base import Checker
from splatrl.envs.robot import Robot
from splatrl.envs.tasks.base import Task
from splatrl.motions.base import PlannedMotion
from splatrl.values import under_key


class Moment(NamedTuple):
    """A snapshot of B robots, from which sensors compute their readings.

    Attributes:
        planar: [B, 3] float64, x and y in metres and yaw in radians.
        body_to_world: [B, 4, 4] float32, metres.
        free_fraction: [B] float32, fraction of the last move that was free.
        memory: what task and sensors remember about each robot, [B, ...] by key.
        depth: [B, H, W] float32, metres along the optical axis, infinite where nothing is seen; None if no sensor needs
            it.
        checker: collision checker of the scene.
        look: draws the robots' views in other states [B, ...]: [B, H, W, 3] uint8. In a reset only the rows that begin
            an episode are drawn.
        state: [B, ...] states of the motion.
        motion: how the robots move.
        sensed: [B, S, s] float64, MuJoCo's sensor data in each substep of the last move; None where episodes begin, and
            without physics.
    """

    planar: Tensor
    body_to_world: Tensor
    free_fraction: Tensor
    memory: Mapping[str, Tensor]
    depth: Tensor | None
    checker: Checker
    look: Callable[[Tensor], Tensor]
    state: Tensor
    motion: PlannedMotion
    sensed: Tensor | None = None


class Sensor(Protocol):
    """Produces an observation of each robot, under the sensor's key in the config.

    Attributes:
        needs_depth: whether the sensor needs ``Moment.depth``.
    """

    needs_depth: bool

    def check(self, task: Task) -> None:
        """Refuse a task in which there is nothing to read, by a ``ValueError``; its scene is not built yet."""
        ...

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of one robot's observation."""
        ...

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """Return the specs of what is remembered about one robot's episode, by key; it travels in the TensorDict."""
        ...

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """Return what to remember about robots whose episodes begin: [B, ...] by key of ``memory_spec``."""
        ...

    def read(self, moment: Moment) -> Tensor:
        """Return the observations of all robots: [B, ...], one robot's shape and dtype as in ``spec``."""
        ...


class PlainSensor:
    """A sensor that works in every task, remembers nothing and needs no depth, unless a subclass overrides that."""

    needs_depth = False

    def check(self, task: Task) -> None:
        """Accept every task."""

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """Return an empty mapping: nothing is remembered."""
        return {}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """Return an empty mapping: nothing is remembered."""
        return {}


def check_sensors(sensors: Mapping[str, Sensor], task: Task) -> None:
    """Refuse sensors that have nothing to read in a task.

    Raises:
        ValueError: names the sensor by its key.
    """
    for key, sensor in sensors.items():
        with under_key(f"sensors.{key}"):
            sensor.check(task)
