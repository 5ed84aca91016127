"""The actions of navigation benchmarks: stop, a step ahead, and turns on the spot."""

from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.collision.base import Checker
from splatrl.motions.base import Move
from splatrl.motions.planar import StoppingMotion
from splatrl.motions.steps import StepMotion


class NavigateMotion(StepMotion, StoppingMotion):
    """Stops, steps forward along the heading, and turns left and right, tied to no lattice.

    A state is [..., 3] float32: x and y in metres and yaw in radians. The four actions, in Habitat's order, are stop,
    which moves nothing and which a task may take as the end of an episode, forward, left (counter-clockwise) and right.

    A blocked robot stays where it was. With ``sliding``, it instead makes the x component of the step if that is free,
    and then the y component if that is free: along walls of voxels, which face the axes, it slides as with Habitat's
    ``allow_sliding``. Either way, the move counts as one that touched something.

    Args:
        height: z of every pose, metres.
        step: length of a step, metres.
        angle_step_deg: angle of a turn, degrees; must divide 360.
        sliding: whether a blocked robot slides.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        spacing: distance between neighbouring starts, metres.
        headings: number of start headings.

    Raises:
        ValueError: for a step that is not positive, an angle that does not divide 360°, or bounds without area.
    """

    def __init__(
        self,
        height: float,
        step: float = 0.25,
        angle_step_deg: float = 30.0,
        sliding: bool = False,
        lower: Sequence[float] = (-1.0, -1.0),
        upper: Sequence[float] = (1.0, 1.0),
        spacing: float = 0.1,
        headings: int = 36,
    ):
        actions = {"stop": (0, 0), "forward": (1, 0), "left": (0, 1), "right": (0, -1)}
        super().__init__(actions, step, angle_step_deg, height, lower, upper, spacing, headings, 0.5 * step)
        self.sliding, self.reach, self.angle_between = sliding, self.step, self.angle_step

    def actions(self) -> Tensor:
        """Return the actions from which paths are made, all but stop: [3] int64."""
        return torch.arange(1, len(self.lengths), device=self.lengths.device)

    def stops(self, action: Tensor) -> Tensor:
        """Return whether actions are stop: [B] int64 -> [B] bool."""
        return action == 0

    def toward(self, turn: Tensor, stop: Tensor) -> Tensor:
        """Return a step forward, a turn towards the direction, or a stop; see ``StoppingMotion``."""
        aside = turn.abs() > 0.5 * self.angle_step
        return torch.where(stop, 0, torch.where(aside, torch.where(turn > 0, 2, 3), 1))

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        """Carry out one action of each robot; see ``Motion``."""
        moved = super().move(state, action, checker)
        if not self.sliding:
            return moved
        blocked = (moved.free_fraction < 1) | ~moved.inside
        ahead, slid = self.advance(state, action), moved.state
        for axis in (0, 1):
            tried = slid.clone()
            tried[:, axis] = ahead[:, axis]
            free = ~checker.sweeps(self.body_to_world(slid), self.body_to_world(tried)) & self.inside(tried)
            slid = torch.where((blocked & free).unsqueeze(1), tried, slid)
        return moved._replace(state=slid, body_to_world=self.body_to_world(slid))
