"""A checker for robots that go through everything."""

import torch
from torch import Tensor

from splatrl.bodies import Body
from splatrl.collision.occupancy import Occupancy


class NoChecker:
    """Finds nothing solid anywhere.

    Args:
        occupancy: accepted as by the other checkers, and ignored.
        body: likewise.
    """

    def __init__(self, occupancy: Occupancy, body: Body):
        self.body = body

    def collides(self, body_to_world: Tensor) -> Tensor:
        """False: [B, 4, 4] -> [B] bool."""
        return torch.zeros(len(body_to_world), dtype=torch.bool, device=body_to_world.device)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """One, the whole move is free: [B, 4, 4] -> [B] float32."""
        return torch.ones(len(start), device=start.device)

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """False: [B, 4, 4] -> [B] bool."""
        return self.collides(start)

    def clearance(self, points: Tensor) -> Tensor:
        """Infinite: [B, 3] -> [B] float32."""
        return torch.full((len(points),), torch.inf, device=points.device)

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """The reach: [B, 4, 4], [R, 3] -> [B, R] float32."""
        return torch.full((len(body_to_world), len(beams)), float(reach), device=body_to_world.device)
