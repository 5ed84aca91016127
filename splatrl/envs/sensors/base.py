"""What a robot senses besides its picture: the interface of every sensor."""

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.collision.base import Checker
from splatrl.envs.robot import Robot
from splatrl.motions.base import Motion


class Moment(NamedTuple):
    """B robots at a moment, as sensors read them.

    Attributes:
        planar: [B, 3] float64, x and y in metres and yaw in radians.
        body_to_world: [B, 4, 4] float32, metres.
        free_fraction: [B] float32, how much of the last move was free.
        memory: what task and sensors remember about each robot, [B, ...] by key.
        depth: [B, H, W] float32, metres along the optical axis, infinite where nothing is seen; None where no sensor
            asks for it.
        checker: what is solid.
        look: draws what cameras of bodies at other poses [B, 4, 4] see, [B, H, W, 3] uint8, for rows that begin.
        state: [B, ...] the motion's states.
        motion: how the robots move.
        sensed: [B, S, s] float64, what sensors of the physics said in each substep of the last move; None where
            episodes begin, and without physics.
    """

    planar: Tensor
    body_to_world: Tensor
    free_fraction: Tensor
    memory: Mapping[str, Tensor]
    depth: Tensor | None
    checker: Checker
    look: Callable[[Tensor], Tensor]
    state: Tensor
    motion: Motion
    sensed: Tensor | None = None


class Sensor(Protocol):
    """Gives an observation of each robot, under the key by which it stands in the config.

    Attributes:
        needs_depth: whether ``Moment.depth`` has to be drawn for it.
    """

    needs_depth: bool

    def spec(self, robot: Robot) -> TensorSpec:
        """Spec of one robot's observation."""
        ...

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """Spec of what is remembered about one robot's episode, by key; it travels in the TensorDict."""
        ...

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """What is remembered from now on of robots whose episodes begin, with the keys of ``memory_spec``."""
        ...

    def read(self, moment: Moment) -> Tensor:
        """The observations of robots: [B, ...]."""
        ...


class PlainSensor:
    """A sensor that remembers nothing and needs no depth; subclasses override that."""

    needs_depth = False

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """Nothing is remembered."""
        return {}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """Nothing is remembered."""
        return {}
