"""gsplat's rasteriser behind our interface: an oracle, and the baseline for speed."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import invert_rigid
from splatrl.renderers.base import (
    RenderOutput,
    checked_background,
    draw_only,
    gaussians_of,
    models_of,
    require_cameras,
    to_pixels,
)
from splatrl.renderers.parts import Parts
from splatrl.renderers.reference import DILATION, NEAR
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene

MOST_CAMERAS = 1024
"""Cameras per call: gsplat numbers images and tiles together in 32 bits, and rows of a launch in 16."""
_MISSING = "GsplatRenderer needs gsplat: pip install 'splatrl[gsplat]', on a machine with CUDA's compiler nvcc"


class GsplatRenderer:
    """Renders with ``gsplat.rasterization`` (Ye et al. 2024; written against 1.5.3), every Gaussian, on a CUDA device.

    Its conventions are those of ``ReferenceRenderer``: near plane, dilation, the margin beside the image at which the
    projection is clamped, the largest alpha (0.999) and where a pixel is finished (1e-4). Classic images agree up to
    rounding, and to the order of equal single-precision depths. What differs by design:

    - It drops what is fainter than 1/255 in antialiased images too, where we draw down to a quarter of that, so at
      low resolutions surfaces far away come out thinner.
    - A Gaussian shows no further than 3.33 standard deviations and, by tiles of 16×16 pixels, on the rectangle around
      that. At 1/255 this takes nothing away.
    - Colours may exceed 1 until they are blended, as in ours, and the image is clamped here.

    Args:
        scene: the scene, or its Gaussians: one model. Values are copied as float32.
        antialiased: keep the energy of Gaussians smaller than a pixel; False is the classic 3DGS image.
        background: colour behind the Gaussians, in [0, 1].
        device: a CUDA device.
        memory: bytes of working memory, approximately; large batches are drawn a part at a time. The estimate assumes
            that a camera sees the whole scene, each Gaussian on about one tile.
        packed: whether gsplat keeps only what a camera sees, which takes less memory and is usually faster here.

    Raises:
        ValueError: for several models, or, when it draws, for parts.
        ImportError: where gsplat is not installed, or has found no nvcc to compile its kernels with.
    """

    def __init__(
        self,
        scene: Scene | Gaussians | Sequence[Scene | Gaussians],
        antialiased: bool = True,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        device: torch.device | str,
        memory: int = 16 * 2**30,
        packed: bool = True,
    ) -> None:
        self._rasterization = _rasterization()
        model, *others = models_of(scene)
        if others:
            raise ValueError(f"scene: expected one model, since gsplat places none, got {1 + len(others)}")
        gaussians, self.device = gaussians_of(model), torch.device(device)
        fields = {"means": gaussians.means, "quats": gaussians.quats, "scales": gaussians.scales}
        fields |= {"opacities": gaussians.opacities, "colors": gaussians.sh}
        self._scene = {name: self._here(value) for name, value in fields.items()}
        self._degree = gaussians.sh_degree
        self._background = torch.tensor(checked_background(background), device=self.device)
        self._mode = "antialiased" if antialiased else "classic"
        self._packed = packed
        # ids, footprint, colour and sorted intersections; and the harmonics, which gsplat copies for each camera
        bytes_each = 128 + 12 * (self._degree + 1) ** 2
        self.at_once = min(MOST_CAMERAS, max(1, memory // (bytes_each * max(1, gaussians.numel()))))

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Colour, depth and alpha of each camera, float32, on the cameras' device; see ``Renderer``."""
        return draw_only(self._rendered, cameras, parts, only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """What an observation is: [B, H, W, 3] uint8, on the cameras' device; see ``Renderer``."""
        return draw_only(self._pixels, cameras, parts, only)

    def _rendered(self, cameras: Cameras, parts: Parts | None) -> RenderOutput:
        images = [self._images(some, "RGB+ED") for some in self._cut(cameras, parts)]
        colors, alphas = (torch.cat(each).to(cameras.camera_to_world.device) for each in zip(*images, strict=True))
        return RenderOutput(colors[..., :3].clamp(0.0, 1.0), colors[..., 3], alphas[..., 0])

    def _pixels(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        images = [to_pixels(self._images(some, "RGB")[0].clamp(0.0, 1.0)) for some in self._cut(cameras, parts)]
        return torch.cat(images).to(cameras.camera_to_world.device)

    def _cut(self, cameras: Cameras, parts: Parts | None) -> list[Cameras]:
        """Batches of as many cameras as memory holds; at least one batch, empty where there are no cameras."""
        if parts is not None:
            got = list(parts.model.shape)
            raise ValueError(f"parts: expected no parts, since gsplat draws one model where it stands, got {got}")
        require_cameras(cameras)
        return [cameras[first : first + self.at_once] for first in range(0, max(1, len(cameras)), self.at_once)]

    @torch.no_grad()
    def _images(self, cameras: Cameras, render_mode: str) -> tuple[Tensor, Tensor]:
        """Colours [C, H, W, 3], with depth 4, and alphas [C, H, W, 1]."""
        shape = (len(cameras), cameras.height, cameras.width)
        if len(cameras) == 0:
            return torch.zeros(*shape, 4 if "D" in render_mode else 3), torch.zeros(*shape, 1)
        viewmats, Ks = self._here(invert_rigid(cameras.camera_to_world)), self._here(cameras.K)
        colors, alphas, _ = self._rasterization(
            **self._scene,
            viewmats=viewmats,
            Ks=Ks,
            width=cameras.width,
            height=cameras.height,
            near_plane=NEAR,
            eps2d=DILATION,
            sh_degree=self._degree,
            packed=self._packed,
            render_mode=render_mode,
            rasterize_mode=self._mode,
        )
        colors[..., :3] += (1.0 - alphas) * self._background  # gsplat 1.5.3 refuses backgrounds where it is packed
        return colors, alphas

    def _here(self, value: Tensor) -> Tensor:
        return value.detach().to(self.device, torch.float32).contiguous()


def _rasterization() -> Any:
    """gsplat's function. Its kernels are compiled here, in minutes, unless that was done before."""
    try:
        import gsplat
        from gsplat.cuda import _backend
    except ImportError as error:
        raise ImportError(f"{_MISSING} ({error})") from error
    if _backend._C is None:  # gsplat says so on the console, and would fail at the first image
        raise ImportError(f"{_MISSING}; gsplat {gsplat.__version__} is installed, but nvcc was not found")
    return gsplat.rasterization
