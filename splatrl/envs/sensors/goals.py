"""Sensors that describe the goal: its distance and direction, or an image taken there."""

from collections.abc import Mapping

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor
from splatrl.envs.tasks.base import Task
from splatrl.geometry import azimuths, wrapped


class GoalSensor(PlainSensor):
    """A sensor of the goal that a task remembers for each episode."""

    def check(self, task: Task) -> None:
        """Refuse tasks without goals of their episodes."""
        if task.goal_radius is None:
            raise ValueError("expected a task with a goal per episode, such as task=pointnav, got one without")

    def goal(self, moment: Moment) -> Tensor:
        """Return the goals: [B, 3] float64, x and y in metres and yaw in radians."""
        return moment.memory["goal"].double()


class PointGoal(GoalSensor):
    """Distance and direction from the robot to the goal: [B, 2] float32, rho in metres and phi in [-π, π].

    This is Habitat's ``pointgoal_with_gps_compass`` in 2D polar coordinates: rho is the straight-line distance, and phi
    the azimuth relative to the robot's heading, positive to the left (``IntegratedPointGoalGPSAndCompassSensor`` in
    habitat-lab's ``tasks/nav/nav.py``).
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of a length and an angle."""
        return Unbounded(shape=(2,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return rho, metres, and phi, radians: [B, 2] float32."""
        away = self.goal(moment)[:, :2] - moment.planar[:, :2]
        phi = wrapped(azimuths(away) - moment.planar[:, 2])
        return torch.stack([away.norm(dim=1), phi], 1).float()


class ImageGoal(GoalSensor):
    """View that the robot's camera would have at the goal, [B, H, W, 3] uint8, rendered once per episode.

    This is Habitat's ``imagegoal``; the goal's yaw is drawn at random together with the goal.
    """

    KEY = "imagegoal"

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of an image of the camera's size."""
        return Bounded(0, 255, shape=(robot.image_height, robot.image_width, 3), dtype=torch.uint8)

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """Return the spec of the image, which is remembered itself."""
        return {self.KEY: self.spec(robot)}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """Render the view at the goal: [B, H, W, 3] uint8."""
        return {self.KEY: moment.look(moment.motion.nearest(self.goal(moment)))}

    def read(self, moment: Moment) -> Tensor:
        """Return the episode's goal image: [B, H, W, 3] uint8."""
        return moment.memory[self.KEY].clone()
