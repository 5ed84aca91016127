"""Finds unreachable free space, so that it can be made solid: captured objects are hollow."""

import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.collision.voxel_grid import MAX_VOXELS, Bounds, checked_box, checked_points, grid_shape, within
from splatrl.native import _core
from splatrl.native.threads import threads_of
from splatrl.values import require_number

Region = tuple[NDArray[np.bool_], tuple[int, int, int]]
"""Voxels [X, Y, Z] bool, and the key of the first one."""


def unreached_voxels(
    occupied: NDArray[np.bool_],
    origin_key: tuple[int, int, int],
    resolution: float,
    opening: float,
    seeds: Tensor | ArrayLike | None = None,
    around: Bounds | None = None,
    max_voxels: int = MAX_VOXELS,
) -> Region | None:
    """Find the free voxels that cannot be reached from the seeds when openings narrower than ``opening`` are closed.

    A ball of that diameter floods the free space from the seeds. Voxels that it touches are reached, and so are free
    voxels up to ``opening`` further on, so that corners and crevices stay free; behind a gap too narrow for the ball,
    this leaves a free rim of that depth. Everything else is unreached. The flood stays within the grid, because
    surfaces that a capture did not see, such as the back of a counter, are open to the outside; so robots that leave
    the grid can come back only the way they went.

    Of the regions that contain seeds or lie next to one, the one with the most seeds is flooded, so a seed on the wrong
    side of a wall does no harm. A region lies next to a seed if it is no farther than ``opening`` from it.

    Args:
        occupied: [X, Y, Z] bool.
        origin_key: key of the first voxel.
        resolution: edge of a voxel, metres.
        opening: diameter of the ball, metres, at least 0; rounded to whole voxels. A body that is nowhere thinner than
            this can go only where the ball can.
        seeds: [N, 3] world, metres: places known to be free and reachable. None floods the largest region.
        around: lower and upper corner, metres, of a box that the flooded grid always includes: where robots are.
        max_voxels: maximum number of voxels in the flooded grid.

    Returns:
        The unreached voxels; None if no seed is near a region, because then nothing is known.

    Raises:
        ValueError: for an ``opening`` that is not finite or below 0, malformed seeds or corners, or a grid that is
            too large to be flooded.
    """
    require_number("fill", opening, 0.0, unit="metres")
    places = None if seeds is None else checked_points("seeds", seeds)
    padded, origin = _widened(occupied, np.array(origin_key, np.int64), resolution, around, max_voxels)
    wide = round(opening / resolution)
    clear = _distances(~padded)  # from each free voxel's centre to the nearest solid one's
    touch = 0.5 * (wide + 1) + 1e-6  # bounds the distance from the middle of a gap of `wide` voxels to its walls
    regions, count = ndimage.label(clear > touch)
    region = _flooded(regions, count, places, origin, resolution, touch + wide)
    if region is None:
        return None
    reached = _distances(regions == region) <= touch
    if wide:
        reached = ndimage.binary_dilation(reached, np.ones((3, 3, 3)), iterations=wide, mask=padded)
    unreached = (padded & ~reached)[1:-1, 1:-1, 1:-1]
    x, y, z = (int(key) + 1 for key in origin)
    return unreached, (x, y, z)


def _widened(
    occupied: NDArray[np.bool_], origin: NDArray[np.int64], resolution: float, around: Bounds | None, max_voxels: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Widen the grid to hold ``around`` and enclose it in a wall one voxel thick.

    Returns:
        The free voxels of the new grid, and the key of its first voxel.
    """
    first, end = origin, origin + occupied.shape
    if around is not None:
        corners = checked_box("around", around) / resolution
        low, high = np.floor(corners[0]).astype(np.int64), np.ceil(corners[1]).astype(np.int64)
        if occupied.size == 0:  # the key of an empty grid's first voxel means nothing
            first, end, origin = low, high, low
        else:
            first, end = np.minimum(first, low), np.maximum(end, high)
    free = np.ones(grid_shape(first, end, resolution, max_voxels), bool)
    inner = tuple(slice(int(a), int(a) + n) for a, n in zip(origin - first, occupied.shape, strict=True))
    free[inner] = ~occupied
    return np.pad(free, 1), first - 1


def _distances(solid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance from each voxel's centre to the nearest solid one's, in voxels: [X, Y, Z]."""
    found = np.empty(solid.shape, np.float32)
    _core.find_distances(np.ascontiguousarray(solid), 1.0, found, threads_of(None))
    return found


def _flooded(
    regions: NDArray[np.int32],
    count: int,
    places: NDArray[np.float64] | None,
    origin: NDArray[np.int64],
    resolution: float,
    reach: float,
) -> int | None:
    """Return the label of the region to flood: the one with the most seeds, or the largest if there are no seeds.

    The result is None if there is no region, or no seed near one.
    """
    if count == 0:
        return None
    if places is None:
        return 1 + int(np.bincount(regions.reshape(-1))[1:].argmax())
    index = np.floor(places / resolution).astype(np.int64) - origin
    index = index[within(index, regions.shape)]
    away, nearest = ndimage.distance_transform_edt(regions == 0, return_indices=True)
    index = index[away[tuple(index.T)] <= reach]
    if len(index) == 0:
        return None
    found = regions[tuple(nearest[(slice(None), *index.T)])]
    return int(np.bincount(found).argmax())


def warn_unfilled(opening: float) -> None:
    """Warn that nothing was filled, and why."""
    warnings.warn(
        f"fill: expected free space {opening:g} m wide near the goal, found none; nothing is filled", stacklevel=3
    )
