"""Motions whose actions are steps of one length along the heading and turns on the spot by one angle."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torchrl.data import Categorical

from splatrl.motions.planar import PlanarMotion, along
from splatrl.values import require_number


class StepMotion(PlanarMotion):
    """Each action goes a number of steps along the heading and turns by a number of angle steps, tied to no lattice.

    A state is [..., 3] float32: x and y in metres and yaw in radians.

    Args:
        actions: number of steps and number of angle steps of each action, by name.
        step: length of a step, metres.
        angle_step_deg: angle of a turn, degrees; must divide 360.
        height: z of every pose, metres.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        spacing: distance between neighbouring starts, metres.
        headings: number of start headings; None takes every heading that is a whole number of turns.
        cell: distance between the positions at which paths are computed, metres.

    Raises:
        ValueError: for a step that is not positive, an angle that does not divide 360°, or bounds without area.
    """

    lengths: Tensor  # [A] float32
    turns: Tensor  # [A] float32

    def __init__(
        self,
        actions: Mapping[str, tuple[int, int]],
        step: float,
        angle_step_deg: float,
        height: float,
        lower: Sequence[float],
        upper: Sequence[float],
        spacing: float,
        headings: int | None,
        cell: float,
    ):
        require_number("task.motion.step", step, above=0.0, unit="metres")
        turns = round(min(360.0 / angle_step_deg, 2.0**62)) if angle_step_deg > 0 else 0
        if turns < 1 or abs(turns * angle_step_deg - 360.0) > 1e-6:
            raise ValueError(f"task.motion.angle_step_deg: expected a divisor of 360, got {angle_step_deg}")
        angle, directions = math.tau / turns, turns if headings is None else headings
        super().__init__(tuple(actions), step, angle, height, lower, upper, spacing, directions, cell, angle)
        lengths, angles = ([each[i] * unit for each in actions.values()] for i, unit in enumerate((step, angle)))
        self.register_buffer("lengths", torch.tensor(lengths), persistent=False)
        self.register_buffer("turns", torch.tensor(angles), persistent=False)

    @property
    def action_spec(self) -> Categorical:
        """Spec of one robot's action: the index of an action; no batch."""
        return Categorical(len(self.lengths), shape=(), dtype=torch.int64)

    def actions(self) -> Tensor:
        """Return the actions from which paths are made, which are all of them: [A] int64."""
        return torch.arange(len(self.lengths), device=self.lengths.device)

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Return where an unobstructed action leads, possibly out of bounds.

        Args:
            state: [B, 3] float32.
            action: [B] int64 in [0, A).

        Returns:
            [B, 3] float32.
        """
        turn = self.turns.index_select(0, action)  # indexing would take -1 as the last action
        return along(state, self.lengths.index_select(0, action), turn, torch.zeros_like(turn))
