"""The reference that the fast renderers are tested against: plain torch, any device, any float type, differentiable."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.renderers.base import (
    RenderOutput,
    checked_background,
    draw_only,
    gaussians_of,
    models_of,
    require_cameras,
    require_drawable,
    to_pixels,
)
from splatrl.renderers.parts import ABSENT, Parts, camera_to_models, checked_parts
from splatrl.scenes.gaussians import GREY_LEVEL, INVISIBLE, Gaussians
from splatrl.scenes.scene import Scene
from splatrl.spherical_harmonics import sh_colors

NEAR = 0.01
"""Near plane, metres: a Gaussian whose mean is nearer along the optical axis is not drawn."""
DILATION = 0.3
"""Square pixels added to every projected covariance, so that a Gaussian covers at least about one pixel."""
MAX_ALPHA = 0.999
MIN_TRANSMITTANCE = 1e-4
"""A pixel is finished before the first Gaussian that would reduce its transmittance to this or less."""
TILE = 16
"""Edge of a tile, pixels; a tile only considers the Gaussians whose bounds touch it."""
CHUNK = 2048
"""Gaussians blended at a time; bounds the memory of a tile."""


class Projected(NamedTuple):
    """The G Gaussians that one camera can see, nearest first.

    Attributes:
        centers: [G, 2] pixels.
        conics: [G, 3] the inverse covariance on the image, (xx, xy, yy), 1 / square pixels.
        extents: [G, 2] half sizes of the box in which each can be visible, pixels.
        opacities: [G].
        colors: [G, 3].
        depths: [G] metres.
    """

    centers: Tensor
    conics: Tensor
    extents: Tensor
    opacities: Tensor
    colors: Tensor
    depths: Tensor


class ReferenceRenderer:
    """Renders Gaussians by elliptical weighted average splatting (Zwicker et al. 2001, Kerbl et al. 2023).

    The conventions are gsplat's. Gradients flow to the Gaussians of every model and to the poses of parts. The output
    has the float type of the Gaussians.

    Args:
        scene: the scene, or its Gaussians; or a sequence of models, which ``Parts.model`` indexes.
        antialiased: preserve the energy of Gaussians smaller than a pixel (Mip-Splatting, Yu et al. 2024): the opacity
            is reduced by as much as dilation enlarges the area. False renders classic 3DGS images.
        background: colour behind the Gaussians, in [0, 1].
        device: the device that renders; None uses that of the Gaussians.

    Raises:
        ValueError: for Gaussians that cannot be drawn.
    """

    def __init__(
        self,
        scene: Scene | Gaussians | Sequence[Scene | Gaussians],
        antialiased: bool = True,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        device: torch.device | str | None = None,
    ) -> None:
        models = [gaussians_of(model) for model in models_of(scene)]
        for model in models:
            require_drawable(model)
        self.models = models if device is None else [model.to(device) for model in models]
        self.antialiased = antialiased
        self.background = checked_background(background)
        self.invisible = INVISIBLE if antialiased else GREY_LEVEL

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Render colour, depth and alpha for each camera, on the device and in the float type of the Gaussians.

        See ``Renderer``.
        """
        return draw_only(self._rendered, cameras, checked_parts(parts, cameras, len(self.models)), only)

    def _rendered(self, cameras: Cameras, parts: Parts | None) -> RenderOutput:
        require_cameras(cameras)
        shape = (len(cameras), cameras.height, cameras.width)
        outputs = self.models[0].means.new_zeros(*shape, 5)
        background = outputs.new_tensor(self.background)
        for row in range(len(cameras)):
            projected = self._seen(cameras, parts, row)
            for top in range(0, cameras.height, TILE):
                for left in range(0, cameras.width, TILE):
                    bottom, right = min(top + TILE, cameras.height), min(left + TILE, cameras.width)
                    tile = blend(projected, left, top, right, bottom, self.invisible)
                    outputs[row, top:bottom, left:right] = tile
        rgb, weighted_depth, alpha = outputs[..., :3], outputs[..., 3], outputs[..., 4]
        rgb = rgb + (1 - alpha).unsqueeze(-1) * background
        covered = alpha > 0
        depth = torch.where(covered, weighted_depth / torch.where(covered, alpha, 1.0), 0.0)
        return RenderOutput(rgb.clamp(0.0, 1.0), depth, alpha)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """Render the pixels of an observation: [B, H, W, 3] uint8."""

        def quantised(
            some: Cameras, their: Parts | None
        ) -> Tensor:  # quantise before rows are spread out, so that rows that are not drawn are zero
            return to_pixels(self._rendered(some, their).rgb)

        with torch.no_grad():
            return draw_only(quantised, cameras, checked_parts(parts, cameras, len(self.models)), only)

    def _seen(self, cameras: Cameras, parts: Parts | None, row: int) -> Projected:
        """Project all parts for one camera; at equal depths, the part that comes first is in front."""
        if parts is None:
            return self.project(self.models[0], cameras, row)
        one = slice(row, row + 1)
        poses = camera_to_models(cameras[one], parts.rows(one))[0]  # [M, 4, 4]
        in_models = Cameras(poses, cameras.K[row], cameras.width, cameras.height)
        seen = [self.project(self.models[0][:0], cameras, row)]  # an empty start, since a row may have no parts
        for part, model in enumerate(parts.model[row].tolist()):
            if model != ABSENT:
                seen.append(self.project(self.models[model], in_models, part))
        joined = [torch.cat(values) for values in zip(*seen, strict=True)]
        order = joined[-1].argsort(stable=True)
        return Projected(*(value[order] for value in joined))

    def project(self, gaussians: Gaussians, cameras: Cameras, row: int) -> Projected:
        """Project a model onto the image of one camera (EWA splatting, eq. 29 to 31 of Zwicker et al. 2001).

        Args:
            gaussians: the model's Gaussians.
            cameras: B cameras in the frame of the model.
            row: index of the camera to use, 0 to B - 1.

        Returns:
            The Gaussians beyond the near plane, nearest first.
        """
        means = gaussians.means
        camera_to_world, K = cameras.camera_to_world[row].to(means), cameras.K[row].to(means)
        turn = camera_to_world[:3, :3].mT  # from the world's axes to the camera's
        offsets = means - camera_to_world[:3, 3]  # subtracted before turning, since both may be far from the origin
        seen = turn @ offsets.mT  # [3, N], camera frame
        kept = (seen[2] >= NEAR).nonzero().squeeze(-1)
        kept = kept[seen[2, kept].argsort(stable=True)]
        visible = gaussians[kept]
        x, y, z = seen[:, kept]

        covariances = project_covariances(turn @ visible.covariances() @ turn.mT, x, y, z, K, cameras)
        xx, xy, yy = covariances[:, 0, 0] + DILATION, covariances[:, 0, 1], covariances[:, 1, 1] + DILATION
        determinants = xx * yy - xy * xy
        opacities = visible.opacities
        if self.antialiased:
            opacities = opacities * (covariances.det() / determinants).clamp_min(1e-12).sqrt()  # no gradient at 0
        reach = 2 * (opacities.detach().clamp_min(self.invisible) / self.invisible).log()  # squared standard deviations
        directions = torch.nn.functional.normalize(offsets[kept], dim=-1)
        return Projected(
            centers=torch.stack([K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]], -1),
            conics=torch.stack([yy, -xy, xx], -1) / determinants.unsqueeze(-1),
            extents=(reach.unsqueeze(-1) * torch.stack([xx, yy], -1).detach()).sqrt() * 1.001 + 0.001,
            opacities=opacities,
            colors=sh_colors(visible.sh, directions),
            depths=z,
        )


