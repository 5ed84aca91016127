"""Reads the .splat format of web viewers: 32 bytes per Gaussian, no header, no harmonics above degree 0."""

from pathlib import Path

import numpy as np
import torch

from splatrl.scenes.gaussians import Gaussians, checked_gaussians
from splatrl.spherical_harmonics import C0

OTHERS = {
    b"ply\n": "a PLY",
    b"ply\r": "a PLY",
    b"NGSP": "an SPZ",
    b"\x1f\x8b\x08\x00": "an SPZ or another gzip file",
    b"\x1f\x8b\x08\x08": "a gzip file",
    b"PK\x03\x04": "an SOG or another ZIP file",
}
"""First bytes of other kinds of files: read as the x of a first Gaussian, these are beyond 1e10 m or below 1e-30 m."""
RECORD = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])


def read_splat(path: Path, max_inflation: float) -> Gaussians:
    """Read a .splat file: linear scales, 8-bit colour and opacity, and wxyz quaternions stored as ``128 q + 128``.

    Raises:
        ValueError: for another kind of file, one that ends within a record, or one without visible Gaussians.
    """
    with path.open("rb") as stream:
        other = OTHERS.get(stream.read(4))
    if other is not None:
        raise ValueError(f"{path}: expected records of a .splat, got {other}; give it the extension of its kind")
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
