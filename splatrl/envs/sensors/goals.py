"""What a robot is told of its goal."""

from collections.abc import Mapping

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor
from splatrl.envs.sensors.odometry import wrapped
from splatrl.geometry import axis_rotations, rigid


def goal_of(moment: Moment) -> Tensor:
    """The goals that the task remembers: [B, 3] float64, x and y in metres and yaw in radians.

    Raises:
        ValueError: for a task that has none.
    """
    if "goal" not in moment.memory:
        raise ValueError("sensors: expected a task with a goal of each episode, such as task=pointnav, got one without")
    return moment.memory["goal"].double()


class PointGoal(PlainSensor):
    """Distance and direction of the goal from where the robot is: [B, 2] float32, rho in metres and phi in [-π, π].

    Habitat's ``pointgoal_with_gps_compass`` in two polar dimensions: rho is the straight distance, and phi the azimuth
    from where the robot looks, to the left positive (``IntegratedPointGoalGPSAndCompassSensor`` of habitat-lab's
    ``tasks/nav/nav.py``).
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """A length and an angle."""
        return Unbounded(shape=(2,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Rho and phi."""
        away = goal_of(moment)[:, :2] - moment.planar[:, :2]
        phi = wrapped(torch.atan2(away[:, 1], away[:, 0]) - moment.planar[:, 2])
        return torch.stack([away.norm(dim=1), phi], 1).float()


class ImageGoal(PlainSensor):
    """What the robot's camera would see at the goal, [B, H, W, 3] uint8, drawn once for an episode.

    Habitat's ``imagegoal``; the goal's yaw is drawn with the goal.
    """

    KEY = "imagegoal"

    def spec(self, robot: Robot) -> TensorSpec:
        """An image of the robot's camera."""
        return Bounded(0, 255, shape=(robot.image_height, robot.image_width, 3), dtype=torch.uint8)

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """The image itself is remembered."""
        return {self.KEY: self.spec(robot)}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """Draw the image."""
        goal = goal_of(moment).float()
        place = torch.cat([goal[:, :2], moment.body_to_world[:, 2:3, 3]], 1)
        return {self.KEY: moment.look(rigid(axis_rotations(2, goal[:, 2]), place))}

    def read(self, moment: Moment) -> Tensor:
        """The image of this episode."""
        return moment.memory[self.KEY].clone()
