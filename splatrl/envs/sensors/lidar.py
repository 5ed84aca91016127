"""A planar lidar."""

import math

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor
from splatrl.values import require_number


class Lidar(PlainSensor):
    """A planar scan from the body's centre: [B, beams] float32 metres, ``reach`` where nothing is hit.

    A beam ends where it enters a solid voxel of the scene or, for a robot with physics, a solid geom of one of the
    things, and is 0 where it begins in one. The robot's own links do not stop it, nor does what is only drawn, such as
    marks and sprites.

    Beams are ordered counter-clockwise, as in ROS's ``sensor_msgs/LaserScan``: the first points half the field of view
    to the right of the body's +x. A 360° field does not repeat its first beam. A single beam points ahead.

    Args:
        beams: number of beams.
        field_deg: field of view, degrees: the angle between the first and the last beam, or 360 to spread the beams
            evenly over a full turn.
        reach: maximum range, metres.
        elevation_deg: angle of all beams above the body's horizontal plane, degrees.

    Raises:
        ValueError: for a number out of range.
    """

    def __init__(self, beams: int = 64, field_deg: float = 360.0, reach: float = 10.0, elevation_deg: float = 0.0):
        require_number("sensors.lidar.beams", beams, 1, 2**20, whole=True)
        require_number("sensors.lidar.field_deg", field_deg, 0.0, 360.0)
        require_number("sensors.lidar.reach", reach, 1e-3, 1e6)
        require_number("sensors.lidar.elevation_deg", elevation_deg, -90.0, 90.0)
        self.reach = float(reach)
        self.beams, self.field_deg, self.elevation_deg = beams, float(field_deg), float(elevation_deg)
        gaps = beams if field_deg == 360.0 else max(beams - 1, 1)
        first = 0.0 if beams == 1 else -field_deg / 2
        azimuth = torch.deg2rad(first + torch.arange(beams, dtype=torch.float64) * field_deg / gaps)
        up = math.radians(elevation_deg)
        level = torch.stack([azimuth.cos(), azimuth.sin()], 1) * math.cos(up)
        self._beams = {torch.device("cpu"): torch.cat([level, torch.full((beams, 1), math.sin(up))], 1).float()}

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of one range per beam."""
        return Bounded(0.0, self.reach, shape=(self.beams,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return the range of each beam: [B, beams] float32, metres."""
        device = moment.body_to_world.device
        if device not in self._beams:  # cached, since each copy would block the host
            self._beams[device] = self._beams[torch.device("cpu")].to(device)
        cast = moment.body_to_world, self._beams[device], self.reach
        scene, things = moment.checker.ranges(*cast), moment.motion.ranges(moment.state, *cast)
        return scene if things is None else torch.minimum(scene, things)
