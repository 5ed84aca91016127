"""A grid of nodes at positions and headings on a plane, and interpolation between them."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from splatrl.motions.base import Taps
from splatrl.motions.size import require_few

PLACES = 1024
"""Poses snap to 1 / PLACES of a cell, so that rounding does not spread a pose on a node over eight nodes."""


@dataclass(frozen=True)
class PoseGrid:
    """Nodes at positions ``cell`` apart and headings ``angle_cell`` apart.

    Attributes:
        lower: [2] position of the first node, metres.
        shape: number of columns (x), rows (y) and headings.
        cell: distance between neighbouring positions, metres.
        angle_cell: angle between neighbouring headings, radians.
    """

    lower: Tensor
    shape: tuple[int, int, int]
    cell: float
    angle_cell: float

    @classmethod
    def over(cls, lower: Tensor, upper: Tensor, cell: float, angle_cell: float) -> "PoseGrid":
        """Make the grid that covers some bounds.

        Args:
            lower: [2] smallest x and y, metres.
            upper: [2] largest x and y, metres.
            cell: distance between neighbouring positions, metres.
            angle_cell: angle between neighbouring headings, radians; rounded so that it divides a full turn.

        Raises:
            ValueError: for more than ``MOST_STATES`` nodes.
        """
        columns, rows = (int(min(cells, 2.0**62)) + 1 for cells in ((upper - lower) / cell).round().tolist())
        headings = round(math.tau / angle_cell)
        where = f" in steps of {cell:g} m"
        require_few((columns, rows, headings), where, "poses for shortest paths", "choose a smaller area")
        return cls(lower, (columns, rows, headings), cell, math.tau / headings)

    def nodes(self) -> Tensor:
        """Return the pose of each node: [C, 3] float32, x and y in metres and yaw in radians."""
        axes = torch.cartesian_prod(*(torch.arange(count, device=self.lower.device) for count in self.shape))
        return torch.cat([self.lower + self.cell * axes[:, :2], self.angle_cell * axes[:, 2:]], 1)

    def taps(self, state: Tensor) -> Taps:
        """Return the eight nodes around poses, with trilinear weights; poses beyond the grid are clamped to its edge.

        Args:
            state: [N, 3] float32, x and y in metres and yaw in radians.

        Returns:
            Taps of [N, 8].
        """
        x, y = ((state[:, :2] - self.lower) / self.cell).unbind(1)
        heading = state[:, 2] / self.angle_cell
        node = state.new_zeros(len(state), 1, dtype=torch.int64)
        weight = state.new_ones(len(state), 1)
        for place, count, wraps in zip((x, y, heading), self.shape, (False, False, True), strict=True):
            place = (place * PLACES).round() / PLACES
            low = place.floor()
            pair = torch.stack([low, low + 1], 1).long()
            pair = pair % count if wraps else pair.clamp(0, count - 1)
            share = torch.stack([1 - (place - low), place - low], 1)
            node = (node.unsqueeze(2) * count + pair.unsqueeze(1)).flatten(1)
            weight = (weight.unsqueeze(2) * share.unsqueeze(1)).flatten(1)
        return Taps(node, weight)
