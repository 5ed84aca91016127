"""Where a film was cut: the times at which another take begins, as in films that were joined or edited."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Floats = NDArray[np.float64]

SIZE = (16, 9)
"""Width and height of the patterns that are compared, pixels: so few that noise and a moving hand change little."""
UNLIKE, SUDDEN, AROUND = 0.2, 5.0, 3
"""Minimum difference between the two frames at a cut, and how many times the differences of the ``AROUND`` frames
before and after it must be. In films of one take, frames of fast turns differ by up to 0.6, but by at most 3 times as
much as those around them; two views of different places differ by 0.5 or more, and rarely by 0.3."""
LATE = 1.5
"""Maximum time between the two frames at a cut, in usual times from frame to frame; a longer one is a gap in a take."""


def coarse(grey: NDArray[np.uint8]) -> Floats:
    """Return a grey image [H, W] over ``SIZE`` pixels, [h, w]."""
    return np.asarray(Image.fromarray(grey).resize(SIZE, Image.Resampling.BOX), np.float64)


def pattern(grey: NDArray[np.uint8]) -> Floats:
    """Return the coarse pattern of a grey image [H, W] as a vector, of length 1 unless the image is of one grey.

    Brightness and contrast are left out: a camera that adapts to the light changes them from frame to frame.
    """
    small = coarse(grey).reshape(-1)
    small -= small.mean()
    return np.asarray(small / max(float(np.linalg.norm(small)), 1e-9))


def takes(seconds: Floats, cuts: Sequence[float]) -> NDArray[np.int64]:
    """Return the number of the take, from 0, to which each of some times [N] belongs, given the ``cuts`` between."""
    return np.searchsorted(np.asarray(cuts, np.float64), seconds, side="right")


def cuts(seconds: Sequence[float], patterns: Sequence[Floats]) -> list[float]:
    """Return the times at which another take begins: those of frames that suddenly differ from the frame before.

    People who pass, shakes and fast turns change several frames in a row, and are no cuts.

    Args:
        seconds: N times of the film's frames, ascending.
        patterns: the ``pattern`` of each.
    """
    if len(seconds) < 3:
        return []
    intervals, shown = np.diff(seconds), np.stack(patterns)
    unlike = 1.0 - (shown[1:] * shown[:-1]).sum(1)
    found = []
    for number in np.flatnonzero((unlike >= UNLIKE) & (intervals <= LATE * np.median(intervals))).tolist():
        around = np.delete(unlike[max(0, number - AROUND) : number + AROUND + 1], min(number, AROUND))
        if unlike[number] >= SUDDEN * around.max():
            found.append(float(seconds[number + 1]))
    return found
