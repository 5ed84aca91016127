"""Casts rays against voxels: the ranges of a lidar's beams."""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.collision.displacement import checked_poses
from splatrl.collision.voxels import Voxels
from splatrl.values import require_number

MOST_ROOM = 255
_PAIRS = 2**20
"""Ray–voxel pairs that ``ranges_by_formula`` tests at once; bounds memory."""


def room_around(voxels: Voxels) -> NDArray[np.uint8]:
    """Return the chessboard (Chebyshev) distance to the nearest solid voxel, in voxels: [Z, X, Y] uint8, at most 255.

    It is 0 in solid voxels. Around a voxel with room r, a cube with r - 1 voxels to each side is empty.
    """
    if voxels.count == 0:
        return np.zeros((0, 0, 0), np.uint8)
    steps = ndimage.distance_transform_cdt(~voxels.occupied, "chessboard")
    return np.ascontiguousarray(np.minimum(steps, MOST_ROOM).astype(np.uint8).transpose(2, 0, 1))


def check_reach(reach: float) -> None:
    """Refuse a reach that is not a finite number above 0."""
    require_number("reach", reach, above=0.0, unit="metres")


def check_beams(beams: Tensor) -> None:
    """Refuse beams that are not unit vectors, [R, 3].

    Raises:
        ValueError: names the argument, what was expected and what was given.
    """
    if beams.ndim != 2 or beams.shape[1] != 3:
        raise ValueError(f"beams: expected shape [R, 3], got {list(beams.shape)}")
    lengths = beams.double().norm(dim=1)
    wrong = (~((lengths - 1.0).abs() < 1e-3)).nonzero()
    if len(wrong):
        row = int(wrong[0])
        raise ValueError(f"beams: expected unit vectors, got {beams[row].tolist()} in row {row}")


def ranges_by_formula(voxels: Voxels, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
    """Compute ``Checker.ranges`` by brute force: the least distance at which a ray enters any solid voxel's box.

    This is the readable reference for the native ray caster. For a ray that only grazes a box, at an edge or along a
    face, rounding decides; the native caster, for which a point on a face belongs to the voxel above, may differ.

    Args:
        voxels: the solid voxels.
        body_to_world: [B, 4, 4], metres.
        beams: [R, 3] unit vectors, body frame.
        reach: maximum range, metres.

    Returns:
        [B, R] float32, metres.
    """
    check_beams(beams)
    check_reach(reach)
    poses = checked_poses("body_to_world", body_to_world)
    ways = beams.detach().cpu().double() @ poses[:, :3, :3].mT
    ways = (ways / ways.norm(dim=2, keepdim=True)).reshape(-1, 3)
    from_ = poses[:, :3, 3].repeat_interleave(len(beams), 0)
    lower = torch.from_numpy(voxels.keys()).double() * voxels.resolution
    nearest = torch.full((len(ways),), float(reach), dtype=torch.float64)
    if len(lower):
        for rows in torch.arange(len(ways)).split(max(_PAIRS // len(lower), 1)):
            near, far = _box_spans(from_[rows], ways[rows], lower, voxels.resolution)
            entered = torch.where((near < far) & (far > 0), near.clamp(min=0.0), torch.inf)
            nearest[rows] = torch.minimum(nearest[rows], entered.amin(1))
    return nearest.reshape(len(poses), len(beams)).float().to(body_to_world.device)


def _box_spans(start: Tensor, way: Tensor, lower: Tensor, edge: float) -> tuple[Tensor, Tensor]:
    """Intersect rays [N, 3] with cubes whose lower corners are [M, 3].

    Returns:
        Distances at which each ray enters and leaves each cube: [N, M] each, the first beyond the second for a miss.
    """
    one = (lower - start[:, None]) / way[:, None]
    other = (lower + edge - start[:, None]) / way[:, None]
    along = (way[:, None] == 0.0) & (start[:, None] >= lower) & (start[:, None] < lower + edge)
    near = torch.where(along, -torch.inf, torch.minimum(one, other)).nan_to_num(torch.inf, torch.inf, -torch.inf)
    far = torch.where(along, torch.inf, torch.maximum(one, other)).nan_to_num(-torch.inf, torch.inf, -torch.inf)
    return near.amax(2), far.amin(2)
