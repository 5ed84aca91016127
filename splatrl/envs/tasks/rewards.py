"""Base class of tasks with one reward for each outcome of a step."""

from abc import abstractmethod
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from splatrl.envs.tasks.base import Anywhere, Outcome, Step, Verdict
from splatrl.envs.tasks.fitting import require_part
from splatrl.envs.tasks.module import TaskModule
from splatrl.motions.base import PlannedMotion
from splatrl.values import require_number


@dataclass(frozen=True)
class FiniteRewards:
    """Named rewards, each of which must be a finite number.

    Raises:
        ValueError: for a reward that is not a finite number; names its key.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            require_number(f"task.rewards.{field.name}", getattr(self, field.name), -1e9, 1e9)


@dataclass(frozen=True)
class Rewards(FiniteRewards):
    """Reward of a step by its outcome: ``step``, or instead one of the others if that happens.

    Attributes:
        step: reward of a step in which nothing else happens.
        goal: reward for reaching the goal.
        collision: reward for touching something.
        out_of_bounds: reward for leaving the bounds.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    step: float = -0.2
    goal: float = 50.0
    collision: float = -10.0
    out_of_bounds: float = -10.0


PUBLISHED = Rewards()
"""The rewards of "Robotic Learning in your Backyard"."""


class OutcomeTask(TaskModule):
    """Judges each step by collision, then bounds, then goal, any of which ends the episode.

    Subclasses define which states are ``reached``.

    Args:
        motion: how the robots move.
        rewards: reward of each outcome.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for rewards of another kind, or ``max_steps`` below 1.
    """

    outcome_rewards: Tensor  # [4] float32, indexed by Outcome

    def __init__(self, motion: PlannedMotion, rewards: Rewards, max_steps: int):
        super().__init__(motion, max_steps)
        require_part("rewards", rewards, Rewards, "a reward for each outcome", "published", "unit")
        values = [rewards.step, rewards.goal, rewards.collision, rewards.out_of_bounds]
        self.register_buffer("outcome_rewards", torch.tensor(values, dtype=torch.float32), persistent=False)

    @abstractmethod
    def reached(self, state: Tensor) -> Tensor | None:
        """Return whether states are at the goal: [B, ...] -> [B] bool; None only until the task has settled."""

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        goal = self.reached(step.move.state)
        assert goal is not None, "a task judges only after settle"
        outcome = self._outcome(step, goal).unsqueeze(1)
        return Verdict(self.outcome_rewards[outcome], outcome != Outcome.RUNNING, outcome)

    def _outcome(self, step: Step, goal: Tensor) -> Tensor:
        """Return the outcome of each step, with collision before bounds before goal: [B] bool -> [B] int64."""
        outcome = torch.where(step.move.inside, goal * Outcome.GOAL, Outcome.OUT_OF_BOUNDS)  # RUNNING is 0
        collides = (step.move.free_fraction < 1) | self.motion.fallen(step.move.state)
        return torch.where(collides, Outcome.COLLISION, outcome)
