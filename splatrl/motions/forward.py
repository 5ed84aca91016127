"""Steps along the heading and turns on the spot: the motion of the fps task."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Categorical

from splatrl.motions.planar import PlanarMotion, along

CELL = 0.05
"""Smallest distance between the positions at which paths are computed, metres."""


class ForwardMotion(PlanarMotion):
    """Moves forward and back by a step along the heading, and turns left and right by an angle, off any lattice.

    A state is [..., 3] float32: x and y in metres and yaw in radians. The four actions, in the published order, are
    forward, back, left (counter-clockwise) and right.

    Args:
        height: z of every pose, metres.
        step: length of a step, metres.
        angle_step_deg: angle of a turn, degrees; it divides 360.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        spacing: distance between neighbouring starts, metres; None takes the step. Starts have every heading that is a
            whole number of turns.

    Raises:
        ValueError: for a step that is not positive, an angle that does not divide a turn, or bounds without area.
    """

    lengths: Tensor  # [4] float32
    turns: Tensor  # [4] float32

    def __init__(
        self,
        height: float,
        step: float = 0.1,
        angle_step_deg: float = 10.0,
        lower: Sequence[float] = (-1.0, -1.0),
        upper: Sequence[float] = (1.0, 1.0),
        spacing: float | None = None,
    ):
        if not step > 0:
            raise ValueError(f"task.motion.step: expected more than 0 metres, got {step}")
        headings = round(360.0 / angle_step_deg) if angle_step_deg > 0 else 0
        if headings < 1 or abs(headings * angle_step_deg - 360.0) > 1e-6:
            raise ValueError(f"task.motion.angle_step_deg: expected a divisor of 360, got {angle_step_deg}")
        angle_step = math.tau / headings
        spacing = step if spacing is None else spacing
        names = ("forward", "back", "left", "right")
        cell = max(0.5 * step, CELL)
        super().__init__(names, step, angle_step, height, lower, upper, spacing, headings, cell, angle_step)
        self.register_buffer("lengths", torch.tensor([step, -step, 0.0, 0.0]), persistent=False)
        self.register_buffer("turns", torch.tensor([0.0, 0.0, angle_step, -angle_step]), persistent=False)

    @property
    def action_spec(self) -> Categorical:
        """One of four actions; no batch."""
        return Categorical(len(self.lengths), shape=(), dtype=torch.int64)

    def actions(self) -> Tensor:
        """The actions from which paths are made: [4] int64."""
        return torch.arange(len(self.lengths), device=self.lengths.device)

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Where an unobstructed action leads, possibly outside the bounds.

        Args:
            state: [B, 3] float32.
            action: [B] int64 in [0, 4).

        Returns:
            [B, 3] float32.
        """
        turn = self.turns[action]
        return along(state, self.lengths[action], turn, torch.zeros_like(turn))
