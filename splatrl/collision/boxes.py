"""Converts axis-aligned boxes to ranges of voxels."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from splatrl.collision.voxel_grid import check_resolution, checked_points

_FACE_SLACK = 1e-3
"""Tolerance at faces, in voxels: a box covers a voxel only if it reaches farther than this into it, because in floating
point 0.3 is rarely exactly 3 · 0.1."""
_FARTHEST = 2.0**53
"""Largest key; beyond it, float64 cannot tell neighbouring voxels apart."""


def box_keys(
    lower: Tensor | ArrayLike, upper: Tensor | ArrayLike, resolution: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the range of voxels that each box covers, wholly or in part.

    Args:
        lower: [N, 3] lower corners, world, metres.
        upper: [N, 3] upper corners, world, metres, above ``lower``.
        resolution: edge of a voxel, metres.

    Returns:
        For each box, the key of its first voxel and the key one past its last: each [N, 3].

    Raises:
        ValueError: for other shapes, non-finite corners or a box without volume.
    """
    check_resolution(resolution)
    low, high = checked_points("lower", lower), checked_points("upper", upper)
    if low.shape != high.shape or not (high > low).all():
        raise ValueError(f"upper: expected corners of shape {list(low.shape)}, each above lower, got {high.tolist()}")
    first, end = np.floor(low / resolution + _FACE_SLACK), np.ceil(high / resolution - _FACE_SLACK)
    first, end = (np.clip(key, -_FARTHEST, _FARTHEST).astype(np.int64) for key in (first, end))
    return first, np.maximum(end, first + 1)
