"""Views of a scene as seen by a person standing in it."""

import math

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision.occupancy import Occupancy
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Bounds

FOV = math.radians(80.0)
_STEPS = 24
"""Number of candidate places along the longer side of the bounds."""


def eye_view(
    gaussians: Gaussians,
    occupancy: Occupancy,
    bounds: Bounds,
    floor: float,
    height: float,
    width: int = 960,
    rows: int = 640,
    antialiased: bool = True,
) -> Tensor:
    """Render a scene from a free place at eye height, looking across its middle.

    Args:
        gaussians: the scene's Gaussians, world frame.
        occupancy: what is solid; the viewer stands clear of it.
        bounds: lower and upper corner of the region in which to stand, metres.
        floor: height of the floor, world frame, metres; the view does not aim below it, and aims at it from above the
            bounds.
        height: height of the eye, world frame, metres.
        width: width of the image, pixels.
        rows: height of the image, pixels.
        antialiased: whether to render antialiased; False gives the classic 3DGS image.

    Returns:
        [rows, width, 3] uint8.
    """
    place = standing_place(occupancy, bounds, height)
    middle = 0.5 * (np.array(bounds[0]) + np.array(bounds[1]))
    away = float(np.hypot(*(middle[:2] - place)))
    drop = min(0.2 * away, height - floor) if height < bounds[1][2] else height - floor
    camera_to_world = look_at([*place, height], [*middle[:2].tolist(), height - drop])
    cameras = Cameras(camera_to_world[None], intrinsics(FOV, width, rows), width, rows)
    return NativeRenderer(gaussians, antialiased).pixels(cameras)[0].cpu()


def standing_place(occupancy: Occupancy, bounds: Bounds, height: float) -> list[float]:
    """Choose a place [x, y] within bounds that is far from anything solid at a height, and far from the middle.

    Args:
        occupancy: what is solid.
        bounds: lower and upper corner, metres.
        height: height at which to look for solid things, world frame, metres.
    """
    lower, upper = np.array(bounds)
    side = float((upper - lower)[:2].max()) or 1.0
    x, y = (
        low + (np.arange(count) + 0.5) * (high - low) / count
        for low, high in zip(lower[:2], upper[:2], strict=True)
        for count in [max(1, math.ceil(_STEPS * (high - low) / side))]
    )
    places = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    solid = np.zeros(places.shape[:2], bool)
    for level in height + 0.02 * side * np.arange(-3, 2):
        points = np.concatenate([places, np.full((*places.shape[:2], 1), level)], -1).reshape(-1, 3)
        solid |= occupancy.contains(torch.from_numpy(points)).reshape(solid.shape)
    clearance = ndimage.distance_transform_edt(np.pad(~solid, 1, constant_values=True))[1:-1, 1:-1] * side / _STEPS
    away = np.linalg.norm(places - 0.5 * (lower + upper)[:2], axis=-1)
    worth = np.where(solid, 0.0, np.minimum(clearance, 0.15 * side) * (away + 0.02 * side))
    best: list[float] = places.reshape(-1, 2)[worth.argmax()].tolist()
    return best


def open_corner(occupancy: Occupancy) -> int:
    """Find the corner that hides the least of the rest from view, as ``quarter_turns`` of ``draw_blocks``.

    Args:
        occupancy: what is solid.
    """
    x, y, z = (count // 2 for count in occupancy.occupied.shape)
    high = occupancy.occupied[:, :, z:]
    quarters = [high[:x, :y], high[:x, y:], high[x:, y:], high[x:, :y]]
    return int(np.argmin([quarter.sum() for quarter in quarters]))
