"""The renderer for GPUs: thousands of small images in one launch, exact or with level of detail."""

import ctypes
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.faults import FaultFlag
from splatrl.native import _core
from splatrl.native.cuda.kernels import CudaKernels, Load, uploaded
from splatrl.renderers.base import RenderOutput, checked_background, checked_only, gaussians_of
from splatrl.renderers.lod import gaussian_arrays, levels_for
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene

BLOCK_THREADS, SHARED_BYTES = 256, 35 * 1024
"""Of a block, which draws one tile at a time."""
BLOCKS_A_MULTIPROCESSOR = 4
"""That the compiler leaves enough registers for."""
TILE = 32
"""Pixels of a tile, both ways."""
MOST_GAUSSIANS = 2**24
"""That a key has room for, merged ones counted."""


def kernel_defines(antialiased: bool, sh_degree: int, levels: bool) -> dict[str, int]:
    """What ``cuda/render.cu`` is compiled with.

    Args:
        antialiased: or classic.
        sh_degree: of the scene.
        levels: whether there are merged Gaussians, as with a tolerance above 0.
    """
    return {
        "ANTIALIASED_IMAGES": int(antialiased),
        "LEVELS_OF_DETAIL": int(levels),
        "SH_DEGREE": sh_degree,
        "BLOCK_THREADS": BLOCK_THREADS,
        "BLOCKS_A_MULTIPROCESSOR": BLOCKS_A_MULTIPROCESSOR,
        "SHARED_BYTES": SHARED_BYTES,
    }


class _SceneArrays(ctypes.Structure):
    """``SceneArrays`` of cuda/tile.h, where all of these are described."""

    _fields_ = (
        *(
            (name, ctypes.c_void_p)
            for name in ("spheres", "shapes", "colors", "indices", "slots", "clusters", "group_bounds")
        ),
        ("background", ctypes.c_float * 3),
        ("tolerance", ctypes.c_float),
    )


class _Views(ctypes.Structure):
    """``Views`` of cuda/tile.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("camera_to_world", "K", "only")),
        *((name, ctypes.c_int) for name in ("batch", "width", "height")),
    )


class _Workspace(ctypes.Structure):
    """``Workspace`` of cuda/tile.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("keys", "nodes", "next_tile", "fault", "efforts")),
        ("key_capacity", ctypes.c_int),
        ("node_capacity", ctypes.c_int),
    )


