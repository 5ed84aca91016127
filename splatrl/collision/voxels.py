"""A grid of voxels: their positions, which of them are solid, and statistics."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.collision.report import OccupancyReport
from splatrl.collision.voxel_grid import FARTHEST_KEY, MAX_VOXELS, check_resolution, checked_points, within


@dataclass(frozen=True, eq=False)
class Voxels:
    """An axis-aligned grid of solid and free voxels in the world frame; everything outside the grid is free.

    The voxel with the integer key k covers [k · resolution, (k + 1) · resolution) along each axis.

    Attributes:
        occupied: [X, Y, Z] bool, True for solid voxels; X, Y and Z may be 0.
        origin_key: key of the voxel ``occupied[0, 0, 0]``.
        resolution: edge of a voxel, metres.
        floaters: number of voxels dropped because their component was too small to be real.
        filled: number of voxels made solid because nothing can reach them.

    Raises:
        ValueError: for another shape or dtype, or a resolution or an origin that ``voxel_grid`` does not allow.
    """

    occupied: NDArray[np.bool_]  # [X, Y, Z]
    origin_key: tuple[int, int, int]
    resolution: float
    floaters: int = 0
    filled: int = 0

    def __post_init__(self) -> None:
        if self.occupied.ndim != 3 or self.occupied.dtype != np.bool_:
            raise ValueError(
                f"Occupancy.occupied: expected bool [X, Y, Z], got {self.occupied.dtype} {list(self.occupied.shape)}"
            )
        keys = self.origin_key
        if len(keys) != 3 or not all(int(key) == key and abs(key) <= FARTHEST_KEY for key in keys):
            raise ValueError(f"Occupancy.origin_key: expected 3 integers of at most 2^40, got {keys}")
        check_resolution(self.resolution)
        object.__setattr__(self, "origin_key", tuple(int(key) for key in self.origin_key))
        object.__setattr__(self, "resolution", float(self.resolution))

    @cached_property
    def count(self) -> int:
        """Number of solid voxels."""
        return int(self.occupied.sum())

    @property
    def volume(self) -> float:
        """Volume of the solid voxels, cubic metres."""
        return self.count * self.resolution**3

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper corner of the grid: each [3] float64, metres."""
        lower = np.array(self.origin_key, np.float64)
        return lower * self.resolution, (lower + self.occupied.shape) * self.resolution

    def keys(self) -> NDArray[np.int64]:
        """Return the keys of the solid voxels: [M, 3]."""
        return np.argwhere(self.occupied) + np.array(self.origin_key, np.int64)

    def centers(self) -> NDArray[np.float32]:
        """Return the centres of the solid voxels: [M, 3] float32, world, metres."""
        return ((self.keys() + 0.5) * self.resolution).astype(np.float32)

    def contains(self, points: Tensor | ArrayLike) -> NDArray[np.bool_]:
        """Return whether each point [N, 3] (world, metres) lies in a solid voxel: [N] bool."""
        index = np.floor(checked_points("points", points) / self.resolution).astype(np.int64) - self.origin_key
        inside = within(index, self.occupied.shape)
        result = np.zeros(len(index), bool)
        result[inside] = self.occupied[tuple(index[inside].T)]
        return result

    def report(self) -> OccupancyReport:
        """Return statistics of the occupancy, which print as a small table."""
        x, y, z = self.occupied.shape
        free = (self.occupied.size - self.count) * self.resolution**3
        pieces = int(ndimage.label(self.occupied, np.ones((3, 3, 3)))[1])
        return OccupancyReport(
            self.resolution, (x, y, z), self.count, pieces, self.volume, free, self.floaters, self.filled
        )

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays for storage in an npz file.

        Returns:
            ``occupied_bits`` [bytes] uint8, one bit per voxel in the order of ``numpy.packbits``; ``shape`` and
            ``origin_key``, [3] int64 each; and the single numbers ``resolution``, in metres, ``floaters`` and
            ``filled``.
        """
        return {
            "occupied_bits": np.packbits(self.occupied),
            "shape": np.array(self.occupied.shape, np.int64),
            "origin_key": np.array(self.origin_key, np.int64),
            "resolution": np.array(self.resolution),
            "floaters": np.array(self.floaters),
            "filled": np.array(self.filled),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], max_voxels: int = MAX_VOXELS) -> Self:
        """Rebuild a grid from the arrays of ``to_arrays``.

        Raises:
            ValueError: if an array is missing or of another kind, the bits do not fill the shape, or the grid has more
                than ``max_voxels``.
        """
        try:
            return cls._unpacked(arrays, max_voxels)
        except (LookupError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(f"occupancy: expected the arrays written by to_arrays, got {error}") from error

    @classmethod
    def _unpacked(cls, arrays: Mapping[str, NDArray[Any]], max_voxels: int) -> Self:
        shape = tuple(int(extent) for extent in arrays["shape"])
        count, packed = math.prod(shape), arrays["occupied_bits"]
        if count > max_voxels:
            raise ValueError(
                f"shape: expected at most {max_voxels} voxels, got {shape}; raise collision.occupancy.max_voxels"
            )
        if min(shape, default=0) < 0 or packed.dtype != np.uint8 or packed.shape != ((count + 7) // 8,):
            raise ValueError(
                f"occupied_bits: expected packed bits (uint8) of {shape} voxels, got {packed.dtype} {packed.shape}"
            )
        bits = np.unpackbits(packed, count=count).astype(bool).reshape(shape)
        floaters, filled = int(arrays["floaters"]), int(arrays["filled"])
        return cls(bits, tuple(arrays["origin_key"].tolist()), float(arrays["resolution"]), floaters, filled)
