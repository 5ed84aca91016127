"""The renderer for CPUs: in C++, exact or with level of detail, one frame per core."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.native import _core
from splatrl.native.threads import threads_of
from splatrl.renderers.base import RenderOutput, checked_background, draw_only, gaussians_of, models_of, require_cameras
from splatrl.renderers.lod import gaussian_arrays, levels_for
from splatrl.renderers.parts import Parts, checked_parts, require_parts_of
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene
from splatrl.waits import late_bar


class Effort(NamedTuple):
    """The work that each frame of a batch took, summed over its tiles.

    Attributes:
        projected: [B] int32, Gaussians that were projected.
        visible: [B] int32, the ones among them that can be visible, including those occluded by others.
        blended: [B] int32, pairs of a Gaussian and a block of 4×4 pixels that were blended.
        project_ms: [B] float32, processor time for culling, projecting and colouring, milliseconds.
        sort_ms: [B] float32, processor time for sorting by depth, milliseconds.
        blend_ms: [B] float32, processor time for blending, milliseconds.
    """

    projected: Tensor
    visible: Tensor
    blended: Tensor
    project_ms: Tensor
    sort_ms: Tensor
    blend_ms: Tensor


class NativeRenderer:
    """Renders the same images as ``ReferenceRenderer`` on the CPU, fast enough for training.

    With a ``tolerance``, distant surfaces are drawn with fewer, larger Gaussians, which are merged from neighbours once
    per scene: as few as possible while the displacement of what is shown stays within the tolerance. It is measured in
    pixels of the requested image, so images are sharp at every resolution.

    A frame has the same bytes alone, in any batch, in any order and with any number of threads. Instruction sets may
    differ in the last bits; ``SPLATRL_ISA=avx512|avx2|portable`` forces one for the renderers made after it is set.
    Pickles and copies hold the scene and the settings, from which the renderer is rebuilt.

    Args:
        scene: the scene, whose levels of detail are kept in its cache; or Gaussians; or several of either, which
            ``Parts.model`` indexes. Values are copied.
        antialiased: preserve the energy of Gaussians smaller than a pixel; False renders classic 3DGS images.
        background: colour behind the Gaussians, in [0, 1].
        threads: cores that a batch is spread over, at most those that this process may use; None uses all of these.
        tolerance: pixels by which level of detail may displace what is shown; 0 renders every Gaussian.

    Raises:
        ValueError: for Gaussians that cannot be drawn, fewer than one thread, a tolerance that is negative or not
            finite, or an unknown ``SPLATRL_ISA``.
    """

    def __init__(
        self,
        scene: Scene | Gaussians | Sequence[Scene | Gaussians],
        antialiased: bool = True,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        threads: int | None = None,
        tolerance: float = 0.0,
    ) -> None:
        self.threads = threads_of(threads)
        models = models_of(scene)
        self._made_of: tuple[Any, ...] = scene, antialiased, background, threads, tolerance
        self._models = len(models)
        self._core = _core.Renderer(antialiased, checked_background(background), tolerance)
        self._add_all(models, tolerance)

    def _add_all(self, models: Sequence[Scene | Gaussians], tolerance: float) -> None:
        """Add models to the core, several at a time."""
        if len(models) == 1:
            return self._add(0, models[0], tolerance)  # in this thread, where Ctrl-C interrupts it
        with ThreadPoolExecutor(threads_of(None)) as pool:
            added = pool.map(partial(self._add, tolerance=tolerance), range(len(models)), models)
            list(late_bar("models to draw", len(models), "model", added))

    def _add(self, number: int, model: Scene | Gaussians, tolerance: float) -> None:
        """Add a model to the core."""
        gaussians = gaussians_of(model)
        arrays = gaussian_arrays(gaussians)
        levels = levels_for(model, arrays, tolerance)
        self._core.add_model(number, **arrays, degree=gaussians.sh_degree, levels=levels)

    def __reduce__(self) -> tuple[type["NativeRenderer"], tuple[Any, ...]]:
        return type(self), self._made_of

    @torch.compiler.disable
    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Render colour, depth and alpha for each camera, float32, on the cameras' device; see ``Renderer``."""
        return draw_only(self._rendered, cameras, self._checked(parts, cameras), only)

    def _checked(self, parts: Parts | None, cameras: Cameras) -> Parts | None:
        """Check parts in the core; ``checked_parts`` is only called to explain what is wrong with them."""
        if parts is not None:
            require_parts_of(parts, cameras)
            model, poses = parts.model.cpu().contiguous(), cpu_floats(parts.model_to_world)
            if _core.first_bad_part(model, poses, self._models) < 0:
                return parts
        return checked_parts(parts, cameras, self._models)

    def _rendered(self, cameras: Cameras, parts: Parts | None) -> RenderOutput:
        shape = (len(cameras), cameras.height, cameras.width)
        rgb, depth, alpha = torch.empty(*shape, 3), torch.empty(shape), torch.empty(shape)
        self._core.render(*_placed(cameras, parts), rgb, depth, alpha, self.threads)
        device = cameras.camera_to_world.device
        return RenderOutput(rgb.to(device), depth.to(device), alpha.to(device))

    @torch.compiler.disable
    def pixels(
        self,
        cameras: Cameras,
        parts: Parts | None = None,
        only: Tensor | None = None,
        out: Tensor | None = None,
    ) -> Tensor:
        """Render the pixels of an observation: [B, H, W, 3] uint8.

        Args:
            cameras: B views.
            parts: the parts that each view draws; None draws model 0 in its own frame.
            only: [B] bool, which rows to draw; the others are zero. None draws all.
            out: [B, H, W, 3] uint8, contiguous, in main memory: the tensor to write to, instead of a new one.

        Raises:
            ValueError: for invalid parts, for an ``out`` of another shape, type, layout or device, or for ``out``
                together with ``only``.
        """
        parts = self._checked(parts, cameras)
        if out is None:
            return draw_only(self._pixels, cameras, parts, only)
        if only is not None:
            raise ValueError(
                "out: cannot be combined with only, since rows that are not drawn would keep their old pixels"
            )
        self._draw(cameras, parts, _checked_out(out, cameras))
        return out

    def _pixels(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        pixels = empty_pixels(cameras)
        self._draw(cameras, parts, pixels)
        return pixels.to(cameras.camera_to_world.device)

    @torch.compiler.disable
    def efforts(self, cameras: Cameras, parts: Parts | None = None) -> Effort:
        """Measure the work that each of B views takes, by drawing it; see ``Effort``."""
        efforts = torch.empty(len(cameras), len(Effort._fields))
        self._draw(cameras, self._checked(parts, cameras), empty_pixels(cameras), efforts)
        values = efforts.unbind(1)
        return Effort(*(value.int() for value in values[:3]), *values[3:])

    def _draw(self, cameras: Cameras, parts: Parts | None, pixels: Tensor, efforts: Tensor | None = None) -> None:
        """Draw into ``pixels``, and write the work that it takes into ``efforts``, [B, fields] float32."""
        self._core.pixels(*_placed(cameras, parts), pixels, efforts, self.threads)


def empty_pixels(cameras: Cameras) -> Tensor:
    """Allocate uninitialised pixels for a batch of cameras: [B, H, W, 3] uint8, in main memory."""
    return torch.empty(len(cameras), cameras.height, cameras.width, 3, dtype=torch.uint8)


def _checked_out(out: Tensor, cameras: Cameras) -> Tensor:
    """Return ``out``, or reject it if it cannot be drawn into."""
    shape = (len(cameras), cameras.height, cameras.width, 3)
    if tuple(out.shape) != shape or out.dtype != torch.uint8 or not out.is_contiguous() or out.device.type != "cpu":
        got = f"{tuple(out.shape)} {out.dtype} on {out.device}{'' if out.is_contiguous() else ', not contiguous'}"
        raise ValueError(f"out: expected {shape} torch.uint8 on cpu, contiguous, got {got}")
    return out


def cpu_floats(value: Tensor) -> Tensor:
    """Convert values of any shape and type to what the core reads: float32, contiguous, in main memory."""
    return value.detach().to("cpu", torch.float32).resolve_neg().contiguous()


def checked_cameras(cameras: Cameras) -> tuple[Tensor, Tensor]:
    """Check cameras as the core relies on.

    Args:
        cameras: B views.

    Returns:
        ``camera_to_world`` [B, 4, 4] and ``K`` [B, 3, 3], as ``cpu_floats`` each.

    Raises:
        ValueError: for poses that are not rigid, or intrinsics that are not a pinhole's; see ``require_cameras``.
    """
    poses, K = cpu_floats(cameras.camera_to_world), cpu_floats(cameras.K)
    if _core.first_bad_camera(poses, K) >= 0:
        require_cameras(cameras)
        raise ValueError("cameras: expected rigid poses and pinhole intrinsics")
    return poses, K


def _placed(cameras: Cameras, parts: Parts | None) -> tuple[Tensor | None, Tensor, Tensor]:
    """Return models, camera poses in the models' frames, and intrinsics, as the core reads them."""
    poses, K = checked_cameras(cameras)
    if parts is None:
        return None, poses.unsqueeze(1), K
    return parts.model.cpu().contiguous(), in_models(poses, parts), K


def in_models(poses: Tensor, parts: Parts) -> Tensor:
    """Express camera poses in the frames of their parts: ``camera_to_models`` in C++.

    Args:
        poses: [B, 4, 4] camera_to_world, as ``cpu_floats``.
        parts: M parts of each row.

    Returns:
        [B, M, 4, 4] camera_to_model, float32, metres, in main memory.
    """
    out = torch.empty(*parts.model.shape, 4, 4)
    _core.camera_to_models(poses, cpu_floats(parts.model_to_world), out)
    return out
