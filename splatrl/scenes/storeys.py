"""Finds the floors and ceilings of a place, and tells them apart by what stands on floors."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.scenes.layers import ALIGNED

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

_CELLS = (6, 20)
"""Fewest and most cells per side of the place, seen from above."""
_CROWDED = 50
"""Mean number of Gaussians in a cell, unless it would need fewer or more cells."""
_BINS = 40
"""Bins of height; a flat surface lies in two of them."""
_APART = 6
"""Maximum number of bins between the flat surfaces of a level, such as a ceiling and the floor above it."""
_WIDE, _WIDE_AT_ENDS = 0.6, 0.35
"""Minimum ratios of a level's cells to those of the widest: worktops, shelves and galleries cover less. At the ends of
a place there are none of these, but furniture hides floors, and films miss parts of ceilings."""
_END = 4
"""Bins at either end of a place that belong to its end."""
_SHARED = 0.5
"""Minimum fraction of a level's cells that the next level covers, too: roofs and terraces cover none of the ground."""
_EVEN = 0.5
"""Minimum ratio of the least height of a storey to the greatest: worktops are nearer to the floor than ceilings."""
_HALVES = (0.15, 0.45), (0.55, 0.85)
"""Fractions of a storey's height between which things stand or hang; beyond them are its floor and its ceiling."""
_FEET = (0.05, 0.15), (0.85, 0.95)
"""Fractions between which things in a half reach the floor, or the ceiling, from which they hang."""
_FEW = (0.02, 0.05, 0.02)
"""Added to what is compared, so that few things say little: weight, fraction of the cells, weight."""
_OPEN = 0.1
"""Fraction of the weight beyond the outermost levels from which a place counts as open there."""


class Level(NamedTuple):
    """A wide flat layer.

    Attributes:
        height: median height of its flat surfaces along the normal.
        bottom: height that a twentieth of them do not reach, such as the ceiling below a slab.
        top: height that a twentieth of them exceed, such as the floor on a slab.
        cells: [cells] whether they cover a cell of the place, seen from above.
    """

    height: float
    bottom: float
    top: float
    cells: Mask


class Storeys(NamedTuple):
    """The levels of a place, which are wide flat layers above one another, and evidence of which way is up.

    Attributes:
        levels: the levels, ascending along the normal; floors and ceilings, if they are two or more.
        standing: evidence in −1 … 1 that up is the normal, from what stands and hangs between the levels.
        opening: evidence in −1 … 1 that up is the normal, from what lies beyond the outermost levels.
    """

    levels: list[Level]
    standing: float
    opening: float


def find_storeys(points: Floats, normals: Floats, weights: Floats, up: Floats) -> Storeys:
    """Find the levels of a place, and on which side of them things stand.

    The lower and the upper half of each storey are compared by the weight of what reaches its floor or its ceiling, by
    the cells that are filled in only one half (walls fill both), and by all that it holds. Flat surfaces tell nothing:
    the tops of cupboards on a wall are as flat as tables.

    Args:
        points: [N, 3] means of the Gaussians, in their own frame and unit.
        normals: [N, 3] normals of the Gaussians; their length, 0 to 1, is the flatness.
        weights: [N] weights of the Gaussians.
        up: [3] unit vector along which levels are sought; its sign is what ``standing`` and ``opening`` judge.
    """
    heights, flat = points @ up, np.abs(normals @ up) > ALIGNED
    ends = np.quantile(heights, [0.005, 0.995])
    across = points @ np.linalg.svd(up[None])[2][1:].T
    low, high = np.quantile(across, [0.01, 0.99], axis=0)
    side = int(np.clip(math.sqrt(len(points) / _CROWDED), *_CELLS))
    cells = np.floor((across - low) / np.maximum(high - low, 1e-12) * side).astype(np.int64)
    inside = ((cells >= 0) & (cells < side)).all(1)
    heights, flat, cells, weights = heights[inside], flat[inside], cells[inside] @ [1, side], weights[inside]
    levels = _levels(heights[flat], cells[flat], side**2, *ends)
    if not levels:
        return Storeys([], 0.0, 0.0)
    compared = np.zeros((2, len(_FEW)))
    for lower, upper in pairwise(levels):
        share = (heights - lower.top) / max(upper.bottom - lower.top, 1e-12)
        halves = [(share > start) & (share < end) for start, end in _HALVES]
        things = [
            half & _around(cells[(share > near) & (share < far)], side)[cells]
            for half, (near, far) in zip(halves, _FEET, strict=True)
        ]
        filled = [_covered(cells[own], side**2) for own in things]
        for own in range(2):
            alone = filled[own] & ~filled[1 - own]
            compared[own] += weights[things[own]].sum(), alone.mean(), weights[halves[own]].sum()
    standing = float(((compared[0] - compared[1]) / (compared.sum(0) + _FEW)).mean())
    least = _EVEN * max(np.diff([level.height for level in levels]), default=0.0)
    above, below = (
        _open(sign * (heights - end), flat, cells, weights, least)
        for sign, end in ((1.0, levels[-1].top), (-1.0, levels[0].bottom))
    )
    return Storeys(levels, standing, ((above - below) / max(above + below, _OPEN)) ** 3)


