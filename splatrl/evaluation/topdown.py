"""Backgrounds of figures and videos: a scene seen from above, and what is solid in it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatrl.cameras import Cameras, look_at
from splatrl.collision.occupancy import Occupancy
from splatrl.envs.tasks.base import Mark
from splatrl.renderers import NativeRenderer
from splatrl.renderers.base import Renderer
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import robust_bounds

Window = tuple[list[float], list[float]]
"""Lower and upper corner of a window, x and y in metres."""

DISTANCE = 500.0
"""Camera height, in lengths of the window: a metre of height then shifts a point by at most 1.5 millimetres."""
DEPTH = 10.0
"""Default depth below the cut, in metres, beyond which things are left out, such as the lower half of a sky dome."""
MARGIN = 0.4
"""Minimum distance by which a map extends beyond the outermost pose, metres."""
AROUND = 0.25
"""Maximum of that distance where the place continues, as a fraction of the longer side of the poses' area."""
NARROWEST = 3.0
"""Longer side of a map, at most, in shorter sides: on the strip that a corridor is, nothing could be read."""
WIDER = 1.5
"""An overview is worth drawing if its longer side is at least this many times the map's."""
WIDEST = 12.0
"""Maximum longer side of an overview, in sides of the map: open country may extend to the horizon beyond."""


class TopDown(NamedTuple):
    """A picture of a window of the world, with +x to the right and +y up.

    Attributes:
        image: [H, W, 3] uint8, row 0 at the largest y.
        extent: left, right, bottom and top edge of the image, metres, in the order of matplotlib's ``extent``.
    """

    image: Tensor
    extent: tuple[float, float, float, float]

    @property
    def pixels_per_metre(self) -> float:
        """Resolution of the picture, the same along x and y."""
        return self.image.shape[1] / (self.extent[1] - self.extent[0])


@dataclass(frozen=True)
class MapView:
    """Background and marks over which maps and charts are drawn.

    Attributes:
        ground: the scene seen from above.
        solid: [H, W] bool mask of the ground's pixels that are solid at the height of the body (``footprint``).
        marks: marks that the task shows in every episode.
        overview: the whole place seen from above, out to its walls; None if the ground shows nearly all of it.
    """

    ground: TopDown
    solid: Tensor | None = None
    marks: Sequence[Mark] = ()
    overview: TopDown | None = None


def top_down(
    gaussians: Gaussians,
    lower: Sequence[float],
    upper: Sequence[float],
    below: float,
    size: int = 720,
    make_renderer: Callable[[Gaussians], Renderer] = NativeRenderer,
    depth: float = DEPTH,
) -> TopDown:
    """Render a window of a scene from straight above, in a nearly orthographic view.

    Only what lies below ``below`` is shown, so that ceilings, tree crowns and the sky do not hide the floor. Gaussians
    that can only be sky are left out as well: those larger than the window, or farther from it than its longer side.
    A window in which nothing is left shows the background.

    Args:
        gaussians: the scene's Gaussians, world frame.
        lower: smallest x and y of the window, metres.
        upper: largest x and y of the window, metres.
        below: height of the cut, metres.
        size: longer side of the picture, pixels. The shorter side is rounded up to a whole number of pixels, and the
            window grows with it, about its centre.
        make_renderer: the renderer's class, or anything that turns Gaussians into a renderer.
        depth: depth below the cut beyond which things are left out, metres.

    Raises:
        ValueError: for a window that has no area.
    """
    (left, bottom), (right, top) = lower, upper
    side = max(right - left, top - bottom)
    if not (math.isfinite(side) and right > left and top > bottom):
        raise ValueError(f"top_down: expected a window with lower < upper, got {list(lower)} and {list(upper)}")
    metres = side / size  # per pixel
    width, height = (max(1, math.ceil(length / metres - 1e-6)) for length in (right - left, top - bottom))
    x, y = 0.5 * (left + right), 0.5 * (bottom + top)
    shown = _floor(gaussians, (x, y), (right - left + 2 * side, top - bottom + 2 * side), side, below, depth)
    distance = DISTANCE * side
    focal = distance / metres
    K = torch.tensor([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])
    camera_to_world = look_at([x, y, below + distance], [x, y, below])
    image = make_renderer(gaussians[shown]).pixels(Cameras(camera_to_world[None], K, width, height))[0]
    half = 0.5 * metres * width, 0.5 * metres * height
    return TopDown(image.cpu(), (x - half[0], x + half[0], y - half[1], y + half[1]))


