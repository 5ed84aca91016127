"""The grid task: walk a lattice to the pose that sees the object."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from splatrl.envs.motions import LatticeMotion
from splatrl.envs.tasks.base import Outcome, Verdict


class Grid(nn.Module):
    """Reach a goal pose by steps along the world's axes and turns on the spot.

    The task of "Robotic Learning in your Backyard", with its actions and rewards.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: [B] int64, one of +x, −x, +y, −y, +spin, −spin.
    Reward: [B, 1] float32; −0.2 a step, and in its place +50 at the goal, −10 on a collision, −10 out of bounds.
    Termination: goal, collision or out of bounds, judged in the order collision, out of bounds, goal. The goal is
        reached where |dx| ≤ one step, |dy| ≤ one step and |dyaw| ≤ one angle step, each by itself. A blocked robot
        stays at its previous lattice pose.
    Truncation: after ``max_steps`` steps.
    State: [B, 3] int64, lattice indices of x, y and heading.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=grid"], batch_size=[4])
        >>> env.rollout(3)["next", "reward"].shape
        torch.Size([4, 3, 1])

    Args:
        motion: the lattice.
        goal: x and y in metres and yaw in degrees of the goal pose, which is the pose that *sees* the object.
        goal_reward: reward at the goal.
        step_reward: reward of any other step.
        collision_reward: reward of touching something.
        bounds_reward: reward of leaving the lattice.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a goal that is not three finite numbers or a limit below one step.
    """

    goal: Tensor  # [3] float64
    outcome_rewards: Tensor  # [4] float32, by Outcome

    def __init__(
        self,
        motion: LatticeMotion,
        goal: Sequence[float],
        goal_reward: float = 50.0,
        step_reward: float = -0.2,
        collision_reward: float = -10.0,
        bounds_reward: float = -10.0,
        max_steps: int = 200,
    ):
        super().__init__()
        if len(goal) != 3 or not all(math.isfinite(value) for value in goal):
            raise ValueError(f"task.goal: expected finite x, y (metres) and yaw (degrees), got {list(goal)}")
        if max_steps < 1:
            raise ValueError(f"task.max_steps: expected at least 1, got {max_steps}")
        self.motion, self.max_steps = motion, max_steps
        x, y, yaw_deg = goal
        rewards = [step_reward, goal_reward, collision_reward, bounds_reward]
        self.register_buffer("goal", torch.tensor([x, y, math.radians(yaw_deg)], dtype=torch.float64), persistent=False)
        self.register_buffer("outcome_rewards", torch.tensor(rewards), persistent=False)

    def reached(self, state: Tensor) -> Tensor:
        """Whether states are within one step and one angle step of the goal: [B, 3] int64 -> [B] bool."""
        offset = (self.motion.planar(state) - self.goal).abs()
        turn = torch.minimum(offset[:, 2] % math.tau, math.tau - offset[:, 2] % math.tau)
        slack = 1 + 1e-6  # the bounds are inclusive
        near = (offset[:, :2] <= self.motion.step * slack).all(1)
        return near & (turn <= self.motion.angle_step * slack)

    def judge(self, state: Tensor, action: Tensor, next_state: Tensor, hit: Tensor) -> Verdict:
        """Judge a step by collision, then bounds, then goal; see ``Task.judge``."""
        outcome = torch.where(self.reached(next_state), Outcome.GOAL, Outcome.RUNNING)
        outcome = torch.where(self.motion.inside(next_state), outcome, Outcome.OUT_OF_BOUNDS)
        outcome = torch.where(hit, Outcome.COLLISION, outcome).unsqueeze(1)
        return Verdict(self.outcome_rewards[outcome], outcome != Outcome.RUNNING, outcome)
