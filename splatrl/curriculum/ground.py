"""The ground of a scene: the places where a body fits, and the ways between them."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.bodies import Box
from splatrl.collision.base import Checker
from splatrl.motions.base import PlannedMotion
from splatrl.native import _core
from splatrl.native.threads import threads_of

WAYS = np.array(
    [
        *[(1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)],
        *[(3, 1), (1, 3), (3, -1), (1, -3), (3, 2), (2, 3), (3, -2), (2, -3)],
    ]
)
"""Half of the 32 directions in which nodes are connected: a path across open ground is at most 1.3 % too long."""
MOST_NODES = 4_000_000
AT_ONCE = 2**16
"""Most states that are made at once: those of robots with physics are long."""


@dataclass(frozen=True, eq=False)
class Ground:
    """Grid nodes where a body fits at every heading, connected where it fits all the way from one to the other.

    Attributes:
        corner: [2] float64, x and y of the first node, metres.
        shape: number of nodes along x and y.
        cell: distance between neighbouring nodes, metres.
        open: [X · Y] bool, True for nodes of the largest connected component.
        ways: [X, Y] uint16, bit k tells whether the body fits all the way from a node to the one at ``WAYS[k]``.
        motion: the robot's motion, a module.
        checker: tells what the body touches.
    """

    corner: NDArray[np.float64]
    shape: tuple[int, int]
    cell: float
    open: NDArray[np.bool_]
    ways: NDArray[np.uint16]
    motion: PlannedMotion
    checker: Checker

    def __deepcopy__(self, memo: dict[int, Any]) -> "Ground":
        return self  # immutable

    def node(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the nodes nearest to places: [N, 2] metres -> [N]."""
        index = np.rint((places - self.corner) / self.cell).astype(np.int64).clip(0, np.array(self.shape) - 1)
        return index[:, 0] * self.shape[1] + index[:, 1]

    def place(self, nodes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the positions of nodes: [N] -> [N, 2] metres."""
        return self.corner + self.cell * np.stack(np.divmod(nodes, self.shape[1]), 1)

    def connected(self, places: Tensor) -> Tensor:
        """Return whether the nodes nearest to places [N, 2] are in the largest connected component: [N] bool."""
        return torch.from_numpy(self.open[self.node(places.double().cpu().numpy())]).to(places.device)

    def distances(self, nodes: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the distances from every node to some nodes, metres: [N] -> [N, X · Y].

        A node that is not open takes the distance of the nearest open one, plus the straight distance to that.
        """
        away, nearest = ndimage.distance_transform_edt(~self.open.reshape(self.shape), return_indices=True)
        metres = np.empty((len(nodes), self.open.size), np.float32)
        _core.find_geodesics(
            ways=self.ways,
            steps=WAYS,
            lengths=self.cell * np.hypot(*WAYS.T),
            goals=nodes,
            nearest=nearest[0].astype(np.int64) * self.shape[1] + nearest[1],
            away=self.cell * away,
            metres=metres,
            threads=threads_of(None),
        )
        return metres


def ground(
    motion: PlannedMotion, checker: Checker, cell: float, fits: Callable[[Tensor], Tensor] | None = None
) -> Ground:
    """Find where a body fits at every heading, and between which of these places when it faces the way it goes.

    A robot can then turn wherever a path leads it.

    Args:
        motion: defines where robots may be, and their poses there.
        checker: tells which poses and moves are free.
        cell: distance between neighbouring nodes, metres.
        fits: body_to_world [N, 4, 4] -> [N] bool, a further condition on where robots may be; None sets no condition.

    Raises:
        ValueError: if no place is free, or for a grid below 2 × 2 or above ``MOST_NODES`` nodes.
    """
    lower, upper = motion.region()[:, :2].double().cpu().numpy()
    x, y = (int(np.floor((high - low) / cell + 1e-6)) + 1 for low, high in zip(lower, upper, strict=True))
    if x < 2 or y < 2 or x * y > MOST_NODES:
        raise ValueError(f"task.cell: expected a cell size that gives 2 × 2 to {MOST_NODES:,} nodes, got {x} × {y}")
    shape = x, y
    index = np.stack(np.meshgrid(np.arange(x), np.arange(y), indexing="ij"), -1).reshape(-1, 2)

    def poses(index: NDArray[np.int64], yaw: float) -> Tensor:
        places = torch.from_numpy(np.insert(lower + cell * index, 2, yaw, 1))
        return torch.cat([motion.body_to_world(motion.nearest(some)) for some in places.split(AT_ONCE)])

    stand = poses(index, 0.0)
    free = ~checker.collides(stand)
    if isinstance(checker.body, Box):  # other bodies are round about z
        for turn in range(3):  # half a turn covers all headings of a box
            rows = free.nonzero().squeeze(1)
            before, after = (poses(index[rows.cpu()], part * math.pi / 3) for part in (turn, turn + 1))
            free[rows] = ~checker.sweeps(before, after)
    free_nodes = (free if fits is None else free & fits(stand)).cpu().numpy()
    if not free_nodes.any():
        (left, bottom), (right, top) = lower.tolist(), upper.tolist()
        raise ValueError(
            f"expected places where the robot fits at every heading, found none for x from {left:.3g} to {right:.3g} "
            f"and y from {bottom:.3g} to {top:.3g} m; try other task.motion.lower and upper, or a smaller robot.body"
        )
    ways = np.zeros(x * y, np.uint16)
    for bit, way in enumerate(WAYS):
        there = index + way
        inside = ((there >= 0) & (there < shape)).all(1)
        begin = np.flatnonzero(inside)
        end = there[begin, 0] * y + there[begin, 1]
        both = free_nodes[begin] & free_nodes[end]
        begin, end, yaw = begin[both], end[both], float(np.arctan2(way[1], way[0]))
        clear = ~checker.sweeps(poses(index[begin], yaw), poses(index[end], yaw)).cpu().numpy()
        ways[begin[clear]] |= np.uint16(1 << bit)
    connected = np.empty(shape, bool)
    _core.find_largest_part(ways.reshape(shape), WAYS, free_nodes.reshape(shape), connected)
    own = copy.deepcopy(motion)  # the task may move its own to another device
    return Ground(lower, shape, cell, connected.reshape(-1), ways.reshape(shape), own, checker)
