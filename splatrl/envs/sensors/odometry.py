"""Where a robot is and where it looks, since its episode began or in the world."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor

START = "episode_start"
"""Key of the pose in which an episode began: [B, 3] float32, x and y in metres and yaw in radians."""


def wrapped(angle: Tensor) -> Tensor:
    """Angles in [-π, π]."""
    return torch.atan2(angle.sin(), angle.cos())


def angle_spec() -> TensorSpec:
    """Spec of one angle."""
    return Bounded(-math.pi - 1e-6, math.pi + 1e-6, shape=(1,), dtype=torch.float32)


class SinceStart(PlainSensor):
    """A sensor that compares a robot with the pose in which its episode began."""

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """``episode_start`` [3] float32."""
        return {START: Unbounded(shape=(3,), dtype=torch.float32)}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """The pose in which the episode begins."""
        return {START: moment.planar.float()}


class Gps(SinceStart):
    """How far the robot has come since its episode began: [B, 2] float32, metres ahead and to the right.

    Habitat's episodic ``gps`` in two dimensions: the origin is the start, the first axis is where the robot looked
    there, and the second points to its right (``EpisodicGPSSensor`` of habitat-lab's ``tasks/nav/nav.py``).
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Two lengths."""
        return Unbounded(shape=(2,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Metres ahead and to the right."""
        start = moment.memory[START].double()
        x, y = (moment.planar - start)[:, :2].unbind(1)
        cos, sin = start[:, 2].cos(), start[:, 2].sin()
        return torch.stack([cos * x + sin * y, sin * x - cos * y], 1).float()


class Compass(SinceStart):
    """How far the robot has turned since its episode began: [B, 1] float32 in [-π, π], to the left positive.

    Habitat's episodic ``compass`` (``EpisodicCompassSensor`` of habitat-lab's ``tasks/nav/nav.py``).
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """An angle."""
        return angle_spec()

    def read(self, moment: Moment) -> Tensor:
        """The turn."""
        return wrapped(moment.planar[:, 2:] - moment.memory[START][:, 2:].double()).float()


class Heading(PlainSensor):
    """Where the robot looks in the world: [B, 1] float32 in [-π, π], 0 along +x, counter-clockwise.

    Habitat's ``heading``, with the world's own forward axis, which here is +x.
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """An angle."""
        return angle_spec()

    def read(self, moment: Moment) -> Tensor:
        """The yaw."""
        return wrapped(moment.planar[:, 2:]).float()
