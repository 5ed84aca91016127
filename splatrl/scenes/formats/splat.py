"""Reads the .splat format of web viewers: 32 bytes per Gaussian, no header, no harmonics above degree 0."""

from pathlib import Path

import numpy as np
import torch

from splatrl.scenes.gaussians import Gaussians, checked_gaussians
from splatrl.spherical_harmonics import C0

RECORD = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])


def read_splat(path: Path, max_inflation: float) -> Gaussians:
    """Read a .splat file: linear scales, 8-bit colour and opacity, and wxyz quaternions stored as ``128 q + 128``.

    Raises:
        ValueError: for a file that ends within a record, or one without visible Gaussians.
    """
    size = path.stat().st_size
    if size % RECORD.itemsize:
        raise ValueError(f"{path}: expected a multiple of {RECORD.itemsize} bytes, got {size}")
    records = np.fromfile(path, RECORD)
    rgba = torch.from_numpy(records["rgba"] / np.float32(255.0))
    return checked_gaussians(
        str(path),
        means=torch.from_numpy(records["means"].astype(np.float32)),
        quats=torch.from_numpy(records["quats"] / np.float32(128.0) - np.float32(1.0)),
        scales=torch.from_numpy(records["scales"].astype(np.float32)),
        opacities=rgba[:, 3],
        sh=((rgba[:, None, :3] - 0.5) / C0),
    )


READERS = {".splat": read_splat}
