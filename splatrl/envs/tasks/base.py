"""The interface that every task implements."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

import torch
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.envs.drawing.base import Drawing, View
from splatrl.envs.robot import Robot
from splatrl.motions.base import Move, PlannedMotion
from splatrl.motions.site import Fits, Site
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians

Memory = Mapping[str, Tensor]
"""A task's memory of each robot, by key: [B, ...] tensors that travel in the TensorDict."""
NOTHING: Memory = {}


@dataclass(frozen=True)
class Anywhere:
    """Draws a state for each robot from all starts of the curriculum, regardless of its level: [B, ...].

    Attributes:
        states: draws the states.
        generator: the env's generator, for anything else that a task draws.
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
    """The robot signalled that it was at its goal, but was not."""


def nothing_drawn() -> View:
    """Refuse to show what robots see."""
    raise ValueError("step: expected a task that does not look at its views, since none are drawn for it")


class Step(NamedTuple):
    """One step of each robot, already carried out.

    The robots' views after the step are drawn as soon as a task reads ``pixels`` or ``shown``.

    Attributes:
        before: [B, ...] states before the step.
        action: [B, ...] actions of the robots.
        move: the motion's result, including the states after the step.
        memory: the task's memory before the step.
        look: returns the views, and draws them the first time.
    """

    before: Tensor
    action: Tensor
    move: Move
    memory: Memory
    look: Callable[[], View] = nothing_drawn

    @property
    def pixels(self) -> Tensor:
        """[B, H, W, 3] uint8, the robots' views after the step."""
        return self.look().pixels

    @property
    def shown(self) -> Mapping[str, Tensor]:
        """What the drawing returned about each view, [B, ...] by key; see ``View``."""
        return self.look().shown


class Verdict(NamedTuple):
    """A task's judgement of one step of each robot.

    Attributes:
        reward: [B, 1] float32.
        terminated: [B, 1] bool.
        outcome: [B, 1] int64, an ``Outcome``; never TIMEOUT, which only the env sets.
        memory: the task's memory after the step, with the keys of ``Task.memory_spec``.
    """

    reward: Tensor
    terminated: Tensor
    outcome: Tensor
    memory: Memory = NOTHING


@dataclass(frozen=True)
class Mark:
    """A mark to be shown on a map.

    Attributes:
        name: entry in the legend.
        planar: [3] float64, x and y in metres and yaw in radians; the yaw is NaN for a mark without direction.
    """

    name: str
    planar: Tensor


