"""Collision checking with the Flexible Collision Library (Pan et al. 2012): the exact reference for other checkers."""

from typing import Any

import fcl
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision.displacement import Displacement, checked_poses
from splatrl.collision.distances import DistanceField
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.octree import encode_octree
from splatrl.collision.rays import ranges_by_formula
from splatrl.values import require_number

_SLACK = 1e-5
"""Gap to the nearest voxel, metres, beyond which a body is free without asking FCL: far above rounding error."""


class FclChecker:
    """Tests a box, a sphere or a capsule against OctoMap octrees of the occupancy, by default a single octree.

    FCL tests poses one by one, which takes some microseconds each; before that, the distance field settles the poses
    that are clear of everything, which never changes an answer. A touch counts as a hit. A move is tested in steps in
    which no point of the body travels more than half a voxel (``Displacement``), so the test may miss a body that
    grazes a voxel's edge by less than that; the answer is the same in both directions. A checker may be used by one
    thread only; copies and pickles build their own octrees.

    Attributes:
        occupancy: the solid voxels.
        body: the body under test, in the body frame.
        blocks: edge of the base voxels that each have their own octree, metres; None for one octree of everything.
    """

    def __init__(self, occupancy: Occupancy, body: Body, blocks: float | None = None) -> None:
        """Build the octrees.

        Args:
            occupancy: the solid voxels, with keys within ±32768.
            body: the body to test.
            blocks: None for one octree, which is fastest; a length in metres for the published layout: one octree for
                each non-empty base voxel of that edge, tested in turn. The answers are the same.

        Raises:
            ValueError: for a voxel outside the range of the octree's keys, or blocks that are not finite metres above
                0.
        """
        if blocks is not None:
            require_number("blocks", blocks, above=0.0, unit="metres")
        self.occupancy = occupancy
        self.body = body
        self.blocks = blocks
        self._field = DistanceField(occupancy)
        self._request = fcl.CollisionRequest()
        self._body_object = fcl.CollisionObject(fcl_shape(body))
        self._octrees = fcl_octrees(occupancy, blocks)

    def __reduce__(self) -> tuple[type["FclChecker"], tuple[Occupancy, Body, float | None]]:
        return FclChecker, (self.occupancy, self.body, self.blocks)

    @torch.compiler.disable
    def collides(self, body_to_world: Tensor) -> Tensor:
        """Return whether the body touches a solid voxel at each pose; see ``Checker.collides``."""
        poses = checked_poses("body_to_world", body_to_world).numpy()
        hits = torch.zeros(len(poses), dtype=torch.bool)
        for row in self._near(poses):
            hits[row] = self._hit(poses[row])
        return hits.to(body_to_world.device)

    @torch.compiler.disable
    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """Return the fraction of each move up to its last free step; see ``Checker.free_fraction``.

        It is 0 where the body touches something at the start, and 1 where it is free all the way, the end included.
        """
        move = Displacement(
            checked_poses("start", start),
            checked_poses("end", end),
            self.body.radius,
            0.5 * self.occupancy.resolution,
        )
        rows = torch.arange(len(move.steps)).repeat_interleave(move.steps + 1)
        index = torch.arange(len(rows)) - (move.steps + 1).cumsum(0)[rows] + move.steps[rows] + 1
        poses = move.at(rows, index).numpy()
        first: dict[int, int] = {}  # row of a move -> index of its first pose that hits
        for near in self._near(poses):
            row = int(rows[near])
            if row not in first and self._hit(poses[near]):
                first[row] = int(index[near])
        fraction = torch.ones(len(move.steps))
        for row, step in first.items():
            fraction[row] = max(step - 1, 0) / move.steps[row]
        return fraction.to(start.device)

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Return whether each move hits anything, ends included: [B] bool."""
        return self.free_fraction(start, end) < 1.0

    @torch.compiler.disable
    def clearance(self, points: Tensor) -> Tensor:
        """Return a lower bound on the distance to the nearest solid voxel; see ``DistanceField.clearance``."""
        return torch.from_numpy(self._field.clearance(points)).float().to(points.device)

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Cast beams by testing every solid voxel; see ``ranges_by_formula``."""
        return ranges_by_formula(self.occupancy, body_to_world, beams, reach)

    def _near(self, poses: NDArray[np.float64]) -> list[int]:
        """Return the rows of poses [M, 4, 4] that FCL has to test."""
        return np.flatnonzero(self._field.clearance(poses[:, :3, 3]) <= self.body.radius + _SLACK).tolist()

    def _hit(self, pose: NDArray[np.float64]) -> bool:
        """Return whether the body touches something at a rigid pose [4, 4]."""
        self._body_object.setTranslation(pose[:3, 3])
        self._body_object.setRotation(pose[:3, :3])
        return any(
            fcl.collide(self._body_object, octree, self._request, fcl.CollisionResult())  # reused results keep hits
            for octree in self._octrees
        )


def fcl_shape(body: Body) -> Any:
    """Convert a body to FCL geometry."""
    match body:
        case Box():
            return fcl.Box(*body.size)
        case Sphere():
            return fcl.Sphere(body.radius)
        case Capsule():
            return fcl.Capsule(body.cap_radius, body.length)


def fcl_octrees(occupancy: Occupancy, blocks: float | None = None) -> list[Any]:
    """Build FCL octrees of the solid voxels: one, or one for each block of that edge (metres) that holds voxel centres.

    If nothing is solid the list is empty, because FCL takes an octree without nodes for a solid one.
    """
    if occupancy.count == 0:
        return []
    parts = [occupancy]
    if blocks is not None:
        keys = occupancy.keys()
        block = np.floor((keys + 0.5) * occupancy.resolution / blocks).astype(np.int64)
        _, number = np.unique(block, axis=0, return_inverse=True)
        order = np.argsort(number.reshape(-1), kind="stable")
        ends = np.cumsum(np.bincount(number.reshape(-1)))[:-1]
        parts = [Occupancy.from_keys(part, occupancy.resolution) for part in np.split(keys[order], ends)]
    return [fcl.CollisionObject(_octree(part)) for part in parts]


def _octree(occupancy: Occupancy) -> Any:
    stream = encode_octree(occupancy)
    try:
        return fcl.OcTree(occupancy.resolution, stream)
    except OverflowError:  # C's char is unsigned here, as on ARM
        return fcl.OcTree(occupancy.resolution, stream.view(np.uint8))
