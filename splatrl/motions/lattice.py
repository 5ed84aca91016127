"""Steps along the world's axes and turns on the spot: the motion of the grid task."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.geometry import axis_rotations, rigid
from splatrl.motions.finite import FiniteMotion
from splatrl.motions.size import require_area, require_few


class LatticeMotion(FiniteMotion):
    """Steps on a lattice of positions and headings: the motion of the grid task.

    A state is [..., 3] int64: the indices of x, y and heading. Positions are ``step`` apart from the lower to the upper
    bound, both included; headings run counter-clockwise from 0 (along +x). The six actions, in order, are +x, −x, +y,
    −y (along the world's axes, whatever the heading), +spin and −spin.

    Args:
        height: z of every pose, metres.
        step: distance between neighbouring positions, metres.
        angle_step_deg: angle between neighbouring headings, degrees; must divide 360.
        lower: smallest x and y, metres.
        upper: largest x and y, metres; a whole number of steps from ``lower``.

    Raises:
        ValueError: for bounds without area, a step that does not divide them, an angle that does not divide 360°, or
            more than ``MOST_STATES`` states.
    """

    turned: Tensor  # [headings, 4, 4], poses of all headings at the world's origin
    origin: Tensor  # [2] float64
    spacing: Tensor  # [3] float32, metres or radians per index of x, y and heading
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
        require_area(lower, upper)
        headings = whole_steps("task.motion.angle_step_deg", 360.0, angle_step_deg)
        columns, rows = (
            whole_steps(f"task.motion.step: bounds along {axis}", high - low, step) + 1
            for axis, low, high in zip("xy", lower, upper, strict=True)
        )
        require_few((columns, rows, headings), f" from {list(lower)} to {list(upper)} m in steps of {step} m")
        moves = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
        names = ("+x", "-x", "+y", "-y", "+spin", "-spin")
        super().__init__((columns, rows, headings), moves, names, step, math.tau / headings, height)
        yaws = torch.arange(headings, dtype=torch.float64) * self.angle_step
        turned = rigid(axis_rotations(2, yaws).float(), torch.zeros(headings, 3))
        self.register_buffer("turned", turned, persistent=False)
        spacing = torch.tensor([step, step, self.angle_step], dtype=torch.float32)
        self.register_buffer("spacing", spacing, persistent=False)
        self.register_buffer("origin", torch.tensor(tuple(lower), dtype=torch.float64), persistent=False)
        self.register_buffer("elevation", torch.tensor(height, dtype=torch.float32), persistent=False)

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Return where an unobstructed action leads, possibly outside the lattice.

        Args:
            state: [B, 3] int64.
            action: [B] int64 in [0, 6).

        Returns:
            [B, 3] int64, with the heading wrapped.
        """
        moved = state + self.moves.index_select(0, action)
        moved[:, 2].remainder_(self.shape[2])
        return moved

    def inside(self, state: Tensor) -> Tensor:
        """Return whether states are within the bounds, which are inclusive: [B, 3] -> [B] bool."""
        place = state[:, :2]
        return ((place >= 0) & (place < self.counts[..., :2])).all(1)

    def planar(self, state: Tensor) -> Tensor:
        """Return position and heading of states: [B, 3] int64 -> [B, 3] float64, x, y in metres, yaw in radians."""
        planar = (state * self.spacing).double()
        planar[:, :2] += self.origin
        return planar

    def body_to_world(self, state: Tensor) -> Tensor:
        """Return the poses of states: [B, 3] int64 -> [B, 4, 4] float32; equal states have bitwise equal poses."""
        poses = self.turned.index_select(0, state[:, 2])
        poses[:, :2, 3] = self.origin + state[:, :2] * self.spacing[:2]
        poses[:, 2, 3] = self.elevation
        return poses


def whole_steps(name: str, length: float, step: float) -> int:
    """Return the number of steps in a length.

    Raises:
        ValueError: if that is not a whole number of at least one.
    """
    got = length / step if step else 0.0
    count = round(got) if step > 0 and length > 0 and math.isfinite(got) else 0
    if count < 1 or abs(count * step - length) > 1e-6 * length:
        raise ValueError(f"{name}: expected a whole number of steps of {step} in {length:.6g}, got {got:.6g}")
    return count