class _Images(ctypes.Structure):
    """``Images`` of cuda/tile.h."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("pixels", "rgb", "depth", "alpha"))


class CudaRenderer:
    """Renders the same images as ``NativeRenderer`` on a CUDA device, without waiting for the host.

    A block of threads draws a tile of 32×32 pixels from beginning to end: it goes down the tree over the scene, sorts
    what may show a slab at a time in shared memory, and blends it with the pixels in registers. Frame i has the same
    bytes alone and in any batch. Kernels are compiled the first time on a machine, in seconds, and kept.

    A camera that is not finite, or whose focal length is not positive, gives a black image; ``raise_faults`` tells.

    Args:
        scene: the scene, whose levels of detail are kept in its cache; or Gaussians. Values are copied.
        antialiased: keep the energy of Gaussians smaller than a pixel; False is the classic 3DGS image.
        background: colour behind the Gaussians, in [0, 1].
        tolerance: pixels by which level of detail may displace what is shown; 0 renders every Gaussian.
        device: a CUDA device.
        memory: bytes of working memory at most: with less, fewer tiles are drawn at a time. None takes a quarter of the
            device's.
        load: gives what runs the kernels; None compiles them for ``device``.

    Raises:
        ValueError: for Gaussians that are not finite or too many, or a tolerance that is negative or not finite.
        ImportError: where the extra ``cuda`` is not installed.
    """

    def __init__(
        self,
        scene: Scene | Gaussians,
        antialiased: bool = True,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        tolerance: float = 0.0,
        device: torch.device | str = "cuda",
        memory: int | None = None,
        load: Load | None = None,
    ) -> None:
        gaussians, colour = gaussians_of(scene), checked_background(background)
        defines = kernel_defines(antialiased, gaussians.sh_degree, tolerance > 0)
        self._kernels = load("render", defines) if load else CudaKernels("render", device, defines)
        self.device = self._kernels.device
        arrays = gaussian_arrays(gaussians)
        levels = levels_for(scene, arrays, tolerance)
        flat = _core.flat_scene(
            **arrays,
            degree=gaussians.sh_degree,
            background=colour,
            levels=levels,
            antialiased=antialiased,
            tolerance=tolerance,
        )
        if len(flat["slots"]) > MOST_GAUSSIANS:
            raise ValueError(
                f"scene: expected at most {MOST_GAUSSIANS:,} Gaussians, merged ones counted, got {len(flat['slots']):,}"
            )
        values = {"background": colour, "tolerance": flat.pop("tolerance")}
        self._arrays = {name: uploaded(value, self.device) for name, value in flat.items()}
        self._scene = _SceneArrays(**{name: value.data_ptr() for name, value in self._arrays.items()}, **values)
        self._key_capacity, self._node_capacity = gaussians.numel(), len(flat["clusters"])
        self._memory = self._kernels.memory // 4 if memory is None else memory
        self._faults = FaultFlag(self.device)
        self._working: tuple[Tensor, Tensor] | None = None  # of every launch, one after the other

    def render(self, cameras: Cameras, only: Tensor | None = None) -> RenderOutput:
        """Colour, depth and alpha of each camera, float32, on the cameras' device; see ``Renderer``."""
        shape = (len(cameras), cameras.height, cameras.width)
        rgb, depth, alpha = self._zeros(*shape, 3), self._zeros(*shape), self._zeros(*shape)
        self._draw("draw_images", cameras, only, _Images(None, rgb.data_ptr(), depth.data_ptr(), alpha.data_ptr()))
        where = cameras.camera_to_world.device
        return RenderOutput(rgb.to(where), depth.to(where), alpha.to(where))

    def pixels(self, cameras: Cameras, only: Tensor | None = None) -> Tensor:
        """What an observation is: [B, H, W, 3] uint8, on the cameras' device; see ``Renderer``."""
        pixels = self._zeros(len(cameras), cameras.height, cameras.width, 3, dtype=torch.uint8)
        self._draw("draw_pixels", cameras, only, _Images(pixels.data_ptr(), None, None, None))
        return pixels.to(cameras.camera_to_world.device)

    def efforts(self, cameras: Cameras) -> Tensor:
        """What it takes to draw each view: [B, 3] int32, counted while drawing it.

        Candidates for its tiles; those of them that show; pairs of one and a patch of 8×4 pixels that were blended.
        """
        efforts = self._zeros(len(cameras), 3, dtype=torch.int32)
        pixels = self._zeros(len(cameras), cameras.height, cameras.width, 3, dtype=torch.uint8)
        self._draw("draw_pixels", cameras, None, _Images(pixels.data_ptr(), None, None, None), efforts)
        return efforts.to(cameras.camera_to_world.device)

    def raise_faults(self) -> None:
        """Raise what was noted of cameras since the last call; see ``Faulty``."""
        row = self._faults.take()
        if row is not None:
            raise ValueError(f"cameras[{row}]: expected finite camera_to_world and K with positive focal lengths")

    def _draw(
        self, kernel: str, cameras: Cameras, only: Tensor | None, images: _Images, efforts: Tensor | None = None
    ) -> None:
        """Queue the drawing. Tensors that are freed before it is done are kept by PyTorch for this stream."""
        if len(cameras) == 0:
            return
        poses, K = (self._here(value, torch.float32) for value in (cameras.camera_to_world, cameras.K))
        mask = None if only is None else self._here(checked_only(only, cameras), torch.bool)
        keys, nodes = self._workspace()
        next_tile = self._zeros(1, dtype=torch.int32)
        views = _Views(poses.data_ptr(), K.data_ptr(), _address(mask), len(cameras), cameras.width, cameras.height)
        workspace = _Workspace(
            *(_address(part) for part in (keys, nodes, next_tile, self._faults.flag, efforts)),
            self._key_capacity,
            self._node_capacity,
        )
        tiles = len(cameras) * -(-cameras.height // TILE) * -(-cameras.width // TILE)
        blocks, arguments = min(len(keys), tiles), (self._scene, views, workspace, images)
        self._kernels.launch(kernel, blocks, BLOCK_THREADS, *arguments, shared=SHARED_BYTES)

    def _workspace(self) -> tuple[Tensor, Tensor]:
        """Keys and nodes of as many blocks as the device holds at a time, or the memory allows."""
        if self._working is None:
            needed = 16 * self._key_capacity + 12 * self._node_capacity
            resident = self._kernels.multiprocessors * self._kernels.resident(
                "draw_pixels", BLOCK_THREADS, SHARED_BYTES
            )
            blocks = max(1, min(resident, self._memory // needed))
            keys = torch.empty(blocks, 2, self._key_capacity, dtype=torch.int64, device=self.device)
            nodes = torch.empty(blocks, 3, self._node_capacity, dtype=torch.int32, device=self.device)
            self._working = keys, nodes
        return self._working

    def _here(self, value: Tensor, dtype: torch.dtype) -> Tensor:
        return value.detach().to(self.device, dtype).contiguous()

    def _zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(shape, dtype=dtype, device=self.device)


def _address(tensor: Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()
