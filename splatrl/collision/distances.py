"""Distance field of an occupancy: bounds how far a point is from the nearest solid voxel with one look-up."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from splatrl.collision.occupancy import Occupancy
from splatrl.collision.voxel_grid import checked_points
from splatrl.native import _core
from splatrl.native.threads import threads_of


class DistanceField:
    """The Euclidean distance transform of an occupancy.

    Attributes:
        centers: [X, Y, Z] float32, metres from each voxel's centre to the nearest solid voxel's centre; 0 in solid
            voxels, infinite if nothing is solid.
    """

    def __init__(self, occupancy: Occupancy) -> None:
        self._occupancy = occupancy
        self.centers: NDArray[np.float32] = np.empty(occupancy.occupied.shape, np.float32)
        solid = np.ascontiguousarray(occupancy.occupied)
        _core.find_distances(solid, occupancy.resolution, self.centers, threads_of(None))

    def clearance(self, points: Tensor | ArrayLike) -> NDArray[np.float64]:
        """Return a lower bound on the distance from each point to the nearest solid voxel.

        Inside the grid, the bound is the distance between the centres of the point's voxel and the nearest solid one,
        minus half a voxel's diagonal for the extent of the solid voxel, minus the distance from the point to the centre
        of its own voxel; it is less than √3 voxels below the true distance. Outside, with q the point of the grid
        nearest to p, it is √(|p − q|² + clearance(q)²), which is a bound because the grid is convex.

        Args:
            points: [N, 3] world, metres.

        Returns:
            [N] float64 metres, 0 inside a solid voxel, infinite if nothing is solid.

        Raises:
            ValueError: names the first row that is not finite.
        """
        cloud = checked_points("points", points)
        grid = self._occupancy
        if grid.count == 0:
            return np.full(len(cloud), np.inf)
        nearest = np.clip(cloud, *grid.bounds)
        index = np.floor(nearest / grid.resolution).astype(np.int64) - grid.origin_key
        index = np.clip(index, 0, np.array(grid.occupied.shape) - 1)  # points on upper faces belong to last voxels
        to_center = np.linalg.norm(nearest - (index + grid.origin_key + 0.5) * grid.resolution, axis=1)
        inside = self.centers[tuple(index.T)] - 0.5 * math.sqrt(3.0) * grid.resolution - to_center
        return np.hypot(np.linalg.norm(cloud - nearest, axis=1), np.maximum(inside, 0.0))
