"""Where a scene's Gaussians are opaque enough to be solid."""

from dataclasses import dataclass

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
    gaussians: Gaussians,
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

    Args:
        gaussians: in the world frame.
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
    kept = (gaussians.opacities >= settings.min_opacity) & (gaussians.scales.amax(1) <= limit)
    if not kept.any():
        return np.zeros((0, 0, 0), bool), (0, 0, 0), 0
    means, scales, quats, opacities = (
        values[kept].detach().double().cpu().numpy()
        for values in (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities)
    )
    axes = Rotation.from_quat(quats, scalar_first=True).as_matrix()
    reach = _EXTENT * np.sqrt(((axes * scales[:, None]) ** 2).sum(2))
    lower, upper = _populated_bounds(means - reach, means + reach) if crop is None else checked_box("crop", crop)
    first = np.floor(np.maximum(means - reach, lower) / resolution).astype(np.int64)
    end = np.ceil(np.minimum(means + reach, upper) / resolution).astype(np.int64)
    inside = (end > first).all(1)
    if not inside.any():
        return np.zeros((0, 0, 0), bool), (0, 0, 0), 0
    first, end = first[inside], end[inside]
    origin = first.min(0)
    density = np.zeros(grid_shape(origin, end.max(0), resolution, max_voxels), np.float32)
    add_density(
        means[inside] / resolution - origin,
        axes[inside],
        scales[inside] / resolution,
        opacities[inside],
        first - origin,
        end - origin,
        _EXTENT,
        density,
    )
    dense = density >= -np.log1p(-settings.cutoff)
    solid = _without_floaters(dense, settings.min_volume / resolution**3)
    return solid, (int(origin[0]), int(origin[1]), int(origin[2])), int(dense.sum() - solid.sum())


def _populated_bounds(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> NDArray[np.float64]:
    low, high = np.quantile(lower, 0.05, axis=0), np.quantile(upper, 0.95, axis=0)
    margin = 0.5 * (high - low).max()
    return np.stack([low - margin, high + margin])


def _without_floaters(solid: NDArray[np.bool_], min_voxels: float) -> NDArray[np.bool_]:
    labels, _ = ndimage.label(solid, np.ones((3, 3, 3)))
    large = np.bincount(labels.reshape(-1)) >= min_voxels - 1e-6
    large[0] = False  # label 0 is free space
    return large[labels]
