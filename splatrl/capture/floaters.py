"""What is solid in a capture although cameras saw through it."""

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.capture.base import Reconstruction
from splatrl.collision.occupancy import Occupancy
from splatrl.scenes.gaussians import Gaussians

MIN_CAMERAS = 4
"""Cameras that must have seen through a voxel."""
AGAINST_HITS = 2.0
"""And this many times as many as saw a point in it or beside it."""
MARGIN = 3.0
"""Voxels before a point at which a ray ends: points are not exact, and surfaces are thick."""
LONGEST = 20.0
"""Metres of a ray that are followed."""
RAYS = 1500
"""A camera, at most."""
_STEP = 0.7
"""Voxels from sample to sample of a ray."""


def seen_through(occupancy: Occupancy, reconstruction: Reconstruction) -> NDArray[np.bool_]:
    """Solid voxels that many cameras saw through to points behind them: [X, Y, Z] bool.

    Args:
        occupancy: what is solid, world frame.
        reconstruction: cameras and what they saw, in the same frame.
    """
    shape = occupancy.occupied.shape
    if not occupancy.occupied.any():
        return np.zeros(shape, bool)
    through, hits = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
    points, centers = reconstruction.points.numpy(), reconstruction.camera_to_world[:, :3, 3].numpy()
    seen_by, seen_point = reconstruction.seen_by.numpy(), reconstruction.seen_point.numpy()
    often = np.bincount(seen_point, minlength=len(points)) >= 3
    order = np.argsort(seen_by, kind="stable")
    ends = np.searchsorted(seen_by[order], np.arange(len(centers) + 1))
    for camera, center in enumerate(centers):
        rows = order[ends[camera] : ends[camera + 1]]
        rows = rows[often[seen_point[rows]]]
        rows = rows[:: max(1, -(-len(rows) // RAYS))]
        aims = points[seen_point[rows]]
        through += _touched(occupancy, _seen_places(occupancy, center, aims))
        hits += _touched(occupancy, _around(aims, occupancy.resolution))
    seen: NDArray[np.bool_] = occupancy.occupied & (through >= MIN_CAMERAS) & (through > AGAINST_HITS * hits)
    return seen


def without_floaters(
    gaussians: Gaussians, occupancy: Occupancy, reconstruction: Reconstruction
) -> tuple[Gaussians, int]:
    """The Gaussians without those in voxels that many cameras saw through, and how many voxels these are."""
    carved = seen_through(occupancy, reconstruction)
    index = torch.floor(gaussians.means.double() / occupancy.resolution).long() - torch.tensor(occupancy.origin_key)
    inside = ((index >= 0) & (index < torch.tensor(carved.shape))).all(1)
    dropped = torch.zeros(len(gaussians), dtype=torch.bool)
    dropped[inside] = torch.from_numpy(carved[tuple(index[inside].T.numpy())])
    return gaussians[~dropped], int(carved.sum())


def _seen_places(occupancy: Occupancy, center: NDArray[np.float64], aims: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places [S, 3] along the rays from a camera towards points that it saw.

    A ray ends before its point, and before all that is solid from there on towards the camera: a surface that it
    meets at a low angle is no floater.
    """
    ways = aims - center
    lengths = np.linalg.norm(ways, axis=1) - MARGIN * occupancy.resolution
    ways, lengths = ways[lengths > 0], lengths[lengths > 0]
    if len(ways) == 0:
        return np.empty((0, 3))
    directions = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    along = np.arange(0.0, min(float(lengths.max()), LONGEST), _STEP * occupancy.resolution)
    places = center + directions[:, None] * along[:, None]  # [rays, samples, 3]
    free = ~occupancy.contains(places.reshape(-1, 3)).reshape(places.shape[:2]) & (along < lengths[:, None])
    last = np.where(free.any(1), free.shape[1] - 1 - free[:, ::-1].argmax(1), -1)
    seen: NDArray[np.float64] = places[np.arange(free.shape[1]) <= last[:, None]]
    return seen


def _around(points: NDArray[np.float64], resolution: float) -> NDArray[np.float64]:
    """Places [27 P, 3] in and beside the voxels of points."""
    steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return (points[:, None] + resolution * steps).reshape(-1, 3)


def _touched(occupancy: Occupancy, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The voxels of a grid in which there is at least one of some places."""
    shape = occupancy.occupied.shape
    index = np.floor(places / occupancy.resolution).astype(np.int64) - occupancy.origin_key
    index = index[((index >= 0) & (index < shape)).all(1)]
    touched = np.zeros(shape, bool)
    touched[tuple(index.T)] = True
    return touched
