"""Steps around an object and towards it: the motion of the circle, polar plane and hemisphere tasks."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.geometry import axis_rotations, rigid
from splatrl.motions.finite import FiniteMotion
from splatrl.motions.lattice import whole_steps
from splatrl.values import are_numbers


class OrbitMotion(FiniteMotion):
    """Moves a camera that looks at an origin over a lattice of azimuths, distances and elevations.

    A state is [..., 3] int64: the indices of azimuth, distance and elevation. Azimuth 0 is on the +x side of the origin
    and azimuths increase counter-clockwise; elevation 0 is level with the origin. The actions, in order, are + and − of
    each of azimuth, elevation and distance that has more than one value.

    Args:
        origin: point at which the camera looks, world, metres.
        angle_step_deg: step of azimuth and elevation, degrees; must divide 360.
        distance_step: step of the distance, metres.
        distance: smallest and largest distance, metres, a whole number of steps apart.
        elevation_deg: smallest and largest elevation, degrees, a whole number of steps apart, both in [−90, 90].

    Raises:
        ValueError: for steps that do not divide their ranges, ranges out of order, or more than ``MOST_STATES`` states.
    """

    smallest: Tensor  # [3] float64: azimuth, distance, elevation
    steps: Tensor  # [3] float64
    origin: Tensor  # [3] float64
    of_scene = (*FiniteMotion.of_scene, "origin")

    def __init__(
        self,
        origin: Sequence[float],
        angle_step_deg: float = 10.0,
        distance_step: float = 0.1,
        distance: Sequence[float] = (0.5, 1.5),
        elevation_deg: Sequence[float] = (0.0, 90.0),
    ):
        if not are_numbers(origin, 3):
            raise ValueError(f"task.motion.origin: expected x, y and z in metres, got {origin}")
        for name, limits in (("distance", distance), ("elevation_deg", elevation_deg)):
            if not are_numbers(limits, 2):
                raise ValueError(
                    f"task.motion.{name}: expected two finite numbers, the smallest and the largest, got {limits}"
                )
        if not 0 < distance[0] <= distance[1] or not -90 <= elevation_deg[0] <= elevation_deg[1] <= 90:
            raise ValueError(
                "task.motion: expected 0 < distance[0] ≤ distance[1] and −90 ≤ elevation_deg[0] ≤ elevation_deg[1] ≤ "
                f"90, got {list(distance)} and {list(elevation_deg)}"
            )
        turns = whole_steps("task.motion.angle_step_deg", 360.0, angle_step_deg)
        rings = _count("task.motion.distance", distance, distance_step)
        tiers = _count("task.motion.elevation_deg", elevation_deg, angle_step_deg)
        shape = (turns, rings, tiers)
        axes = [(name, axis) for name, axis in (("azimuth", 0), ("elevation", 2), ("distance", 1)) if shape[axis] > 1]
        moves = [[sign * (axis == i) for i in range(3)] for _, axis in axes for sign in (1, -1)]
        names = [f"{sign}{name}" for name, _ in axes for sign in "+-"]
        super().__init__(shape, moves, names, distance_step, math.radians(angle_step_deg), None)
        smallest = [0.0, distance[0], math.radians(elevation_deg[0])]
        self.register_buffer("smallest", torch.tensor(smallest, dtype=torch.float64), persistent=False)
        steps = torch.tensor([self.angle_step, distance_step, self.angle_step], dtype=torch.float64)
        self.register_buffer("steps", steps, persistent=False)
        self.register_buffer("origin", torch.tensor(tuple(origin), dtype=torch.float64), persistent=False)

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Return where an unobstructed action leads, maybe off the lattice: [B, 3] int64, [B] int64 -> [B, 3] int64."""
        moved = state + self.moves.index_select(0, action)
        return torch.cat([moved[:, :1] % self.shape[0], moved[:, 1:]], 1)

    def inside(self, state: Tensor) -> Tensor:
        """Return whether distance and elevation are within their ranges, which are inclusive: [B, 3] -> [B] bool."""
        ring, tier = state[:, 1], state[:, 2]
        return (ring >= 0) & (ring < self.counts[..., 1]) & (tier >= 0) & (tier < self.counts[..., 2])

    def sphere(self, state: Tensor) -> Tensor:
        """Return azimuth (radians), distance (metres) and elevation (radians): [B, 3] int64 -> [B, 3] float64."""
        return self.smallest + state * self.steps

    def planar(self, state: Tensor) -> Tensor:
        """Return position and heading of states: [B, 3] int64 -> [B, 3] float64, x, y in metres, yaw in radians."""
        azimuth, distance, elevation = self.sphere(state).unbind(1)
        reach = distance * elevation.cos()
        x, y = self.origin[..., 0] + reach * azimuth.cos(), self.origin[..., 1] + reach * azimuth.sin()
        return torch.stack([x, y, (azimuth + math.pi) % math.tau], 1)

    def body_to_world(self, state: Tensor) -> Tensor:
        """Return the poses of states, with the body's +x towards the origin: [B, 3] int64 -> [B, 4, 4] float32."""
        azimuth, distance, elevation = self.sphere(state).unbind(1)
        rotation = axis_rotations(2, azimuth + math.pi) @ axis_rotations(1, elevation)
        place = self.origin - distance.unsqueeze(1) * rotation[:, :, 0]
        return rigid(rotation, place).float()


def _count(name: str, limits: Sequence[float], step: float) -> int:
    """Return the number of values in a range, both ends included."""
    low, high = limits
    return whole_steps(name, high - low, step) + 1 if high > low else 1
