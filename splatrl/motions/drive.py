"""A differential drive: an action is a linear and an angular velocity, held for a time step."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded

from splatrl.motions.planar import StoppingMotion, along
from splatrl.values import require_number

CELL, CELLS = 0.05, 4
"""Distance between the positions at which paths are computed, metres, where starts lie closely; elsewhere it is a
multiple, with at least ``CELLS`` from one start to the next, so that a large place needs no more of them."""
STILL = 0.1
"""Fraction of both velocity limits below which an action means stop, in tasks in which the robot declares arrival."""
HEADINGS_A_TURN = 4
"""Headings at which paths are computed within the largest turn of one time step."""
SLOWEST = 1e-6
"""Smallest turn in one time step, radians."""
REACH = 0.25
"""Look-ahead distance for choosing a direction, metres."""
WAYS = 36
"""Number of directions from which to choose."""


class DriveMotion(StoppingMotion):
    """Two driven wheels: an action is a linear and an angular velocity, reached at once and held for a time step.

    A state is [..., 3] float32: x and y in metres and yaw in radians. The robot follows the exact arc; collision is
    checked along the straight line between the ends of the step, with the heading turning at a constant rate.

    Paths consist of full speed forwards and backwards, turns on the spot, and the arcs that combine them.

    Args:
        height: z of every pose, metres.
        time_step: duration of an action, seconds.
        linear: lowest and highest linear velocity, metres per second; forwards is positive.
        angular_deg: highest angular velocity in either direction, degrees per second.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        spacing: distance between neighbouring starts, metres.
        headings: number of start headings.

    Raises:
        ValueError: for a time step that is not positive, velocities out of order, turns below ``SLOWEST`` in a time
            step, or anything that ``PlanarMotion`` refuses.
    """

    limits: Tensor  # [2, 2] float32: lowest and highest linear and angular velocity

    def __init__(
        self,
        height: float,
        time_step: float = 0.2,
        linear: Sequence[float] = (-0.25, 0.5),
        angular_deg: float = 90.0,
        lower: Sequence[float] = (-1.0, -1.0),
        upper: Sequence[float] = (1.0, 1.0),
        spacing: float = 0.1,
        headings: int = 36,
    ):
        require_number("task.motion.time_step", time_step, above=0.0, unit="seconds")
        if len(linear) != 2 or not linear[0] <= 0 < linear[1] or not angular_deg > 0:
            raise ValueError(
                f"task.motion: expected linear = [at most 0, more than 0] m/s and angular_deg > 0, "
                f"got {list(linear)} and {angular_deg}"
            )
        angular = math.radians(angular_deg)
        step, turn = linear[1] * time_step, angular * time_step
        if not SLOWEST <= turn < math.inf:
            raise ValueError(
                f"task.motion: expected a turn of at least {SLOWEST:g} radians within time_step, got {turn:g}"
            )
        angle_cell = math.tau / math.ceil(HEADINGS_A_TURN * math.tau / turn - 1e-9)
        cells = math.floor(spacing / (CELLS * CELL) + 1e-9) if 0 < spacing < math.inf else 1
        super().__init__((), step, turn, height, lower, upper, spacing, headings, CELL * max(1, cells), angle_cell)
        self.time_step = time_step
        self.reach, self.angle_between = REACH, math.tau / WAYS
        limits = torch.tensor([[linear[0], -angular], [linear[1], angular]], dtype=torch.float32)
        self.register_buffer("limits", limits, persistent=False)

    @property
    def seconds_per_step(self) -> float:
        """Duration of an action, seconds."""
        return self.time_step

    @property
    def controls(self) -> tuple[str, str]:
        """Names of the two velocities of an action."""
        return "forward (m/s)", "turn (rad/s)"

    @property
    def action_spec(self) -> Bounded:
        """Spec of one robot's action, [2]: linear velocity, metres per second, and angular, radians per second."""
        return Bounded(low=self.limits[0], high=self.limits[1], shape=(2,), dtype=torch.float32)

    def actions(self) -> Tensor:
        """Return the actions from which paths are made: [N, 2] float32."""
        (back, right), (ahead, left) = self.limits.tolist()
        pairs = [(v, w) for v in sorted({back, 0.0, ahead}) for w in (right, 0.0, left) if (v, w) != (0.0, 0.0)]
        return torch.tensor(pairs, device=self.limits.device)

    def stops(self, action: Tensor) -> Tensor:
        """Return whether both velocities are within a tenth of their limits, as in Habitat: [B, 2] -> [B] bool."""
        return (action.abs() < STILL * self.limits.abs().amax(0)).all(1)

    def toward(self, turn: Tensor, stop: Tensor) -> Tensor:
        """Turn on the spot until no other direction is nearer to the heading, then drive; see ``StoppingMotion``."""
        _, (fastest, quickest) = self.limits
        ahead = torch.where(turn.abs() > 0.5 * self.angle_between, 0.0, fastest)
        action = torch.stack([ahead, (turn / self.time_step).clamp(-quickest, quickest)], 1)
        return torch.where(stop.unsqueeze(1), 0.0, action)

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Return where an unobstructed action leads, possibly out of bounds.

        Args:
            state: [B, 3] float32.
            action: [B, 2] float32, clamped to the limits.

        Returns:
            [B, 3] float32.
        """
        velocity = action.clamp(self.limits[0], self.limits[1])
        turn = velocity[:, 1] * self.time_step
        chord = velocity[:, 0] * self.time_step * torch.sinc(0.5 * turn / math.pi)  # sin(turn / 2) / (turn / 2)
        return along(state, chord, turn, 0.5 * turn)
