"""gsplat's rasteriser behind our interface, as a test oracle and a baseline for speed."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.extras import install_hint, require
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
"""The most cameras per call: gsplat indexes images and tiles together with 32 bits, and rows of a launch with 16."""
_MISSING = ("gsplat", "GsplatRenderer needs gsplat", ", on a machine with CUDA's compiler nvcc")


class GsplatRenderer:
    """Renders every Gaussian with ``gsplat.rasterization`` (Ye et al. 2024; written against 1.5.3) on a CUDA device.

    Its conventions are those of ``ReferenceRenderer``: near plane, dilation, the margin around the image at which the
    projection is clamped, the maximum alpha (0.999) and the transmittance at which a pixel is finished (1e-4). Classic
    images agree up to rounding and up to the order of depths that are equal in single precision. Differences by design:

    - It drops what is fainter than 1/255 in antialiased images too, where we draw down to a quarter of that, so at
      low resolutions distant surfaces come out thinner.
    - A Gaussian extends no further than 3.33 standard deviations and, in tiles of 16×16 pixels, to the rectangle around
      that. At a threshold of 1/255 this removes nothing.
    - Colours may exceed 1 until they are blended, as in ours, and the image is clamped here.

    Args:
        scene: the scene, or its Gaussians: one model. Values are copied as float32.
        antialiased: preserve the energy of Gaussians smaller than a pixel; False renders classic 3DGS images.
        background: colour behind the Gaussians, in [0, 1].
        device: a CUDA device.
        memory: approximate working memory in bytes; larger batches are drawn in several calls. The estimate assumes
            that a camera sees the whole scene, each Gaussian on about one tile.
        packed: whether gsplat keeps only what a camera sees, which takes less memory and is usually faster here.

    Raises:
        ValueError: for several models, or, when drawing, for parts.
        ImportError: if gsplat is not installed, or has found no nvcc to compile its kernels with.
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
            raise ValueError(f"scene: expected one model, since gsplat cannot place several, got {1 + len(others)}")
        gaussians, self.device = gaussians_of(model), torch.device(device)
        fields = {"means": gaussians.means, "quats": gaussians.quats, "scales": gaussians.scales}
        fields |= {"opacities": gaussians.opacities, "colors": gaussians.sh}
        self._scene = {name: self._here(value) for name, value in fields.items()}
        self._degree = gaussians.sh_degree
        self._background = torch.tensor(checked_background(background), device=self.device)
        self._mode = "antialiased" if antialiased else "classic"
        self._packed = packed
        # IDs, footprint, colour and sorted intersections, plus the harmonics, which gsplat copies for each camera
        bytes_each = 128 + 12 * (self._degree + 1) ** 2
        self.at_once = min(MOST_CAMERAS, max(1, memory // (bytes_each * max(1, gaussians.numel()))))

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Render colour, depth and alpha for each camera, float32, on the cameras' device; see ``Renderer``."""
        return draw_only(self._rendered, cameras, parts, only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """Render the pixels of an observation: [B, H, W, 3] uint8, on the cameras' device; see ``Renderer``."""
        return draw_only(self._pixels, cameras, parts, only)

    def _rendered(self, cameras: Cameras, parts: Parts | None) -> RenderOutput:
        images = [self._images(some, "RGB+ED") for some in self._cut(cameras, parts)]
        colors, alphas = (torch.cat(each).to(cameras.camera_to_world.device) for each in zip(*images, strict=True))
        return RenderOutput(colors[..., :3].clamp(0.0, 1.0), colors[..., 3], alphas[..., 0])

    def _pixels(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        images = [to_pixels(self._images(some, "RGB")[0].clamp(0.0, 1.0)) for some in self._cut(cameras, parts)]
        return torch.cat(images).to(cameras.camera_to_world.device)

    def _cut(self, cameras: Cameras, parts: Parts | None) -> list[Cameras]:
        """Split cameras into batches that fit into memory: at least one, which is empty if there are no cameras."""
        if parts is not None:
            got = list(parts.model.shape)
            raise ValueError(f"parts: expected none, since gsplat draws a single model in its own frame, got {got}")
        require_cameras(cameras)
        return [cameras[first : first + self.at_once] for first in range(0, max(1, len(cameras)), self.at_once)]

    @torch.no_grad()
    def _images(self, cameras: Cameras, render_mode: str) -> tuple[Tensor, Tensor]:
        """Render colours [C, H, W, 3], or [C, H, W, 4] with depth, and alphas [C, H, W, 1]."""
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
        colors[..., :3] += (1.0 - alphas) * self._background  # gsplat 1.5.3 rejects backgrounds when packed
        return colors, alphas

    def _here(self, value: Tensor) -> Tensor:
        return value.detach().to(self.device, torch.float32).contiguous()


def _rasterization() -> Any:
    """Import gsplat's function. This compiles its kernels, which takes minutes, unless that has been done before."""
    gsplat, backend = (require(module, *_MISSING) for module in ("gsplat", "gsplat.cuda._backend"))
    if backend._C is None:  # gsplat only prints a message, and would fail at the first image
        found = f"gsplat {gsplat.__version__} is installed, but nvcc was not found"
        raise ImportError(f"{install_hint(*_MISSING)}; {found}")
    return gsplat.rasterization
