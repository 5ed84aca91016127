"""One reward for each way in which a step can turn out: what the tasks share."""

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from splatrl.envs.tasks.base import Motion, Outcome, Verdict


class OutcomeRewards(nn.Module, ABC):
    """Judges a step by collision, then bounds, then goal; a goal, a collision and leaving the bounds end the episode.

    Subclasses say what ``reached`` means.

    Args:
        motion: of the robots.
        goal_reward: reward at the goal.
        step_reward: reward of any other step.
        collision_reward: reward of touching something.
        bounds_reward: reward of leaving the bounds.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a limit below one step.
    """

    motion: Motion
    outcome_rewards: Tensor  # [4] float32, by Outcome

    def __init__(
        self,
        motion: Motion,
        goal_reward: float,
        step_reward: float,
        collision_reward: float,
        bounds_reward: float,
        max_steps: int,
    ):
        super().__init__()
        if max_steps < 1:
            raise ValueError(f"task.max_steps: expected at least 1, got {max_steps}")
        self.motion, self.max_steps, self.goal_reward = motion, max_steps, goal_reward
        rewards = torch.tensor([step_reward, goal_reward, collision_reward, bounds_reward], dtype=torch.float32)
        self.register_buffer("outcome_rewards", rewards, persistent=False)

    @abstractmethod
    def reached(self, state: Tensor) -> Tensor:
        """Whether states are at the goal: [B, ...] -> [B] bool."""

    def judge(self, state: Tensor, action: Tensor, next_state: Tensor, hit: Tensor) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        goal = torch.where(self.reached(next_state), Outcome.GOAL, Outcome.RUNNING)
        outcome = self._blocked(next_state, hit, goal).unsqueeze(1)
        return Verdict(self.outcome_rewards[outcome], outcome != Outcome.RUNNING, outcome)

    def _blocked(self, next_state: Tensor, hit: Tensor, otherwise: Tensor) -> Tensor:
        """The outcome of moves that are blocked, and of the others what is given: [B] int64."""
        outcome = torch.where(self.motion.inside(next_state), otherwise, Outcome.OUT_OF_BOUNDS)
        return torch.where(hit, Outcome.COLLISION, outcome)
