"""What every task promises."""

from enum import IntEnum
from typing import NamedTuple, Protocol, runtime_checkable

from torch import Tensor
from torchrl.data import TensorSpec


class Outcome(IntEnum):
    """How an episode stands after a step."""

    RUNNING = 0
    GOAL = 1
    COLLISION = 2
    OUT_OF_BOUNDS = 3
    TIMEOUT = 4


class Verdict(NamedTuple):
    """A task's judgement of one step of each robot.

    Attributes:
        reward: [B, 1] float32.
        terminated: [B, 1] bool.
        outcome: [B, 1] int64, an Outcome; never TIMEOUT, which is the env's to say.
    """

    reward: Tensor
    terminated: Tensor
    outcome: Tensor


class Motion(Protocol):
    """How actions change a task's state; states are [B, ...] tensors of any kind."""

    @property
    def action_spec(self) -> TensorSpec:
        """Spec of one robot's action."""
        ...

    @property
    def state_spec(self) -> TensorSpec:
        """Spec of one robot's state."""
        ...

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Where an unhindered action leads."""
        ...

    def inside(self, state: Tensor) -> Tensor:
        """Whether states are within the bounds: [B] bool."""
        ...

    def planar(self, state: Tensor) -> Tensor:
        """Position and heading of states: [B, 3] float64, x and y in metres, yaw in radians."""
        ...

    def body_to_world(self, state: Tensor) -> Tensor:
        """Poses of states: [B, 4, 4] float32."""
        ...


class Task(Protocol):
    """Owns the goal: motion, goal test, rewards and the limit of steps."""

    motion: Motion
    goal: Tensor  # x and y in metres and yaw in radians of the goal pose, [3] float64; yaw is NaN where any will do
    max_steps: int

    def reached(self, state: Tensor) -> Tensor:
        """Whether states are at the goal: [B] bool."""
        ...

    def judge(self, state: Tensor, action: Tensor, next_state: Tensor, hit: Tensor) -> Verdict:
        """Judge one step, before anything is rendered.

        Args:
            state: [B, ...] before the step.
            action: [B, ...].
            next_state: [B, ...] where the unhindered action leads.
            hit: [B] bool, whether the body touches something on the way there.
        """
        ...


@runtime_checkable
class SeenGoal(Protocol):
    """A task whose goal is an object that must be seen: judged by the ``ImageGoal`` transform, behind the overlay."""

    goal_reward: float
    ends_at_goal: bool

    def targets(self, states: Tensor) -> Tensor:
        """Places for the object at the beginning of episodes.

        Args:
            states: [N, D], drawn from the whole start set, one for each place.

        Returns:
            [N, 3] float32, world, metres.
        """
        ...

    def seen(self, state: Tensor, target: Tensor, pixels: Tensor) -> Tensor:
        """Whether robots are at the object and see it.

        Args:
            state: [B, ...].
            target: [B, 3] where the object is, world, metres.
            pixels: [B, H, W, 3] uint8, with the object in them.

        Returns:
            [B] bool.
        """
        ...
