"""Base classes of motions, with defaults for what only a robot with physics needs."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from splatrl.collision.base import Checker
from splatrl.collision.occupancy import Occupancy
from splatrl.geometry import planar_of
from splatrl.motions.base import Move, PlannedMotion, Steering
from splatrl.motions.site import Fits, Site
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene


class MotionModule(nn.Module):
    """A motion that by default is a single move of a robot without a visible body, the same in all scenes."""

    steps_on_host = False
    stacks = True
    leaves = False
    models: Sequence[Gaussians] = ()

    @property
    def steering(self) -> Steering | None:
        """None: no action stops."""
        return None

    @property
    def seconds_per_step(self) -> float | None:
        """None: an action is a single move."""
        return None

    @property
    def controls(self) -> Sequence[str]:
        """Nothing: the numbers of an action have no names."""
        return ()

    def region(self: PlannedMotion) -> Tensor:
        """Return the corners of the box around all starts: [2, 3] float32, metres."""
        places = self.body_to_world(self.states())[:, :3, 3]
        return torch.stack([places.amin(0), places.amax(0)])

    def planar_of(self, body_to_world: Tensor) -> Tensor:
        """Return position and heading of the body."""
        return planar_of(body_to_world)

    def obstacles(self, scene: Scene, occupancy: Occupancy, antialiased: bool) -> Occupancy:
        """Return all solid voxels."""
        return occupancy

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Return where episodes may begin, unchanged."""
        return fits

    def outside(self, state: Tensor, leeway: float) -> Tensor:
        """Return False for all robots: a move that would leave the bounds is not made."""
        return torch.zeros(len(state), dtype=torch.bool, device=state.device)

    def fallen(self, state: Tensor) -> Tensor:
        """Return False for all robots: without physics they stay upright."""
        return torch.zeros(len(state), dtype=torch.bool, device=state.device)

    def varied(self, state: Tensor, generator: torch.Generator) -> Tensor:
        """Return the states unchanged: nothing differs between episodes."""
        return state

    def parts(self, state: Tensor) -> Parts | None:
        """Return None: only the scene is drawn."""
        return None

    def ranges(self, state: Tensor, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor | None:
        """Return None: only the scene stops beams."""
        return None


class SweptMotion(MotionModule, ABC):
    """A motion in which a robot either moves straight to where the action leads or stays where it is.

    A robot stays where it was when the swept body touches something, or when the action leads out of the bounds.
    """

    @abstractmethod
    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Return where an unobstructed action leads; see ``PlannedMotion``."""

    @abstractmethod
    def inside(self, state: Tensor) -> Tensor:
        """Return whether states are within the bounds; see ``PlannedMotion``."""

    @abstractmethod
    def body_to_world(self, state: Tensor) -> Tensor:
        """Return the poses of states; see ``Motion``."""

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        """Carry out one action of each robot; see ``Motion``."""
        ahead = self.advance(state, action)
        start, end = self.body_to_world(state), self.body_to_world(ahead)
        free_fraction, inside = checker.free_fraction(start, end), self.inside(ahead)
        stays = (free_fraction < 1) | ~inside
        return Move(
            state=torch.where(stays.view(-1, *[1] * (state.ndim - 1)), state, ahead),
            body_to_world=torch.where(stays.view(-1, 1, 1), start, end),
            free_fraction=free_fraction,
            inside=inside,
        )
