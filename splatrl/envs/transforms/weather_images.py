"""Rendering weather into images: dusk and sun, fog, rain and snow, and drops on the lens."""

from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.envs.transforms.native_images import cores_for, in_core
from splatrl.envs.transforms.weather_patterns import RAIN, SNOW, lens, pattern
from splatrl.native import _core

SKY = (0.80, 0.83, 0.86)
"""Colour of fog in daylight, sRGB."""
STREAK, FLAKE = (0.86, 0.89, 0.93), (0.97, 0.97, 0.99)
"""Colours of rain and of snow in daylight, sRGB."""
NIGHT = (0.86, 0.95, 1.12)
"""Colour gains at full dusk, when light is bluer."""
MIST = 0.05
"""Additional fog in the heaviest rain or snow, extinction per metre."""
GLOOM = 0.22
"""Fraction of the light that is lost in the heaviest rain."""
GAMMA = 2.2
LAYERS = len(RAIN)
"""Number of layers, one behind the other, in which rain and snow fall."""


@cache
def _colors(device: torch.device) -> tuple[Tensor, ...]:
    """Return ``SKY``, ``STREAK``, ``FLAKE`` and ``NIGHT`` on a device, [3] float32; cached: copying blocks the host."""
    return tuple(torch.tensor(color, device=device) for color in (SKY, STREAK, FLAKE, NIGHT))


class Light(NamedTuple):
    """Light and fog of a batch of images.

    Attributes:
        tint: [B, 3] float32, colour gains of the light.
        veil: [B, 3] float32, colour of the fog.
        left: [B, H, W] float32, transmittance of the fog; None without fog.
    """

    tint: Tensor
    veil: Tensor
    left: Tensor | None


class Falling(NamedTuple):
    """Rain or snow over a batch of images.

    Attributes:
        strength: [B] float32, 0 to 1.
        wind: [B] float32, slant of the streaks, columns per row.
        snows: [B] bool, true for snow, false for rain.
        begin: [B, ``LAYERS``, 2] float32 in [0, 1), offset of each layer within its pattern.
        color: [B, 3] float32, colour of streaks or flakes.
    """

    strength: Tensor
    wind: Tensor
    snows: Tensor
    begin: Tensor
    color: Tensor


class Wet(NamedTuple):
    """Drops on the lens, for a batch of images.

    Attributes:
        strength: [B] float32, 0 to 1.
        begin: [B, 2] float32, offset of each lens within the pattern.
    """

    strength: Tensor
    begin: Tensor


def light(weather: Tensor, far: Tensor | None) -> Light:
    """Compute light and fog from the weather.

    Fog leaves the fraction exp(−fog · depth) of the light (Koschmieder's law).

    Args:
        weather: [B, 11] float32; see ``Weather``.
        far: [B, H, W] float32, metres; without it there is no fog.
    """
    fog, dusk, rain, snow = (weather[:, number] for number in (0, 1, 5, 6))
    sky, _, _, night = _colors(weather.device)
    bright = (((1 - dusk) * (1 - GLOOM * rain)).log() / GAMMA).exp()  # unlike a power, with the same bytes in any batch
    tint = weather[:, 2:5] * bright[:, None] * (1 + dusk[:, None] * (night - 1))
    left = None
    if far is not None:
        thick = (fog + MIST * (rain + snow))[:, None, None]
        left = torch.where(thick > 0, torch.exp(-thick * far), 1.0)  # depth may be infinite
    return Light(tint, sky * tint, left)


def falling(weather: Tensor, tint: Tensor, begin: Tensor) -> Falling:
    """Return rain or snow, whichever is stronger, from weather, tint and offsets.

    Takes [B, 11], [B, 3] and [B, ``LAYERS``, 2] float32.
    """
    rain, snow, wind = (weather[:, number] for number in (5, 6, 8))
    snows = snow > rain
    _, streak, flake, _ = _colors(weather.device)
    color = torch.where(snows[:, None], flake, streak)
    return Falling(torch.maximum(rain, snow), torch.where(snows, 0.0, wind), snows, begin, color * tint)


