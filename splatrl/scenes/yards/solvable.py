"""Measures how hard a yard is for a robot, by a flood fill over its solid cells at the robot's size.

The measure is that of the grid task: poses on a lattice of 11 × 11 places and 16 headings, moves of 0.2 m along x and y
and turns by 22.5°, and a body of 0.4 × 0.4 m whose centre is 0.4 m above the ground.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.surfels import Surfels

Bools = NDArray[np.bool_]

CELL = 0.05
"""Edge of a cell, metres."""
SLAB = (0.31, 0.49)
"""Heights between which a thing blocks the body, metres: nearly a voxel more than the body's own on either side."""
HALF = 0.2
"""Half the width of the body, metres."""
REACH = 6
"""Cells from the centre of the body to beyond its corners."""
CORE = 1.0
"""Half width of the square that the lattice covers, metres."""
STEP = 4
"""Cells between neighbouring places of the lattice."""
HEADINGS = 16
HAIR = 0.01
"""Amount by which the body may be larger or smaller on each side in a steady yard, metres."""


@dataclass(frozen=True)
class Cells:
    """The cells that are solid at the height of the robots' bodies.

    Attributes:
        solid: [X, Y] bool mask of the solid cells.
        first: lower corner of cell (0, 0), in cells from the origin.
    """

    solid: Bools
    first: tuple[int, int]

    @classmethod
    def empty(cls, lower: tuple[float, float], upper: tuple[float, float]) -> "Cells":
        """Return the cells of a rectangle, all free."""
        first = (round(lower[0] / CELL), round(lower[1] / CELL))
        shape = (round(upper[0] / CELL) - first[0], round(upper[1] / CELL) - first[1])
        return cls(np.zeros(shape, bool), first)

    def fill(self, solid: Solid, pad: float, round_: bool = False) -> None:
        """Mark the cells that a box, or the ellipse in it, covers at least partly once grown by ``pad`` metres."""
        if solid.high[2] <= SLAB[0] or solid.low[2] >= SLAB[1]:
            return
        x, y = self._centers()
        half = np.subtract(solid.high, solid.low)[:2] / 2 + pad
        middle = np.add(solid.high, solid.low)[:2] / 2
        dx, dy = (np.maximum(np.abs(at - to) - CELL / 2 + 1e-6, 0.0) for at, to in zip((x, y), middle, strict=True))
        if round_:
            self.solid[:] |= (dx[:, None] / half[0]) ** 2 + (dy[None] / half[1]) ** 2 < 1
        else:
            self.solid[:] |= (dx < half[0])[:, None] & (dy < half[1])[None]

    def fill_surfels(self, part: Surfels, least: int) -> None:
        """Mark the cells that contain at least ``least`` surfels."""
        kept = (part.means[:, 2] > SLAB[0]) & (part.means[:, 2] < SLAB[1])
        index = np.floor(part.means[kept, :2] / CELL).astype(int) - self.first
        index = index[((index >= 0) & (index < self.solid.shape)).all(1)]
        counts = np.zeros(self.solid.shape, int)
        np.add.at(counts, tuple(index.T), 1)
        self.solid[:] |= counts >= least

    def _centers(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        x, y = (
            CELL * (first + np.arange(count) + 0.5) for first, count in zip(self.first, self.solid.shape, strict=True)
        )
        return x, y


@dataclass(frozen=True)
class Difficulty:
    """The difficulty of a yard.

    Attributes:
        blocked: fraction of the lattice's places where the body fits at no heading.
        longest: length of the shortest path to the goal from the farthest pose that is connected to it, steps.
        connected: fraction of the free poses from which the goal can be reached.
        open: fraction of the free ground of the whole yard that is connected to the goal for a round body.
        goal_free: whether the goal and all poses next to it are free.
        steady: whether a slightly larger or smaller body fits in the same places when parallel to the lattice.
    """

    blocked: float
    longest: int
    connected: float
    open: float
    goal_free: bool
    steady: bool


BLOCKED = (0.18, 0.30)
LONGEST = (22, 28)
"""Allowed ranges of ``blocked`` and ``longest``, around the backyard's own values of 0.27 and 24."""


def solvable(found: Difficulty) -> bool:
    """Return whether a yard is as hard as the backyard and solvable from every free pose."""
    (least, most), (nearest, farthest) = BLOCKED, LONGEST
    bounded = least <= found.blocked <= most and nearest <= found.longest <= farthest
    return bounded and found.goal_free and found.steady and found.connected == 1.0 and found.open > 0.97


@cache
def footprints(half: float = HALF) -> NDArray[np.float32]:
    """Return masks of the cells that a body centred on a grid corner covers: [8, 2·REACH, 2·REACH].

    There is one mask for each eighth of a quarter turn. A cell is covered if the square of the cell and that of the
    body overlap (separating axes).
    """
    centers = CELL * (np.arange(-REACH, REACH) + 0.5)
    x, y = np.meshgrid(centers, centers, indexing="ij")
    masks = []
    for turn in np.arange(8) * np.pi / 16:
        cos, sin = np.cos(turn), np.sin(turn)
        spread = cos + sin  # half extent of a turned square of half width 1
        near = (np.abs(x) < half * spread + CELL / 2 - 1e-9) & (np.abs(y) < half * spread + CELL / 2 - 1e-9)
        for u, v in ((cos, sin), (-sin, cos)):
            near &= np.abs(u * x + v * y) < half + spread * CELL / 2 - 1e-9
        masks.append(near)
    return np.array(masks, np.float32)


def free_places(cells: Cells, masks: NDArray[np.float32]) -> Bools:
    """Return whether bodies fit at each corner of the core's cells.

    Args:
        cells: solid cells of the yard.
        masks: [T, 2·REACH, 2·REACH] float32, the bodies' footprints; see ``footprints``.

    Returns:
        [41, 41, T] bool.
    """
    count = round(2 * CORE / CELL) + 1
    start = [round(-CORE / CELL) - first - REACH for first in cells.first]
    window = np.ascontiguousarray(
        cells.solid[start[0] : start[0] + count + 2 * REACH - 1, start[1] : start[1] + count + 2 * REACH - 1]
    )
    around = np.lib.stride_tricks.sliding_window_view(window, (2 * REACH, 2 * REACH)).astype(np.float32)
    assert around.shape[:2] == (count, count), (around.shape, cells)
    return np.einsum("ijkl,tkl->ijt", around, masks, optimize=True) < 0.5


def difficulty(cells: Cells, goal: tuple[float, float, float]) -> Difficulty:
    """Measure how hard a yard is.

    Args:
        cells: solid cells of the yard.
        goal: x and y in metres and yaw in degrees, a pose of the lattice.
    """
    fits = free_places(cells, np.concatenate([footprints(), *(footprints(HALF + hair)[:1] for hair in (-HAIR, HAIR))]))
    turns = np.arange(2 * HEADINGS) % 8
    at = fits[::STEP, ::STEP][..., turns]  # [11, 11, 32]
    free = at[..., ::2]
    sub = fits[..., turns[::2]]  # [41, 41, 16]
    along_x = np.stack([sub[k : k + 37 : STEP][:, ::STEP] for k in range(STEP + 1)]).all(0)  # [10, 11, 16]
    along_y = np.stack([sub[::STEP, k : k + 37 : STEP] for k in range(STEP + 1)]).all(0)
    turning = free & at[..., 1::2] & np.roll(free, -1, 2)  # from each heading to the next
    i, j = (round((value + CORE) / (STEP * CELL)) for value in goal[:2])
    h = round(goal[2] / (360 / HEADINGS))
    reached = np.zeros_like(free)
    reached[np.ix_(range(i - 1, i + 2), range(j - 1, j + 2), [(h + k) % HEADINGS for k in (-1, 0, 1)])] = True
    known, longest = reached & free, 0
    while True:
        grown = known.copy()
        grown[1:] |= known[:-1] & along_x
        grown[:-1] |= known[1:] & along_x
        grown[:, 1:] |= known[:, :-1] & along_y
        grown[:, :-1] |= known[:, 1:] & along_y
        grown |= np.roll(known & turning, 1, 2) | (np.roll(known, -1, 2) & turning)
        if (grown == known).all():
            break
        known, longest = grown, longest + 1
    return Difficulty(
        blocked=float((~free.any(2)).mean()),
        longest=longest,
        connected=float(known.sum() / max(free.sum(), 1)),
        open=_open(cells, goal),
        steady=bool((fits[::STEP, ::STEP, 8] == fits[::STEP, ::STEP, 9]).all()),
        goal_free=bool(free[reached].all()),
    )


def _open(cells: Cells, goal: tuple[float, float, float]) -> float:
    """Return the fraction of the free ground that is connected to the goal, for a disc that encloses the body."""
    apart = ndimage.distance_transform_edt(np.pad(~cells.solid, 1, constant_values=False))[1:-1, 1:-1]
    room = apart > 2**0.5 * HALF / CELL
    labels, _ = ndimage.label(room)
    there = labels[round(goal[0] / CELL) - cells.first[0], round(goal[1] / CELL) - cells.first[1]]
    return float((labels[room] == there).mean()) if there else 0.0


def place_near(cells: Cells, goal: tuple[float, float, float], rng: np.random.Generator) -> tuple[float, float]:
    """Choose a free place in the core to hang an object, well away from the goal if possible: x and y, metres."""
    apart = CELL * ndimage.distance_transform_edt(~cells.solid)
    places = np.round(0.1 * np.arange(-8, 9), 1)
    x, y = (grid.ravel() for grid in np.meshgrid(places, places, indexing="ij"))
    room = apart[np.round(x / CELL).astype(int) - cells.first[0], np.round(y / CELL).astype(int) - cells.first[1]]
    off = np.hypot(x - goal[0], y - goal[1])
    score = np.minimum(room, 0.45) + 0.1 * np.minimum(off, 0.8) + 0.08 * rng.random(len(x))
    best = int(score.argmax())
    return float(x[best]), float(y[best])
