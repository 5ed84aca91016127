"""Limits and checks shared by all voxel grids: resolution, coordinates and size."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

MAX_VOXELS = 2**26
"""Default maximum number of voxels in a grid: 64 MiB of occupancy, 256 MiB of densities."""

Bounds = tuple[Sequence[float], Sequence[float]]
"""Lower and upper corner of an axis-aligned box, metres."""


FINEST, COARSEST = 1e-4, 1e3
"""Smallest and largest edge of a voxel, metres."""
FARTHEST_KEY = 2**40
"""Largest key of a voxel along an axis, at which double precision still tells positions within a voxel apart."""


def check_resolution(resolution: float) -> None:
    """Refuse a voxel edge for which positions could not be computed.

    Raises:
        ValueError: for anything but a number from ``FINEST`` to ``COARSEST`` metres.
    """
    if isinstance(resolution, bool) or not (np.isreal(resolution) and FINEST <= resolution <= COARSEST):
        raise ValueError(f"resolution: expected {FINEST:g} to {COARSEST:g} metres, got {resolution}")


def checked_points(name: str, values: Tensor | ArrayLike) -> NDArray[np.float64]:
    """Return points as [N, 3] float64, metres.

    Raises:
        ValueError: for another shape, or for rows that are not finite; names the first of these.
    """
    array = np.asarray(values.detach().cpu() if isinstance(values, Tensor) else values, np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: expected shape [N, 3], got {list(array.shape)}")
    finite = np.isfinite(array)
    if not finite.all():
        row = int((~finite.all(1)).argmax())
        raise ValueError(f"{name}: expected finite coordinates, got {array[row].tolist()} in row {row}")
    return array


def within(index: NDArray[np.int64], shape: Sequence[int]) -> NDArray[np.bool_]:
    """Return whether each index [N, 3] lies within a grid of a given shape: [N].

    Comparing column by column is several times as fast as reducing many rows of three.
    """
    inside = np.ones(len(index), bool)
    for column, size in zip(index.T, shape, strict=True):
        inside &= (column >= 0) & (column < size)
    return inside


def checked_box(name: str, box: Bounds) -> NDArray[np.float64]:
    """Return the corners of a box as [2, 3] float64, metres.

    Raises:
        ValueError: if they are not two finite corners, the lower one first.
    """
    corners = checked_points(name, [tuple(corner) for corner in box])
    if len(corners) != 2 or not (corners[0] < corners[1]).all():
        raise ValueError(f"{name}: expected a lower corner and an upper corner above it, got {corners.tolist()}")
    return corners


def widened(*boxes: Bounds) -> Bounds:
    """Return the box that holds some boxes, which may be flat, each widened by a tenth of its longest side."""
    lower, upper = np.array(boxes, np.float64).swapaxes(0, 1)
    margin = 0.1 * (upper - lower).max(1, keepdims=True)
    return (lower - margin).min(0).tolist(), (upper + margin).max(0).tolist()


def grid_shape(
    first_key: NDArray[np.int64], end_key: NDArray[np.int64], resolution: float, max_voxels: int
) -> tuple[int, int, int]:
    """Return the number of voxels along each axis from ``first_key`` up to, but not including, ``end_key``.

    Args:
        first_key: [3] int64, key of the grid's lowest voxel.
        end_key: [3] int64, key of the voxel beyond the grid's highest.
        resolution: edge of a voxel, metres.
        max_voxels: maximum number of voxels.

    Raises:
        ValueError: if the grid has more than ``max_voxels``; names its bounds and resolution.
    """
    x, y, z = (max(int(end) - int(first), 0) for first, end in zip(first_key, end_key, strict=True))
    if x * y * z > max_voxels:
        lower, upper = (np.round(key * resolution, 3).tolist() for key in (first_key, end_key))
        raise ValueError(
            f"grid from {lower} to {upper} m at a resolution of {resolution} m: expected at most {max_voxels} voxels, "
            f"got {[x, y, z]}, {x * y * z} in total; crop the grid, choose a coarser resolution, or raise "
            "collision.occupancy.max_voxels"
        )
    return x, y, z
