"""Exact collision checking in C++ on a bit grid and its distance field, thousands of poses at once."""

from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule
from splatrl.collision.displacement import checked_poses
from splatrl.collision.distances import DistanceField
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.rays import check_beams, check_reach, room_around
from splatrl.collision.voxel_grid import checked_points
from splatrl.native import _core
from splatrl.native.threads import threads_of


class Queries(Protocol):
    """Queries answered in C++, given the addresses of C-contiguous CPU memory; see ``_core.Collider``."""

    def collides(self, poses: int, out: int, count: int, threads: int, /) -> int: ...
    def free_fraction(self, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...
    def sweeps(self, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...
    def clearance(self, points: int, out: int, count: int, threads: int, /) -> int: ...


class NativeQueries:
    """The queries of a C++ checker, whether one grid answers them or several.

    Attributes:
        body: the body under test, in the body frame.
        threads: cores that a large batch is spread over.
        core: the C++ object that answers the queries.
    """

    body: Body
    threads: int
    core: Queries

    @torch.compiler.disable
    def collides(self, body_to_world: Tensor) -> Tensor:
        """Return whether the body touches a solid voxel at each pose; see ``Checker.collides``."""
        poses = _floats("body_to_world", body_to_world, (4, 4))
        hits = torch.empty(len(poses), dtype=torch.bool)
        if self.core.collides(poses.data_ptr(), hits.data_ptr(), len(poses), self.threads) >= 0:
            refuse(body_to_world=body_to_world)
        return _to_device_of(hits, body_to_world)

    @torch.compiler.disable
    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """Return the free fraction of each move, never beyond the first contact; see ``Checker.free_fraction``."""
        fraction = torch.empty(len(start), dtype=torch.float32)
        return self._move(self.core.free_fraction, start, end, fraction)

    @torch.compiler.disable
    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Return whether each move hits anything, ends included: [B] bool."""
        return self._move(self.core.sweeps, start, end, torch.empty(len(start), dtype=torch.bool))

    @torch.compiler.disable
    def clearance(self, points: Tensor) -> Tensor:
        """Return a lower bound on the distance to the nearest solid voxel; see ``DistanceField.clearance``."""
        places = _floats("points", points, (3,))
        metres = torch.empty(len(places), dtype=torch.float32)
        if self.core.clearance(places.data_ptr(), metres.data_ptr(), len(places), self.threads) >= 0:
            checked_points("points", points)
            raise ValueError("points: expected finite points and valid scene indices")
        return _to_device_of(metres, points)

    def _move(self, query: Callable[..., int], start: Tensor, end: Tensor, out: Tensor) -> Tensor:
        starts, ends = _floats("start", start, (4, 4)), _floats("end", end, (4, 4))
        check_pairs(starts, ends)
        if query(starts.data_ptr(), ends.data_ptr(), out.data_ptr(), len(starts), self.threads) >= 0:
            refuse(start=start, end=end)
        return _to_device_of(out, start)


class NativeChecker(NativeQueries):
    """Tests a box, a sphere or a capsule, at any rotation, against the voxels of an occupancy.

    Answers are the same as those of ``FclChecker`` on the same voxels, except for touches: anything within a
    micrometre is always a hit, whereas FCL's answer depends on the rounding of the pose. Everything outside the grid is
    free. The distance field settles most poses with one look-up; the others are tested against the voxels around them,
    column by column, on all separating axes at once. A move at a fixed orientation is tested exactly, as the solid that
    the body sweeps (a zonotope for a box). A move that turns is cut into parts; in each, the body keeps the orientation
    at the middle of the part and is grown by the largest displacement that this causes, at most a tenth of a voxel. So
    the test never misses a hit, but may report one where the body passes within 0.3 voxels.

    Tensors on the CPU are read and written in place; others are copied to the CPU and the answers back.

    Attributes:
        occupancy: the solid voxels.
        body: the body under test, in the body frame.
        threads: cores that a large batch is spread over.
        collider: the C++ collider of the body and the grid.
    """

    def __init__(self, occupancy: Occupancy, body: Body, threads: int | None = None) -> None:
        """Pack the grid and compute its distance field.

        Args:
            occupancy: the solid voxels.
            body: the body to test.
            threads: cores that a large batch is spread over, at most those that this process may use; None takes all
                of them.

        Raises:
            ValueError: for fewer than one thread.
        """
        self.occupancy = occupancy
        self.body = body
        self.threads = threads_of(threads)
        self.core = self.collider = collider(occupancy, body)

    def __reduce__(self) -> tuple[type["NativeChecker"], tuple[Occupancy, Body, int]]:
        return NativeChecker, (self.occupancy, self.body, self.threads)

    @torch.compiler.disable
    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Cast beams; see ``Checker.ranges``. The first call computes the free space around each voxel."""
        poses, ways = _floats("body_to_world", body_to_world, (4, 4)), _floats("beams", beams, (3,))
        check_beams(ways)
        check_reach(reach)
        metres = torch.empty(len(poses), len(ways), dtype=torch.float32)
        where = poses.data_ptr(), ways.data_ptr(), metres.data_ptr()
        if self._rays.ranges(*where, len(poses), len(ways), float(reach), self.threads) >= 0:
            refuse(body_to_world=body_to_world)
        return _to_device_of(metres, body_to_world)

    @cached_property
    def _rays(self) -> _core.RayCaster:
        grid = self.occupancy
        return _core.RayCaster(room=room_around(grid), corner=corner_of(grid), resolution=grid.resolution)


def collider(occupancy: Occupancy, body: Body) -> _core.Collider:
    """Pack the grid and compute its distance field."""
    half, half_length, radius = _dimensions(body)
    return _core.Collider(
        solid=occupancy.occupied,
        distance=DistanceField(occupancy).centers,
        corner=corner_of(occupancy),
        resolution=occupancy.resolution,
        half=half,
        half_length=half_length,
        radius=radius,
    )


def corner_of(occupancy: Occupancy) -> tuple[float, float, float]:
    """Return the lower corner of the grid, world, metres."""
    x, y, z = (key * occupancy.resolution for key in occupancy.origin_key)
    return x, y, z


def check_shape(name: str, values: Tensor, shape: tuple[int, ...]) -> None:
    """Refuse anything but a tensor [B, *shape].

    Raises:
        ValueError: names the argument, what was expected and what was given.
    """
    if not isinstance(values, Tensor):
        raise ValueError(f"{name}: expected a torch.Tensor, got {type(values).__name__}")
    if values.shape[1:] != shape or values.ndim != len(shape) + 1:
        raise ValueError(f"{name}: expected shape [B, {', '.join(map(str, shape))}], got {list(values.shape)}")


def check_pairs(starts: Tensor, ends: Tensor) -> None:
    """Refuse moves with different numbers of starts and ends, [B, 4, 4] each.

    Raises:
        ValueError: names both numbers.
    """
    if len(starts) != len(ends):
        raise ValueError(f"end: expected {len(starts)} poses, as many as in start, got {len(ends)}")


def refuse(**poses: Tensor) -> None:
    """Raise an error that names the first pose that is not rigid, and why it is not."""
    for name, values in poses.items():
        checked_poses(name, values.float())
    raise ValueError(f"{', '.join(poses)}: expected rigid poses and valid scene indices")


def _dimensions(body: Body) -> tuple[tuple[float, float, float], float, float]:
    """Return half extents, half the cylinder's length and the radius, metres; 0 for those that a body lacks."""
    if isinstance(body, Box):
        x, y, z = body.size
        return (0.5 * x, 0.5 * y, 0.5 * z), 0.0, 0.0
    if isinstance(body, Capsule):
        return (0.0, 0.0, 0.0), 0.5 * body.length, body.cap_radius
    return (0.0, 0.0, 0.0), 0.0, body.radius


def _floats(name: str, values: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Return the values as contiguous float32 on the CPU."""
    check_shape(name, values, shape)
    if values.dtype is torch.float32 and values.device.type == "cpu" and values.is_contiguous() and not values.is_neg():
        return values
    return values.detach().to("cpu", torch.float32).resolve_neg().contiguous()


def _to_device_of(values: Tensor, like: Tensor) -> Tensor:
    return values if like.device.type == "cpu" else values.to(like.device)
