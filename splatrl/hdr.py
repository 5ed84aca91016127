"""Convert films of high dynamic range, which phones make unless told not to, to the colours of any other film.

The brightness of paper, 75 % of HLG's signal and 203 nits of PQ's, becomes white (ITU-R BT.2408); anything brighter is
clipped. The primaries of BT.2020 become those of sRGB (BT.2087).
"""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

PQ, HLG = 16, 18
"""FFmpeg's numbers of transfer functions."""
PAPER = 203.0
"""Luminance of white paper, nits."""
GAMMA = 2.2
"""Gamma exponent between stored values and linear light, close enough to sRGB's."""
STEPS = 2**16
"""Number of brightnesses that are told apart, as many as the darkest of the 256 levels need."""
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
    stored = np.asarray(image.convert("RGB"))
    # in single precision and by tables, since films have millions of pixels in each frame
    seen = np.take((STEPS - 1) * light.astype(np.float32), stored).reshape(-1, 3) @ TO_SRGB.T.astype(np.float32)
    shown = (255.0 * (np.arange(STEPS) / (STEPS - 1)) ** (1.0 / GAMMA)).round().astype(np.uint8)
    return Image.fromarray(np.take(shown, np.clip(seen, 0, STEPS - 1).astype(np.uint16)).reshape(stored.shape))


def _hlg(signal: Floats) -> Floats:
    """Return linear light from HLG's signal, both from 0 to 1 (ITU-R BT.2100, table 5)."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(signal <= 0.5, signal**2 / 3.0, (np.exp((signal - c) / a) + b) / 12.0)


def _pq(signal: Floats) -> Floats:
    """Return nits from PQ's signal, from 0 to 1 (ITU-R BT.2100, table 4)."""
    root = signal ** (32.0 / 2523.0)
    return 10_000.0 * (np.maximum(root - 0.8359375, 0.0) / (18.8515625 - 18.6875 * root)) ** (16384.0 / 2610.0)
