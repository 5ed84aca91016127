"""A contact sensor, like a bumper."""

import torch
from torch import Tensor
from torchrl.data import Categorical, TensorSpec

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor


class Contact(PlainSensor):
    """Whether the last move touched something: [B, 1] bool, false where an episode begins."""

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of a flag, [1] bool."""
        return Categorical(2, shape=(1,), dtype=torch.bool)

    def read(self, moment: Moment) -> Tensor:
        """Return whether any part of the last move was blocked: [B, 1] bool."""
        return moment.free_fraction.unsqueeze(1) < 1.0
