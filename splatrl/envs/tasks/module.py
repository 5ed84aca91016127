"""Base class of tasks, with defaults for everything but the reward."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

import torch
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.envs.drawing.base import Drawing
from splatrl.envs.robot import Robot
from splatrl.envs.tasks.base import NOTHING, Anywhere, Mark, Memory
from splatrl.motions.base import PlannedMotion
from splatrl.motions.site import Fits, Site
from splatrl.per_scene import rows_of
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.values import require_number, under_key

Module = TypeVar("Module", bound="TaskModule")


class TaskModule(torch.nn.Module):
    """A task that by default remembers nothing, places nothing and has no goal states; subclasses override that.

    Whatever the motion draws, such as the links of a robot with physics, is drawn; whatever it varies between episodes,
    such as physical parameters, is varied.

    Args:
        motion: how the robots move; if it is a module, it moves to a device with the task.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for ``max_steps`` below 1.
    """

    motion: PlannedMotion
    leeway = 0.0
    """Distance beyond the motion's bounds at which robots count as outside, metres."""
    varies = True
    """Whether episodes draw from what the motion varies; False if the task replaces the motion's models."""
    landmark = "landmarks.goal"
    """Key of the place that the goal is at or shows, for error messages."""
    goals_for_success: int | None = None
    chooses_episodes = False
    given_together: Sequence[str] = ()

    def __init__(self, motion: PlannedMotion, max_steps: int):
        super().__init__()
        require_number("task.max_steps", max_steps, 1, whole=True)
        self.motion, self.max_steps = motion, max_steps

    def at(self: Module, scene: Tensor) -> Module:
        """Return the task for rows in given scenes; see ``Task.at`` and ``splatrl.per_scene``."""
        return rows_of(self, scene)

    @property
    def goal_radius(self) -> float | None:
        """None: episodes cannot be given with their goals."""
        return None

    @property
    def ways_out(self) -> str:
        """What to change where no pose is free or no path leads to the goal; see ``Task``."""
        places = self.landmark if self.motion.height is None else f"{self.landmark} or robot.height"
        return f"try another {places}, or a smaller robot.body"

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Put the motion into a scene; return where it lets episodes begin."""
        with under_key("task.motion"):
            return self.motion.settle(site._replace(leeway=self.leeway, varies=self.varies), fits)

    def check_picture(self, drawing: Drawing, robot: Robot) -> None:
        """Accept every drawing and camera."""

    def in_scene(self, episodes: Mapping[str, Tensor], scene: int) -> dict[str, Tensor]:
        """Return the episodes as they are: their memory does not depend on how many scenes there are."""
        return {**episodes}

    @property
    def models(self) -> Sequence[Gaussians]:
        """Models of the motion."""
        return self.motion.models

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Return the states as drawn, with what the motion varies between episodes."""
        return self.motion.varied(state, anywhere.generator)

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Empty: nothing is remembered."""
        return {}

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Return an empty memory."""
        return NOTHING

    def goals_reached(self, state: Tensor, memory: Memory) -> Tensor:
        """Return 0: the memory tells of no goals that have been reached."""
        return torch.zeros(len(state), 1, dtype=torch.int64, device=state.device)

    def reached(self, state: Tensor) -> Tensor | None:
        """Return None: there are no goal states."""
        return None

    def parts(self, state: Tensor, memory: Memory) -> Parts | None:
        """Return what the motion draws; None stands for the scene alone."""
        return self.motion.parts(state)

    @property
    def teaches(self) -> bool:
        """Whether the class has a ``teach`` of its own."""
        return type(self).teach is not TaskModule.teach

    def teach(self, state: Tensor, memory: Memory) -> Tensor | None:
        """Return None: the planner is the teacher."""
        return None

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return no marks."""
        return []
