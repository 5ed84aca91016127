"""Whether a film's scale is carried on from each part to the next.

The scale is carried past an image by the points whose distance follows from the images up to it, and again from the
images after it. Where there are hardly any, what was filmed later may have any scale, and nothing else shows it: such a
part agrees with itself, images and all.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # the process that runs COLMAP needs no PyTorch, whose import takes seconds
    from splatrl.capture.base import Reconstruction

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

APART = math.cos(math.radians(1.0))
"""Cosine of the minimum angle between two directions from which a point's distance follows."""
OWN = 0.05
"""Minimum fraction of the points whose distance must follow from each side: a few images at either end, or a camera
that has only turned so far, have no scale of their own."""
WEAK, TORN = 0.125, 0.01
"""Number of points that carry the scale, relative to the points that an image shows, below which it may be wrong, and
below which it is not carried on at all."""


def carried(places: Floats, points: Floats, seen_point: Whole, seen_by: Whole) -> Floats:
    """Return how well the scale is carried past each camera of a film.

    All cameras before and after count, however far away: where a film comes back to a place, its points carry the scale
    past everything in between.

    Args:
        places: [N, 3] positions of the cameras, in the order of the film, in any unit.
        points: [P, 3] points, in the same frame.
        seen_point: [T] index of the point in each observation of a point by a camera.
        seen_by: [T] index of the camera in each observation.

    Returns:
        [N] number of points that carry it, relative to the mean number of points that a camera sees; infinite where one
        side of the film has no scale of its own.
    """
    count = len(places)
    if not len(seen_point):
        return np.full(count, np.inf)
    order = np.lexsort((seen_by, seen_point))
    seen_point, seen_by = seen_point[order], seen_by[order]
    first = np.flatnonzero(np.diff(seen_point, prepend=-1))
    last = np.append(first[1:], len(seen_point)) - 1
    ray = points[seen_point] - places[seen_by]
    ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-12)

    def apart_from(ends: Whole) -> NDArray[np.bool_]:
        ends = np.repeat(ends, last - first + 1)
        return np.einsum("ij,ij->i", ray, ray[ends]) < APART

    early = np.minimum.reduceat(np.where(apart_from(first), seen_by, count), first)  # from here on, it has a distance
    late = np.maximum.reduceat(np.where(apart_from(last), seen_by, -1), first)  # up to here, it gets one again
    before, after, both = (
        np.cumsum(_starts(early, count)),
        np.cumsum(_starts(count - 1 - late, count))[::-1],
        np.cumsum(_starts(early[early <= late], count) - _starts(late[early <= late] + 1, count)),
    )
    own = np.minimum(before, after) >= OWN * len(first)
    return np.where(own, both * count / len(seen_point), np.inf)


def longest_stretch(ways: Floats) -> NDArray[np.bool_]:
    """Return the images of the longest stretch of a film along which its scale is carried on, [N] bool.

    Args:
        ways: the result of ``carried``.
    """
    stretch = np.cumsum(ways < TORN)  # an image past which it is not carried on begins the next one
    found: NDArray[np.bool_] = stretch == np.bincount(stretch).argmax()
    return found


def weakest(found: Reconstruction) -> tuple[float, float] | None:
    """Return when a film's scale is carried on worst, seconds, and how well; None where it is carried on well.

    Args:
        found: a reconstruction in any frame and unit.
    """
    if found.carried is None or found.seconds is None:
        return None
    row = int(found.carried.argmin())
    share = float(found.carried[row])
    return (float(found.seconds[row]), share) if share < WEAK else None


def _starts(numbers: Whole, count: int) -> Whole:
    """Return how often each number from 0 to ``count`` − 1 occurs; larger ones do not count."""
    return np.bincount(numbers[numbers < count], minlength=count)
