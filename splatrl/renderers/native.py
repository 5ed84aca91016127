"""The renderer for processors: exact, C++, one frame per core."""

import os
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import quats_to_rotations
from splatrl.native import _core
from splatrl.renderers.base import RenderOutput, checked_background, require_finite
from splatrl.scenes.gaussians import Gaussians


class NativeRenderer:
    """Renders the same images as ``ReferenceRenderer`` at the speed that training needs, on the CPU.

    Frame i has the same bytes alone, in any batch, in any order and with any number of threads. Instruction sets may
    differ in the last bits; ``SPLATRL_ISA=avx512|avx2|baseline`` forces one for the renderers made after it is set.

    Args:
        gaussians: the scene; its values are copied.
        antialiased: keep the energy of Gaussians smaller than a pixel; False is the classic 3DGS image.
        background: colour behind the Gaussians, in [0, 1].
        threads: cores that a batch is spread over; None takes all that this process may use.

    Raises:
        ValueError: for Gaussians that are not finite, fewer threads than one, or an unknown ``SPLATRL_ISA``.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        antialiased: bool = True,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        threads: int | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise ValueError(f"threads: expected at least 1, or None for all cores, got {threads}")
        self.threads = threads or usable_cores()
        axes = quats_to_rotations(gaussians.quats.double()) * gaussians.scales.double().unsqueeze(-2)
        fields = {
            "means": gaussians.means,
            "axes": axes,  # [N, 3, 3], the columns are standard deviations
            "opacities": gaussians.opacities,
            "sh": gaussians.sh,
        }
        arrays = {name: _cpu_floats(value) for name, value in fields.items()}
        for name, value in arrays.items():
            if not bool(value.isfinite().all()):
                raise ValueError(f"gaussians.{name}: expected finite values")
        self._core = _core.Renderer(
            **arrays, degree=gaussians.sh_degree, antialiased=antialiased, background=checked_background(background)
        )

    def render(self, cameras: Cameras) -> RenderOutput:
        """Colour, depth and alpha of each camera, float32, on the cameras' device."""
        shape = (len(cameras), cameras.height, cameras.width)
        rgb, depth, alpha = torch.empty(*shape, 3), torch.empty(shape), torch.empty(shape)
        efforts = torch.empty(len(cameras), 6)
        self._core.render(*_checked(cameras), rgb, depth, alpha, efforts, self.threads)
        device = cameras.camera_to_world.device
        return RenderOutput(rgb.to(device), depth.to(device), alpha.to(device))

    def pixels(self, cameras: Cameras) -> Tensor:
        """[B, H, W, 3] uint8, on the cameras' device."""
        return self._draw(cameras)[0].to(cameras.camera_to_world.device)

    def visible(self, cameras: Cameras) -> Tensor:
        """How many Gaussians can show in each view, those hidden by others included: [B] int32."""
        return self._draw(cameras)[1][:, 1].int()

    def _draw(self, cameras: Cameras) -> tuple[Tensor, Tensor]:
        pixels = torch.empty(len(cameras), cameras.height, cameras.width, 3, dtype=torch.uint8)
        efforts = torch.empty(len(cameras), 6)
        self._core.pixels(*_checked(cameras), pixels, efforts, self.threads)
        return pixels, efforts


def usable_cores() -> int:
    """Cores that this process may use: its affinity where the system has one, else all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _cpu_floats(value: Tensor) -> Tensor:
    return value.detach().to("cpu", torch.float32).contiguous()


def _checked(cameras: Cameras) -> tuple[Tensor, Tensor]:
    """Poses and intrinsics as the core reads them, after the checks that it relies on."""
    require_finite(cameras)
    return _cpu_floats(cameras.camera_to_world), _cpu_floats(cameras.K)
