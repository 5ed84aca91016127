"""Points measured by a depth sensor, added to the triangulated ones: bare walls and floors have no others."""

from dataclasses import replace

import numpy as np
import torch

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.photo_files import read_photo
from splatrl.images import read_grey

ACROSS = 8
"""Rows and columns of the grid of points taken from each depth image; points without depth are left out."""


def with_measured_points(reconstruction: Reconstruction) -> Reconstruction:
    """Add points from the sensor's depths to a reconstruction, each seen by the camera that measured it.

    Args:
        reconstruction: cameras and points; returned unchanged where it has no depths.

    Raises:
        CaptureError: for a photo or a depth image that cannot be read.
    """
    if not reconstruction.depths:
        return reconstruction
    points, colors, cameras = [], [], []
    K = np.linalg.inv(reconstruction.K.numpy())
    for row, path in enumerate(reconstruction.depths):
        try:
            counts = read_grey(path).astype(np.float64)
        except ValueError as error:
            raise CaptureError(str(error)) from error
        size = np.array([counts.shape[1], counts.shape[0]])
        grid = (np.stack(np.meshgrid(*[np.arange(ACROSS)] * 2), -1).reshape(-1, 2) + 0.5) / ACROSS
        column, line = (grid * size).astype(int).T
        depth = counts[line, column] * reconstruction.depth_unit
        column, line, depth = column[depth > 0], line[depth > 0], depth[depth > 0]
        shares = (np.stack([column, line], 1) + 0.5) / size  # normalised; the photo has the same field of view
        pixels = shares * [reconstruction.width, reconstruction.height]
        local = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ K.T * depth[:, None]
        pose = reconstruction.camera_to_world[row].numpy()
        points.append(local @ pose[:3, :3].T + pose[:3, 3])
        photo = np.asarray(read_photo(reconstruction.paths[row]))
        colors.append(photo[pixels[:, 1].astype(int), pixels[:, 0].astype(int)])
        cameras.append(np.full(len(depth), row))
    more = torch.from_numpy(np.concatenate(points))
    first = len(reconstruction.points)
    return replace(
        reconstruction,
        points=torch.cat([reconstruction.points, more]),
        colors=torch.cat([reconstruction.colors, torch.from_numpy(np.concatenate(colors))]),
        seen_point=torch.cat([reconstruction.seen_point, torch.arange(first, first + len(more))]),
        seen_by=torch.cat([reconstruction.seen_by, torch.from_numpy(np.concatenate(cameras))]),
    )
