"""Tells which way along the normal of floors is up."""

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.layers import Layer
from splatrl.scenes.storeys import Storeys

Floats = NDArray[np.float64]

SURE_FROM, LIKELY_FROM = 0.6, 0.3
"""Minimum evidence, of at most 1, from which a side is called fairly sure, and likely."""
_STANDING, _OPENING = 0.6, 0.5
"""Weights of what stands between floors and ceilings, and of what lies beyond the outermost ones. Pipes, ducts and
beams may hang in an empty hall, so what stands is never enough to be fairly sure."""
_NEAR = 0.15
"""Distance from the layer, in diagonals of the scene, within which the file's origin says nothing."""


def upper_side(heights: Floats, weights: Floats, layer: Layer, storeys: Storeys, size: float) -> tuple[float, str]:
    """Return evidence in −1 … 1 that up is the normal of a layer, not its opposite, and the strongest reason.

    Where there are several floors and ceilings, it is what stands and hangs in the storeys, and on which side the place
    is open. A single layer is ground: up is the side that things stand on or, if that is unclear, the side of the
    file's origin, which structure from motion puts near the cameras. Between floors and ceilings it says nothing.

    Args:
        heights: [N] heights of the Gaussians along the normal.
        weights: [N] weights of the Gaussians, summing to 1.
        layer: the main layer.
        storeys: the floors and ceilings along its normal.
        size: diagonal of the scene.
    """
    return _of_ground(heights, weights, layer, size) if len(storeys.levels) < 2 else _of_storeys(storeys)


def _of_ground(heights: Floats, weights: Floats, layer: Layer, size: float) -> tuple[float, str]:
    relative = heights - layer.height
    above, below = weights[relative > layer.thickness].sum(), weights[relative < -layer.thickness].sum()
    outside = above + below
    things = float(((above - below) / outside) ** 3) if outside > 0.01 else 0.0
    origin = -layer.height / size
    cameras = 0.5 * float(np.sign(origin)) if abs(origin) > _NEAR else 0.0
    if abs(things) < abs(cameras):
        reason = "the file's origin, usually near the cameras, is on that side; the rest of the scene says little"
    elif abs(things) > 0.01:
        reason = f"{max(above, below) / outside:.0%} of what lies outside the layer is on that side"
    else:
        reason = "the two sides cannot be told apart"
    return float(np.clip(things + cameras, -1, 1)), reason


def _of_storeys(storeys: Storeys) -> tuple[float, str]:
    standing, opening = _STANDING * storeys.standing, _OPENING * storeys.opening
    evidence = float(np.clip(standing + opening, -1, 1))
    if abs(evidence) <= LIKELY_FROM:
        reason = "little tells floors from ceilings"
    elif abs(opening) > abs(standing):
        reason = "the place is open on that side"
    else:
        reason = "more stands on that side of them than hangs from the other"
    return evidence, f"{len(storeys.levels)} flat layers lie above one another, and {reason}"