def project_covariances(covariances: Tensor, x: Tensor, y: Tensor, z: Tensor, K: Tensor, cameras: Cameras) -> Tensor:
    """Project covariances with the Jacobian of the pinhole at the mean.

    The point of linearisation is clamped to 0.15 image sizes beyond the image; further out, the Jacobian blows up.

    Args:
        covariances: [G, 3, 3] camera frame, square metres.
        x: [G] x of the means in the camera frame, metres.
        y: [G] y of the means in the camera frame, metres.
        z: [G] z of the means in the camera frame, metres, at least ``NEAR``.
        K: [3, 3] intrinsics, pixels.
        cameras: cameras that give the size of the image.

    Returns:
        [G, 2, 2] square pixels.
    """
    margin_x, margin_y = 0.15 * cameras.width / K[0, 0], 0.15 * cameras.height / K[1, 1]
    slope_x = (x / z).clamp(-K[0, 2] / K[0, 0] - margin_x, (cameras.width - K[0, 2]) / K[0, 0] + margin_x)
    slope_y = (y / z).clamp(-K[1, 2] / K[1, 1] - margin_y, (cameras.height - K[1, 2]) / K[1, 1] + margin_y)
    zero = torch.zeros_like(z)
    jacobians = torch.stack(
        [K[0, 0] / z, zero, -K[0, 0] * slope_x / z, zero, K[1, 1] / z, -K[1, 1] * slope_y / z], -1
    ).unflatten(-1, (2, 3))
    return jacobians @ covariances @ jacobians.mT


