"""Which voxels of a scene are solid."""

import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.collision.density import solid_voxels
from splatrl.collision.grid import MAX_VOXELS, Bounds, check_resolution, checked_crop, checked_points, grid_shape
from splatrl.scenes.gaussians import Gaussians

if TYPE_CHECKING:
    from splatrl.scenes.scene import Scene

_FACE_SLACK = 1e-3
"""In voxels: a box that reaches no further than this into a voxel does not fill it, as 0.3 is rarely 3 · 0.1."""


@dataclass(frozen=True, eq=False)
class Occupancy:
    """An axis-aligned grid of solid voxels in the world frame; whatever lies outside the grid is free.

    The voxel with the integer key k covers [k · resolution, (k + 1) · resolution) along each axis.

    Attributes:
        occupied: [X, Y, Z] bool; X, Y, Z may be 0.
        origin_key: key of the voxel ``occupied[0, 0, 0]``.
        resolution: edge of a voxel, metres.

    Raises:
        ValueError: for another shape or dtype, or a resolution that is not finite and positive.
    """

    occupied: NDArray[np.bool_]  # [X, Y, Z]
    origin_key: tuple[int, int, int]
    resolution: float

    def __post_init__(self) -> None:
        if self.occupied.ndim != 3 or self.occupied.dtype != np.bool_:
            raise ValueError(
                f"Occupancy.occupied: expected bool [X, Y, Z], got {self.occupied.dtype} {list(self.occupied.shape)}"
            )
        if len(self.origin_key) != 3:
            raise ValueError(f"Occupancy.origin_key: expected 3 integers, got {self.origin_key}")
        check_resolution(self.resolution)
        object.__setattr__(self, "origin_key", tuple(int(key) for key in self.origin_key))
        object.__setattr__(self, "resolution", float(self.resolution))

    @classmethod
    def empty(cls, resolution: float = 0.05) -> "Occupancy":
        """A world in which nothing is solid."""
        return cls(np.zeros((0, 0, 0), bool), (0, 0, 0), resolution)

    @classmethod
    def from_keys(cls, keys: ArrayLike, resolution: float, max_voxels: int = MAX_VOXELS) -> "Occupancy":
        """The smallest grid around some solid voxels.

        Args:
            keys: [M, 3] integers, repeats allowed.
            resolution: edge of a voxel, metres.
            max_voxels: the largest grid that may be made.

        Raises:
            ValueError: for keys of another shape or dtype, or a grid above ``max_voxels``.
        """
        array = np.asarray(keys)
        if array.ndim != 2 or array.shape[1] != 3 or not np.issubdtype(array.dtype, np.integer):
            raise ValueError(f"keys: expected integers [M, 3], got {array.dtype} {list(array.shape)}")
        if len(array) == 0:
            return cls.empty(resolution)
        origin = array.min(0)
        occupied = np.zeros(grid_shape(origin, array.max(0) + 1, resolution, max_voxels), bool)
        occupied[tuple((array - origin).T)] = True
        return cls(occupied, tuple(origin.tolist()), resolution)

    @classmethod
    def from_points(
        cls,
        points: Tensor | ArrayLike,
        resolution: float = 0.05,
        crop: Bounds | None = None,
        max_voxels: int = MAX_VOXELS,
    ) -> "Occupancy":
        """The voxels that hold at least one point of a cloud.

        Args:
            points: [N, 3] world, metres.
            resolution: edge of a voxel, metres.
            crop: lower and upper corner, metres; points outside are left out. None keeps all.
            max_voxels: the largest grid that may be made.

        Raises:
            ValueError: for another shape, a non-finite point, or a grid above ``max_voxels``.
        """
        check_resolution(resolution)
        cloud = checked_points("points", points)
        if crop is not None:
            lower, upper = checked_crop(crop)
            cloud = cloud[((cloud >= lower) & (cloud < upper)).all(1)]
        return cls.from_keys(np.floor(cloud / resolution).astype(np.int64), resolution, max_voxels)

    @classmethod
    def from_boxes(
        cls,
        lower: Tensor | ArrayLike,
        upper: Tensor | ArrayLike,
        resolution: float = 0.05,
        max_voxels: int = MAX_VOXELS,
    ) -> "Occupancy":
        """The voxels that axis-aligned boxes fill, wholly or in part.

        Args:
            lower: [N, 3] lower corners, world, metres.
            upper: [N, 3] upper corners, world, metres, above ``lower``.
            resolution: edge of a voxel, metres.
            max_voxels: the largest grid that may be made.

        Raises:
            ValueError: for other shapes, non-finite corners, a box without volume, or a grid above ``max_voxels``.
        """
        check_resolution(resolution)
        low, high = checked_points("lower", lower), checked_points("upper", upper)
        if low.shape != high.shape or not (high > low).all():
            raise ValueError(f"upper: expected {list(low.shape)} corners above lower, got {high.tolist()}")
        if len(low) == 0:
            return cls.empty(resolution)
        first = np.floor(low / resolution + _FACE_SLACK).astype(np.int64)
        last = np.maximum(np.ceil(high / resolution - _FACE_SLACK).astype(np.int64), first + 1)
        origin = first.min(0)
        occupied = np.zeros(grid_shape(origin, last.max(0), resolution, max_voxels), bool)
        for (x0, y0, z0), (x1, y1, z1) in zip(first - origin, last - origin, strict=True):
            occupied[x0:x1, y0:y1, z0:z1] = True
        return cls(occupied, tuple(origin.tolist()), resolution)

    @classmethod
    def from_gaussians(
        cls,
        gaussians: Gaussians,
        resolution: float = 0.05,
        min_opacity: float = 0.1,
        cutoff: float = 0.5,
        min_volume: float = 0.008,
        max_scale: float | None = None,
        crop: Bounds | None = None,
        max_voxels: int = MAX_VOXELS,
    ) -> "Occupancy":
        """The voxels that a scene's Gaussians make opaque; ``solid_voxels`` tells how and what each setting does."""
        solid, origin = solid_voxels(
            gaussians, resolution, min_opacity, cutoff, min_volume, max_scale, crop, max_voxels
        )
        return cls(solid, origin, resolution).trimmed()

    @classmethod
    def from_scene(cls, scene: "Scene", **settings: Any) -> "Occupancy":
        """``from_gaussians`` of a scene's Gaussians, kept in the scene's cache.

        Args:
            scene: holds ``gaussians`` in the world frame, ``bounds`` and a cache.
            **settings: what ``from_gaussians`` takes. Without a ``crop`` (or with None) the grid ends at the scene's
                bounds, widened on all sides by a tenth of their longest one.
        """
        if settings.get("crop") is None:
            lower, upper = np.array(scene.bounds, np.float64)  # may be flat, as the scene may
            margin = 0.1 * (upper - lower).max()
            settings["crop"] = ((lower - margin).tolist(), (upper + margin).tolist())
        recipe = inspect.signature(cls.from_gaussians).bind(scene.gaussians, **settings)
        recipe.apply_defaults()
        stated = {name: value for name, value in recipe.arguments.items() if name != "gaussians"}
        arrays = scene.cached("occupancy", stated, lambda: cls.from_gaussians(scene.gaussians, **stated).to_arrays())
        return cls.from_arrays(arrays)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "Occupancy":
        """Undo ``to_arrays``."""
        shape = tuple(int(extent) for extent in arrays["shape"])
        bits = np.unpackbits(arrays["occupied_bits"], count=math.prod(shape)).astype(bool).reshape(shape)
        return cls(bits, tuple(arrays["origin_key"].tolist()), float(arrays["resolution"]))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays to keep in an npz file, one bit a voxel."""
        return {
            "occupied_bits": np.packbits(self.occupied),
            "shape": np.array(self.occupied.shape, np.int64),
            "origin_key": np.array(self.origin_key, np.int64),
            "resolution": np.array(self.resolution),
        }

    def trimmed(self) -> "Occupancy":
        """The same solid voxels in the smallest grid that holds them."""
        if not self.occupied.any():
            return Occupancy.empty(self.resolution)
        (box,) = ndimage.find_objects(self.occupied.view(np.int8))
        x, y, z = (key + span.start for key, span in zip(self.origin_key, box, strict=True))
        return Occupancy(np.ascontiguousarray(self.occupied[box]), (x, y, z), self.resolution)

    @cached_property
    def count(self) -> int:
        """How many voxels are solid."""
        return int(self.occupied.sum())

    @property
    def volume(self) -> float:
        """Volume of what is solid, cubic metres."""
        return self.count * self.resolution**3

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper corner of the grid: each [3] float64, metres."""
        lower = np.array(self.origin_key, np.float64)
        return lower * self.resolution, (lower + self.occupied.shape) * self.resolution

    def keys(self) -> NDArray[np.int64]:
        """Keys of the solid voxels: [M, 3]."""
        return np.argwhere(self.occupied) + np.array(self.origin_key, np.int64)

    def centers(self) -> NDArray[np.float32]:
        """Centres of the solid voxels: [M, 3] float32, world, metres."""
        return ((self.keys() + 0.5) * self.resolution).astype(np.float32)

    def contains(self, points: Tensor | ArrayLike) -> NDArray[np.bool_]:
        """Whether each point [N, 3] (world, metres) lies in a solid voxel: [N]."""
        index = np.floor(checked_points("points", points) / self.resolution).astype(np.int64) - self.origin_key
        inside = ((index >= 0) & (index < self.occupied.shape)).all(1)
        result = np.zeros(len(index), bool)
        result[inside] = self.occupied[tuple(index[inside].T)]
        return result
