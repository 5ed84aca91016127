"""The scene as physics sees it: a ground plane and boxes."""

from dataclasses import dataclass

import torch
from torch import Tensor

UPRIGHT = 0.5
"""Lower limit on the z of a ground's unit normal: anything steeper is a wall."""


@dataclass(frozen=True)
class Terrain:
    """Ground and static obstacles of a scene, world frame, metres.

    Attributes:
        plane: [4] float64, the ground's unit normal, which points up, and its offset: normal · x = offset.
        boxes: [N, 6] float64, centre and half sizes of boxes along the world's axes.

    Raises:
        ValueError: for another shape, a number that is not finite, a normal that is not a unit vector or whose z is not
            above ``UPRIGHT``, or a box without volume.
    """

    plane: Tensor
    boxes: Tensor

    def __post_init__(self) -> None:
        for name, shape in (("plane", (4,)), ("boxes", (len(self.boxes), 6))):
            value = getattr(self, name)
            if value.shape != shape or value.dtype != torch.float64 or not value.isfinite().all():
                raise ValueError(
                    f"terrain.{name}: expected finite float64 {list(shape)}, got {value.dtype} {list(value.shape)}"
                )
        if abs(float(self.plane[:3].norm()) - 1.0) > 1e-6 or not self.plane[2] > UPRIGHT:
            raise ValueError(f"terrain.plane: expected a unit normal that points up, got {self.plane[:3].tolist()}")
        if not (self.boxes[:, 3:] > 0).all():
            raise ValueError("terrain.boxes: expected positive half sizes, got at least one that is not")

    @property
    def upright(self) -> Tensor:
        """[4] float64: unit quaternion wxyz of the shortest rotation from z to the ground's normal."""
        x, y, z = self.plane[:3]
        w = torch.sqrt(0.5 * (1.0 + z))
        return torch.stack([w, -y / (2 * w), x / (2 * w), torch.zeros_like(w)])

    def height(self, places: Tensor) -> Tensor:
        """Return the height of the ground: [..., 2] float64 x and y -> [...] float64 z, metres."""
        x, y, z, offset = self.plane.to(places)
        return (offset - x * places[..., 0] - y * places[..., 1]) / z


def level_ground(height: float = 0.0) -> Terrain:
    """Return a terrain that is a level plane and nothing else."""
    return Terrain(torch.tensor([0.0, 0.0, 1.0, height], dtype=torch.float64), torch.zeros(0, 6, dtype=torch.float64))
