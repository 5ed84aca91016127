"""How much of the free ground of a captured place steps along x and y reach, and where their lattice should lie."""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.collision.voxels import Voxels

Floats = NDArray[np.float64]
Keys = NDArray[np.int64]
Walk = tuple[tuple[float, float], tuple[float, float]]
"""Lower and upper corner [x, y] of where robots walk, metres."""

BODY = (0.4, 0.1)
"""Width and height of the body of ``task=grid``, metres."""
FEW = 0.1
"""Fraction of the free places that may be out of reach without a word, as in training."""
SHIFTS = (-0.4, -0.2, 0.0, 0.2, 0.4)
"""Shifts of the lattice along each axis that are tried, in steps. Fifths of a step are no whole numbers of voxels: a
lattice on the faces of voxels touches more of them."""
TOUCH = 1e-6
"""Distance, in voxels, up to which a body touches a voxel."""


@dataclass(frozen=True, eq=False)
class FreeGround:
    """The free ground of an area, on which the body of ``task=grid`` fits.

    Attributes:
        solid: [X + 1, Y + 1] int64, number of columns that are solid at the body's height before each corner.
        first_key: keys [2] along x and y of the column that is first in ``solid``.
        edge: edge of a column, metres.
        part: [U, V] bool, columns of the ground, in the middle of which the body fits.
        part_key: keys [2] of the column ``part[0, 0]``.
    """

    solid: NDArray[np.int64]
    first_key: Keys
    edge: float
    part: NDArray[np.bool_]
    part_key: Keys

    def out_of_reach(self, walk: Walk, step: float) -> float:
        """Return which fraction of the free places of a lattice steps do not reach from its largest connected part.

        Places and the ways between neighbours alternate in one grid, so that ``label`` finds the connected parts.

        Args:
            walk: corners of the lattice.
            step: distance between neighbouring places, metres.
        """
        lower, upper = np.array(walk)
        counts = np.round((upper - lower) / step).astype(int) + 1
        x, y = (low + step * np.arange(count) for low, count in zip(lower, counts, strict=True))
        grid = np.zeros((2 * len(x) - 1, 2 * len(y) - 1), bool)
        grid[::2, ::2] = self.fits(x, x, y, y) & self._within(x, y)
        grid[1::2, ::2] = self.fits(x[:-1], x[1:], y, y)
        grid[::2, 1::2] = self.fits(x, x, y[:-1], y[1:])
        sizes = np.bincount(ndimage.label(grid)[0][::2, ::2].reshape(-1))[1:]
        return float(1.0 - sizes.max() / sizes.sum()) if sizes.any() else float(self.part.any())

    def _within(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """Return which places are on the ground: [len(x), len(y)]."""
        rows, columns = (np.floor(at / self.edge + TOUCH).astype(np.int64) for at in (x, y))
        rows, columns = rows - self.part_key[0] + 1, columns - self.part_key[1] + 1
        padded = np.pad(self.part, 1)
        return padded[np.ix_(np.clip(rows, 0, len(padded) - 1), np.clip(columns, 0, padded.shape[1] - 1))]

    def fits(self, left: Floats, right: Floats, front: Floats, back: Floats) -> NDArray[np.bool_]:
        """Return whether a body fits all the way from ``left`` to ``right`` and ``front`` to ``back``: [X, Y]."""
        corners = []
        for axis, (low, high) in enumerate(((left, right), (front, back))):
            first = np.ceil((low - 0.5 * BODY[0]) / self.edge - TOUCH).astype(np.int64) - 1
            last = np.floor((high + 0.5 * BODY[0]) / self.edge + TOUCH).astype(np.int64)
            ends = np.stack([first, last + 1]) - self.first_key[axis]
            corners.append(np.clip(ends, 0, self.solid.shape[axis] - 1))
        (x0, x1), (y0, y1) = corners
        count = self.solid[np.ix_(x1, y1)] - self.solid[np.ix_(x0, y1)]
        empty: NDArray[np.bool_] = count == self.solid[np.ix_(x1, y0)] - self.solid[np.ix_(x0, y0)]
        return empty


def free_ground(solid: Voxels, height: float, walk: Walk, known: Floats) -> FreeGround:
    """Find the free ground of an area.

    Args:
        solid: what is solid.
        height: height of the middle of a robot's body, metres.
        walk: corners of the area.
        known: [N, 2] x and y of places that are known to be floor, metres; parts without any of them are left out.
    """
    edge, bottom = solid.resolution, solid.origin_key[2]
    low, high = height - 0.5 * BODY[1], height + 0.5 * BODY[1]
    layers = np.arange(math.ceil(low / edge - TOUCH) - 1, math.floor(high / edge + TOUCH) + 1) - bottom
    columns = solid.occupied[:, :, layers[(layers >= 0) & (layers < solid.occupied.shape[2])]].any(2)
    before = np.pad(columns, ((1, 0), (1, 0))).cumsum(0, dtype=np.int64).cumsum(1)
    first, last = np.floor(np.array(walk) / edge + TOUCH).astype(np.int64)
    x, y = ((np.arange(start, end + 1) + 0.5) * edge for start, end in zip(first, last, strict=True))
    anywhere = FreeGround(before, np.array(solid.origin_key[:2]), edge, np.ones((len(x), len(y)), bool), first)
    labels = ndimage.label(anywhere.fits(x, x, y, y))[0]
    index = np.floor(known / edge).astype(np.int64) - first
    index = index[((index >= 0) & (index < labels.shape)).all(1)]
    return replace(anywhere, part=(labels > 0) & np.isin(labels, labels[tuple(index.T)]))


def aligned(ground: FreeGround, walk: Walk, step: float) -> Walk:
    """Shift an area by a fraction of a step if its lattice then reaches considerably more, as through a doorway."""
    missed = ground.out_of_reach(walk, step)
    if missed <= FEW:
        return walk
    shifts = sorted(product(SHIFTS, SHIFTS), key=lambda by: (math.hypot(*by), by))
    shifted = [_shifted(walk, x * step, y * step) for x, y in shifts]
    shares = [ground.out_of_reach(each, step) for each in shifted]
    return shifted[int(np.argmin(shares))] if min(shares) < missed - FEW else walk


def remarks(ground: FreeGround, walk: Walk, step: float) -> list[str]:
    """Say how much of the ground is out of reach and what to type, in one sentence; in none where it is little."""
    share = ground.out_of_reach(walk, step)
    if share <= FEW:
        return []
    finer = next((part for part in (step / 2, step / 4) if ground.out_of_reach(walk, part) <= FEW), None)
    remedy = "a narrower robot.body may reach it" if finer is None else f"task.motion.step={finer:g} in training does"
    missed = f"{100 * share:.0f} % of the free floor cannot be reached in steps of {step:g} m"
    return [f"{missed} by a body {BODY[0]:g} m wide: {remedy}."]


def _shifted(walk: Walk, x: float, y: float) -> Walk:
    (left, front), (right, back) = walk
    return (round(left + x, 2), round(front + y, 2)), (round(right + x, 2), round(back + y, 2))
