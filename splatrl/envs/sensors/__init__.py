"""Sensors: what robots observe besides their picture."""

from splatrl.envs.sensors.base import Moment, PlainSensor, Sensor
from splatrl.envs.sensors.contact import Contact
from splatrl.envs.sensors.depth import Depth
from splatrl.envs.sensors.goals import ImageGoal, PointGoal
from splatrl.envs.sensors.lidar import Lidar
from splatrl.envs.sensors.odometry import Compass, Gps, Heading

__all__ = [
    "Compass",
    "Contact",
    "Depth",
    "Gps",
    "Heading",
    "ImageGoal",
    "Lidar",
    "Moment",
    "PlainSensor",
    "PointGoal",
    "Sensor",
]
