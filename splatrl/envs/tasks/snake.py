"""The snake task: one apple after the other."""

import torch
from torch import Tensor

from splatrl.envs.tasks.apple import Apple
from splatrl.envs.tasks.base import Verdict


class Snake(Apple):
    """Find apple after apple: each time one is reached, the next stands at another free place.

    Observation and action are those of ``Apple``.
    Reward: [B, 1] float32; −0.2 a step, and in its place +50 at an apple, −10 for touching something or the bounds.
    Termination: never. A blocked robot stays where it was and goes on; ``outcome`` says what that step met.
    Truncation: after ``max_steps`` steps.
    State: that of ``Apple``; ``target`` [B, 3] float32 moves on in the step that reaches it, and is shown at the new
        place from the next step on.

    The published code knows no bounds and pushes a robot back by two steps until it is free; here a move that would
    touch something is not made. Starts and apples are free places connected to ``place``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=snake"], batch_size=[4])
        >>> bool(env.rollout(20)["next", "terminated"].any())
        False
    """

    ends_at_goal = False

    def judge(self, state: Tensor, action: Tensor, next_state: Tensor, hit: Tensor) -> Verdict:
        """Judge all but the goal; see ``Task.judge``."""
        verdict = super().judge(state, action, next_state, hit)
        return verdict._replace(terminated=torch.zeros_like(verdict.terminated))

    def targets(self, states: Tensor) -> Tensor:
        """An apple where each state is, at the height of ``place``: [N, 3] -> [N, 3] float32."""
        return torch.cat([states[:, :2], self.place[2].expand(len(states), 1)], 1)
