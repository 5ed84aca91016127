"""The actions of navigation benchmarks: stop, a step ahead, and turns on the spot."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Categorical

from splatrl.collision.base import Checker
from splatrl.motions.base import Move
from splatrl.motions.planar import PlanarMotion, along


class NavigateMotion(PlanarMotion):
    """Stops, steps forward along the heading, and turns left and right, off any lattice.

    A state is [..., 3] float32: x and y in metres and yaw in radians. The four actions, in Habitat's order, are stop,
    which moves nothing and which a task may take for the end of an episode, forward, left (counter-clockwise) and
    right.

    A blocked robot stays where it was, or with ``sliding`` goes as far along x, and then along y, as that part of the
    step is free: along walls of voxels, which face the axes, it slides as Habitat's ``allow_sliding`` lets it. Either
    way the move counts as one that touched something.

    Args:
        height: z of every pose, metres.
        step: length of a step, metres.
        angle_step_deg: angle of a turn, degrees; it divides 360.
        sliding: whether a blocked robot slides.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        spacing: distance between neighbouring starts, metres.
        headings: number of directions of the starts.

    Raises:
        ValueError: for a step that is not positive, an angle that does not divide a turn, or bounds without area.
    """

    lengths: Tensor  # [4] float32
    turns: Tensor  # [4] float32

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
        if not step > 0:
            raise ValueError(f"task.motion.step: expected more than 0 metres, got {step}")
        turns = round(360.0 / angle_step_deg) if angle_step_deg > 0 else 0
        if turns < 1 or abs(turns * angle_step_deg - 360.0) > 1e-6:
            raise ValueError(f"task.motion.angle_step_deg: expected a divisor of 360, got {angle_step_deg}")
        angle = math.tau / turns
        names = ("stop", "forward", "left", "right")
        super().__init__(names, step, angle, height, lower, upper, spacing, headings, 0.5 * step, angle)
        self.sliding = sliding
        self.register_buffer("lengths", torch.tensor([0.0, step, 0.0, 0.0]), persistent=False)
        self.register_buffer("turns", torch.tensor([0.0, 0.0, angle, -angle]), persistent=False)

    @property
    def action_spec(self) -> Categorical:
        """One of four actions; no batch."""
        return Categorical(len(self.lengths), shape=(), dtype=torch.int64)

    def actions(self) -> Tensor:
        """The actions from which paths are made, all but stop: [3] int64."""
        return torch.arange(1, len(self.lengths), device=self.lengths.device)

    def stops(self, action: Tensor) -> Tensor:
        """Whether actions are stop: [B] int64 -> [B] bool."""
        return action == 0

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Where an unobstructed action leads, possibly outside the bounds.

        Args:
            state: [B, 3] float32.
            action: [B] int64 in [0, 4).

        Returns:
            [B, 3] float32.
        """
        turn = self.turns[action]
        return along(state, self.lengths[action], turn, torch.zeros_like(turn))

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