def put_into(
    pixels: Tensor, seen: Light, far: Tensor | None, things: Falling | None = None, drops: Wet | None = None
) -> Tensor:
    """Apply weather to images: [B, H, W, 3] uint8 -> [B, H, W, 3] uint8.

    Args:
        pixels: the images.
        seen: light and fog.
        far: [B, H, W] float32, depth in metres, which occludes rain and snow behind it; None occludes nothing.
        things: rain or snow.
        drops: drops on the lens.
    """
    if in_core(pixels):
        return _by_core(pixels, seen, far, things, drops)
    colors = pixels.float() / 255 * seen.tint[:, None, None]
    if seen.left is not None:
        left = seen.left.unsqueeze(-1)
        colors = colors * left + (1 - left) * seen.veil[:, None, None]
    if things is not None:
        cover = _covered(things, far, pixels.shape[1:3]).unsqueeze(-1)
        colors = colors + cover * (things.color[:, None, None] - colors)
    if drops is not None:
        colors = _through_drops(colors, drops)
    return (255 * colors + 0.5).floor().clamp(0, 255).to(torch.uint8)


def _by_core(pixels: Tensor, seen: Light, far: Tensor | None, things: Falling | None, drops: Wet | None) -> Tensor:
    """Do the same as ``put_into`` in the C++ core, in one pass over each image."""
    (height, width), device, out = pixels.shape[1:3], pixels.device, torch.empty_like(pixels).contiguous()
    over, on = None, None
    if things is not None:
        drawn = pattern((*RAIN, *SNOW), height, width, device)
        over = drawn.cover, drawn.rank, drawn.distance, *(one.contiguous() for one in things)
    if drops is not None:
        glass = lens(height, width, device)
        on = glass.shift, glass.cover, glass.rank, glass.shine, *(one.contiguous() for one in drops)
    _core.put_into_weather(
        pixels.contiguous(),
        seen.tint.contiguous(),
        seen.veil.contiguous(),
        None if seen.left is None else seen.left.contiguous(),
        None if far is None else far.contiguous(),
        over,
        on,
        out,
        cores_for(pixels),
    )
    return out


def _texels(begin: Tensor, tall: int, wide: int) -> tuple[Tensor, Tensor]:
    """Convert offsets within a pattern, [B, 2] float32, to rows and columns, [B, 1] int64 each."""
    return (begin[:, :1] * tall).long(), (begin[:, 1:] * wide).long()


def _covered(things: Falling, far: Tensor | None, size: torch.Size) -> Tensor:
    """Return the fraction of each pixel that rain or snow covers: [B, H, W]."""
    (height, width), count, device = size, len(things.strength), things.strength.device
    over = pattern((*RAIN, *SNOW), height, width, device)
    _, tall, wide = over.cover.shape
    y, x = torch.arange(height, device=device), torch.arange(width, device=device)
    lean = (things.wind[:, None] * y).round().long()  # [B, H]
    clear = torch.ones(count, height, width, device=device)
    for near in range(LAYERS):
        layer = near + LAYERS * things.snows[:, None].long()  # [B, 1]
        down, along = _texels(things.begin[:, near], tall, wide)
        rows, columns = (down + y) % tall + layer * tall, (along - lean).unsqueeze(-1) + x  # [B, H], [B, H, W]
        texel = (rows.unsqueeze(-1) * wide + columns % wide).flatten()
        cover, rank = (texels.flatten().index_select(0, texel).view(clear.shape) for texels in (over.cover, over.rank))
        shows = rank < things.strength[:, None, None]
        if far is not None:
            shows &= far > over.distance[layer].unsqueeze(-1)
        clear = clear * (1 - cover * shows)
    return 1 - clear


def _through_drops(colors: Tensor, drops: Wet) -> Tensor:
    """Return images as seen through a wet lens: [B, H, W, 3]."""
    count, height, width, _ = colors.shape
    on = lens(height, width, colors.device)
    tall, wide = on.cover.shape
    y, x = torch.arange(height, device=colors.device), torch.arange(width, device=colors.device)
    down, along = _texels(drops.begin, tall, wide)
    texel = (((down + y) % tall)[:, :, None] * wide + ((along + x) % wide)[:, None, :]).flatten()  # [B H W]

    def of(texels: Tensor) -> Tensor:
        return texels.flatten().index_select(0, texel).view(count, height, width)

    cover = (of(on.cover) * (of(on.rank) < drops.strength[:, None, None])).unsqueeze(-1)
    source_row = (y[:, None] + of(on.shift[..., 0])).clamp(0, height - 1)
    source = source_row * width + (x + of(on.shift[..., 1])).clamp(0, width - 1)
    first = torch.arange(count, device=colors.device).view(count, 1, 1) * (height * width)
    bent = colors.view(-1, 3).index_select(0, (first + source).flatten()).view(colors.shape)
    bent = bent + of(on.shine).unsqueeze(-1) * (0.25 + bent.mean(-1, keepdim=True))
    return colors + cover * (bent - colors)