class Task(Protocol):
    """Defines what robots are rewarded for, how they move, and when an episode ends.

    A task judges each step once. The robots' views are drawn when a task reads them, so the image may decide whether a
    goal is reached. It may remember something about each robot, have one goal, several or none, and place objects in
    the scene. ``TaskModule`` has defaults for everything but the reward.

    Attributes:
        motion: how the robots move.
        max_steps: an episode is truncated after this many steps.
        goals_for_success: None for a task whose episodes end at their goal and thereby succeed; a number for a task
            whose episodes continue, and succeed once they have reached at least that many goals. Curricula and
            evaluations use it.
        chooses_episodes: whether each start has a goal of its own, so that evaluations use the episodes of
            ``ChoosingTask``.
        leeway: how far beyond the motion's bounds robots may go before they count as outside, metres.
        given_together: keys of the memory that depend on each other: a reset is given all of them or none.
    """

    motion: PlannedMotion
    max_steps: int
    goals_for_success: int | None
    chooses_episodes: bool
    leeway: float
    given_together: Sequence[str]

    @property
    def ways_out(self) -> str:
        """What to change where no pose is free or no path leads to the goal, as it ends an error message."""
        ...

    @property
    def goal_radius(self) -> float | None:
        """Distance from the goal within which an episode can succeed, metres, of a ``GoalTask``; None for others."""
        ...

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Put the motion, and whatever the task places, into a scene; return where episodes may begin there.

        This happens once, before anything else but ``motion.states`` and ``reached``, which decide what the scene's
        solid voxels are needed for. A task that chooses its goals here returns None from ``reached`` until then.

        Args:
            site: the scene, and the robot's body in it.
            fits: where the body is within the scene's bounds and touches nothing.

        Raises:
            ValueError: for a scene in which the task is impossible.
        """
        ...

    def check_picture(self, drawing: Drawing, robot: Robot) -> None:
        """Refuse a drawing or a camera with which the task is impossible.

        Args:
            drawing: draws the robots' views.
            robot: the robot, for its camera.

        Raises:
            ValueError: names the key, what was expected and what was given.
        """
        ...

    @property
    def models(self) -> Sequence[Gaussians]:
        """Models that the renderer draws besides the scene, in the order in which ``parts`` numbers them, from 1."""
        ...

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Return the states [B, ...] in which episodes begin: those drawn, with the task's objects placed in them."""
        ...

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Specs of what is remembered about one robot, by key; empty for a task that remembers nothing."""
        ...

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Return what is remembered when episodes begin.

        Args:
            state: [B, ...] states in which they begin.
            anywhere: draws states, for objects that are placed at random.
        """
        ...

    def goals_reached(self, state: Tensor, memory: Memory) -> Tensor:
        """Return how many goals have been reached where episodes begin with a given memory, [B, 1] int64."""
        ...

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge one step.

        Args:
            step: the actions, their results, and, if it reads them, the robots' views afterwards.
            anywhere: draws states, for objects that are placed at random.
        """
        ...

    def reached(self, state: Tensor) -> Tensor | None:
        """Return whether states are at a goal, judged by state alone: [B, ...] -> [B] bool; None if there are no goals.

        Paths are planned to these states, and starts are ordered by their distance to them.
        """
        ...

    def parts(self, state: Tensor, memory: Memory) -> Parts | None:
        """Return the placed models that make up each robot's world, [B, M]; None stands for the scene alone."""
        ...

    @property
    def teaches(self) -> bool:
        """Whether the task has a teacher of its own; it is known before the task settles in a scene."""
        ...

    def teach(self, state: Tensor, memory: Memory) -> Tensor | None:
        """Return the actions [B, ...] of a teacher that knows the state; None, without one, defers to the planner.

        DAgger labels states with them, and demonstrations of the teacher consist of them.

        Args:
            state: [B, ...] states of the motion.
            memory: what is remembered about each robot.
        """
        ...

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return the marks that a map shows for the task.

        Args:
            memory: what is remembered about one robot at one step, without a batch dimension; None asks for the marks
                that all episodes have in common.
        """
        ...

    def at(self, scene: Tensor) -> "Task":
        """Return the task for rows in given scenes, [B] int64, if it was ``stacked`` from one task per scene."""
        ...

    def to(self, device: torch.device | str) -> "Task":
        """Move the tensors of the task and its motion to a device, and return the task."""
        ...


class ChoosingTask(Protocol):
    """A task that ``chooses_episodes`` for evaluation."""

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Draw test episodes in one scene from a seed.

        Args:
            starts: [S, ...] states in which episodes may begin.
            count: number of episodes, N.
            seed: seed of everything that is drawn.

        Returns:
            ``state`` [N, ...], and the task's memory at the start of each episode, by key.
        """
        ...

    def in_scene(self, episodes: Mapping[str, Tensor], scene: int) -> dict[str, Tensor]:
        """Return episodes that the task of one scene drew as this task, which is of all scenes, remembers them.

        Args:
            episodes: the result of ``episodes``.
            scene: index of the scene.
        """
        ...


class GoalTask(ChoosingTask, Protocol):
    """A task with a ``goal_radius``, whose memory holds ``goal`` [B, 3] and ``start_distance`` [B, 1] float32."""

    def with_goals(self, state: Tensor, goal: Tensor, scene: Tensor) -> tuple[Task, Memory]:
        """Return a copy of the task that knows further goals, and its memory at the start of episodes with them.

        Args:
            state: [N, ...] start states.
            goal: [N, 3] float32 goals, x and y in metres and yaw in radians.
            scene: [N] int64, index of each episode's scene.

        Raises:
            ValueError: for a goal that robots cannot reach from its start; names the episode.
        """
        ...
