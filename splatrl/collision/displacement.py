"""Rigid poses of a body, and the poses between two of them at which a move is tested."""

import torch
from torch import Tensor

from splatrl.geometry import first_not_rigid, quats_to_rotations, rigid, rotations_to_quats


def checked_poses(name: str, body_to_world: Tensor) -> Tensor:
    """Refuse all but rigid poses: other code would take a NaN for free space and a reflection for a rotation.

    Args:
        name: of the argument, for the message.
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
    """Straight moves, each cut into steps in which no point within ``radius`` of the origin travels far.

    The origin moves along a line while the body turns about its origin by spherical linear interpolation. The poses are
    the same, bit by bit, when start and end are exchanged.

    Attributes:
        steps: [B] int64, at least 1; the poses of a row have the indices 0 to ``steps``.
    """

    def __init__(self, start: Tensor, end: Tensor, radius: float, max_travel: float) -> None:
        """Plan the steps.

        Args:
            start: [B, 4, 4] float64 body_to_world.
            end: [B, 4, 4] float64 body_to_world.
            radius: of the body about its origin, metres.
            max_travel: farthest that a point of the body may travel in a step, metres.
        """
        if start.shape != end.shape:
            raise ValueError(f"end: expected as many poses as start, {start.shape[0]}, got {end.shape[0]}")
        self._start, self._end = start, end
        self._still = (start[:, :3, :3] == end[:, :3, :3]).flatten(1).all(1)
        self._start_quats = rotations_to_quats(start[:, :3, :3])
        end_quats = rotations_to_quats(end[:, :3, :3])
        opposed = (self._start_quats * end_quats).sum(1, keepdim=True) < 0
        self._end_quats = torch.where(opposed, -end_quats, end_quats)  # the shorter way round
        difference, total = self._start_quats - self._end_quats, self._start_quats + self._end_quats
        self._arc = 2.0 * torch.atan2(difference.norm(dim=1), total.norm(dim=1))  # half the turn's angle
        travel = (end - start)[:, :3, 3].norm(dim=1) + 2.0 * self._arc * radius
        self.steps = (travel / max_travel).ceil().clamp(min=1).long()

    def at(self, rows: Tensor, index: Tensor) -> Tensor:
        """Poses on the way.

        Args:
            rows: [M] int64, which moves.
            index: [M] int64, 0 for the start; at most ``steps[rows]``, whose pose is the end.

        Returns:
            body_to_world [M, 4, 4] float64.
        """
        steps = self.steps[rows]
        # both shares are quotients, so going back swaps them; `index / steps` would multiply by a reciprocal
        before, after = (part.double().div(steps).unsqueeze(1) for part in (steps - index, index))
        start, end, arc = self._start[rows], self._end[rows], self._arc[rows].unsqueeze(1)
        slight = arc < 1e-6  # where the sine of an angle is the angle
        quats = self._start_quats[rows] * torch.where(slight, before, torch.sin(before * arc))
        quats = quats + self._end_quats[rows] * torch.where(slight, after, torch.sin(after * arc))
        rotation = quats_to_rotations(quats)
        as_start = self._still[rows] | (before[:, 0] == 1.0)  # the given poses exactly, not by way of quaternions
        rotation = torch.where(as_start[:, None, None], start[:, :3, :3], rotation)
        rotation = torch.where((after == 1.0).unsqueeze(2), end[:, :3, :3], rotation)
        return rigid(rotation, before * start[:, :3, 3] + after * end[:, :3, 3])
