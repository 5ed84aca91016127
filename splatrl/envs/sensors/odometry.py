"""Position and heading sensors, relative to the start of the episode or to the world."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor
from splatrl.geometry import along_heading, wrapped

START = "episode_start"
"""Key of the pose at the start of the episode: [B, 3] float32, x and y in metres and yaw in radians."""


def angle_spec() -> TensorSpec:
    """Return the spec of a single angle, [1] float32."""
    return Bounded(-math.pi - 1e-6, math.pi + 1e-6, shape=(1,), dtype=torch.float32)


class SinceStart(PlainSensor):
    """A sensor that compares a robot's pose with the one at the start of its episode."""

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """Return the spec of ``episode_start``, [3] float32."""
        return {START: Unbounded(shape=(3,), dtype=torch.float32)}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """Return the pose in which the episode begins: [B, 3] float32, x and y in metres and yaw in radians."""
        return {START: moment.planar.float()}


class Gps(SinceStart):
    """Displacement of the robot since its episode began: [B, 2] float32, metres ahead and to the right.

    This is Habitat's episodic ``gps`` in two dimensions: the origin is the start, the first axis is the robot's heading
    there, and the second points to its right (``EpisodicGPSSensor`` in habitat-lab's ``tasks/nav/nav.py``).
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of two lengths."""
        return Unbounded(shape=(2,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return the displacement ahead and to the right: [B, 2] float32, metres."""
        start = moment.memory[START].double()
        ahead, left = along_heading((moment.planar - start)[:, :2], start[:, 2]).unbind(1)
        return torch.stack([ahead, -left], 1).float()


class Compass(SinceStart):
    """Rotation of the robot since its episode began: [B, 1] float32 in [-π, π], positive to the left.

    This is Habitat's episodic ``compass`` (``EpisodicCompassSensor`` in habitat-lab's ``tasks/nav/nav.py``).
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of an angle."""
        return angle_spec()

    def read(self, moment: Moment) -> Tensor:
        """Return the rotation since the start: [B, 1] float32, radians."""
        return wrapped(moment.planar[:, 2:] - moment.memory[START][:, 2:].double()).float()


class Heading(PlainSensor):
    """Heading of the robot in the world: [B, 1] float32 in [-π, π], 0 along +x, counter-clockwise.

    This is Habitat's ``heading``, measured from this world's forward axis, +x.
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of an angle."""
        return angle_spec()

    def read(self, moment: Moment) -> Tensor:
        """Return the yaw: [B, 1] float32, radians."""
        return wrapped(moment.planar[:, 2:]).float()
