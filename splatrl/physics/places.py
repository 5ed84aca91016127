"""Places where bodies could stand: heights of floor with free space above it, and its largest connected part."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splatrl.collision.voxels import Voxels
from splatrl.native import _core

CLEARANCE = 0.3
"""Minimum free space above a place to stand, metres."""
STEP = 0.12
"""Maximum difference in height between adjacent places that are connected, metres."""


def standing_heights(
    voxels: Voxels, lower: Sequence[float], upper: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the height of the lowest solid top in each column that has free space above it.

    Args:
        voxels: the solid voxels, the ground included.
        lower: smallest x and y of the columns' centres, metres.
        upper: largest x and y, metres.

    Returns:
        Centres of the columns [X, Y, 2] and heights [X, Y], metres; NaN where nothing is solid.
    """
    edge, shape = voxels.resolution, voxels.occupied.shape
    spans = []
    for axis in range(2):
        centers = (np.arange(shape[axis]) + voxels.origin_key[axis] + 0.5) * edge
        inside = np.flatnonzero((centers >= lower[axis]) & (centers <= upper[axis]))
        spans.append(slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else slice(0, 0))
    solid = voxels.occupied[spans[0], spans[1]]
    gap = max(1, math.ceil(CLEARANCE / edge - 1e-6))
    above = np.pad(solid, ((0, 0), (0, 0), (0, gap)))  # space above the grid is free
    stands = solid.copy()
    for layer in range(1, gap + 1):
        stands &= ~above[:, :, layer : layer + shape[2]]
    first = stands.argmax(2) if shape[2] else np.zeros(solid.shape[:2], np.int64)
    heights = np.where(stands.any(2), (first + voxels.origin_key[2] + 1) * edge, np.nan)
    x, y = (
        (np.arange(span.start, span.stop) + voxels.origin_key[axis] + 0.5) * edge for axis, span in enumerate(spans)
    )
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1), heights


def widest_part(heights: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find the largest set of columns between which one could walk without steps above ``STEP``.

    Args:
        heights: [X, Y] metres, NaN for columns where nothing can stand.

    Returns:
        [X, Y] bool; all False if nothing can stand anywhere.
    """
    known = ~np.isnan(heights)
    if not known.any():
        return known
    ways = np.zeros(heights.shape, np.uint16)
    for bit, (a, b) in enumerate(((np.s_[:-1, :], np.s_[1:, :]), (np.s_[:, :-1], np.s_[:, 1:]))):
        beside = known[a] & known[b]
        beside[beside] = np.abs(heights[a][beside] - heights[b][beside]) <= STEP + 1e-9
        ways[a][beside] |= np.uint16(1 << bit)
    largest = np.empty(heights.shape, bool)
    _core.find_largest_part(ways, np.array([(1, 0), (0, 1)]), known, largest)
    return largest
