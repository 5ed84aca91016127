"""Whether images show all directions, as 360° cameras do: no pinhole camera explains them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from splatrl.capture.videos import shrunk
from splatrl.images import read_photo

SHAPES = 1.98, 2.02
"""Ratios of width to height that images of 360° cameras have; so have those of a few phones."""
LONGEST = 960
VARIED = 1.0
"""Minimum mean deviation of an edge from its mean, grey levels."""
ALIKE, MOST = 0.5, 0.9
"""Maximum difference of the left edge of an image from its right, relative to that of columns apart, and the minimum
fraction of images in which it is as small: in a 360° film it is 0.06 to 0.16, in others most often above 0.7."""


def around(paths: Sequence[Path], size: tuple[int, int]) -> bool:
    """Return whether images show all directions: the right edge of each continues at its left.

    Args:
        paths: some images of one size.
        size: their width and height, pixels.
    """
    if not SHAPES[0] <= size[0] / size[1] <= SHAPES[1] or not paths:
        return False
    return float(np.mean([_closed(read_photo(path)) for path in paths])) >= MOST


def _closed(image: Image.Image) -> bool:
    """Return whether the left edge of an image differs much less from its right than columns apart do."""
    grey = np.asarray(shrunk(image, LONGEST).convert("L"), np.float64)
    last = grey.shape[1] - 1
    apart = [_between(grey, 0, part * last // 4) for part in (1, 2, 3)]
    apart.append(_between(grey, last // 8, last - last // 8))  # in a corridor, its sides are alike, too
    within = float(np.abs(grey[:, 0] - grey[:, 0].mean()).mean())  # bars of one colour say nothing
    return within >= VARIED and _between(grey, 0, last) < ALIKE * min(within, *apart)


def _between(grey: np.ndarray, first: int, second: int) -> float:
    """Return the mean difference of two columns of an image, grey levels."""
    return float(np.abs(grey[:, first] - grey[:, second]).mean())
