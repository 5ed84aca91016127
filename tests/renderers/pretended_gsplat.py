"""A fake gsplat that draws with our reference and checks its arguments, so that a transposed matrix is detected."""

from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import invert_rigid
from splatrl.renderers import ReferenceRenderer
from splatrl.scenes import Gaussians


def rasterization(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    rasterize_mode: str = "classic",
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Check the arguments, and return with the reference what gsplat 1.5.3 promises."""
    count, batch = len(means), len(viewmats)
    assert (means.shape, quats.shape, scales.shape) == ((count, 3), (count, 4), (count, 3))
    assert opacities.shape == (count,) and viewmats.shape == (batch, 4, 4) and Ks.shape == (batch, 3, 3)
    assert sh_degree is not None and colors.shape == (count, (sh_degree + 1) ** 2, 3)
    assert backgrounds is None or not packed  # gsplat confuses the shape of the images with that of packed means
    assert batch > 0
    given = (means, quats, scales, opacities, colors, viewmats, Ks)
    assert all(value.dtype == torch.float32 and value.is_contiguous() and not value.requires_grad for value in given)
    assert (near_plane, radius_clip, eps2d, far_plane) == (0.01, 0.0, 0.3, 1e10)
    scene = Gaussians(means, quats, scales, opacities, colors, batch_size=[count])
    reference = ReferenceRenderer(scene, rasterize_mode == "antialiased")
    rgb, depth, alpha = reference.render(Cameras(invert_rigid(viewmats), Ks, width, height))
    assert render_mode in ("RGB", "RGB+ED") and rasterize_mode in ("classic", "antialiased")
    colors_out = rgb if render_mode == "RGB" else torch.cat([rgb, depth.unsqueeze(-1)], -1)
    return colors_out, alpha.unsqueeze(-1), {}


def modules(rasterization: Any = rasterization, extension: object = "compiled") -> dict[str, ModuleType]:
    """Return the ``sys.modules`` of such an installed gsplat; ``extension`` is None if it found no compiler."""
    package, cuda, backend = (ModuleType(name) for name in ("gsplat", "gsplat.cuda", "gsplat.cuda._backend"))
    package.__version__, package.rasterization = "1.5.3", rasterization  # type: ignore[attr-defined]
    backend._C, cuda._backend = extension, backend  # type: ignore[attr-defined]
    return {module.__name__: module for module in (package, cuda, backend)}