def blend(projected: Projected, left: int, top: int, right: int, bottom: int, invisible: float) -> Tensor:
    """Blend the Gaussians over one tile, front to back.

    Args:
        projected: the Gaussians, nearest first.
        left: left edge of the tile, pixels: its first column.
        top: top edge of the tile, pixels: its first row.
        right: right edge of the tile, pixels: the column after its last.
        bottom: bottom edge of the tile, pixels: the row after its last.
        invisible: opacity below which a Gaussian is not visible.

    Returns:
        [bottom - top, right - left, 5]: red, green, blue, the sum of depths times blending weights in metres, alpha.
    """
    like = projected.centers
    low, high = like.new_tensor([left, top]), like.new_tensor([right, bottom])
    touches = ((projected.centers + projected.extents > low) & (projected.centers - projected.extents < high)).all(1)
    chosen = touches.nonzero().squeeze(-1)
    columns = torch.arange(left, right, dtype=like.dtype, device=like.device) + 0.5
    rows = torch.arange(top, bottom, dtype=like.dtype, device=like.device) + 0.5
    points = torch.cartesian_prod(rows, columns).flip(-1)  # [P, 2], x then y
    blended = like.new_zeros(points.shape[0], 5)
    transmittance = like.new_ones(points.shape[0], 1)
    for chunk in chosen.split(CHUNK):
        alphas = alpha_at(points, Projected(*(value[chunk] for value in projected)), invisible)  # [P, G]
        after = transmittance * (1 - alphas).cumprod(1)
        before = torch.cat([transmittance, after[:, :-1]], 1)
        shares = torch.where(after > MIN_TRANSMITTANCE, alphas * before, 0.0)
        values = torch.cat([projected.colors[chunk], projected.depths[chunk, None]], 1)
        blended = blended + torch.cat([shares @ values, shares.sum(1, keepdim=True)], 1)
        transmittance = after[:, -1:]
        if bool((transmittance <= MIN_TRANSMITTANCE).all()):
            break
    return blended.unflatten(0, (bottom - top, right - left))


def alpha_at(points: Tensor, projected: Projected, invisible: float) -> Tensor:
    """Return the opacity of each Gaussian at each point, 0 where it is invisible: [P, 2] pixels -> [P, G]."""
    dx, dy = (points[:, None] - projected.centers).unbind(-1)
    xx, xy, yy = projected.conics.unbind(-1)
    sigmas = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
    alphas = (projected.opacities * (-sigmas).exp()).clamp_max(MAX_ALPHA)
    return torch.where(alphas >= invisible, alphas, 0.0)
