"""Collision checking on a GPU: the grid and arithmetic of ``NativeChecker``, with one kernel launch per query."""

import ctypes
from functools import cached_property

import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision.native import check_pairs, check_shape, collider, corner_of, refuse
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.rays import check_beams, check_reach, room_around
from splatrl.collision.voxel_grid import checked_points
from splatrl.device_faults import FaultFlag
from splatrl.native.cuda.kernels import CudaKernels, Load, uploaded

BLOCK_THREADS = 256
BLOCKS_A_MULTIPROCESSOR = 2
"""Resident blocks per multiprocessor for which the compiler must leave enough registers (``__launch_bounds__``)."""
_KINDS = (Box, Sphere, Capsule)
"""Body classes in the order of the C++ enum Shape::Kind."""
_WARP = 32
_MOST_AT_ONCE = 1024
"""Maximum queries that a block processes at once; equals MOST_OPEN of cuda/collide.cu."""
_MOST_BLOCKS = 2**16
_ALIGNED = 16
"""Bytes of a pose that one load reads, and therefore the alignment that a pose needs."""


def kernel_defines(body: Body) -> dict[str, int]:
    """Return the macros with which ``cuda/collide.cu`` is compiled for a body.

    Raises:
        ValueError: for anything other than a body.
    """
    if not isinstance(body, _KINDS):
        raise ValueError(f"body: expected a Box, a Sphere or a Capsule, got {body!r}")
    return {
        "BLOCK_THREADS": BLOCK_THREADS,
        "BLOCKS_A_MULTIPROCESSOR": BLOCKS_A_MULTIPROCESSOR,
        "BODY_KIND": _KINDS.index(type(body)),
    }


class _Grid(ctypes.Structure):
    """Mirrors the C++ struct ``Grid`` of collision_grid.h."""

    _fields_ = (
        ("size", ctypes.c_int * 3),
        ("words", ctypes.c_int),
        ("empty", ctypes.c_bool),
        ("resolution", ctypes.c_double),
        ("inverse", ctypes.c_double),
        ("corner", ctypes.c_double * 3),
        ("bits", ctypes.c_void_p),
        ("distance", ctypes.c_void_p),
    )


class _Shape(ctypes.Structure):
    """Mirrors the C++ struct ``Shape`` of collision_shape.h."""

    _fields_ = (
        ("kind", ctypes.c_int),
        ("half", ctypes.c_double * 3),
        *((name, ctypes.c_double) for name in ("half_length", "radius", "inner", "outer")),
    )


class _Queries(ctypes.Structure):
    """Mirrors the C++ struct ``Queries`` of cuda/collide.cu."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("start", "end", "hits", "fractions", "fault")),
        *((name, ctypes.c_int) for name in ("count", "at_once")),
    )


class _RayGrid(ctypes.Structure):
    """Mirrors the C++ struct ``RayGrid`` of rays.h."""

    _fields_ = (
        ("size", ctypes.c_int * 3),
        ("resolution", ctypes.c_double),
        ("inverse", ctypes.c_double),
        ("corner", ctypes.c_double * 3),
        ("room", ctypes.c_void_p),
    )


class _Beams(ctypes.Structure):
    """Mirrors the C++ struct ``Beams`` of cuda/collide.cu."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("poses", "ways", "fault")),
        *((name, ctypes.c_int) for name in ("along", "count")),
    )


