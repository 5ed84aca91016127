"""The renderer for GPUs: thousands of small images in one launch, exact or with level of detail."""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.device_faults import FaultFlag
from splatrl.native.cuda.kernels import CudaKernels, Kernels, Load
from splatrl.native.cuda.turns import Turns
from splatrl.renderers.base import RenderOutput, checked_background, checked_only, models_of
from splatrl.renderers.cuda_models import MOST_INDICES, CudaModels, Packer
from splatrl.renderers.cuda_parts import MOST_PARTS, CudaParts, require_few_parts_of
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene

BLOCK_THREADS = 256
"""Threads per block; a block draws one tile at a time."""
SHARED_KIB = {"draw_pixels": 49, "draw_images": 60}
"""Shared memory per block by kernel, KiB: a multiprocessor of a graphics card has 100, and needs 1 more per block."""
TILE = 32
"""Width and height of a tile, pixels."""


def kernel_defines(antialiased: bool, sh_degree: int, levels: bool, parts: bool = False) -> dict[str, int]:
    """Return the macros that ``cuda/render.cu`` is compiled with.

    Args:
        antialiased: True for antialiased images, False for classic ones.
        sh_degree: degree of the spherical harmonics.
        levels: whether there are merged Gaussians, as there are with a tolerance above 0.
        parts: whether rows draw parts; otherwise they draw the first model in its own frame.
    """
    return {
        "ANTIALIASED_IMAGES": int(antialiased),
        "LEVELS_OF_DETAIL": int(levels),
        "SH_DEGREE": sh_degree,
        "MOST_PARTS": MOST_PARTS if parts else 0,
        "BLOCK_THREADS": BLOCK_THREADS,
        "SHARED_BYTES": shared_bytes("draw_pixels", parts),
        "SHARED_BYTES_WITH_DEPTH": shared_bytes("draw_images", parts),
    }


def shared_bytes(kernel: str, parts: bool) -> int:
    """Return the shared memory of a block in bytes; the offsets of a row's parts take half a KiB of it."""
    return 1024 * (SHARED_KIB[kernel] + int(parts))


LEAST_KEYS = 2**15
"""Minimum number of a tile's candidates that every block has room for: half a megabyte."""


class _Views(ctypes.Structure):
    """``Views`` of cuda/tile.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("camera_to_world", "K", "only", "places")),
        *((name, ctypes.c_int) for name in ("batch", "width", "height", "parts")),
    )


class _Workspace(ctypes.Structure):
    """``Workspace`` of cuda/tile.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("keys", "nodes", "next_tile", "chosen", "left", "fault", "efforts")),
        ("key_capacity", ctypes.c_int),
        ("node_capacity", ctypes.c_int),
    )


