"""The snake task: one apple after another."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from splatrl.envs.tasks.apple import Apple
from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, Verdict
from splatrl.motions import ForwardMotion
from splatrl.values import require_number


class Snake(Apple):
    """Find apple after apple: whenever one is reached, the next one appears at another free place.

    Observation and action are those of ``Apple``.
    Reward: [B, 1] float32; −0.2 a step, or instead +50 at an apple, −10 for touching something or the bounds.
    Termination: never. A blocked robot stays where it was and goes on; ``outcome`` says what happened in that step.
    Truncation: after ``max_steps`` steps.
    Success: with at least ``apples`` in an episode; ``goals`` [B, 1] int64 counts them.
    State: that of ``Apple``; ``target`` [B, 3] float32 moves on in the step that reaches it, and is drawn at the new
        place from the next step on.

    The published code has no bounds, and pushes a robot back by two steps until it is free; here a move that would
    touch something is not made. Starts and apples are free places connected to ``place``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=snake"], batch_size=[4])
        >>> bool(env.rollout(20)["next", "terminated"].any())
        False

    Args:
        motion: how the robots move.
        place: a place from which all others can be reached, at the height of the apples, world, metres.
        apples: apples that make an episode a success.
        settings: those of ``Apple``.

    Raises:
        ValueError: for fewer apples than one, or what ``Apple`` refuses.
    """

    def __init__(self, motion: ForwardMotion, place: Sequence[float], apples: int = 1, **settings: Any):
        super().__init__(motion, place, **settings)
        require_number("task.apples", apples, 1, whole=True)
        self.goals_for_success = apples

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Place the first apple anywhere; see ``Task.begin``."""
        return {"target": self._targets(anywhere())}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step and place the next apple; see ``Task.judge``."""
        fresh, old = self._targets(anywhere()), step.memory["target"]
        outcome = self._outcome(step, self.seen(step.move.state, old, step.pixels)).unsqueeze(1)
        target = torch.where(outcome == Outcome.GOAL, fresh, old)
        never = torch.zeros_like(outcome, dtype=torch.bool)
        return Verdict(self.outcome_rewards[outcome], never, outcome, {"target": target})

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """The current apple; without a memory nothing, since no place is the same in every episode."""
        return [] if memory is None else super().marks(memory)

    def _targets(self, states: Tensor) -> Tensor:
        """A place for an apple at each state, at the height of ``place``: [B, 3] -> [B, 3] float32."""
        return torch.cat([states[:, :2], self.place[..., 2:].expand(len(states), 1)], 1)
