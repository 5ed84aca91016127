"""Validates rigid poses, and interpolates the poses at which a move between two of them is tested."""

import torch
from torch import Tensor

from splatrl.geometry import atan2, first_not_rigid, quats_to_rotations, rigid, rotations_to_quats


def checked_poses(name: str, body_to_world: Tensor) -> Tensor:
    """Refuse all but rigid poses: later code would take a NaN for free space and a reflection for a rotation.

    Args:
        name: name of the argument, for the error message.
        body_to_world: [B, 4, 4].

    Returns:
        [B, 4, 4] float64 on the CPU.

    Raises:
        ValueError: names the first row that is not finite, not a rotation or not a rigid transform.
    """
    if body_to_world.ndim != 3 or body_to_world.shape[1:] != (4, 4):
        raise ValueError(f"{name}: expected shape [B, 4, 4], got {list(body_to_world.shape)}")
    poses = body_to_world.detach().to("cpu", torch.float64)
    fault = first_not_rigid(poses)
    if fault is not None:
        row, expected = fault
        raise ValueError(f"{name}: expected {expected}, got {body_to_world[row].tolist()} in row {row}")
    return poses


class Displacement:
    """Straight moves, each cut into steps so short that no point within ``radius`` of the origin travels far.

    The origin moves along a line while the body turns about its origin by spherical linear interpolation. The poses are
    bitwise the same when start and end are exchanged.

    Attributes:
        steps: [B] int64, number of steps of each move, at least 1; the poses of a row have indices 0 to ``steps``.
    """

    def __init__(self, start: Tensor, end: Tensor, radius: float, max_travel: float) -> None:
        """Plan the steps.

        Args:
            start: [B, 4, 4] float64 body_to_world.
            end: [B, 4, 4] float64 body_to_world.
            radius: radius of the body about its origin, metres.
            max_travel: maximum distance that a point of the body may travel in one step, metres.
        """
        if start.shape != end.shape:
            raise ValueError(f"end: expected {start.shape[0]} poses, as many as in start, got {end.shape[0]}")
        self._start, self._end = start, end
        self._still = (start[:, :3, :3] == end[:, :3, :3]).flatten(1).all(1)
        self._start_quats = rotations_to_quats(start[:, :3, :3])
        end_quats = rotations_to_quats(end[:, :3, :3])
        opposed = (self._start_quats * end_quats).sum(1, keepdim=True) < 0
        self._end_quats = torch.where(opposed, -end_quats, end_quats)  # take the shorter arc
        difference, total = self._start_quats - self._end_quats, self._start_quats + self._end_quats
        self._arc = 2.0 * atan2(difference.norm(dim=1), total.norm(dim=1))  # half the rotation angle
        travel = (end - start)[:, :3, 3].norm(dim=1) + 2.0 * self._arc * radius
        self.steps = (travel / max_travel).ceil().clamp(min=1).long()

    def at(self, rows: Tensor, index: Tensor) -> Tensor:
        """Return poses along the moves.

        Args:
            rows: [M] int64, the move to which each pose belongs.
            index: [M] int64, the step of each pose, from 0 at the start to ``steps[rows]`` at the end.

        Returns:
            body_to_world [M, 4, 4] float64.
        """
        steps = self.steps[rows]
        # both fractions are quotients, so reversing a move swaps them exactly; `index / steps` would multiply by a
        # reciprocal
        before, after = (part.double().div(steps).unsqueeze(1) for part in (steps - index, index))
        start, end, arc = self._start[rows], self._end[rows], self._arc[rows].unsqueeze(1)
        slight = arc < 1e-6  # small enough that sin x equals x
        quats = self._start_quats[rows] * torch.where(slight, before, torch.sin(before * arc))
        quats = quats + self._end_quats[rows] * torch.where(slight, after, torch.sin(after * arc))
        rotation = quats_to_rotations(quats)
        as_start = self._still[rows] | (before[:, 0] == 1.0)  # exactly the given rotations, not via quaternions
        rotation = torch.where(as_start[:, None, None], start[:, :3, :3], rotation)
        rotation = torch.where((after == 1.0).unsqueeze(2), end[:, :3, :3], rotation)
        return rigid(rotation, before * start[:, :3, 3] + after * end[:, :3, 3])
