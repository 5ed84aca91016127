"""Where a scene's Gaussians are opaque enough to be solid."""

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
"""A Gaussian ends this many standard deviations from its mean."""


@dataclass(frozen=True)
class DensitySettings:
    """Which Gaussians count, and how dense a voxel must be to be solid.

    In YAML it is a node of its own: ``_target_: splatrl.collision.DensitySettings`` and these keys.

    Attributes:
        min_opacity: Gaussians below it are haze and left out, in [0, 1].
        cutoff: absorbed share of light above which a voxel is solid, in (0, 1).
        min_volume: cubic metres below which a connected component is a floater and dropped. The volume is that of
            whole voxels, so nothing is dropped on a grid where fewer than two voxels amount to it.
        max_scale: Gaussians with a larger standard deviation, metres, are sky and left out. None takes 20 voxels, or
            1 m where that is more; this is what bounds the work for one Gaussian.

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
            raise ValueError(f"cutoff: expected a share in (0, 1), got {self.cutoff}")
        if not self.min_volume >= 0.0:
            raise ValueError(f"min_volume: expected cubic metres of at least 0, got {self.min_volume}")
        if self.max_scale is not None and not self.max_scale > 0.0:
            raise ValueError(f"max_scale: expected metres above 0, or None, got {self.max_scale}")


DEFAULT_DENSITY = DensitySettings()


def solid_voxels(
    pieces: Sequence[Callable[[], Gaussians]],
    resolution: float,
    settings: DensitySettings,
    crop: Bounds | None,
    max_voxels: int,
) -> tuple[NDArray[np.bool_], tuple[int, int, int], int]:
    """Find the voxels that absorb at least ``settings.cutoff`` of the light, and drop what floats.

    A voxel's density is σ = Σ opacity · exp(−½ d²) over the Gaussians whose 3σ extent reaches it, with d a lower bound
    of the Mahalanobis distance from the mean to the voxel: the distance to the box around the voxel that lies along
    the Gaussian's own axes. It is exact where these are the world's, and it never misses a voxel that a thin slanted
    surface crosses. The voxel is solid if 1 − e^−σ ≥ ``cutoff`` and its 26-connected component is large enough.

    All pieces of a scene add to one grid, so voxels at the borders of blocks are those of the blocks merged.

    Args:
        pieces: each gives some of the Gaussians in the world frame. One is in memory at a time; those with something in
            the grid are asked twice, for its size and for densities.
        resolution: edge of a voxel, metres.
        settings: which Gaussians count and what is solid.
        crop: lower and upper corner of the grid, metres. None takes the box that holds the 5th to the 95th percentile
            of the Gaussians' extents along each axis, widened on all sides by half its longest one: all of a
            room, none of the splats that stray kilometres away.
        max_voxels: the largest grid that may be made.

    Returns:
        Solid voxels [X, Y, Z] bool, the key of the first, and how many voxels were dropped with floaters.

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
    """The Gaussians of a piece that count."""

    means: NDArray[np.float64]  # [N, 3] metres, like all lengths here
    axes: NDArray[np.float64]  # [N, 3, 3], columns
    scales: NDArray[np.float64]  # [N, 3]
    opacities: NDArray[np.float64]  # [N]
    reach: NDArray[np.float64]  # [N, 3], how far they extend along the world's axes


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
    """Which Gaussians reach into a box [2, 3], and for those the key of the first voxel and one past the last."""
    (lower, upper), beyond = within, 2 * resolution  # where no voxel of the box is: a floater's key may have no int64
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
    large[0] = False  # label 0 is free space
    return large[labels]
