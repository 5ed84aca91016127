"""The strides task: a legged robot follows commanded velocities by proprioception alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Memory, Outcome, Step, Verdict
from splatrl.envs.tasks.fitting import require_part
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.motions.legs import JOINTS, STRIDE, StridesMotion
from splatrl.physics.trot import FREQUENCY
from splatrl.values import require_number

NEAR, STRAIGHT = 0.25, 0.5
"""Velocity errors, in metres and radians per second, at which the reward for speed and turning has fallen to 1/e."""


@dataclass(frozen=True)
class StridesRewards(FiniteRewards):
    """Terms of the reward, which are summed in each step; a fall replaces them all.

    Attributes:
        speed: reward for matching the commanded velocity along the ground, scaled by exp(−(error / 0.25 m/s)²).
        turn: reward for matching the commanded angular velocity, likewise with 0.5 rad/s.
        smooth: weight of the squared change of each joint's departure from the trot since the step before.
        small: weight of the square of each joint's departure from the trot.
        bounce: weight of the squared vertical velocity, m²/s².
        sway: weight of the squared angular velocity of roll and pitch, rad²/s².
        fall: reward for a fall.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    speed: float = 1.0
    turn: float = 0.5
    smooth: float = -0.02
    small: float = -0.01
    bounce: float = -0.5
    sway: float = -0.02
    fall: float = -5.0


class Strides(TaskModule):
    """Follow commanded velocities on legs, blindly; the policy controls how far the joints depart from a trot.

    Observation: proprioception from the sensor ``felt`` (``LegsMotion.felt``); ``pixels`` carry no information.
    Action: [B, 12] float32 in [-1, 1], see ``StridesMotion``.
    Reward: [B, 1] float32, see ``StridesRewards``.
    Termination: a fall; or success, which is decided at the end of the last command.
    Truncation: at the end of the last command, without success.
    Success: no fall, and a mean error of the velocity along the ground of at most ``allowed``.
    State: [B, n] float64, see ``LegsMotion``; it holds the commands of the episode. Memory: ``strides`` [B, 1] int64,
        number of strides made; ``error`` [B, 1] float32, sum of their velocity errors, metres per second.

    Robots begin standing, at a random phase of the trot, with small random joint offsets and velocities.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=strides"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["felt"].shape
        torch.Size([4, 3, 46])

    Args:
        motion: how actions control the joints.
        rewards: see ``StridesRewards``.
        allowed: maximum mean velocity error of a success, metres per second.
        forward: lowest and highest commanded forward speed, metres per second; None takes the motion's limits.
        shaken: maximum initial offset of a joint, radians; initial velocities vary by three times this value per
            second.

    Raises:
        ValueError: for any other kind of motion or rewards, or a number out of range.
    """

    chooses_episodes = True
    motion: StridesMotion

    def __init__(
        self,
        motion: StridesMotion,
        rewards: StridesRewards | None = None,
        allowed: float = 0.2,
        shaken: float = 0.1,
        forward: Sequence[float] | None = None,
    ):
        require_part("motion", motion, StridesMotion, "legs controlled joint by joint", "strides")
        super().__init__(motion, round(motion.commands * motion.span / STRIDE))
        require_number("task.allowed", allowed, 0.0, 10.0)
        require_number("task.shaken", shaken, 0.0, 1.0)
        low, high = motion.forward_limits if forward is None else forward
        if not -2.0 <= low <= high <= 2.0:
            raise ValueError(f"task.forward: expected -2 ≤ lowest ≤ highest ≤ 2 m/s, got {[low, high]}")
        self.rewards, self.allowed, self.shaken = rewards or StridesRewards(), allowed, shaken
        require_part("rewards", self.rewards, StridesRewards, "the rewards of strides", "strides")
        self.lowest, self.highest = (low, -motion.turn_limit), (high, motion.turn_limit)

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Specs of the memory; see the class."""
        return {
            "strides": Unbounded(shape=(1,), dtype=torch.int64),
            "error": Unbounded(shape=(1,), dtype=torch.float32),
        }

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Return states that stand at the origin, randomly perturbed, with random commands; see ``Task.start``."""
        motion, layout, count = self.motion, self.motion.layout, len(state)
        options: dict[str, Any] = {"generator": anywhere.generator, "dtype": torch.float64, "device": state.device}
        state = motion.varied(motion.placed(state.new_zeros(count, 3)), anywhere.generator)
        drawn = self.shaken * (2.0 * torch.rand(count, 2 * JOINTS + 6, **options) - 1.0)
        state[:, layout.joints] += drawn[:, :JOINTS]
        state[:, layout.robot_velocities] += 3.0 * drawn[:, JOINTS:]
        state[:, motion.lead] = torch.rand(count, **options) / FREQUENCY
        low, high = (
            torch.tensor(limits, dtype=torch.float64, device=state.device) for limits in (self.lowest, self.highest)
        )
        commands = low + (high - low) * torch.rand(count, motion.commands, 2, **options)
        return motion.commanded(state, commands.flatten(1))

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Return a memory of no strides and no error; see ``Task.begin``."""
        none = torch.zeros(len(state), 1, device=state.device)
        return {"strides": none.long(), "error": none}

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Draw starts and commands for tests; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = starts[:1].expand(count, -1)
        anywhere = Anywhere(lambda: state, generator)
        state = self.start(state, anywhere)
        return {"state": state, **self.begin(state, anywhere)}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, motion, after = self.rewards, self.motion, step.move.state
        asked = motion.command(step.before)
        moves, velocity = motion.level_velocity(after), motion.velocity(after)
        error = (moves[:, 0] - asked[:, 0]).square() + moves[:, 1].square()
        astray = (moves[:, 2] - asked[:, 1]).square()
        departure = motion.departure(after)
        change = (departure - motion.departure(step.before)).square().sum(1)
        reward = rewards.speed * (-error / NEAR**2).exp() + rewards.turn * (-astray / STRAIGHT**2).exp()
        reward += rewards.smooth * change + rewards.small * departure.square().sum(1)
        reward += rewards.bounce * after[:, motion.layout.velocity][:, 2].square()
        reward += rewards.sway * velocity[:, 3:5].square().sum(1)
        fallen = motion.fallen(after) | step.move.failed
        reward = torch.where(fallen, rewards.fall, reward)
        strides, error = (
            step.memory["strides"] + 1,
            step.memory["error"] + error.sqrt().float().unsqueeze(1),
        )
        over = (strides.squeeze(1) >= self.max_steps) & ~fallen
        reached = over & (error.squeeze(1) / self.max_steps <= self.allowed)
        outcome = torch.where(fallen, Outcome.COLLISION, torch.where(reached, Outcome.GOAL, Outcome.RUNNING))
        memory = {"strides": strides, "error": error}
        return Verdict(reward.float().unsqueeze(1), (fallen | reached).unsqueeze(1), outcome.unsqueeze(1), memory)

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """Return no departures, so that the teacher is the trot alone; see ``Task.teach``."""
        return torch.zeros(len(state), JOINTS, device=state.device)