class CudaChecker:
    """Gives the same answers as ``NativeChecker`` on a CUDA device, without synchronising with the host.

    One look-up in the distance field, and some points inside the body that may be solid, settle most poses, with one
    thread per pose; each of the others is searched by a warp of 32 threads, with one column of voxels per thread.
    Arithmetic is in double precision, as on the CPU; a row has the same answer alone and in any batch. Kernels are
    compiled once per machine, which takes seconds, and cached.

    Tensors on the device are read in place, and errors in them are recorded there: a pose that is not finite or not
    rigid counts as a hit (free fraction 0, clearance 0), and ``raise_faults`` reports it later. Tensors elsewhere are
    copied to the device and the answers back, and invalid ones are refused at once.

    Args:
        occupancy: the solid voxels.
        body: the body to test, in the body frame.
        device: a CUDA device.
        load: function that loads the kernels; None compiles them for ``device``.

    Attributes:
        occupancy: the solid voxels.
        body: the body under test.
        device: the device that answers queries.

    Raises:
        ValueError: for anything other than a body.
        ImportError: if the extra ``cuda`` is not installed.
    """

    def __init__(
        self,
        occupancy: Occupancy,
        body: Body,
        device: torch.device | str = "cuda",
        load: Load | None = None,
    ) -> None:
        defines = kernel_defines(body)
        self._kernels = load("collide", defines) if load else CudaKernels("collide", device, defines)
        self.occupancy, self.body, self.device = occupancy, body, self._kernels.device
        core = collider(occupancy, body)
        self._bits, self._distance = (uploaded(values, self.device) for values in (core.bits, core.distance))
        half, numbers = core.shape[:3], core.shape[3:]
        self._shape = _Shape(_KINDS.index(type(body)), half, *numbers)
        self._grid = _Grid(
            core.distance.shape,
            core.bits.shape[2],
            occupancy.count == 0,
            occupancy.resolution,
            1.0 / occupancy.resolution,
            corner_of(occupancy),
            self._bits.data_ptr(),
            self._distance.data_ptr(),
        )
        self._faults, self._faults_elsewhere = FaultFlag(self.device), FaultFlag(self.device)

    def __reduce__(self) -> tuple[type["CudaChecker"], tuple[Occupancy, Body, torch.device]]:
        return CudaChecker, (self.occupancy, self.body, self.device)

    def collides(self, body_to_world: Tensor) -> Tensor:
        """Return whether the body touches a solid voxel at each pose; see ``Checker.collides``."""
        return self._answers("find_hits", torch.bool, body_to_world=body_to_world)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """Return the free fraction of each move, never beyond the first contact; see ``Checker.free_fraction``."""
        return self._answers("follow_moves", torch.float32, start=start, end=end)

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Return whether each move hits anything, ends included: [B] bool."""
        return self._answers("follow_moves", torch.bool, start=start, end=end)

    @torch.compiler.disable
    def clearance(self, points: Tensor) -> Tensor:
        """Return a lower bound on the distance to the nearest solid voxel; see ``DistanceField.clearance``."""
        check_shape("points", points, (3,))
        places, faults = self._here(points), self._faults_for(points)
        metres = torch.empty(len(places), device=self.device)
        if len(places) > 0:
            blocks = min(-(-len(places) // BLOCK_THREADS), _MOST_BLOCKS)
            arguments = (self._grid, places, faults.flag, len(places), metres)
            self._kernels.launch("find_clearances", blocks, BLOCK_THREADS, *arguments)
        if faults is self._faults_elsewhere and faults.take() is not None:
            checked_points("points", points)
        return metres.to(points.device)

    @torch.compiler.disable
    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Cast beams, with one thread per beam; see ``Checker.ranges``. Beams of an invalid pose have range 0.

        The first call copies the ray caster's grid to the device.
        """
        check_shape("body_to_world", body_to_world, (4, 4))
        check_shape("beams", beams, (3,))
        poses, ways = self._here(body_to_world), self._here(beams)
        faults = self._faults_for(body_to_world, beams)
        check_reach(reach)
        if faults is self._faults_elsewhere:  # checking beams on the device would synchronise
            check_beams(beams)
        metres = torch.empty(len(poses), len(ways), device=self.device)
        if metres.numel() > 0:
            blocks = min(-(-metres.numel() // BLOCK_THREADS), _MOST_BLOCKS)
            rays = _Beams(poses.data_ptr(), ways.data_ptr(), faults.flag.data_ptr(), len(ways), len(poses))
            arguments = (self._rays, rays, ctypes.c_double(reach), metres)
            self._kernels.launch("find_ranges", blocks, BLOCK_THREADS, *arguments)
        if faults is self._faults_elsewhere and faults.take() is not None:
            refuse(body_to_world=body_to_world)
        return metres.to(body_to_world.device)

    @cached_property
    def _rays(self) -> "_RayGrid":
        room, resolution = room_around(self.occupancy), self.occupancy.resolution
        self._room = uploaded(room, self.device)
        height, *plane = room.shape
        sizes = (ctypes.c_int * 3)(*plane, height)
        return _RayGrid(sizes, resolution, 1.0 / resolution, corner_of(self.occupancy), self._room.data_ptr())

    def raise_faults(self) -> None:
        """Raise the faults recorded for poses and points since the last call; see ``Faulty``."""
        row = self._faults.take()
        if row is not None:
            raise ValueError(f"row {row}: expected finite numbers and, for a pose, an orthonormal rotation")

    @torch.compiler.disable
    def _answers(self, query: str, dtype: torch.dtype, **poses: Tensor) -> Tensor:
        """Answer a query about poses, or about moves given by their two end poses."""
        for name, values in poses.items():
            check_shape(name, values, (4, 4))
        here = [self._here(values) for values in poses.values()]
        check_pairs(here[0], here[-1])
        asked = next(iter(poses.values()))
        count, faults = len(asked), self._faults_for(*poses.values())
        answers = torch.empty(count, dtype=dtype, device=self.device)
        if count > 0:
            at_once = self._at_once(count)
            ends, at = (here[0].data_ptr(), here[-1].data_ptr()), answers.data_ptr()
            places = (at, None) if dtype is torch.bool else (None, at)
            queries = _Queries(*ends, *places, faults.flag.data_ptr(), count, at_once)
            blocks = min(-(-count // at_once), _MOST_BLOCKS)
            self._kernels.launch(query, blocks, BLOCK_THREADS, self._grid, self._shape, queries)
        if faults is self._faults_elsewhere and faults.take() is not None:
            refuse(**poses)
        return answers.to(asked.device)

    def _at_once(self, count: int) -> int:
        """Return queries per block: enough that its warps finish together, but few enough to occupy every block."""
        share = -(-count // (BLOCKS_A_MULTIPROCESSOR * self._kernels.multiprocessors))
        return min(-(-share // _WARP) * _WARP, _MOST_AT_ONCE)

    def _here(self, values: Tensor) -> Tensor:
        """Return the values as contiguous float32 on the device, aligned for 16-byte loads."""
        floats = values.detach().to(self.device, torch.float32).contiguous()
        return floats if floats.data_ptr() % _ALIGNED == 0 else floats.clone()

    def _faults_for(self, *values: Tensor) -> FaultFlag:
        return self._faults if all(value.device == self.device for value in values) else self._faults_elsewhere
