"""The interface that every task implements."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.motions.base import Move, PlannedMotion
from splatrl.motions.physics import PhysicsMotion
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.several import rows_of
from splatrl.values import require_number

Module = TypeVar("Module", bound="TaskModule")
Memory = Mapping[str, Tensor]
"""What a task remembers of each robot, by key: [B, ...] tensors that travel in the TensorDict."""
NOTHING: Memory = {}


@dataclass(frozen=True)
class Anywhere:
    """Draws a state for each robot from the whole start set, whatever the level: [B, ...].

    Attributes:
        states: draws them.
        generator: the env's own, for what else a task draws.
    """

    states: Callable[[], Tensor]
    generator: torch.Generator

    def __call__(self) -> Tensor:
        """Draw a state for each robot."""
        return self.states()


class Outcome(IntEnum):
    """The state of an episode after a step."""

    RUNNING = 0
    GOAL = 1
    COLLISION = 2
    OUT_OF_BOUNDS = 3
    TIMEOUT = 4
    STOPPED = 5
    """The robot said that it was at its goal, and was not."""


class Step(NamedTuple):
    """One step of each robot, after it was carried out and rendered.

    Attributes:
        before: [B, ...] states before it.
        action: [B, ...] what the robots did.
        move: what the motion made of the action, including the states after it.
        memory: what the task remembered before it.
        pixels: [B, H, W, 3] uint8, what the robots see after it.
    """

    before: Tensor
    action: Tensor
    move: Move
    memory: Memory
    pixels: Tensor


class Verdict(NamedTuple):
    """A task's judgement of one step of each robot.

    Attributes:
        reward: [B, 1] float32.
        terminated: [B, 1] bool.
        outcome: [B, 1] int64, an ``Outcome``; never TIMEOUT, which only the env sets.
        memory: what the task remembers from now on, with the keys of ``Task.memory_spec``.
    """

    reward: Tensor
    terminated: Tensor
    outcome: Tensor
    memory: Memory = NOTHING


@dataclass(frozen=True)
class Mark:
    """Something that a map shows.

    Attributes:
        name: its entry in the legend.
        planar: [3] float64, x and y in metres and yaw in radians; the yaw is NaN where there is no direction.
    """

    name: str
    planar: Tensor


class Task(Protocol):
    """What robots are rewarded for, how they move, and when an episode ends.

    A task judges each step once, after the robots' views are rendered, so that the image may decide whether a goal is
    reached. It may remember something about each robot, have one goal, several or none, and place things in the
    picture. ``TaskModule`` has defaults for everything but the reward.

    Attributes:
        motion: how the robots move.
        max_steps: an episode is truncated after this many steps.
        goals_for_success: None for a task whose episodes end at their goal, and so succeed; a number for one whose
            episodes go on, and succeed with at least so many goals. Curricula and tests go by it.
        chooses_episodes: whether starts belong to goals of their own, so that tests take those of ``ChoosingTask``.
    """

    motion: PlannedMotion
    max_steps: int
    goals_for_success: int | None
    chooses_episodes: bool

    @property
    def models(self) -> Sequence[Gaussians]:
        """What the renderer must be able to draw besides the scene, in the order that ``parts`` counts them, from 1."""
        ...

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """States [B, ...] in which episodes begin, with what the task places in the states that were drawn."""
        ...

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Spec of what is remembered about one robot, by key; empty for a task that remembers nothing."""
        ...

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """What is remembered when episodes begin.

        Args:
            state: [B, ...] states in which they begin.
            anywhere: draws states, for things that are placed at random.
        """
        ...

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge one step.

        Args:
            step: what happened, and what is seen now.
            anywhere: draws states, for things that are placed at random.
        """
        ...

    def reached(self, state: Tensor) -> Tensor | None:
        """Whether states are at a goal, judged by the state alone: [B, ...] -> [B] bool; None without goal states.

        Paths are planned to these states, and starts are ordered by their distance to them.
        """
        ...

    def parts(self, state: Tensor, memory: Memory) -> Parts | None:
        """What each robot's world consists of: [B, M] placed models; None is the unmoved scene alone."""
        ...

    def teach(self, state: Tensor, memory: Memory) -> Tensor | None:
        """The actions [B, ...] of one who knows the state, for DAgger; None where the planner is to be asked.

        Args:
            state: [B, ...].
            memory: what is remembered about each robot.
        """
        ...

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """What a map shows of the task.

        Args:
            memory: what is remembered about one robot at one step, without a batch dimension; None asks for what every
                episode has in common.
        """
        ...

    def at(self, scene: Tensor) -> "Task":
        """The task for rows in some of several scenes, if it was ``stacked`` from theirs: [B] int64."""
        ...

    def to(self, device: torch.device | str) -> "Task":
        """The task with its tensors, and those of its motion, on a device."""
        ...


class ChoosingTask(Protocol):
    """A task that ``chooses_episodes``."""

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Episodes for tests in one scene, drawn by a seed.

        Args:
            starts: [S, ...] states in which episodes may begin.
            count: number of episodes.
            seed: of what is drawn.

        Returns:
            ``state`` [N, ...], and what the task remembers where each begins, by key.
        """
        ...


class TaskModule(torch.nn.Module):
    """A task that by default remembers nothing, places nothing and has no goal states; subclasses override that.

    A robot with physics is drawn with its things, and begins with physics of its episode's own.

    Args:
        motion: how the robots move; if it is a module, it moves to a device with the task.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a limit below one step.
    """

    motion: PlannedMotion
    goals_for_success: int | None = None
    chooses_episodes = False

    def __init__(self, motion: PlannedMotion, max_steps: int):
        super().__init__()
        require_number("task.max_steps", max_steps, 1, whole=True)
        self.motion, self.max_steps = motion, max_steps

    def at(self: Module, scene: Tensor) -> Module:
        """The task for rows in some scenes; see ``Task.at`` and ``splatrl.several``."""
        return rows_of(self, scene)

    @property
    def models(self) -> Sequence[Gaussians]:
        """The robot's links and things, if it has physics; otherwise nothing."""
        return self.motion.models if isinstance(self.motion, PhysicsMotion) else []

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """The states that were drawn; a robot with physics obeys one of its models."""
        return self.motion.varied(state, anywhere.generator) if isinstance(self.motion, PhysicsMotion) else state

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Nothing is remembered."""
        return {}

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Nothing is remembered."""
        return NOTHING

    def reached(self, state: Tensor) -> Tensor | None:
        """There are no goal states."""
        return None

    def parts(self, state: Tensor, memory: Memory) -> Parts | None:
        """The scene alone, or with the links and things of a robot with physics."""
        return self.motion.parts(state) if isinstance(self.motion, PhysicsMotion) else None

    def teach(self, state: Tensor, memory: Memory) -> Tensor | None:
        """The planner is to be asked."""
        return None

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Nothing to show."""
        return []
