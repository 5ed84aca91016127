"""What a fit compares its renders with: the photos at one size, their cameras, and known depths."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.photo_files import read_photo


@dataclass(frozen=True)
class Frame:
    """The frame of a fit: the mean of the camera positions is its origin, and their extent its unit.

    Attributes:
        middle: [3] float64, the origin in the frame of the reconstruction.
        extent: distance from there to the farthest camera, in the unit of the reconstruction.
    """

    middle: Tensor
    extent: float


@dataclass(frozen=True)
class Pictures:
    """N photos of one size with their cameras and sparse depths, in the frame of the fit.

    Attributes:
        pixels: [N, H, W, 3] uint8.
        K: [3, 3] float32.
        camera_to_world: [N, 4, 4] float32.
        soundings: [S, 3] float32, sparse depths grouped by camera: column, row, inverse depth.
        firsts: [N + 1] int64, index of each camera's first sounding.
    """

    pixels: Tensor
    K: Tensor
    camera_to_world: Tensor
    soundings: Tensor
    firsts: Tensor


def frame_of(camera_to_world: Tensor) -> Frame:
    """Return the frame of a fit to cameras [N, 4, 4]."""
    positions = camera_to_world[:, :3, 3].double()
    middle = positions.mean(0)
    extent = float((positions - middle).norm(dim=1).max())
    if not extent > 0.0:
        raise CaptureError("camera_to_world: expected cameras at different positions, got all of them at one")
    return Frame(middle, extent)


def sightings(reconstruction: Reconstruction, frame: Frame) -> tuple[Tensor, Tensor, Tensor]:
    """Return where cameras saw points, grouped by camera.

    Returns:
        [S, 3] float64: column and row as fractions of the image's size, depth in the unit of the fit; [S] int64,
        indices of the cameras; [S] int64, indices of the points.
    """
    order = reconstruction.seen_by.argsort(stable=True)
    camera, point = reconstruction.seen_by[order], reconstruction.seen_point[order]
    poses = reconstruction.camera_to_world.double()[camera]
    away = reconstruction.points.double()[point] - poses[:, :3, 3]
    x, y, z = (poses[:, :3, :3].mT @ away.unsqueeze(-1)).squeeze(-1).unbind(-1)
    K = reconstruction.K.double()
    across = (K[0, 0] * x / z + K[0, 2]) / reconstruction.width
    down = (K[1, 1] * y / z + K[1, 2]) / reconstruction.height
    kept = (z > 0) & (across >= 0) & (across < 1) & (down >= 0) & (down < 1)
    seen = torch.stack([across, down, z / frame.extent], 1)
    return seen[kept], camera[kept], point[kept]


def pictures(reconstruction: Reconstruction, frame: Frame, widths: Sequence[int]) -> list[Pictures]:
    """Read each photo once and resize it to some widths, keeping its shape as closely as whole pixels allow.

    Raises:
        CaptureError: for a photo of another size than the reconstruction states.
    """
    full = reconstruction.width, reconstruction.height
    sizes = [(width, max(1, round(full[1] * width / full[0]))) for width in widths]
    read = [np.empty((len(reconstruction.paths), height, width, 3), np.uint8) for width, height in sizes]
    for row, path in enumerate(reconstruction.paths):
        image = read_photo(path)
        if image.size != full:
            expected = f"{full[0]} × {full[1]}"
            raise CaptureError(f"{path}: expected {expected} pixels, got {image.size[0]} × {image.size[1]}")
        for size, images in zip(sizes, read, strict=True):
            images[row] = np.asarray(image.resize(size, Image.Resampling.BOX))
    seen, camera, _ = sightings(reconstruction, frame)
    firsts = torch.searchsorted(camera, torch.arange(len(reconstruction.paths) + 1))
    poses = reconstruction.camera_to_world.double().clone()
    poses[:, :3, 3] = (poses[:, :3, 3] - frame.middle) / frame.extent
    return [
        Pictures(
            pixels=torch.from_numpy(images),
            K=reconstruction.K_at(width, height).float(),
            camera_to_world=poses.float(),
            soundings=torch.stack([seen[:, 0] * width, seen[:, 1] * height, 1.0 / seen[:, 2]], 1).float(),
            firsts=firsts,
        )
        for (width, height), images in zip(sizes, read, strict=True)
    ]
