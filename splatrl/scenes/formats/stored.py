"""Converts between stored values (logs and logits) and the activated ones of ``Gaussians``."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.scenes.gaussians import Gaussians, checked_gaussians

EDGE = 1e-9
"""Minimum distance of opacities from 0 and 1, so that logits are finite; in float32, 1 is still read back as 1."""

Floats = NDArray[np.float32]


def activated(
    source: object,
    means: Floats | NDArray[np.float64],
    quats: Floats,
    log_scales: Floats,
    opacity_logits: Floats,
    sh: Floats,
    smoothing: Floats | None = None,
) -> Gaussians:
    """Build Gaussians from the values that a file stores.

    The 3D smoothing filter of Mip-Splatting (Yu et al. 2024) convolves a Gaussian of scales s with one of standard
    deviation f: they become √(s² + f²), and the opacity is reduced by as much as that enlarges the volume.

    Args:
        source: origin of the values, for error messages.
        means: [N, 3], float64 if the file stores doubles.
        quats: [N, 4] wxyz, of any length.
        log_scales: [N, 3].
        opacity_logits: [N].
        sh: [N, K, 3].
        smoothing: [N, 1] standard deviation of the filter, in the unit of the means; None if there is none.
    """
    scales = torch.from_numpy(log_scales).double().exp()
    opacities = torch.from_numpy(opacity_logits).double().sigmoid()
    if smoothing is not None:
        smoothed = torch.hypot(scales, torch.from_numpy(smoothing).double().expand_as(scales))
        opacities = opacities * (scales / smoothed).prod(1)
        scales = smoothed
    return checked_gaussians(
        str(source),
        means=torch.from_numpy(means),
        quats=torch.from_numpy(quats),
        scales=scales,
        opacities=opacities,
        sh=torch.from_numpy(sh),
    )


def from_gsply(path: Path, decoded: Any) -> Gaussians:
    """Build Gaussians from gsply's output: log scales, opacity logits and harmonics [N, K, 3] above degree 0."""
    sh = np.concatenate([decoded.sh0[:, None, :], decoded.shN], 1)
    stored = (decoded.means, decoded.quats, decoded.scales, decoded.opacities, sh)
    return activated(path, *(np.ascontiguousarray(values, np.float32) for values in stored))


def opacity_logits(opacities: Tensor) -> Tensor:
    """Return the logits that a file stores for opacities [N] in [0, 1]: [N] float64, finite even for 0 and 1."""
    return opacities.double().clamp(EDGE, 1 - EDGE).logit()
