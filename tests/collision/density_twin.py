"""Readable reference for the voxel density of ``splatrl/native/occupancy.cpp``: every voxel against every Gaussian."""

import numpy as np
from numpy.typing import NDArray

from splatrl.geometry import quats_to_rotations
from splatrl.scenes.gaussians import Gaussians

EXTENT = 3.0
"""Standard deviations from its mean at which a Gaussian is cut off."""


def density_of(gaussians: Gaussians, centers: NDArray[np.float64], resolution: float) -> NDArray[np.float64]:
    """Sum opacity · exp(−½ d²) over all Gaussians.

    d is the Mahalanobis distance from the mean to the bounding box of the voxel along the Gaussian's axes.

    A Gaussian reaches a voxel if d is at most ``EXTENT`` and its world-aligned bounding box touches the voxel.

    Args:
        gaussians: Gaussians in the world frame.
        centers: [M, 3], centres of the voxels, metres.
        resolution: edge length of a voxel, metres.

    Returns:
        [M], density of each voxel.
    """
    rotations = quats_to_rotations(gaussians.quats.double()).numpy()
    scales, means, opacities = (v.double().numpy() for v in (gaussians.scales, gaussians.means, gaussians.opacities))
    density = np.zeros(len(centers))
    for mean, rotation, scale, opacity in zip(means, rotations, scales, opacities, strict=True):
        along = np.abs((centers - mean) @ rotation)
        half = 0.5 * resolution * np.abs(rotation).sum(0)
        squares = (np.maximum((along - half) / scale, 0.0) ** 2).sum(1)
        reach = EXTENT * np.sqrt(((rotation * scale) ** 2).sum(1))
        reached = (np.abs(centers - mean) < reach + 0.5 * resolution).all(1)
        density += np.where((squares <= EXTENT**2) & reached, opacity * np.exp(-0.5 * squares), 0.0)
    return density
