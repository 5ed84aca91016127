"""Sensors: what robots observe in addition to their camera image."""

from splatrl.envs.sensors.base import Moment, PlainSensor, Sensor
from splatrl.envs.sensors.contact import Contact
from splatrl.envs.sensors.depth import Depth
from splatrl.envs.sensors.goals import GoalSensor, ImageGoal, PointGoal
from splatrl.envs.sensors.lidar import Lidar
from splatrl.envs.sensors.odometry import Compass, Gps, Heading
from splatrl.envs.sensors.physics import EgoMotion, Felt, Joints, Measured, Velocity

__all__ = [
    "Compass",
    "Contact",
    "Depth",
    "EgoMotion",
    "Felt",
    "GoalSensor",
    "Gps",
    "Heading",
    "ImageGoal",
    "Joints",
    "Lidar",
    "Measured",
    "Moment",
    "PlainSensor",
    "PointGoal",
    "Sensor",
    "Velocity",
]