def _levels(heights: Floats, cells: Ints, count: int, low: float, high: float) -> list[Level]:
    """Return the levels among flat surfaces, by their heights [N] and cells [N], between the ends of a place."""
    bins = np.floor((heights - low) / max(high - low, 1e-12) * (_BINS - 1) + 0.5).astype(np.int64) + 1
    grid = np.zeros((_BINS + 2, count), bool)
    seen = (bins > 0) & (bins <= _BINS)
    grid[bins[seen], cells[seen]] = True
    wide = (grid[:-1] | grid[1:]).sum(1)  # of two bins, the second of which is one more than the index
    least = np.full(len(wide), _WIDE * wide.max())
    least[:_END] = least[-_END:] = _WIDE_AT_ENDS * wide.max()
    found = np.flatnonzero(wide >= np.maximum(1.0, least))
    levels = list[Level]()
    if not len(found):
        return levels
    for near in np.split(found, np.flatnonzero(np.diff(found) > _APART) + 1):
        widest = near[wide[near].argmax()]
        height = float(np.median(heights[(bins == widest) | (bins == widest + 1)]))
        within = (bins >= near[0]) & (bins <= near[-1] + 1)
        bottom, top = np.quantile(heights[within], [0.05, 0.95]).tolist()
        levels.append(Level(height, bottom, top, _covered(cells[within], count)))
    return _storeys(levels, low, high)


def _storeys(levels: list[Level], low: float, high: float) -> list[Level]:
    """Leave out levels that bound no storey with the next, since they lie beside it or too near to it."""
    while len(levels) > 1:
        gaps = np.diff([low, *(level.height for level in levels), high])
        wide = [int(level.cells.sum()) for level in levels]
        shared = [int((lower.cells & upper.cells).sum()) for lower, upper in pairwise(levels)]
        wrong = (gaps[1:-1] < _EVEN * gaps.max()) | (np.array(shared) < _SHARED * np.minimum(wide[:-1], wide[1:]))
        if not wrong.any():
            break
        first = int(wrong.argmax())
        del levels[first if wide[first] < wide[first + 1] else first + 1]
    return levels


def _open(beyond: Floats, flat: Mask, cells: Ints, weights: Floats, least: float) -> float:
    """Return the weight at distances above 0 beyond an outermost level [N], except where a flat surface closes it.

    What reaches no farther than ``least`` is no storey, as a pit in a floor, and counts 0.
    """
    far = float(np.quantile(beyond, 0.995))
    if far <= least:
        return 0.0
    closing = flat & (beyond > 0.5 * far)
    return float(weights[(beyond > 0.0) & ~np.isin(cells, cells[closing])].sum())


def _covered(cells: Ints, count: int) -> Mask:
    """Return which of all cells are among those given: [count]."""
    return np.bincount(cells, minlength=count) > 0


def _around(cells: Ints, side: int) -> Mask:
    """Return which of all cells are among those given or beside one: [side²]."""
    return ndimage.binary_dilation(_covered(cells, side**2).reshape(side, side), np.ones((3, 3))).ravel()
