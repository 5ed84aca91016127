"""Base class of tasks whose goal is a pose on the ground: grid, fps, poster and drive, which differ in their motion."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.envs.tasks.base import Mark, Memory
from splatrl.envs.tasks.rewards import PUBLISHED, OutcomeTask, Rewards
from splatrl.motions.base import PlannedMotion
from splatrl.values import are_numbers

SLACK = 1e-4
"""Tolerance for rounding at the inclusive bounds of the goal, as a fraction of a step."""


class PoseGoal(OutcomeTask):
    """Reach a pose to within one step along x, one along y and one angle step, each judged separately.

    Args:
        motion: how the robots move.
        goal: x and y in metres and yaw in degrees of the goal pose, from which the object is *seen*.
        rewards: reward of each outcome.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a goal that is not three finite numbers, or ``max_steps`` below 1.
    """

    goal: Tensor  # [3] float64
    tolerance: Tensor  # [3] float64
    of_scene = ("goal",)

    def __init__(
        self,
        motion: PlannedMotion,
        goal: Sequence[float],
        rewards: Rewards = PUBLISHED,
        max_steps: int = 200,
    ):
        super().__init__(motion, rewards, max_steps)
        if not are_numbers(goal, 3):
            raise ValueError(
                f"task.goal: expected finite x, y (metres) and yaw (degrees), got {goal}; type another landmarks.goal"
            )
        tolerance = torch.tensor([motion.step, motion.step, motion.angle_step], dtype=torch.float64)
        self.register_buffer("tolerance", tolerance * (1 + SLACK), persistent=False)
        x, y, yaw_deg = goal
        self.register_buffer("goal", torch.tensor([x, y, math.radians(yaw_deg)], dtype=torch.float64), persistent=False)

    def reached(self, state: Tensor) -> Tensor:
        """Return whether states are within one step and one angle step of the goal: [B, ...] -> [B] bool."""
        offset = (self.motion.planar(state) - self.goal).abs_()
        turn = offset[:, 2].remainder_(math.tau)
        torch.minimum(turn, math.tau - turn, out=turn)
        return (offset <= self.tolerance).all(1)

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return a mark at the goal pose; see ``Task.marks``."""
        return [Mark("goal pose", self.goal)]