def map_window(
    gaussians: Gaussians, lower: Sequence[float], upper: Sequence[float], below: float
) -> tuple[Window, Window | None]:
    """Choose the window of a map around some poses, and that of an overview that extends to the walls.

    Args:
        gaussians: the scene's Gaussians, world frame.
        lower: smallest x and y of the poses, metres.
        upper: largest x and y of the poses, metres.
        below: height of the cut, metres.

    Returns:
        Both windows; None for the overview if the map shows nearly all of the place.
    """
    height = gaussians.means[:, 2]
    inside = (height < below) & (height > below - DEPTH)
    place = [corner[:2] for corner in robust_bounds(gaussians[inside])] if inside.any() else [lower, upper]
    around = max(MARGIN, AROUND * max(high - low for low, high in zip(lower, upper, strict=True)))
    low = [min(x - MARGIN, max(x - around, edge)) for x, edge in zip(lower, place[0], strict=True)]
    high = [max(x + MARGIN, min(x + around, edge)) for x, edge in zip(upper, place[1], strict=True)]
    side = max(b - a for a, b in zip(low, high, strict=True))
    short = [max(0.0, 0.5 * (side / NARROWEST - (b - a))) for a, b in zip(low, high, strict=True)]
    low = [edge - more for edge, more in zip(low, short, strict=True)]
    high = [edge + more for edge, more in zip(high, short, strict=True)]
    reach = 0.5 * (WIDEST - 1.0) * side
    wide_low = [max(min(a, edge - MARGIN), a - reach) for a, edge in zip(low, place[0], strict=True)]
    wide_high = [min(max(b, edge + MARGIN), b + reach) for b, edge in zip(high, place[1], strict=True)]
    wide = max(b - a for a, b in zip(wide_low, wide_high, strict=True))
    return (low, high), (wide_low, wide_high) if wide >= WIDER * side else None


def _floor(
    gaussians: Gaussians,
    center: tuple[float, float],
    size: tuple[float, float],
    widest: float,
    below: float,
    depth: float,
) -> Tensor:
    means = gaussians.means
    beside = (means[:, :2] - means.new_tensor(center)).abs() <= 0.5 * means.new_tensor(size)
    small = gaussians.scales.amax(1) <= widest
    return beside.all(1) & small & (means[:, 2] < below) & (means[:, 2] > below - depth)


def footprint(occupancy: Occupancy, low: float, high: float, ground: TopDown) -> Tensor:
    """Mask what is solid between two heights in a top-down picture.

    Args:
        occupancy: the scene's occupancy.
        low: lower of the two heights, metres.
        high: upper of the two heights, metres.
        ground: the top-down picture.

    Returns:
        [H, W] bool, true where the pixel's centre lies over a solid voxel.
    """
    left, _, _, top = ground.extent
    height, width = ground.image.shape[:2]
    x = left + (np.arange(width) + 0.5) / ground.pixels_per_metre
    y = top - (np.arange(height) + 0.5) / ground.pixels_per_metre
    origin = np.array(occupancy.origin_key)
    bottom, ceiling = (round_(z / occupancy.resolution) for round_, z in ((math.floor, low), (math.ceil, high)))
    layers = occupancy.occupied[:, :, max(bottom - origin[2], 0) : max(ceiling - origin[2], 0)].any(2)
    padded = np.pad(layers, 1)  # empty padding, since everything outside the grid is free
    column, row = (
        (np.floor(at / occupancy.resolution).astype(int) - key + 1).clip(0, count - 1)
        for at, key, count in zip((x, y), origin, padded.shape, strict=False)
    )
    return torch.from_numpy(padded[np.ix_(column, row)].T.copy())
