"""Writes Niantic's SPZ, version 3, which current viewers read; ``spz`` reads it back."""

import gzip
import math
import warnings
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.files import replacing
from splatrl.scenes.formats.spz import ANTIALIASED, COLOR_SCALE, HEADER, PIECE, Header
from splatrl.scenes.gaussians import Gaussians

VERSION = 3
FRACTIONAL_BITS = 12  # fractional bits of a position, as in other writers: a quarter of a millimetre
LARGEST = 2**23 - 1  # largest position in 24-bit signed fixed point
LOG_SCALE_STEPS, LEAST_LOG_SCALE = 16.0, -10.0
MOST_LOG_SCALE = 255 / LOG_SCALE_STEPS + LEAST_LOG_SCALE
COARSE = 0.25
"""Largest step of positions per longest standard deviation of the median Gaussian: rounding then moves a mean by at
most an eighth of it along each axis, which is too little to see."""
FEW = 1e-3
"""Largest fraction of Gaussians that may be left out."""
STRAY = 10.0
"""A stray Gaussian is this many times as far from the middle of the scene as 99 % of the others."""

Bytes = NDArray[np.uint8]


def write_spz(path: Path, gaussians: Gaussians, antialiased: bool = False) -> None:
    """Write Gaussians as SPZ, a fifth to a quarter of the size of a PLY file.

    The file is written atomically, and the same Gaussians give the same bytes. Positions are rounded to 1/4096
    (coarser beyond 2 km), log scales to 1/16, opacities and colours to 1/255 of their range, harmonics to 1/128, and
    rotations to 0.3°. Harmonics above degree 0 are clamped to ±1, and scales to the range from e^-10 to 379 units, with
    a warning that counts the Gaussians that are shrunk.

    The farthest Gaussian sets the step of all positions. If that is too coarse for the sizes of the others, a few stray
    ones are left out, with a warning that counts them; if the scene itself is that large, a warning states the step.

    Args:
        path: the file to write.
        gaussians: Gaussians in any frame.
        antialiased: whether they were trained with antialiasing, for viewers.

    Raises:
        ValueError: for values that are not finite, scales that are not above 0, or positions beyond what the format can
            store.
    """
    values = {
        name: getattr(gaussians, name).detach().cpu().double()
        for name in ("means", "quats", "scales", "opacities", "sh")
    }
    sizes = values["scales"].amax(1)
    values["scales"] = values["scales"].log()
    for name, value in values.items():
        if not value.isfinite().all():
            raise ValueError(f"{path}: {name}: expected values that are finite when stored, got non-finite ones")
    stray = _stray(values["means"], sizes)
    if stray.any():
        values = {name: value[~stray] for name, value in values.items()}
        warnings.warn(
            f"{path}: left out {int(stray.sum())} of {len(stray)} Gaussians, so far from the others that the positions "
            "of all would have been rounded more coarsely than their sizes allow",
            stacklevel=3,
        )
    _warn_of_size(path, values["scales"])
    count, bits = len(values["means"]), _fractional_bits(path, values["means"], sizes)
    header = Header(b"NGSP", VERSION, count, gaussians.sh_degree, bits, ANTIALIASED if antialiased else 0, 0)
    fixed = (values["means"] * 2.0**bits).round().to(torch.int32).numpy().astype("<i4")
    parts = [
        fixed.view(np.uint8).reshape(-1, 4)[:, :3],  # the lower 24 bits of each
        _bytes(255.0 * values["opacities"]),
        _bytes(255.0 * (COLOR_SCALE * values["sh"][:, 0] + 0.5)),
        _bytes(LOG_SCALE_STEPS * (values["scales"] - LEAST_LOG_SCALE)),
        _smallest_three(values["quats"]),
        _bytes(128.0 * values["sh"][:, 1:] + 128.0),
    ]
    with replacing(path) as stream, gzip.GzipFile("", "wb", fileobj=stream, mtime=0) as packed:
        packed.write(HEADER.pack(*header))
        for part in parts:
            content = np.ascontiguousarray(part).reshape(-1)
            for first in range(0, len(content), PIECE):  # Ctrl-C takes effect between pieces
                packed.write(content[first : first + PIECE].data)


def _warn_of_size(path: Path, log_scales: Tensor) -> None:
    """Warn if Gaussians are larger than the format can store, beyond rounding."""
    shrunk = int((log_scales.amax(1) > MOST_LOG_SCALE + 0.5 / LOG_SCALE_STEPS).sum())
    if shrunk:
        warnings.warn(
            f"{path}: {shrunk} of {len(log_scales)} Gaussians are shrunk to {math.exp(MOST_LOG_SCALE):.0f} units, the "
            "largest size that SPZ stores; write a PLY",
            stacklevel=4,
        )


def _fractional_bits(path: Path, means: Tensor, sizes: Tensor) -> int:
    """Return the most fractional bits with which all positions can be stored; warn if they are too few."""
    farthest = float(means.abs().max())
    bits = FRACTIONAL_BITS if farthest == 0.0 else min(FRACTIONAL_BITS, math.floor(math.log2(LARGEST / farthest)))
    if bits < 0:
        raise ValueError(f"{path}: means: expected at most {LARGEST:,} units from the origin, got {farthest:,.0f}")
    if bits < _bits_needed(sizes):
        warnings.warn(
            f"{path}: positions are rounded to {2.0**-bits:.2g} units, since Gaussians lie up to {farthest:.3g} units "
            f"from the origin, but half of them are smaller than {float(sizes.median()):.2g}; write a PLY, or subtract "
            "an offset first",
            stacklevel=4,
        )
    return bits


def _bits_needed(sizes: Tensor) -> int:
    """Return the fractional bits of positions that Gaussians of these sizes need: [N] longest standard deviations."""
    return min(FRACTIONAL_BITS, max(0, math.ceil(-math.log2(COARSE * float(sizes.median())))))


def _stray(means: Tensor, sizes: Tensor) -> Tensor:
    """Return which few Gaussians are too far away for the others to be stored finely enough: [N] bool.

    There are none if many are that far away, or if they are not far from the rest of the scene.
    """
    beyond = means.abs().amax(1) > LARGEST / 2.0 ** _bits_needed(sizes)
    if beyond.sum() <= FEW * len(means):
        away = (means - means.median(0).values).abs().amax(1)
        usual = away.kthvalue(math.ceil(0.99 * len(away))).values
        if (away[beyond] > STRAY * usual).all():
            return beyond
    return torch.zeros_like(beyond)


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
