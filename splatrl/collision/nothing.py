"""A checker for robots that pass through everything."""

import torch
from torch import Tensor

from splatrl.bodies import Body
from splatrl.collision.occupancy import Occupancy


class NoChecker:
    """Reports that nothing is solid anywhere.

    Args:
        occupancy: ignored; accepted because the other checkers take it.
        body: the robot's body, which is never tested.
    """

    def __init__(self, occupancy: Occupancy, body: Body):
        self.body = body

    def collides(self, body_to_world: Tensor) -> Tensor:
        """Return False for every pose: [B, 4, 4] -> [B] bool."""
        return torch.zeros(len(body_to_world), dtype=torch.bool, device=body_to_world.device)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """Return 1 for every move, since all of it is free: [B, 4, 4] -> [B] float32."""
        return torch.ones(len(start), device=start.device)

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Return False for every move: [B, 4, 4] -> [B] bool."""
        return self.collides(start)

    def clearance(self, points: Tensor) -> Tensor:
        """Return infinity for every point: [B, 3] -> [B] float32."""
        return torch.full((len(points),), torch.inf, device=points.device)

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Return the reach for every beam: [B, 4, 4], [R, 3] -> [B, R] float32."""
        return torch.full((len(body_to_world), len(beams)), float(reach), device=body_to_world.device)
