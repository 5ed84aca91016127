"""Poses anywhere on a plane: the base of motions whose state is x, y and yaw."""

import math
from abc import abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from splatrl.geometry import axis_rotations, rigid
from splatrl.motions.base import Taps
from splatrl.motions.module import SweptMotion
from splatrl.motions.pose_grid import PoseGrid
from splatrl.motions.size import require_area, require_few, values_within

EDGE = 1e-5
"""Tolerance for rounding at the inclusive bounds, metres."""


class PlanarMotion(SweptMotion):
    """A motion whose state is [..., 3] float32: x and y in metres and yaw in radians in [0, τ).

    Episodes begin on a lattice of positions, ``spacing`` apart within the bounds, with ``headings`` directions; from
    there robots can reach any pose. Paths are computed at the nodes of a ``PoseGrid`` and interpolated.

    Args:
        action_names: a name for each discrete action; empty if actions are continuous.
        step: longest distance that an action moves the robot, metres.
        angle_step: largest angle that an action turns the robot, radians.
        height: z of every pose, metres.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        spacing: distance between neighbouring starts, metres.
        headings: number of start headings, evenly spaced from 0 (along +x).
        cell: distance between the positions at which paths are computed, metres.
        angle_cell: angle between the headings at which paths are computed, radians; must divide a full turn.

    Raises:
        ValueError: for bounds without area, a spacing that is not positive, fewer than one heading, or more than
            ``MOST_STATES`` starts.
    """

    lower: Tensor  # [2] float32; [S, 2] for several scenes
    upper: Tensor  # [2] float32
    elevation: Tensor  # [] float32, the height
    of_scene: tuple[str, ...] = ("lower", "upper", "elevation", "height")

    def __init__(
        self,
        action_names: Sequence[str],
        step: float,
        angle_step: float,
        height: float,
        lower: Sequence[float],
        upper: Sequence[float],
        spacing: float,
        headings: int,
        cell: float,
        angle_cell: float,
    ):
        super().__init__()
        require_area(lower, upper)
        if not 0 < spacing < math.inf or headings < 1:
            raise ValueError(f"task.motion: expected spacing > 0 and headings ≥ 1, got {spacing} and {headings}")
        columns, rows = (values_within(low, high, spacing) for low, high in zip(lower, upper, strict=True))
        where = f" from {list(lower)} to {list(upper)} m in steps of {spacing} m"
        require_few((columns, rows, headings), where, remedy="choose a larger task.motion.spacing or a smaller area")
        self.action_names, self.step, self.angle_step = tuple(action_names), step, angle_step
        self.height, self.spacing, self.headings = height, spacing, headings
        self.cell, self.angle_cell = cell, angle_cell
        self.register_buffer("lower", torch.tensor(tuple(lower), dtype=torch.float32), persistent=False)
        self.register_buffer("upper", torch.tensor(tuple(upper), dtype=torch.float32), persistent=False)
        self.register_buffer("elevation", torch.tensor(height, dtype=torch.float32), persistent=False)

    @property
    @abstractmethod
    def action_spec(self) -> TensorSpec:
        """Spec of one robot's action; see ``Motion``."""

    @abstractmethod
    def actions(self) -> Tensor:
        """Return the actions from which paths are made; see ``PlannedMotion``."""

    @property
    def state_spec(self) -> Bounded:
        """Spec of one robot's state: x, y and yaw, [3], within bounds that cover all scenes; no batch."""
        lower, upper = self.lower.reshape(-1, 2).amin(0) - EDGE, self.upper.reshape(-1, 2).amax(0) + EDGE
        low, high = torch.cat([lower, lower.new_zeros(1)]), torch.cat([upper, upper.new_full((1,), math.tau)])
        return Bounded(low=low, high=high, shape=(3,), dtype=torch.float32)

    def states(self) -> Tensor:
        """Return the lattice of starts: [S, 3] float32."""
        axes = [
            low + self.spacing * torch.arange(math.floor((high - low) / self.spacing + 1e-6) + 1, dtype=torch.float64)
            for low, high in zip(self.lower.double().tolist(), self.upper.double().tolist(), strict=True)
        ]
        yaws = torch.arange(self.headings, dtype=torch.float64) * (math.tau / self.headings)
        return torch.cartesian_prod(*axes, yaws).float().to(self.lower.device)

    def region(self) -> Tensor:
        """Return the corners of the bounds, at the robots' height: [2, 3] float32, metres."""
        return torch.cat([torch.stack([self.lower, self.upper]), self.elevation.expand(2, 1)], 1)

    def inside(self, state: Tensor) -> Tensor:
        """Return whether states are within the bounds, which are inclusive: [B, 3] -> [B] bool."""
        place = state[:, :2]
        return ((place >= self.lower - EDGE) & (place <= self.upper + EDGE)).all(1)

    @property
    def grid(self) -> PoseGrid:
        """The nodes at which paths are computed."""
        return PoseGrid.over(self.lower, self.upper, self.cell, self.angle_cell)

    def nodes(self) -> Tensor:
        """Return the nodes of ``grid``: [C, 3] float32."""
        return self.grid.nodes()

    def taps(self, state: Tensor) -> Taps:
        """Return the eight nodes around states: [N, 3] -> taps of [N, 8]."""
        return self.grid.taps(state)

    def nearest(self, planar: Tensor) -> Tensor:
        """Return positions and headings, which are states already: [N, 3] float64 -> [N, 3] float32."""
        return planar.to(self.lower)

    def planar(self, state: Tensor) -> Tensor:
        """Return position and heading of states: [B, 3] -> [B, 3] float64, x and y in metres, yaw in radians."""
        return state.double()

    def body_to_world(self, state: Tensor) -> Tensor:
        """Return the poses of states: [B, 3] -> [B, 4, 4] float32."""
        height = self.elevation.expand(len(state)).unsqueeze(1)
        return rigid(axis_rotations(2, state[:, 2]), torch.cat([state[:, :2], height], 1))


class StoppingMotion(PlanarMotion):
    """A planar motion in which some action declares that the robot has arrived; see ``Steering``."""

    reach: float
    angle_between: float

    @property
    def steering(self) -> "StoppingMotion":
        """The motion itself."""
        return self

    @abstractmethod
    def stops(self, action: Tensor) -> Tensor:
        """Return whether actions declare arrival; see ``Steering``."""

    @abstractmethod
    def toward(self, turn: Tensor, stop: Tensor) -> Tensor:
        """Return actions that lead in a direction, or that stop; see ``Steering``."""


def along(state: Tensor, distance: Tensor, turn: Tensor, bend: Tensor) -> Tensor:
    """Move states along their heading, or at an angle to it, and turn them.

    Args:
        state: [B, 3] x, y and yaw.
        distance: [B] length of the move, metres.
        turn: [B] change of the heading, radians.
        bend: [B] angle from the heading before the move to the direction of the move, radians.

    Returns:
        [B, 3], with the yaw in [0, τ).
    """
    way = state[:, 2] + bend
    yaw = (state[:, 2] + turn) % math.tau
    return torch.stack([state[:, 0] + distance * way.cos(), state[:, 1] + distance * way.sin(), yaw], 1)
