"""A depth camera."""

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor
from splatrl.values import require_number


class Depth(PlainSensor):
    """Depth of each pixel of the robot's own view, [B, H, W, 1] float32, like Habitat's ``depth``.

    Depth is in metres along the optical axis, clipped to the camera's range and, if ``normalize`` is set, scaled so
    that the range becomes [0, 1] (Habitat's ``min_depth``, ``max_depth`` and ``normalize_depth``). Where nothing is
    seen, it takes the farthest value.

    Args:
        nearest: lower end of the camera's range, metres.
        farthest: upper end of the camera's range, metres.
        normalize: whether to scale the range to [0, 1].

    Raises:
        ValueError: for a range that is empty or not finite.
    """

    needs_depth = True

    def __init__(self, nearest: float = 0.0, farthest: float = 10.0, normalize: bool = True):
        require_number("sensors.depth.nearest", nearest, 0.0, 1e6)
        require_number("sensors.depth.farthest", farthest, 0.0, 1e6)
        if not nearest < farthest:
            raise ValueError(f"sensors.depth: expected nearest below farthest, got {nearest} and {farthest}")
        self.nearest, self.farthest, self.normalize = nearest, farthest, normalize

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of a one-channel image of the camera's size."""
        low, high = (0.0, 1.0) if self.normalize else (self.nearest, self.farthest)
        return Bounded(low, high, shape=(robot.image_height, robot.image_width, 1), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return the depth of each pixel: [B, H, W, 1] float32, metres, or in [0, 1] if normalised."""
        assert moment.depth is not None, "expected depth, which the env renders if a sensor needs it, got None"
        depth = moment.depth.clamp(self.nearest, self.farthest)
        if self.normalize:
            depth = ((depth - self.nearest) / (self.farthest - self.nearest)).clamp(0.0, 1.0)
        return depth.unsqueeze(-1)
