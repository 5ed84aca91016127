"""Initial Gaussians of a fit: on the points of the reconstruction, and between them."""

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fitting.model import LOG_SCALE, LOGIT, MEAN, QUAT, SH, Model
from splatrl.capture.fitting.pictures import Frame, Pictures
from splatrl.capture.stereo import Depths
from splatrl.spherical_harmonics import C0

OPACITY = 0.3
NEIGHBOURS = 3
"""Nearest neighbours whose root-mean-square distance sets a Gaussian's initial size."""
LARGEST = 0.3
"""Largest initial standard deviation of a Gaussian, in units of the cameras' extent."""


def start(
    reconstruction: Reconstruction,
    frame: Frame,
    seen: Pictures,
    depths: Depths,
    rows: Tensor,
    model: Model,
    share: float,
    seed: int,
) -> None:
    """Fill an empty model with initial Gaussians.

    Args:
        reconstruction: the reconstruction whose points are used.
        frame: frame of the fit.
        seen: the photos.
        depths: depths of the photos' pixels.
        rows: [n] int64, indices of the photos that may be used.
        model: the model to fill; it must be empty.
        share: minimum fraction of the cap to fill.
        seed: seed of the random samples.

    Raises:
        CaptureError: where there are no points.
    """
    if len(reconstruction.points) == 0:
        raise CaptureError("points: expected at least one point for the initial Gaussians, got none")
    random = np.random.default_rng(seed)
    points = ((reconstruction.points.double() - frame.middle) / frame.extent).numpy()
    colors = reconstruction.colors.double().numpy() / 255.0
    if len(points) > model.cap:
        kept = np.sort(random.permutation(len(points))[: model.cap])
        points, colors = points[kept], colors[kept]
    missing = int(model.cap * share) - len(points)
    if missing > 0:
        more = between(seen, depths.likely, rows, missing, random)
        more_points, more_colors = more if more is not None else beside(points, colors, missing, random)
        points, colors = np.concatenate([points, more_points]), np.concatenate([colors, more_colors])
    columns = torch.zeros(model.values.shape[0], len(points))
    columns[MEAN] = torch.from_numpy(points.T)
    columns[LOG_SCALE] = torch.from_numpy(np.log(spacing(points)))
    columns[QUAT.start] = 1.0
    columns[LOGIT] = float(np.log(OPACITY / (1 - OPACITY)))
    columns[SH : SH + 3] = torch.from_numpy((colors.T - 0.5) / C0)
    model.add(columns)


def spacing(points: np.ndarray) -> np.ndarray:
    """Return the standard deviations with which Gaussians at these points touch: [n]."""
    if len(points) <= NEIGHBOURS:
        return np.full(len(points), 0.1 * LARGEST)
    distances = cKDTree(points).query(points, NEIGHBOURS + 1)[0][:, 1:]
    return np.clip(0.5 * np.sqrt((distances**2).mean(1)), 1e-4, LARGEST)


def between(
    seen: Pictures, inverses: Tensor, rows: Tensor, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray] | None:
    """Place random pixels at their likely depths; return positions and colours [count, 3], or None without depths.

    Args:
        seen: the photos.
        inverses: [N, h, w] likely inverse depths of their pixels, 0 where there is none.
        rows: [n] int64, indices of the photos to sample from.
        count: number of pixels to draw.
        random: random generator that draws the pixels.
    """
    found = inverses.numpy()
    usable = [row for row in rows.tolist() if found[row].any()]
    if not usable:
        return None
    height, width = seen.pixels.shape[1:3]
    K = seen.K.double().numpy()
    points, colors = [], []
    shares = np.diff(np.linspace(0, count, len(usable) + 1).astype(int))
    for row, wanted in zip(usable, shares.tolist(), strict=True):
        lines, columns = found[row].nonzero()
        chosen = random.integers(0, len(lines), wanted)
        down = (lines[chosen] + random.random(wanted)) * (height / found.shape[1])
        across = (columns[chosen] + random.random(wanted)) * (width / found.shape[2])
        rays = np.stack([(across - K[0, 2]) / K[0, 0], (down - K[1, 2]) / K[1, 1], np.ones(wanted)], 1)
        pose = seen.camera_to_world[row].double().numpy()
        distances = 1.0 / found[row][lines[chosen], columns[chosen]].astype(np.float64)
        points.append((rays * distances[:, None]) @ pose[:3, :3].T + pose[:3, 3])
        inside = down.astype(int).clip(0, height - 1), across.astype(int).clip(0, width - 1)
        colors.append(seen.pixels[row].numpy()[inside] / 255.0)
    return np.concatenate(points), np.concatenate(colors)


def beside(
    points: np.ndarray, colors: np.ndarray, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return random positions near points, with the colours of these points."""
    chosen = random.integers(0, len(points), count)
    moved = points[chosen] + random.normal(size=(count, 3)) * 2.0 * spacing(points)[chosen, None]
    return moved, colors[chosen]
