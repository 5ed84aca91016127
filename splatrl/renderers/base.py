"""The interface of all renderers, and the checks that they share."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import first_not_rigid
from splatrl.renderers.parts import Parts, require_parts_of
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene


class RenderOutput(NamedTuple):
    """A batch of rendered views.

    Attributes:
        rgb: [B, H, W, 3] float32 in [0, 1], sRGB, over the background.
        depth: [B, H, W] float32, metres along the optical axis: the expected depth, a mean over the Gaussians of the
            pixel by blending weight; 0 where alpha is 0.
        alpha: [B, H, W] float32 in [0, 1], the fraction of the pixel that Gaussians cover.
    """

    rgb: Tensor
    depth: Tensor
    alpha: Tensor


class Renderer(Protocol):
    """Turns cameras into images of placed models. A frame has the same bytes whatever else is in the batch.

    A renderer takes one model or a sequence, which ``Parts.model`` indexes. Each row draws all of its ``parts`` into
    one image; without ``parts``, every row draws model 0 in its own frame. If ``only`` [B] bool is given, the other
    rows are not drawn and are zero.
    """

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Render colour, depth and alpha for each of B cameras; see ``RenderOutput``."""
        ...

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """Render the pixels of an observation: [B, H, W, 3] uint8, ``round(255 · rgb)``."""
        ...


UNIT = 1e-3
"""Tolerance on the length of a unit quaternion."""
DRAWABLE = {
    "means": "finite coordinates in metres",
    "quats": "a unit quaternion",
    "scales": "positive, finite numbers of metres",
    "opacities": "a number from 0 to 1",
    "sh": "finite values",
}
"""Requirement on each field of ``Gaussians`` for drawing, as error messages word it."""

Drawn = TypeVar("Drawn", Tensor, RenderOutput)


def checked_only(only: Tensor, cameras: Cameras) -> Tensor:
    """Check a mask of rows, and return it unchanged.

    Raises:
        ValueError: for another shape or type than [B] bool.
    """
    if only.shape != (len(cameras),) or only.dtype != torch.bool:
        raise ValueError(f"only: expected [{len(cameras)}] torch.bool, got {list(only.shape)} {only.dtype}")
    return only


def draw_only(
    draw: Callable[[Cameras, Parts | None], Drawn], cameras: Cameras, parts: Parts | None, only: Tensor | None
) -> Drawn:
    """Draw some rows of a batch and leave the others zero, for renderers that can read the mask on the host.

    Args:
        draw: function that renders cameras and their parts, [N, ...] each.
        cameras: B views.
        parts: the parts of the B rows; None draws model 0 in its own frame.
        only: [B] bool, which rows to draw; None draws all.

    Returns:
        The results of ``draw``, [B, ...].

    Raises:
        ValueError: for ``parts`` or an ``only`` of another shape or type.
    """
    if parts is not None:
        require_parts_of(parts, cameras)
    if only is None:
        return draw(cameras, parts)
    rows = checked_only(only, cameras).nonzero().squeeze(1)
    drawn = draw(cameras[rows], None if parts is None else parts.rows(rows))

    def placed(images: Tensor) -> Tensor:
        return among_zeros(images, rows.to(images.device), len(only))

    return RenderOutput(*(placed(images) for images in drawn)) if isinstance(drawn, RenderOutput) else placed(drawn)


def among_zeros(fresh: Tensor, rows: Tensor, count: int) -> Tensor:
    """Scatter rows into a batch whose other rows are zero: [N, ...], [N] int64 -> [count, ...]."""
    values = fresh.new_zeros(count, *fresh.shape[1:])
    if values.device.type != "cpu" or values.dtype is torch.bfloat16 or fresh.requires_grad:
        return values.index_copy_(0, rows, fresh)
    values.numpy()[rows.numpy()] = fresh.numpy()  # copies whole rows; index_copy_ copies single numbers
    return values


def to_pixels(rgb: Tensor) -> Tensor:
    """Quantise colours: [..., 3] float in [0, 1] -> [..., 3] uint8, rounded to nearest, halves up."""
    return (255.0 * rgb + 0.5).floor().to(torch.uint8)


def gaussians_of(scene: Scene | Gaussians) -> Gaussians:
    """Return the Gaussians of a scene, or Gaussians as they are."""
    return scene.gaussians if isinstance(scene, Scene) else scene


def models_of(scene: Scene | Gaussians | Sequence[Scene | Gaussians]) -> list[Scene | Gaussians]:
    """Return the models that a renderer is given, one or several, as a list.

    Raises:
        ValueError: if there are none.
    """
    models = [scene] if isinstance(scene, Scene | Gaussians) else list(scene)
    if not models:
        raise ValueError("scene: expected at least one model, got none")
    return models


def require_cameras(cameras: Cameras) -> None:
    """Reject cameras that no renderer can draw.

    Raises:
        ValueError: for a pose that is not rigid, or a K that is not that of a pinhole without skew; names the first
            such row.
    """
    fault = first_not_rigid(cameras.camera_to_world.detach())
    if fault is not None:
        row, expected = fault
        raise ValueError(f"camera_to_world[{row}]: expected {expected}, got {cameras.camera_to_world[row].tolist()}")
    K = cameras.K
    fixed = K[:, [0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] == K.new_tensor([0.0, 0.0, 0.0, 0.0, 1.0])
    pinhole = K.flatten(1).isfinite().all(1) & (K[:, 0, 0] > 0) & (K[:, 1, 1] > 0) & fixed.all(1)
    if not bool(pinhole.all()):
        row = int(pinhole.int().argmin())
        raise ValueError(
            f"K[{row}]: expected finite values, positive focal lengths, no skew and a last row of 0, 0, 1, "
            f"got {K[row].tolist()}"
        )


def require_drawable(gaussians: Gaussians) -> None:
    """Reject Gaussians that no renderer can draw; ``DRAWABLE`` lists what each field must be.

    Raises:
        ValueError: for such Gaussians; names the field and the first such row.
    """
    g, most = gaussians, torch.finfo(torch.float32).max
    lengths = g.quats.detach().double().norm(dim=1)
    right = {
        "means": (g.means.abs() <= most).all(1),
        "quats": (lengths - 1.0).abs() <= UNIT,
        "scales": ((g.scales > 0) & (g.scales <= most)).all(1),
        "opacities": (g.opacities >= 0) & (g.opacities <= 1),
        "sh": (g.sh.abs() <= most).flatten(1).all(1),
    }
    for name, rows in right.items():
        if not bool(rows.all()):
            row = int(rows.int().argmin())
            got = getattr(g, name)[row].tolist()
            raise ValueError(f"gaussians.{name}[{row}]: expected {DRAWABLE[name]}, got {got!r:.200}")


def checked_background(background: Sequence[float]) -> tuple[float, float, float]:
    """Check a background colour, and return it as three floats.

    Raises:
        ValueError: for anything but three numbers in [0, 1].
    """
    if len(background) != 3 or not all(0.0 <= value <= 1.0 for value in background):
        raise ValueError(f"background: expected red, green and blue in [0, 1], got {tuple(background)}")
    red, green, blue = (float(value) for value in background)
    return red, green, blue
