"""Steps along the world's axes and turns on the spot: the motion of the grid task."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.geometry import axis_rotations, rigid
from splatrl.motions.finite import FiniteMotion


class LatticeMotion(FiniteMotion):
    """Steps on a lattice of positions and headings: the motion of the grid task.

    A state is [..., 3] int64: the indices of x, y and heading. Positions are ``step`` apart from the lower to the upper
    bound, both included; headings run counter-clockwise from 0 (along +x). The six actions, in order, are +x, −x, +y,
    −y (along the world's axes, whatever the heading), +spin and −spin.

    Args:
        height: z of every pose, metres.
        step: distance between neighbouring positions, metres.
        angle_step_deg: angle between neighbouring headings, degrees; it divides 360.
        lower: smallest x and y, metres.
        upper: largest x and y, metres; a whole number of steps from ``lower``.

    Raises:
        ValueError: for a step that does not divide the bounds or an angle that does not divide a turn.
    """

    rotations: Tensor  # [headings, 3, 3]
    origin: Tensor  # [2] float64
    elevation: Tensor  # [] float32, the height
    of_scene = (*FiniteMotion.of_scene, "origin", "elevation")

    def __init__(
        self,
        height: float,
        step: float = 0.2,
        angle_step_deg: float = 22.5,
        lower: Sequence[float] = (-1.0, -1.0),
        upper: Sequence[float] = (1.0, 1.0),
    ):
        headings = whole_steps("task.motion.angle_step_deg", 360.0, angle_step_deg)
        columns, rows = (
            whole_steps(f"task.motion.step: bounds along {axis}", high - low, step) + 1
            for axis, low, high in zip("xy", lower, upper, strict=True)
        )
        moves = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
        names = ("+x", "-x", "+y", "-y", "+spin", "-spin")
        super().__init__((columns, rows, headings), moves, names, step, math.tau / headings, height)
        yaws = torch.arange(headings, dtype=torch.float64) * self.angle_step
        self.register_buffer("rotations", axis_rotations(2, yaws).float(), persistent=False)
        self.register_buffer("origin", torch.tensor(tuple(lower), dtype=torch.float64), persistent=False)
        self.register_buffer("elevation", torch.tensor(height, dtype=torch.float32), persistent=False)

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Where an unobstructed action leads, possibly outside the lattice.

        Args:
            state: [B, 3] int64.
            action: [B] int64 in [0, 6).

        Returns:
            [B, 3] int64, heading wrapped.
        """
        moved = state + self.moves[action]
        return torch.cat([moved[:, :2], moved[:, 2:] % self.shape[2]], 1)

    def inside(self, state: Tensor) -> Tensor:
        """Whether states are within the bounds, which are inclusive: [B, 3] -> [B] bool."""
        x, y = state[:, 0], state[:, 1]
        return (x >= 0) & (x < self.counts[..., 0]) & (y >= 0) & (y < self.counts[..., 1])

    def planar(self, state: Tensor) -> Tensor:
        """Position and heading of states: [B, 3] int64 -> [B, 3] float64, x and y in metres, yaw in radians."""
        return torch.cat([self.origin + state[:, :2] * self.step, state[:, 2:] * self.angle_step], 1)

    def body_to_world(self, state: Tensor) -> Tensor:
        """Poses of states: [B, 3] int64 -> [B, 4, 4] float32; equal states have poses of equal bytes."""
        position, height = self.planar(state)[:, :2].float(), self.elevation.expand(len(state)).unsqueeze(1)
        return rigid(self.rotations[state[:, 2]], torch.cat([position, height], 1))


def whole_steps(name: str, length: float, step: float) -> int:
    """The number of steps in a length.

    Raises:
        ValueError: if that is not a whole number of at least one.
    """
    count = round(length / step) if step > 0 and length > 0 else 0
    if count < 1 or abs(count * step - length) > 1e-6 * length:
        got = length / step if step else 0.0
        raise ValueError(f"{name}: expected a whole number of steps of {step} in {length:.6g}, got {got:.6g}")
    return count
