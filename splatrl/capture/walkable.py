"""Where robots could walk in a splat that came without its cameras."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.capture.area import BESIDE, VOXEL, Area, whole_steps
from splatrl.capture.lattice import Walk, aligned
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.voxel_grid import within
from splatrl.collision.voxels import Voxels
from splatrl.scenes.scene import OPAQUE, Bounds, Scene

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
AROUND, SPARSE = 0.5, 0.1
"""Standard deviation, metres, of the window in which the Gaussians around a place are counted, and the fraction of
their usual number below which a place belongs to the background: a capture shows its surroundings with far fewer."""


def walkable_area(scene: Scene, occupancy: Occupancy, floor: float, height: float) -> Area | None:
    """Find the free floor around the most open place that was captured well, and what is solid there.

    Of the parts of the free floor, the one with the most Gaussians is taken, without what belongs to the background;
    the largest one where all Gaussians are faint.

    Args:
        scene: the scene, world frame.
        occupancy: what is solid in the whole scene, coarsely.
        floor: height of the floor, world, metres.
        height: height of a robot's camera above the floor, metres.

    Returns:
        The area; None where too little floor is free at that height.

    Raises:
        ValueError: where one voxel is larger than the area could be.
    """
    if occupancy.resolution > 2 * REACH:
        raise ValueError(
            f"expected voxels of at most {2 * REACH:g} m to find where robots could walk, got {occupancy.resolution:g}"
        )
    crowded = _crowded(scene, occupancy, floor, height)
    free = _free_floor(occupancy, floor, height)
    labels, count = ndimage.label(free)
    if count == 0:
        return None
    around, sizes = ndimage.sum_labels(crowded, labels, np.arange(1, count + 1)), np.bincount(labels.ravel())[1:]
    part = labels == 1 + int(np.lexsort((sizes, around))[-1])
    if crowded[part].any():
        part &= crowded >= SPARSE * np.average(crowded[part], weights=crowded[part])
    if part.sum() < FEWEST:
        return None
    room = ndimage.distance_transform_edt(np.pad(part, 1))[1:-1, 1:-1]
    edge, origin = occupancy.resolution, np.array(occupancy.origin_key[:2])
    places = (np.argwhere(part) + origin + 0.5) * edge
    middle = (np.array(np.unravel_index(int(room.argmax()), room.shape)) + origin + 0.5) * edge
    near = places[(np.abs(places - middle) <= REACH).all(1)]
    walk, step = whole_steps(near)
    ground = Voxels(part[:, :, None], (*occupancy.origin_key[:2], math.floor(floor / edge)), edge)
    area = _around(scene, walk, step, ground, floor, height)
    shifted = aligned(area.ground(), walk, area.spacing)
    return area if shifted == walk else _around(scene, shifted, step, ground, floor, height)


def _around(scene: Scene, walk: Walk, step: float | None, ground: Voxels, floor: float, height: float) -> Area:
    """Return the bounds around where robots walk on some ground, and what is solid within them."""
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
    return Area(bounds, walk, step, round(floor + height, 3), solid, nothing, ground)


def _crowded(scene: Scene, occupancy: Occupancy, floor: float, height: float) -> NDArray[np.float64]:
    """Return how many opaque Gaussians are around each column of voxels, from the floor to a robot's height: [X, Y]."""
    edge, counts = occupancy.resolution, np.zeros(occupancy.occupied.shape[:2])
    means = scene.gaussians.means[scene.gaussians.opacities >= OPAQUE].double().cpu().numpy()
    means = means[(means[:, 2] > floor - 2 * edge) & (means[:, 2] < floor + height + 2 * edge)]
    columns = np.floor(means[:, :2] / edge).astype(np.int64) - np.array(occupancy.origin_key[:2])
    np.add.at(counts, tuple(columns[within(columns, counts.shape)].T), 1.0)
    result: NDArray[np.float64] = ndimage.gaussian_filter(counts, AROUND / edge)
    return result


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
