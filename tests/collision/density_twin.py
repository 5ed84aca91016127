"""The density of voxels from its definition, every voxel against every Gaussian: the readable twin of
``splatrl/native/occupancy.cpp``."""

import numpy as np
from numpy.typing import NDArray

from splatrl.geometry import quats_to_rotations
from splatrl.scenes.gaussians import Gaussians

EXTENT = 3.0
"""A Gaussian ends this many standard deviations from its mean."""


def density_of(gaussians: Gaussians, centers: NDArray[np.float64], resolution: float) -> NDArray[np.float64]:
    """Sum opacity · exp(−½ d²) over all Gaussians, d from the mean to the box around the voxel along their axes.

    A Gaussian reaches a voxel where d is at most its extent and its bounding box along the world's axes touches it.

    Args:
        gaussians: in the world frame.
        centers: [M, 3] of voxels, metres.
        resolution: edge of a voxel, metres.

    Returns:
        [M]
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
