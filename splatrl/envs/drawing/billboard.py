"""Compositing a sprite, placed in the world, over rendered images."""

from math import prod
from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.envs.drawing.base import HAZE
from splatrl.envs.drawing.sprite import TAPS, Sprite

ALPHA_STEPS = 65536
"""Alpha is summed as integer multiples of 1/65536, so that the order of summation does not affect the result."""


class _Taps(NamedTuple):
    """The texels that pixels read along one axis.

    Attributes:
        first: [B, N] int64, the first of the ``TAPS`` texels of each pixel.
        weights: [B, N, TAPS] float32, weight of each texel.
        inside: [B, N] bool, whether the pixel overlaps the sprite at all.
    """

    first: Tensor
    weights: Tensor
    inside: Tensor


def overlay(
    pixels: Tensor,
    depth: Tensor,
    camera_to_world: Tensor,
    K: Tensor,
    target: Tensor,
    sprite: Sprite,
    size: float,
    near: float = 0.05,
    only: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Draw a sprite at a position in the world, occluded by anything nearer.

    The sprite is a billboard parallel to the image plane and upright in the image, so all of it lies at the depth of
    its centre along the optical axis. Its colour in a pixel is the mean over the pixel's area, or over one texel's area
    where that is larger (a magnified sprite is interpolated linearly); a sprite smaller than a pixel fades in
    proportion to its area. Each image is drawn independently of the rest of the batch.

    Args:
        pixels: [..., H, W, 3] uint8, the rendered images.
        depth: [..., H, W] float32, depth of the images along the optical axis, metres, infinite where nothing is seen.
        camera_to_world: [..., 4, 4] float32, metres, OpenCV camera axes.
        K: [3, 3] float32 intrinsics in pixels.
        target: [..., 3] or [3] float32, centre of the sprite, world, metres.
        sprite: the sprite to draw.
        size: width of the sprite, metres.
        near: near plane, metres: a sprite closer than this along the optical axis, or behind the camera, is not drawn.
        only: [...] bool, which images to draw over; None draws over all.

    Returns:
        The images [..., H, W, 3] uint8; the fraction of each that the sprite covers [..., 1] float32, which is the mean
        of its alpha over the pixels; and their depth [..., H, W] float32, which is the sprite's where its alpha is at
        least ``HAZE``.
    """
    *batch, height, width, _ = pixels.shape
    count = prod(batch)
    assert depth.shape == pixels.shape[:-1], (depth.shape, pixels.shape)
    places = target.expand(*batch, 3).reshape(count, 3)
    column, row, distance = _project(camera_to_world.reshape(count, 4, 4), K, places)
    shown = distance >= near if only is None else (distance >= near) & only.reshape(count)
    distance = distance.clamp_min(near)
    wide, high = K[0, 0] * size / distance, K[1, 1] * size * sprite.aspect / distance  # pixels, [B]
    level = _level(sprite, wide, high)
    least = (level == 0).float()  # minimum texels per pixel: 1 at the finest level, which may be magnified, else 0
    across = _taps(column - wide / 2, wide, width, sprite.widths[level], least)
    down = _taps(row - high / 2, high, height, sprite.heights[level], least)
    inside = ((down.inside & shown.unsqueeze(1)).unsqueeze(2) & across.inside.unsqueeze(1)).flatten()  # [B H W]
    points = _points(inside)
    image, place = points // (height * width), points % (height * width)
    behind, ahead = depth.flatten().index_select(0, points), distance.index_select(0, image)
    visible = inside.index_select(0, points) & (behind >= ahead)
    color = _sample(sprite, level, image, down, place // width, across, place % width) * visible.unsqueeze(1)
    drawn = pixels.reshape(-1, 3).clone()
    under = drawn.index_select(0, points)
    drawn[points] = (under * (1 - color[:, 3:]) + color[:, :3] + 0.5).floor().to(torch.uint8)
    cover = torch.zeros(len(inside), dtype=torch.int64, device=pixels.device)
    cover[points] = (color[:, 3] * ALPHA_STEPS).round().long()
    share = cover.view(count, height * width).sum(1).double() / (ALPHA_STEPS * height * width)
    solid = depth.flatten().clone()
    solid[points] = torch.where(color[:, 3] >= HAZE, ahead, behind)
    return drawn.view(pixels.shape), share.float().view(*batch, 1), solid.view(depth.shape)


def _points(inside: Tensor) -> Tensor:
    """Return the indices of pixels to draw: the sprite's rectangle, or all on a GPU, where ``nonzero`` would block."""
    if inside.device.type == "cpu":
        return inside.nonzero().squeeze(1)
    return torch.arange(len(inside), device=inside.device)


def _project(camera_to_world: Tensor, K: Tensor, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Project points to column, row and depth, [B] each; column and row are meaningless unless the depth is positive.

    Written as sums of products, because the rounding of a matrix product may depend on the batch size.
    """
    offset = (target - camera_to_world[:, :3, 3]).unsqueeze(2) * camera_to_world[:, :3, :3]
    x, y, z = (offset[:, 0] + offset[:, 1] + offset[:, 2]).unbind(1)
    safe = torch.where(z > 0, z, 1.0)
    return K[0, 0] * x / safe + K[0, 2], K[1, 1] * y / safe + K[1, 2], z


def _level(sprite: Sprite, wide: Tensor, high: Tensor) -> Tensor:
    """Choose the mip level at which a pixel covers one to two texels along its more minified axis: [B] int64."""
    ratio = torch.maximum(sprite.widths[0] / wide, sprite.heights[0] / high)
    return (torch.frexp(ratio).exponent.long() - 1).clamp(0, len(sprite.starts) - 1)  # exact, unlike log2


def _taps(begin: Tensor, extent: Tensor, pixels: int, texels: Tensor, least: Tensor) -> _Taps:
    """Find the texels that each pixel covers along an axis, and their weights.

    Args:
        begin: [B] position at which the sprite begins, pixels.
        extent: [B] length of the sprite, pixels.
        pixels: size of the image along the axis, pixels.
        texels: [B] size of the sprite's mip level along the axis, texels.
        least: [B] minimum number of texels that a pixel reads, even if it covers fewer.
    """
    scale = (texels / extent).unsqueeze(1)  # texels per pixel
    centers = torch.arange(pixels, device=begin.device) + 0.5 - begin.unsqueeze(1)
    reach = scale.maximum(least.unsqueeze(1))
    lower = centers * scale - reach / 2
    upper = lower + reach
    first = lower.clamp_min(0).floor().long().minimum((texels - TAPS).clamp_min(0).unsqueeze(1))
    edges = (first.unsqueeze(2) + torch.arange(TAPS + 1, device=begin.device)).float()
    ends = edges.maximum(lower.unsqueeze(2)).minimum(upper.unsqueeze(2))
    weights = (ends[..., 1:] - ends[..., :-1]).clamp_min(0) / reach.unsqueeze(2)
    return _Taps(first, weights, (upper > 0) & (lower < texels.unsqueeze(1)))


def _sample(
    sprite: Sprite, level: Tensor, image: Tensor, down: _Taps, row: Tensor, across: _Taps, column: Tensor
) -> Tensor:
    """Sample the premultiplied sprite colours of N pixels, each in its own image: [N, 4]."""
    stride = sprite.widths.clamp_min(TAPS)[level].index_select(0, image)
    line = image * down.first.shape[1] + row
    pile = image * across.first.shape[1] + column
    first = sprite.starts[level].index_select(0, image)
    first = first + down.first.flatten().index_select(0, line) * stride + across.first.flatten().index_select(0, pile)
    heights, widths = (
        down.weights.flatten(0, 1).index_select(0, line),
        across.weights.flatten(0, 1).index_select(0, pile),
    )
    color = torch.zeros(len(image), 4, device=image.device)
    for j in range(TAPS):
        for i in range(TAPS):
            texels = sprite.texels.index_select(0, first + (j * stride + i))
            color = color + texels * (heights[:, j] * widths[:, i]).unsqueeze(1)
    return color
