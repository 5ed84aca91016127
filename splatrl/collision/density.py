"""Finds the voxels in which a scene's Gaussians are opaque enough to be solid."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from splatrl.collision.voxel_grid import Bounds, check_resolution, checked_box, grid_shape
from splatrl.native._core import add_density
from splatrl.scenes.gaussians import Gaussians

_EXTENT = 3.0
"""Standard deviations from its mean at which a Gaussian is cut off."""


@dataclass(frozen=True)
class DensitySettings:
    """Settings for which Gaussians count and how dense a voxel must be to be solid.

    In YAML this is a node of its own, with ``_target_: splatrl.collision.DensitySettings`` and these keys.

    Attributes:
        min_opacity: opacity in [0, 1] below which Gaussians are taken for haze and left out.
        cutoff: fraction of the light that a voxel must absorb to be solid, in (0, 1).
        min_volume: volume below which a connected component is taken for a floater and dropped, cubic metres. Volume
            is counted in whole voxels, so nothing is dropped on a grid where a single voxel is at least this large.
        max_scale: standard deviation above which Gaussians are taken for sky and left out, metres. None takes 20
            voxels or 1 m, whichever is larger. This limit bounds the work per Gaussian.

    Raises:
        ValueError: for a value out of range.
    """

    min_opacity: float = 0.1
    cutoff: float = 0.5
    min_volume: float = 0.008
    max_scale: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_opacity <= 1.0:
            raise ValueError(f"min_opacity: expected an opacity in [0, 1], got {self.min_opacity}")
        if not 0.0 < self.cutoff < 1.0:
            raise ValueError(f"cutoff: expected a fraction in (0, 1), got {self.cutoff}")
        if not self.min_volume >= 0.0:
            raise ValueError(f"min_volume: expected a non-negative number of cubic metres, got {self.min_volume}")
        if self.max_scale is not None and not self.max_scale > 0.0:
            raise ValueError(f"max_scale: expected a positive number of metres, or None, got {self.max_scale}")


DEFAULT_DENSITY = DensitySettings()


def solid_voxels(
    pieces: Sequence[Callable[[], Gaussians]],
    resolution: float,
    settings: DensitySettings,
    crop: Bounds | None,
    max_voxels: int,
) -> tuple[NDArray[np.bool_], tuple[int, int, int], int]:
    """Find the voxels that absorb at least ``settings.cutoff`` of the light, and drop floaters.

    A voxel's density is σ = Σ opacity · exp(−½ d²) over the Gaussians whose 3σ extent reaches it, where d is a lower
    bound on the Mahalanobis distance from the mean to the voxel: the distance to the box that encloses the voxel and is
    aligned with the Gaussian's own axes. It is exact if these are the world's axes, and it never misses a voxel that a
    thin slanted surface crosses. The voxel is solid if 1 − e^−σ ≥ ``cutoff`` and its 26-connected component is large
    enough.

    All pieces of a scene add to one grid, so voxels at the borders of blocks are the same as for the merged blocks.

    Args:
        pieces: functions that each load some of the Gaussians, in the world frame. Only one piece is in memory at a
            time; a piece with Gaussians in the grid is loaded twice, for the grid's size and for densities, and without
            a crop every piece is loaded once more, for the bounds.
        resolution: edge of a voxel, metres.
        settings: which Gaussians count and what is solid.
        crop: lower and upper corner of the grid, metres. None takes the box that holds the 5th to the 95th percentile
            of the Gaussians' extents along each axis, widened on all sides by half its longest side: this covers all
            of a room, but none of the splats that stray kilometres away.
        max_voxels: maximum number of voxels in the grid.

    Returns:
        Solid voxels [X, Y, Z] bool, the key of the first, and the number of voxels dropped as floaters.

    Raises:
        ValueError: for a resolution or a crop out of range, or a grid above ``max_voxels``.
    """
    check_resolution(resolution)
    limit = max(1.0, 20.0 * resolution) if settings.max_scale is None else settings.max_scale

    find = partial(_ellipsoids, min_opacity=settings.min_opacity, max_scale=limit)
    within = _populated_bounds([find(piece()) for piece in pieces]) if crop is None else checked_box("crop", crop)
    filled = []
    for piece in pieces:
        _, first, end = _voxels(find(piece()), within, resolution)
        if len(first):
            filled.append((piece, first.min(0), end.max(0)))
    if not filled:
        return np.zeros((0, 0, 0), bool), (0, 0, 0), 0
    origin, last = np.min([first for _, first, _ in filled], 0), np.max([end for _, _, end in filled], 0)
    density = np.zeros(grid_shape(origin, last, resolution, max_voxels), np.float32)
    for piece, _, _ in filled:
        part = find(piece())
        rows, first, end = _voxels(part, within, resolution)
        add_density(
            part.means[rows] / resolution - origin,
            part.axes[rows],
            part.scales[rows] / resolution,
            part.opacities[rows],
            first - origin,
            end - origin,
            _EXTENT,
            density,
        )
    dense = density >= -np.log1p(-settings.cutoff)
    solid = _without_floaters(dense, settings.min_volume / resolution**3)
    return solid, (int(origin[0]), int(origin[1]), int(origin[2])), int(dense.sum() - solid.sum())


class _Ellipsoids(NamedTuple):
    """The Gaussians of a piece that pass the opacity and scale limits."""

    means: NDArray[np.float64]  # [N, 3] metres, like all lengths here
    axes: NDArray[np.float64]  # [N, 3, 3], one axis per column
    scales: NDArray[np.float64]  # [N, 3]
    opacities: NDArray[np.float64]  # [N]
    reach: NDArray[np.float64]  # [N, 3], half extents along the world's axes


def _ellipsoids(gaussians: Gaussians, min_opacity: float, max_scale: float) -> _Ellipsoids:
    kept = (gaussians.opacities >= min_opacity) & (gaussians.scales.amax(1) <= max_scale)
    means, scales, quats, opacities = (
        values[kept].detach().double().cpu().numpy()
        for values in (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities)
    )
    axes = Rotation.from_quat(quats, scalar_first=True).as_matrix() if len(quats) else np.zeros((0, 3, 3))
    reach = _EXTENT * np.sqrt(((axes * scales[:, None]) ** 2).sum(2))
    return _Ellipsoids(means, axes, scales, opacities, reach)


def _voxels(
    part: _Ellipsoids, within: NDArray[np.float64], resolution: float
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Return which Gaussians reach into a box [2, 3], and for those the key of the first voxel and one past the last.

    Extents are clamped to just outside the box, because the key of a stray splat may overflow int64.
    """
    (lower, upper), beyond = within, 2 * resolution
    least = np.minimum(np.maximum(part.means - part.reach, lower), upper + beyond)
    most = np.maximum(np.minimum(part.means + part.reach, upper), lower - beyond)
    first, end = np.floor(least / resolution).astype(np.int64), np.ceil(most / resolution).astype(np.int64)
    inside = (end > first).all(1)
    return inside, first[inside], end[inside]


def _populated_bounds(parts: Sequence[_Ellipsoids]) -> NDArray[np.float64]:
    lower = np.concatenate([part.means - part.reach for part in parts])
    upper = np.concatenate([part.means + part.reach for part in parts])
    if len(lower) == 0:
        return np.zeros((2, 3))
    low, high = np.quantile(lower, 0.05, axis=0), np.quantile(upper, 0.95, axis=0)
    margin = 0.5 * (high - low).max()
    return np.stack([low - margin, high + margin])


def _without_floaters(solid: NDArray[np.bool_], min_voxels: float) -> NDArray[np.bool_]:
    labels, _ = ndimage.label(solid, np.ones((3, 3, 3)))
    large = np.bincount(labels.reshape(-1)) >= min_voxels - 1e-6
    large[0] = False  # label 0 marks free space
    return large[labels]
