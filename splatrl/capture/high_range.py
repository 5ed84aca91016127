"""Convert films of high dynamic range, which phones make unless told not to, to the colours of any other film.

The brightness of paper, 75 % of HLG's signal and 203 nits of PQ's, becomes white (ITU-R BT.2408); anything brighter is
clipped. The primaries of BT.2020 become those of sRGB (BT.2087).
"""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from splatrl.evaluation.walk_looks import GAMMA

UNKNOWN, PQ, HLG = 2, 16, 18
"""FFmpeg's numbers of transfer functions."""
PAPER = 203.0
"""Luminance of white paper, nits."""
TO_SRGB = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])

Floats = NDArray[np.float64]


def usual_range(image: Image.Image, transfer: int) -> Image.Image:
    """Convert an RGB image to standard dynamic range and the primaries of sRGB.

    Args:
        image: the image as decoded.
        transfer: FFmpeg's number of the film's transfer function; an image with any but PQ and HLG is returned
            unchanged.
    """
    if transfer not in (PQ, HLG):
        return image
    levels = np.arange(256) / 255.0
    light = (_hlg(levels) / _hlg(np.array(0.75))) if transfer == HLG else _pq(levels) / PAPER
    seen = light[np.asarray(image.convert("RGB"))] @ TO_SRGB.T
    return Image.fromarray((255.0 * np.clip(seen, 0.0, 1.0) ** (1.0 / GAMMA)).round().astype(np.uint8))


def _hlg(signal: Floats) -> Floats:
    """Return linear light from HLG's signal, both from 0 to 1 (ITU-R BT.2100, table 5)."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(signal <= 0.5, signal**2 / 3.0, (np.exp((signal - c) / a) + b) / 12.0)


def _pq(signal: Floats) -> Floats:
    """Return nits from PQ's signal, from 0 to 1 (ITU-R BT.2100, table 4)."""
    root = signal ** (32.0 / 2523.0)
    return 10_000.0 * (np.maximum(root - 0.8359375, 0.0) / (18.8515625 - 18.6875 * root)) ** (16384.0 / 2610.0)
