"""The snake task: find one apple after another."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from splatrl.envs.tasks.apple import Apple
from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, Verdict
from splatrl.motions import ForwardMotion
from splatrl.values import require_number


class Snake(Apple):
    """Find one apple after another: whenever one is reached, the next appears at another free place.

    Observation and action are those of ``Apple``.
    Reward: [B, 1] float32; −0.2 per step, replaced by +50 at an apple, −10 for touching something or the bounds.
    Termination: never. A blocked robot stays where it was and the episode continues; ``outcome`` tells what happened in
        that step.
    Truncation: after ``max_steps`` steps.
    Success: at least ``apples`` found in an episode; ``goals`` [B, 1] int64 counts them.
    State: that of ``Apple``; ``target`` [B, 3] float32 changes in the step in which the apple is reached, and the apple
        is rendered at its new place from the next step on.

    The published code has no bounds, and pushes a robot back by two steps until it is free; here a move that would
    touch something is not made. Starts and apples are at free places connected to ``place``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=snake"], batch_size=[4])
        >>> bool(env.rollout(20)["next", "terminated"].any())
        False

    Args:
        motion: how the robots move.
        place: a position to which all starts and apples must be connected; its z is the height of all apples; world,
            metres.
        apples: number of apples that makes an episode a success.
        settings: further arguments of ``Apple``.

    Raises:
        ValueError: for fewer than one apple, or anything that ``Apple`` refuses.
    """

    def __init__(self, motion: ForwardMotion, place: Sequence[float], apples: int = 1, **settings: Any):
        super().__init__(motion, place, **settings)
        require_number("task.apples", apples, 1, whole=True)
        self.goals_for_success = apples

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Place the first apple at random; see ``Task.begin``."""
        return {"target": self._targets(anywhere())}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step and place the next apple; see ``Task.judge``."""
        fresh, old = self._targets(anywhere()), step.memory["target"]
        outcome = self._outcome(step, self.seen(step.move.state, old, step.pixels, step.shown)).unsqueeze(1)
        target = torch.where(outcome == Outcome.GOAL, fresh, old)
        never = torch.zeros_like(outcome, dtype=torch.bool)
        return Verdict(self.outcome_rewards[outcome], never, outcome, {"target": target})

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return a mark at the current apple; without a memory none, since every episode has other places."""
        return [] if memory is None else super().marks(memory)

    def _targets(self, states: Tensor) -> Tensor:
        """Return apple positions at given states, at the height of ``place``: [B, 3] -> [B, 3] float32."""
        return torch.cat([states[:, :2], self.place[..., 2:].expand(len(states), 1)], 1)
