"""Distances across the columns of a voxel grid, seen from above."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


def cells_across(
    marked: NDArray[np.bool_], first_key: Sequence[int], resolution: float, places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how far the column of each place is from the nearest marked one, from centre to centre.

    Args:
        marked: [X, Y], the columns to which distances are measured.
        first_key: keys along x and y of the column ``marked[0, 0]``.
        resolution: edge of a column, metres.
        places: [..., 2] x and y, metres; one beyond the columns counts as in the column at their edge.

    Returns:
        [...] edges of a column, infinite if none is marked.
    """
    if not marked.any():
        return np.full(places.shape[:-1], np.inf)
    index = np.floor(places / resolution).astype(np.int64) - np.array(first_key, np.int64)
    index = np.clip(index, 0, np.array(marked.shape) - 1)
    across: NDArray[np.float64] = ndimage.distance_transform_edt(~marked)[tuple(np.moveaxis(index, -1, 0))]
    return across
