"""Find voxels that are solid although cameras saw through them: blobs in mid-air, and haze that no image shows."""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.cameras import Cameras, depths_at
from splatrl.capture.base import Reconstruction
from splatrl.collision.occupancy import Occupancy
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians

MIN_CAMERAS = 4
"""Minimum number of cameras that must have seen through a voxel."""
AGAINST_HITS = 2.0
"""These cameras must also outnumber, by more than this factor, those that saw a point in the voxel or beside it."""
MARGIN = 3.0
"""Voxels before a point at which a ray ends: points are inexact, and surfaces have a thickness."""
LONGEST = 20.0
"""Maximum length over which a ray is followed, metres."""
RAYS = 1500
"""Maximum number of rays per camera."""
DRAWN_WIDTH = 240
"""Width of the renders in which haze is looked for, pixels."""
OPAQUE = 0.5
"""Minimum alpha at which the depth of a rendered pixel counts."""
HAZE_CAMERAS = 2
"""Minimum number of cameras that must see a surface behind a voxel."""
DRAWN_MARGIN = (1.5, 0.04)
"""Tolerance in the depth of that surface: this many voxels, but at least this fraction of the depth."""
_STEP = 0.7
"""Voxels between two samples of a ray."""


def seen_through(occupancy: Occupancy, reconstruction: Reconstruction) -> NDArray[np.bool_]:
    """Find solid voxels that many cameras saw through to points behind them: [X, Y, Z] bool.

    Args:
        occupancy: what is solid, world frame.
        reconstruction: cameras and the points that they saw, in the same frame.
    """
    solid = occupancy.occupied
    if not solid.any():
        return np.zeros(solid.shape, bool)
    through, hits = np.zeros(solid.size, np.int32), np.zeros(solid.size, np.int32)
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
        through[_crossed(occupancy, center, aims)] += 1
        hits[_beside(occupancy, aims)] += 1
    seen = (through >= MIN_CAMERAS) & (through > AGAINST_HITS * hits)
    return solid & seen.reshape(solid.shape)


def hazy_voxels(
    occupancy: Occupancy, gaussians: Gaussians, reconstruction: Reconstruction, known: Tensor | None = None
) -> NDArray[np.bool_]:
    """Find solid voxels behind which more cameras see a surface than see one in them: [X, Y, Z] bool.

    What a fit could not place, on glossy or bare walls, becomes a haze that no image shows, yet its density still adds
    up. The surface that a camera sees is taken from its render and, separately, from the known depths of its photo.

    Args:
        occupancy: what is solid, world frame.
        gaussians: the Gaussians that it was made from.
        reconstruction: the cameras, in the same frame.
        known: [N, h, w] depths of the photos' pixels, metres, 0 where unknown; None where no depth is known.
    """
    cells = np.argwhere(occupancy.occupied)
    out = np.zeros(occupancy.occupied.shape, bool)
    if len(cells) == 0:
        return out
    places = torch.from_numpy((cells + occupancy.origin_key + 0.5) * occupancy.resolution)
    width = min(DRAWN_WIDTH, reconstruction.width)
    height = max(1, round(reconstruction.height * width / reconstruction.width))
    renderer, poses = NativeRenderer(gaussians), reconstruction.camera_to_world.float()
    K = reconstruction.K_at(width, height).float()

    def drawn(row: int) -> Tensor:
        view = renderer.render(Cameras(poses[row : row + 1], K, width, height))
        return torch.where(view.alpha[0] >= OPAQUE, view.depth[0], 0.0)

    hazy = _behind(places, reconstruction, occupancy.resolution, drawn)
    if known is not None:
        hazy |= _behind(places, reconstruction, occupancy.resolution, lambda row: known[row])
    out[tuple(cells[hazy.numpy()].T)] = True
    return out


def _behind(places: Tensor, reconstruction: Reconstruction, edge: float, depths: Callable[[int], Tensor]) -> Tensor:
    """Return whether more cameras see a surface behind each place [M, 3] than at it: [M] bool.

    ``depths`` returns the depth image [h, w] of a camera, given its index.
    """
    behind, within = torch.zeros(len(places), dtype=torch.int64), torch.zeros(len(places), dtype=torch.int64)
    for row, pose in enumerate(reconstruction.camera_to_world.double()):
        depth = depths(row)
        z, far = depths_at(places, depth, pose, reconstruction.K_at(depth.shape[1], depth.shape[0]), edge)
        margin = (DRAWN_MARGIN[1] * far).clamp_min(DRAWN_MARGIN[0] * edge)
        behind += (far > 0) & (z < far - margin)
        within += (far > 0) & ((z - far).abs() <= margin)
    return (behind >= HAZE_CAMERAS) & (behind > within)


def without_floaters(
    gaussians: Gaussians, occupancy: Occupancy, reconstruction: Reconstruction
) -> tuple[Gaussians, int]:
    """Remove the Gaussians in voxels that many cameras saw through; return the rest and the number of these voxels."""
    carved = seen_through(occupancy, reconstruction)
    index = torch.floor(gaussians.means.double() / occupancy.resolution).long() - torch.tensor(occupancy.origin_key)
    inside = ((index >= 0) & (index < torch.tensor(carved.shape))).all(1)
    dropped = torch.zeros(len(gaussians), dtype=torch.bool)
    dropped[inside] = torch.from_numpy(carved[tuple(index[inside].T.numpy())])
    return gaussians[~dropped], int(carved.sum())


def _crossed(occupancy: Occupancy, center: NDArray[np.float64], aims: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the flat indices, each once, of the solid voxels on the rays from a camera to points that it saw.

    A ray ends before its point, and before any solid stretch that leads up to that end: a surface that a ray meets at a
    grazing angle is no floater.
    """
    ways = aims - center
    lengths = np.linalg.norm(ways, axis=1) - MARGIN * occupancy.resolution
    ways, lengths = ways[lengths > 0], lengths[lengths > 0]
    if len(ways) == 0:
        return np.empty(0, np.int64)
    directions = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    along = np.arange(0.0, min(float(lengths.max()), LONGEST), _STEP * occupancy.resolution)
    short = along < lengths[:, None]  # [rays, samples]
    ray, sample = short.nonzero()
    number = _solid(
        occupancy, *(start + way[ray] * along[sample] for start, way in zip(center, directions.T, strict=True))
    )
    free = np.zeros(short.shape, bool)
    free[short] = number < 0
    last = np.where(free.any(1), free.shape[1] - 1 - free[:, ::-1].argmax(1), -1)
    return np.unique(number[(number >= 0) & (sample < last[ray])])


def _beside(occupancy: Occupancy, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the flat indices, each once, of the solid voxels that contain points or are among their 26 neighbours."""
    steps = occupancy.resolution * np.array([-1.0, 0.0, 1.0])
    x, y, z = points.T[:, :, None] + steps
    number = _solid(occupancy, x[:, :, None, None], y[:, None, :, None], z[:, None, None, :])
    return np.unique(number[number >= 0])


def _solid(occupancy: Occupancy, *places: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the flat row-major index of the solid voxel at each place, given by its x, y and z; -1 where none is."""
    number, inside = np.zeros((), np.int64), np.ones((), bool)
    for axis, first, size in zip(places, occupancy.origin_key, occupancy.occupied.shape, strict=True):
        index = np.floor(axis / occupancy.resolution).astype(np.int64) - first
        number, inside = number * size + index, inside & (index >= 0) & (index < size)
    number = np.where(inside, number, 0)
    return np.where(inside & occupancy.occupied.reshape(-1)[number], number, -1)
