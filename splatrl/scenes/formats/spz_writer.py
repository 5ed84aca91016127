"""Writes Niantic's SPZ, version 3, which current viewers read; ``spz`` reads it back."""

import gzip
import math
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.files import replacing
from splatrl.scenes.formats.spz import COLOR_SCALE, HEADER, PIECE, Header
from splatrl.scenes.gaussians import Gaussians

VERSION = 3
FRACTIONAL_BITS = 12  # fractional bits of a position, as in other writers: a quarter of a millimetre
ANTIALIASED = 0x1  # flag: trained with antialiasing, and to be rendered with it
LARGEST = 2**23 - 1  # largest position in 24-bit signed fixed point

Bytes = NDArray[np.uint8]


def write_spz(path: Path, gaussians: Gaussians, antialiased: bool = True) -> None:
    """Write Gaussians as SPZ, a fifth to a quarter of the size of a PLY file.

    The file is written atomically, and the same Gaussians give the same bytes. Positions are rounded to 1/4096
    (coarser beyond 2 km), log scales to 1/16, opacities and colours to 1/255 of their range, harmonics to 1/128, and
    rotations to 0.3°. Harmonics above degree 0 are clamped to ±1, and scales to the range from e^-10 to e^6.

    Args:
        path: the file to write.
        gaussians: Gaussians in any frame.
        antialiased: whether they are to be rendered with antialiasing.

    Raises:
        ValueError: for values that are not finite, scales that are not above 0, or positions beyond what the format can
            store.
    """
    values = {
        name: getattr(gaussians, name).detach().cpu().double()
        for name in ("means", "quats", "scales", "opacities", "sh")
    }
    values["scales"] = values["scales"].log()
    for name, value in values.items():
        if not value.isfinite().all():
            raise ValueError(f"{path}: {name}: expected values that are finite when stored, got non-finite ones")
    farthest = float(values["means"].abs().max())
    bits = FRACTIONAL_BITS if farthest == 0.0 else min(FRACTIONAL_BITS, math.floor(math.log2(LARGEST / farthest)))
    if bits < 0:
        raise ValueError(f"{path}: means: expected at most {LARGEST:,} units from the origin, got {farthest:,.0f}")
    header = Header(b"NGSP", VERSION, len(gaussians), gaussians.sh_degree, bits, ANTIALIASED if antialiased else 0, 0)
    fixed = (values["means"] * 2.0**bits).round().to(torch.int32).numpy().astype("<i4")
    parts = [
        fixed.view(np.uint8).reshape(-1, 4)[:, :3],  # the lower 24 bits of each
        _bytes(255.0 * values["opacities"]),
        _bytes(255.0 * (COLOR_SCALE * values["sh"][:, 0] + 0.5)),
        _bytes(16.0 * (values["scales"] + 10.0)),
        _smallest_three(values["quats"]),
        _bytes(128.0 * values["sh"][:, 1:] + 128.0),
    ]
    with replacing(path) as stream, gzip.GzipFile("", "wb", fileobj=stream, mtime=0) as packed:
        packed.write(HEADER.pack(*header))
        for part in parts:
            content = np.ascontiguousarray(part).reshape(-1)
            for first in range(0, len(content), PIECE):  # Ctrl-C takes effect between pieces
                packed.write(content[first : first + PIECE].data)


def _bytes(values: Tensor) -> Bytes:
    return values.round().clamp(0, 255).to(torch.uint8).numpy()


def _smallest_three(quats: Tensor) -> Bytes:
    """Encode rotations wxyz [N, 4] → [N, 4] bytes: which of x, y, z, w is largest, and the others relative to √½."""
    xyzw = np.roll(torch.nn.functional.normalize(quats, dim=1).numpy(), -1, axis=1)
    largest = np.abs(xyzw).argmax(1)
    left_out = np.arange(4) == largest[:, None]
    xyzw = xyzw * np.where(xyzw[left_out] < 0, -1.0, 1.0)[:, None]
    three = xyzw[~left_out].reshape(-1, 3)
    sizes = np.minimum(np.round(np.abs(three) * (math.sqrt(2.0) * 511)), 511).astype(np.uint32)
    words = sizes | (three < 0).astype(np.uint32) << 9
    word = largest.astype(np.uint32) << 30 | words[:, 0] << 20 | words[:, 1] << 10 | words[:, 2]
    return word.astype("<u4").view(np.uint8).reshape(-1, 4)
