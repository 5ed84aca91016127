"""Where the Gaussians of a fit begin: on the points of the reconstruction, and between them."""

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fit_model import LOGIT, SH, Model
from splatrl.capture.fit_pictures import Frame, Pictures
from splatrl.capture.sweep import AGREEING, neighbours_of, sweep
from splatrl.spherical_harmonics import C0

OPACITY = 0.3
NEIGHBOURS = 3
LARGEST = 0.3
"""Standard deviation with which a Gaussian begins at most, in the extent of the cameras."""


def start(
    reconstruction: Reconstruction, frame: Frame, seen: Pictures, rows: Tensor, model: Model, share: float, seed: int
) -> None:
    """Fill a model.

    Args:
        reconstruction: whose points are used.
        frame: of the fit.
        seen: the photos that may be looked at.
        rows: [n] int64, which of them.
        model: an empty one.
        share: of the cap that is filled at least.
        seed: of what is drawn at random.

    Raises:
        CaptureError: where there are no points.
    """
    if len(reconstruction.points) == 0:
        raise CaptureError("points: expected at least one to start from, got none")
    random = np.random.default_rng(seed)
    points = ((reconstruction.points.double() - frame.middle) / frame.extent).numpy()
    colors = reconstruction.colors.double().numpy() / 255.0
    if len(points) > model.cap:
        kept = np.sort(random.permutation(len(points))[: model.cap])
        points, colors = points[kept], colors[kept]
    missing = int(model.cap * share) - len(points)
    if missing > 0:
        more = between(seen, rows, missing, random)
        more_points, more_colors = more if more is not None else beside(points, colors, missing, random)
        points, colors = np.concatenate([points, more_points]), np.concatenate([colors, more_colors])
    columns = torch.zeros(model.values.shape[0], len(points))
    columns[:3] = torch.from_numpy(points.T)
    columns[3:6] = torch.from_numpy(np.log(spacing(points)))
    columns[6] = 1.0
    columns[LOGIT] = float(np.log(OPACITY / (1 - OPACITY)))
    columns[SH : SH + 3] = torch.from_numpy((colors.T - 0.5) / C0)
    model.add(columns)


def spacing(points: np.ndarray) -> np.ndarray:
    """Standard deviations with which Gaussians at these points touch: [n]."""
    if len(points) <= NEIGHBOURS:
        return np.full(len(points), 0.1 * LARGEST)
    distances = cKDTree(points).query(points, NEIGHBOURS + 1)[0][:, 1:]
    return np.clip(0.5 * np.sqrt((distances**2).mean(1)), 1e-4, LARGEST)


def between(
    seen: Pictures, rows: Tensor, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray] | None:
    """Random pixels at depths at which photos agree, near to what the nearest soundings of their image suggest.

    None where no image has soundings.
    """
    usable = [row for row in rows.tolist() if seen.firsts[row + 1] - seen.firsts[row] > NEIGHBOURS]
    if not usable:
        return None
    height, width = seen.pixels.shape[1:3]
    K = seen.K.double().numpy()
    points, colors = [], []
    shares = np.diff(np.linspace(0, count, len(usable) + 1).astype(int))
    for row, wanted in zip(usable, shares.tolist(), strict=True):
        known = seen.soundings[seen.firsts[row] : seen.firsts[row + 1]].double().numpy()
        places = random.random((wanted, 2)) * (width, height)
        distances, nearest = cKDTree(known[:, :2]).query(places, NEIGHBOURS)
        weights = 1.0 / (distances + 1.0)
        inverses = (weights * known[nearest, 2]).sum(1) / weights.sum(1)
        others = neighbours_of(seen, row, rows, float(np.median(1.0 / known[:, 2])))
        if len(others) >= AGREEING and wanted > 0:
            found = sweep(seen, row, others, torch.from_numpy(places).float(), torch.from_numpy(inverses).float())
            inverses = found.double().numpy()
        rays = np.stack([(places[:, 0] - K[0, 2]) / K[0, 0], (places[:, 1] - K[1, 2]) / K[1, 1], np.ones(wanted)], 1)
        pose = seen.camera_to_world[row].double().numpy()
        points.append((rays / inverses[:, None]) @ pose[:3, :3].T + pose[:3, 3])
        columns, lines = places[:, 0].astype(int), places[:, 1].astype(int)
        colors.append(seen.pixels[row].numpy()[lines, columns] / 255.0)
    return np.concatenate(points), np.concatenate(colors)


def beside(
    points: np.ndarray, colors: np.ndarray, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random places near points, with their colours."""
    chosen = random.integers(0, len(points), count)
    moved = points[chosen] + random.normal(size=(count, 3)) * 2.0 * spacing(points)[chosen, None]
    return moved, colors[chosen]
