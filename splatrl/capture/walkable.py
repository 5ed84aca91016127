"""Where robots could walk in a splat that came without its cameras."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.capture.area import BESIDE, VOXEL, Area, whole_steps
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.voxels import Voxels
from splatrl.scenes.scene import Bounds, Scene

REACH = 6.0
"""Maximum distance from the most open place to the edge of the walkable area, along x and y, metres."""
ABOVE = 0.5
"""Minimum reach of the bounds above and below a robot's height, metres."""
CLOSED = 3
"""Number of voxels over which holes in a captured floor are closed."""
FEWEST = 16
"""Minimum number of voxels of free floor; with fewer, there is nowhere to walk."""
MOST_VOXELS = 256
"""Maximum number of voxels along the diagonal of where robots can be."""
VIEW = 2.0
"""Maximum margin around the walkable area that pictures of it show, metres."""


def walkable_area(scene: Scene, occupancy: Occupancy, floor: float, height: float) -> Area | None:
    """Find the free floor around the most open place, and what is solid there.

    Args:
        scene: the scene, world frame.
        occupancy: what is solid in the whole scene, coarsely.
        floor: height of the floor, world, metres.
        height: height of a robot's camera above the floor, metres.

    Returns:
        The area; None where too little floor is free at that height.
    """
    free = _free_floor(occupancy, floor, height)
    labels, count = ndimage.label(free)
    if count == 0:
        return None
    part = labels == 1 + int(np.bincount(labels.reshape(-1))[1:].argmax())
    if part.sum() < FEWEST:
        return None
    room = ndimage.distance_transform_edt(np.pad(part, 1))[1:-1, 1:-1]
    edge, origin = occupancy.resolution, np.array(occupancy.origin_key[:2])
    places = (np.argwhere(part) + origin + 0.5) * edge
    middle = (np.array(np.unravel_index(int(room.argmax()), room.shape)) + origin + 0.5) * edge
    near = places[(np.abs(places - middle) <= REACH).all(1)]
    walk, step = whole_steps(near)
    lower, upper = scene.bounds
    low = [max(walk[0][axis] - VIEW, min(lower[axis], walk[0][axis] - BESIDE)) for axis in range(2)]
    high = [min(walk[1][axis] + VIEW, max(upper[axis], walk[1][axis] + BESIDE)) for axis in range(2)]
    bottom = min(floor - 2 * VOXEL, floor + height - ABOVE)
    top = max(min(upper[2], floor + 2 * height + ABOVE), floor + height + ABOVE)
    bounds: Bounds = ((low[0], low[1], round(bottom, 3)), (high[0], high[1], round(top, 3)))
    diagonal = math.dist(*bounds)
    voxel = float(f"{max(VOXEL, diagonal / MOST_VOXELS):.2g}")
    solid = Occupancy.from_gaussians(scene.gaussians, voxel, crop=bounds)
    nothing = Voxels(np.zeros((0, 0, 0), bool), (0, 0, 0), voxel)
    return Area(bounds, walk, step, round(floor + height, 3), solid, nothing)


def _free_floor(occupancy: Occupancy, floor: float, height: float) -> NDArray[np.bool_]:
    """Return which columns of voxels have a floor and nothing solid above it up to a robot: [X, Y] bool."""
    edge, bottom = occupancy.resolution, occupancy.origin_key[2]
    top = max(bottom, math.ceil((floor + height + 2 * edge) / edge))
    low = min(max(bottom, math.floor((floor - 2 * edge) / edge)), top)
    foot = min(max(low, math.floor(floor / edge) + 2), top)
    solid = occupancy.occupied
    ground = solid[:, :, low - bottom : foot - bottom].any(2)
    ground = ndimage.binary_closing(np.pad(ground, CLOSED), iterations=CLOSED)[CLOSED:-CLOSED, CLOSED:-CLOSED]
    result: NDArray[np.bool_] = ground & ~solid[:, :, foot - bottom : top - bottom].any(2)
    return result
