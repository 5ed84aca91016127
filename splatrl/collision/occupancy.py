"""Finds and edits the solid voxels of a scene.

All of it is one class, whose documented constructors and edits make the file long; what they compute is elsewhere.
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import blake2b
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.collision.boxes import box_keys
from splatrl.collision.density import DEFAULT_DENSITY, DensitySettings, solid_voxels
from splatrl.collision.fill import unreached_voxels, warn_unfilled
from splatrl.collision.point_clouds import file_digest, read_points
from splatrl.collision.voxel_grid import (
    MAX_VOXELS,
    Bounds,
    check_resolution,
    checked_box,
    checked_points,
    grid_shape,
    widened,
)
from splatrl.collision.voxels import Voxels
from splatrl.scenes.gaussians import Gaussians

if TYPE_CHECKING:
    from splatrl.scenes.scene import Scene

HEADERS = 4096
"""Maximum bytes of an occupancy's arrays besides its bits."""


@dataclass(frozen=True, eq=False)
class Occupancy(Voxels):
    """Solid voxels in the world frame, and the methods that find and edit them; everything outside the grid is free.

    See ``Voxels`` for the attributes. An occupancy is immutable: editing one returns another.
    """

    @classmethod
    def empty(cls, resolution: float = 0.05) -> "Occupancy":
        """Make an occupancy in which nothing is solid."""
        return cls(np.zeros((0, 0, 0), bool), (0, 0, 0), resolution)

    @classmethod
    def from_keys(cls, keys: ArrayLike, resolution: float, max_voxels: int = MAX_VOXELS) -> "Occupancy":
        """Make the smallest grid around given solid voxels.

        Args:
            keys: [M, 3] integers, repeats allowed.
            resolution: edge of a voxel, metres.
            max_voxels: maximum number of voxels in the grid.

        Raises:
            ValueError: for keys of another shape or dtype, or a grid above ``max_voxels``.
        """
        array = np.asarray(keys)
        if array.ndim != 2 or array.shape[1] != 3 or not np.issubdtype(array.dtype, np.integer):
            raise ValueError(f"keys: expected integers of shape [M, 3], got {array.dtype} {list(array.shape)}")
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
        """Make an occupancy of the voxels that hold at least one point of a cloud.

        Args:
            points: [N, 3] world, metres.
            resolution: edge of a voxel, metres.
            crop: lower and upper corner, metres; points outside are left out. None keeps all points.
            max_voxels: maximum number of voxels in the grid.

        Raises:
            ValueError: for another shape, a non-finite point, or a grid above ``max_voxels``.
        """
        check_resolution(resolution)
        cloud = checked_points("points", points)
        if crop is not None:
            lower, upper = checked_box("crop", crop)
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
        """Make an occupancy of the voxels that axis-aligned boxes fill, wholly or in part.

        Args:
            lower: [N, 3] lower corners, world, metres.
            upper: [N, 3] upper corners, world, metres, above ``lower``.
            resolution: edge of a voxel, metres.
            max_voxels: maximum number of voxels in the grid.

        Raises:
            ValueError: for other shapes, non-finite corners, a box without volume, or a grid above ``max_voxels``.
        """
        first, end = box_keys(lower, upper, resolution)
        if len(first) == 0:
            return cls.empty(resolution)
        origin = first.min(0)
        occupied = np.zeros(grid_shape(origin, end.max(0), resolution, max_voxels), bool)
        for (x0, y0, z0), (x1, y1, z1) in zip(first - origin, end - origin, strict=True):
            occupied[x0:x1, y0:y1, z0:z1] = True
        return cls(occupied, tuple(origin.tolist()), resolution)

    @classmethod
    def from_gaussians(
        cls,
        gaussians: Gaussians,
        resolution: float = 0.05,
        density: DensitySettings = DEFAULT_DENSITY,
        crop: Bounds | None = None,
        max_voxels: int = MAX_VOXELS,
    ) -> "Occupancy":
        """Make an occupancy of the voxels that Gaussians make opaque; see ``solid_voxels`` for method and arguments."""
        return cls.from_pieces([lambda: gaussians], resolution, density, crop, max_voxels)

    @classmethod
    def from_pieces(
        cls,
        pieces: Sequence[Callable[[], Gaussians]],
        resolution: float = 0.05,
        density: DensitySettings = DEFAULT_DENSITY,
        crop: Bounds | None = None,
        max_voxels: int = MAX_VOXELS,
    ) -> "Occupancy":
        """Do the same as ``from_gaussians`` for a scene in pieces, of which only one is in memory at a time."""
        solid, origin, floaters = solid_voxels(pieces, resolution, density, crop, max_voxels)
        return cls(solid, origin, resolution, floaters).trimmed()

    @classmethod
    def from_file(
        cls,
        path: str | os.PathLike[str],
        resolution: float = 0.05,
        crop: Bounds | None = None,
        max_voxels: int = MAX_VOXELS,
    ) -> "Occupancy":
        """Apply ``from_points`` to a point cloud file whose coordinates are world metres.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: for a damaged file, one without a point inside the crop, or a grid above ``max_voxels``.
        """
        points = read_points(path)
        occupancy = cls.from_points(points, resolution, crop, max_voxels)
        if occupancy.count == 0:
            extent = [np.round(corner, 3).tolist() for corner in (points.min(0), points.max(0))]
            raise ValueError(
                f"{path}: crop: expected a box that contains points, got {crop}; the point cloud spans {extent}"
            )
        return occupancy

    @classmethod
    def from_scene(
        cls,
        scene: "Scene",
        seeds: Tensor | ArrayLike | None = None,
        around: Bounds | None = None,
        resolution: float = 0.05,
        density: DensitySettings = DEFAULT_DENSITY,
        crop: Bounds | None = None,
        max_voxels: int = MAX_VOXELS,
        cloud: str | os.PathLike[str] | None = None,
        fill: float | None = None,
        clear: Sequence[Bounds] = (),
        add: Sequence[Bounds] = (),
    ) -> "Occupancy":
        """Find what is solid in a scene, edit and fill it, and keep it in the scene's cache until an argument changes.

        Args:
            scene: holds ``gaussians`` in the world frame, ``bounds`` and a cache.
            seeds: [N, 3] places that robots can reach, world, metres, for ``fill``.
            around: lower and upper corner of the region where robots are, metres, for ``crop`` and ``fill``.
            resolution: edge of a voxel, metres.
            density: which Gaussians are solid; unused with a cloud.
            crop: lower and upper corner of the grid, metres. None takes the box that holds the scene's bounds and
                ``around``, each widened on all sides by a tenth of its longest side.
            max_voxels: maximum number of voxels in the grid.
            cloud: a point cloud file, PLY or PCD, in world metres: a laser or depth-camera scan of the place, whose
                points determine what is solid in place of the Gaussians. None takes the Gaussians.
            fill: widest opening that counts as closed when what lies behind it is made solid, metres; see ``solid``.
                None leaves hollow objects hollow.
            clear: boxes, each a lower and an upper corner, metres, in which nothing is solid.
            add: boxes that are solid, even inside a box of ``clear``.
        """
        within = widened(scene.bounds, scene.bounds if around is None else around) if crop is None else crop
        cleared, added = _boxes("clear", clear), _boxes("add", add)
        flood = None if fill is None else _flood(fill, seeds, around)
        recipe = {
            "resolution": resolution,
            "density": asdict(density),
            "crop": checked_box("crop", within).tolist(),
            "max_voxels": max_voxels,
            "cloud": None if cloud is None else file_digest(cloud),
            "free": None if scene.free is None else [file_digest(scene.free.path), scene.free.voxel_size],
            "clear": cleared.tolist(),
            "add": added.tolist(),
            "fill": None if flood is None else {name: _written(value) for name, value in flood.items()},
        }

        def build() -> dict[str, NDArray[Any]]:
            if cloud is None:
                occupancy = cls.from_pieces(scene.pieces, resolution, density, within, max_voxels)
                if scene.free is not None:
                    free = cls.from_points(read_points(scene.free.path), scene.free.voxel_size, None, max_voxels)
                    occupancy = occupancy.without(free)
            else:
                occupancy = cls.from_file(cloud, resolution, within, max_voxels)
            occupancy = occupancy.carved(cleared[:, 0], cleared[:, 1])
            occupancy = occupancy.with_boxes(added[:, 0], added[:, 1], max_voxels)
            return (occupancy if flood is None else occupancy.solid(**flood, max_voxels=max_voxels)).to_arrays()

        return cls.from_arrays(scene.cached("occupancy", recipe, build, max_voxels // 8 + HEADERS), max_voxels)

    @cached_property
    def digest(self) -> str:
        """Fingerprint of the solid voxels and their positions."""
        frame = [*map(int, (*self.occupied.shape, *self.origin_key)), float(self.resolution)]
        digest = blake2b(repr(frame).encode(), digest_size=16)
        digest.update(np.packbits(self.occupied).tobytes())
        return digest.hexdigest()

    def __or__(self, other: "Occupancy") -> "Occupancy":
        """Return the union of the solid voxels of two grids; see ``joined``."""
        return self.joined(other)

    def joined(self, other: "Occupancy", max_voxels: int = MAX_VOXELS) -> "Occupancy":
        """Return the union of the solid voxels of two grids of the same resolution.

        Args:
            other: the other grid.
            max_voxels: maximum number of voxels in the grid around both, unless one of them has more.

        Raises:
            ValueError: for grids of different resolutions, or so far apart that the grid around both is too large.
        """
        if not math.isclose(self.resolution, other.resolution, rel_tol=1e-9):
            raise ValueError(
                f"|: expected two grids of the same resolution, got {self.resolution} and {other.resolution} m"
            )
        grids = [grid for grid in (self, other) if grid.occupied.size]
        floaters, filled = self.floaters + other.floaters, self.filled + other.filled
        if not grids:
            return replace(self, floaters=floaters, filled=filled)
        first = np.min([grid.origin_key for grid in grids], 0)
        end = np.max([np.add(grid.origin_key, grid.occupied.shape) for grid in grids], 0)
        largest = max(max_voxels, *(grid.occupied.size for grid in (self, other)))
        occupied = np.zeros(grid_shape(first, end, self.resolution, largest), bool)
        for grid in grids:
            occupied[_window(grid.origin_key - first, grid.occupied.shape)] |= grid.occupied
        return Occupancy(occupied, tuple(first.tolist()), self.resolution, floaters, filled)

    def with_boxes(
        self, lower: Tensor | ArrayLike, upper: Tensor | ArrayLike, max_voxels: int = MAX_VOXELS
    ) -> "Occupancy":
        """Return a copy in which boxes, given by corners [N, 3] in metres, are solid: the union with ``from_boxes``."""
        return self.joined(Occupancy.from_boxes(lower, upper, self.resolution, max_voxels), max_voxels)

    def without(self, free: Voxels) -> "Occupancy":
        """Return a copy without the voxels whose centre and corners all lie in occupied voxels of another grid."""
        solid = self.keys()
        open_ = np.ones(len(solid), bool)
        for corner in np.concatenate([[[0.5] * 3], np.stack(np.meshgrid(*[[0.01, 0.99]] * 3), -1).reshape(-1, 3)]):
            open_ &= free.contains((solid + corner) * self.resolution)
        occupied = self.occupied.copy()
        occupied[tuple((solid[open_] - self.origin_key).T)] = False
        return replace(self, occupied=occupied)

    def carved(self, lower: Tensor | ArrayLike, upper: Tensor | ArrayLike) -> "Occupancy":
        """Return a copy without the voxels that boxes, given by corners [N, 3] in metres, cover wholly or in part."""
        occupied = self.occupied.copy()
        for first, end in zip(*box_keys(lower, upper, self.resolution), strict=True):
            x, y, z = np.clip([first - self.origin_key, end - self.origin_key], 0, occupied.shape).T
            occupied[slice(*x), slice(*y), slice(*z)] = False
        return replace(self, occupied=occupied)

    def solid(
        self,
        opening: float,
        seeds: Tensor | ArrayLike | None = None,
        around: Bounds | None = None,
        max_voxels: int = MAX_VOXELS,
    ) -> "Occupancy":
        """Return a copy in which everything that cannot be reached is solid; see ``unreached_voxels``.

        If nothing is free near the seeds, nothing changes and a warning is issued.
        """
        found = unreached_voxels(self.occupied, self.origin_key, self.resolution, opening, seeds, around, max_voxels)
        if found is None:
            warn_unfilled(opening)
            return self
        unreached, origin = found
        whole = self.joined(Occupancy(unreached, origin, self.resolution), max_voxels)
        return replace(whole, filled=self.filled + int(unreached.sum())).trimmed()

    def trimmed(self) -> "Occupancy":
        """Return the same solid voxels in the smallest grid that holds them."""
        if not self.occupied.any():
            return replace(Occupancy.empty(self.resolution), floaters=self.floaters, filled=self.filled)
        (box,) = ndimage.find_objects(self.occupied.view(np.int8))
        x, y, z = (key + span.start for key, span in zip(self.origin_key, box, strict=True))
        return replace(self, occupied=np.ascontiguousarray(self.occupied[box]), origin_key=(x, y, z))


def _window(start: NDArray[np.int64], shape: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice(int(at), int(at) + extent) for at, extent in zip(start, shape, strict=True))


def _boxes(name: str, boxes: Sequence[Bounds]) -> NDArray[np.float64]:
    """Check boxes and stack their lower and upper corners: [N, 2, 3]."""
    return np.array([checked_box(name, box) for box in boxes]).reshape(-1, 2, 3)


def _flood(opening: float, seeds: Tensor | ArrayLike | None, around: Bounds | None) -> dict[str, Any]:
    """Check and return the arguments of ``solid``."""
    return {
        "opening": opening,
        "seeds": None if seeds is None else checked_points("seeds", seeds),
        "around": None if around is None else checked_box("around", around),
    }


def _written(value: Any) -> Any:
    """Represent a value in JSON: an array, which may have a row for every state of a robot, by its digest."""
    return blake2b(value.tobytes(), digest_size=16).hexdigest() if isinstance(value, np.ndarray) else value