class _Images(ctypes.Structure):
    """``Images`` of cuda/tile.h."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("pixels", "rgb", "depth", "alpha"))


class _Working(NamedTuple):
    """Working memory of thread blocks.

    Attributes:
        keys: int64, enough for [blocks, 2, key_capacity] and for [1, 2, most_keys].
        nodes: [blocks, 3, node_capacity] int32.
        key_capacity: keys that each block has room for while all blocks are running.
        most_keys: the most keys that a tile can need; only a few blocks at a time have room for as many.
    """

    keys: Tensor
    nodes: Tensor
    key_capacity: int
    most_keys: int

    @property
    def few_blocks(self) -> int:
        """Number of blocks that can run at a time if each is to have room for any tile."""
        return min(len(self.nodes), len(self.keys) // (2 * self.most_keys))


class CudaRenderer:
    """Renders the same images as ``NativeRenderer`` on a CUDA device, without synchronising with the host.

    A thread block draws a tile of 32×32 pixels from start to finish: it descends the trees over the models, sorts the
    candidates by depth, one slab at a time in shared memory, and blends each slab into the pixels. A frame has the same
    bytes alone and in any batch. Kernels are compiled once per machine, within seconds, and cached. One difference
    remains: with level of detail, the CPU draws what is partly occluded more coarsely, so one byte in 1,000 may differ
    by more than a grey level.

    A camera whose pose is not rigid, or whose K has skew or a focal length that is not positive, gives a black image. A
    part whose pose is not rigid, or whose model does not exist, shows nothing; a row whose parts together have too many
    Gaussians shows the background. ``raise_faults`` reports all three. A row has at most 128 parts, with at most 2²⁸
    Gaussians in all, merged ones included. A ``BlockScene`` is a single model, kept on the device in full: its blocks
    are each drawn at their own levels of detail, as ``BlockRenderer`` draws them.

    Args:
        scene: a scene, in blocks or not, whose levels of detail are kept in its cache; or Gaussians; or several such
            models, which ``Parts.model`` indexes. Values are copied.
        antialiased: preserve the energy of Gaussians smaller than a pixel; False renders classic 3DGS images.
        background: colour behind the Gaussians, in [0, 1].
        tolerance: pixels by which level of detail may displace what is shown; 0 renders every Gaussian.
        device: a CUDA device.
        memory: upper bound on working memory, bytes; None means a quarter of the device's memory. With less memory,
            more tiles have too many candidates for most thread blocks and are drawn later, by the few blocks that have
            room. Enough for the most candidates that a tile can have, 16 bytes per Gaussian, is always allocated.
        most_gaussians: upper bound on the Gaussians of a row's parts together, merged ones not counted. A tile can have
            at most this many candidates, or M times the Gaussians of the largest model if that is less, since the host
            does not read which models the M parts refer to.
        load: function that loads the kernels; None compiles them for ``device``.

    Raises:
        ValueError: for Gaussians that are not finite or too many, or a tolerance that is negative or not finite.
        ImportError: if the extra ``cuda`` is not installed.
    """

    def __init__(
        self,
        scene: Scene | Gaussians | Sequence[Scene | Gaussians],
        antialiased: bool = True,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        tolerance: float = 0.0,
        device: torch.device | str = "cuda",
        memory: int | None = None,
        most_gaussians: int = MOST_INDICES,
        load: Load | None = None,
    ) -> None:
        if not 1 <= most_gaussians <= MOST_INDICES:
            raise ValueError(f"most_gaussians: expected a number from 1 to {MOST_INDICES:,}, got {most_gaussians:,}")
        packer = Packer(models_of(scene), antialiased, checked_background(background), tolerance)
        self._load = load or (lambda source, defines: CudaKernels(source, device, defines))
        self._exact = tolerance == 0
        self._settings = antialiased, packer.sh_degree, not self._exact
        self._kernels = self._load("render", kernel_defines(*self._settings))
        self._parts: tuple[Kernels, CudaParts] | None = None  # loaded when first needed
        self.device = self._kernels.device
        self._models = CudaModels(packer, self.device)
        self._most_gaussians = most_gaussians
        self._memory = self._kernels.memory // 4 if memory is None else memory
        self._faults = FaultFlag(self.device)
        self._working: dict[int | None, _Working] = {}  # by the number of parts; successive launches share it
        self._turns = Turns(self.device)

    @torch.compiler.disable
    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Render colour, depth and alpha for each camera, float32, on the cameras' device; see ``Renderer``."""
        shape = (len(cameras), cameras.height, cameras.width)
        rgb, depth, alpha = self._zeros(*shape, 3), self._zeros(*shape), self._zeros(*shape)
        images = _Images(None, rgb.data_ptr(), depth.data_ptr(), alpha.data_ptr())
        self._draw("draw_images", cameras, parts, only, images)
        where = cameras.camera_to_world.device
        return RenderOutput(rgb.to(where), depth.to(where), alpha.to(where))

    @torch.compiler.disable
    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """Render the pixels of an observation: [B, H, W, 3] uint8, on the cameras' device; see ``Renderer``."""
        pixels = self._zeros(len(cameras), cameras.height, cameras.width, 3, dtype=torch.uint8)
        self._draw("draw_pixels", cameras, parts, only, _Images(pixels.data_ptr(), None, None, None))
        return pixels.to(cameras.camera_to_world.device)

    @torch.compiler.disable
    def efforts(self, cameras: Cameras, parts: Parts | None = None) -> Tensor:
        """Measure the work that each view takes, by drawing it: [B, 3] int32.

        The columns count the candidates of its tiles, those among them that are visible, and the pairs of a Gaussian
        and a cell of 4×2 pixels that were blended.
        """
        efforts = self._zeros(len(cameras), 3, dtype=torch.int32)
        pixels = self._zeros(len(cameras), cameras.height, cameras.width, 3, dtype=torch.uint8)
        self._draw("draw_pixels", cameras, parts, None, _Images(pixels.data_ptr(), None, None, None), efforts)
        return efforts.to(cameras.camera_to_world.device)

    def raise_faults(self) -> None:
        """Raise an error for the faults in cameras and parts that were recorded since the last call; see ``Faulty``."""
        row = self._faults.take()
        if row is not None:
            raise ValueError(
                f"cameras[{row}]: expected rigid camera_to_world and K with positive focal lengths and no skew"
            )
        if self._parts is not None:
            self._parts[1].raise_faults()

    def _draw(
        self,
        kernel: str,
        cameras: Cameras,
        parts: Parts | None,
        only: Tensor | None,
        images: _Images,
        efforts: Tensor | None = None,
    ) -> None:
        """Queue the drawing. Tensors may be freed before it is done, since only this stream reuses their memory."""
        if len(cameras) == 0:
            return
        if parts is not None:
            require_few_parts_of(parts, cameras)
        poses, K = (self._here(value, torch.float32) for value in (cameras.camera_to_world, cameras.K))
        mask = None if only is None else self._here(checked_only(only, cameras), torch.bool)
        kernels = self._kernels if parts is None else self._for_parts()[0]
        places = None if parts is None else self._for_parts()[1].places(poses, parts, mask)
        working = self._working_for(parts)
        numbers = (len(cameras), cameras.width, cameras.height, 0 if parts is None else parts.model.shape[1])
        views = _Views(*(_address(value) for value in (poses, K, mask, places)), *numbers)
        tiles = len(cameras) * -(-cameras.height // TILE) * -(-cameras.width // TILE)
        left = self._zeros(1 + tiles, dtype=torch.int32) if working.key_capacity < working.most_keys else None

        shared = shared_bytes(kernel, parts is not None)

        def launch(
            kernel: str,
            output: _Images | Tensor,
            blocks: int = len(working.nodes),
            room: int = working.key_capacity,
            chosen: Tensor | None = None,
            left: Tensor | None = None,
        ) -> None:
            next_tile = self._zeros(1, dtype=torch.int32)
            memory = (working.keys, working.nodes, next_tile, chosen, left, self._faults.flag, efforts)
            addresses = (_address(part) for part in memory)
            workspace = _Workspace(*addresses, room, working.nodes.shape[2])
            arguments = self._models.arrays, views, workspace, output
            kernels.launch(kernel, min(blocks, tiles), BLOCK_THREADS, *arguments, shared=shared)

        with self._turns.taken():
            order = None
            if self._exact and tiles > len(working.nodes):  # so that no block begins a large tile when others are done
                weights = self._zeros(tiles, dtype=torch.int32)
                launch("weigh_tiles", weights)
                order = heaviest_first(weights)
            launch(kernel, images, chosen=order, left=left)
            if left is not None:  # tiles that had no room, on only as many blocks as have room for any tile
                launch(kernel, images, working.few_blocks, working.most_keys, left)

    def _for_parts(self) -> tuple[Kernels, CudaParts]:
        """Return the kernels that draw rows with parts, and the placement of parts; both are loaded on first use."""
        if self._parts is None:
            drawing = self._load("render", kernel_defines(*self._settings, parts=True))
            self._parts = drawing, CudaParts(self._load("place", {}), self._models, self._most_gaussians)
        return self._parts

    def _working_for(self, parts: Parts | None) -> _Working:
        """Return working memory for as many blocks as the device runs at a time, or as the memory allows."""
        columns = None if parts is None else parts.model.shape[1]
        if columns not in self._working:
            kernels, most_keys = self._kernels, self._models.models[0].gaussians
            if parts is not None:
                kernels, placing = self._for_parts()
                most_keys = placing.capacity(parts)
            node_capacity = max(1, columns or 1) * self._models.clusters
            shared = shared_bytes("draw_pixels", parts is not None)
            resident = kernels.multiprocessors * kernels.resident("draw_pixels", BLOCK_THREADS, shared)
            room = (self._memory // resident - 12 * node_capacity) // 16
            key_capacity = min(most_keys, max(LEAST_KEYS, room))
            blocks = max(1, min(resident, self._memory // (16 * key_capacity + 12 * node_capacity)))
            keys = torch.empty(2 * max(blocks * key_capacity, most_keys), dtype=torch.int64, device=self.device)
            nodes = torch.empty(blocks, 3, node_capacity, dtype=torch.int32, device=self.device)
            self._working[columns] = _Working(keys, nodes, key_capacity, most_keys)
        return self._working[columns]

    def _here(self, value: Tensor, dtype: torch.dtype) -> Tensor:
        return value.detach().to(self.device, dtype).contiguous()

    def _zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(shape, dtype=dtype, device=self.device)


def heaviest_first(weights: Tensor) -> Tensor:
    """Return how many tiles there are, and then all of them by descending weight: [1 + tiles] int32.

    Args:
        weights: estimated work of each tile, [tiles] int32.
    """
    order = weights.argsort(descending=True).int()
    return torch.cat((torch.full_like(order[:1], len(order)), order))


def _address(tensor: Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()
