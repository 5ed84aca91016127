"""Geometry of the layers over the splats: solid voxels, possible starts, and the camera path of a capture."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splatrl.collision.point_clouds import read_points
from splatrl.collision.voxels import Voxels
from splatrl.curriculum.planner import UNREACHABLE, Plan
from splatrl.scenes.scene import Bounds

MOST_FACES = 400_000
"""Maximum number of squares in a surface; a coarser grid is shown if there would be more."""
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
EDGES = np.array([[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]])
"""Edges of a box, as pairs of corners numbered in binary order."""

Floats = NDArray[np.float32]


def surface(voxels: Voxels, most: int = MOST_FACES) -> tuple[Floats, NDArray[np.uint32]]:
    """Return the faces between solid and free voxels as triangles.

    Args:
        voxels: the voxel grid.
        most: maximum number of squares; the voxel size is doubled until there are no more than that.

    Returns:
        Vertices [4 M, 3] float32, world, metres, and triangles [2 M, 3] uint32.
    """
    occupied, edge = voxels.occupied, voxels.resolution
    squares = _squares(occupied)
    while len(squares) > most:
        padded = np.pad(occupied, [(0, count % 2) for count in occupied.shape])
        x, y, z = (count // 2 for count in padded.shape)
        occupied, edge = np.asarray(padded.reshape(x, 2, y, 2, z, 2).any((1, 3, 5))), 2 * edge
        squares = _squares(occupied)
    vertices = (squares * edge + np.array(voxels.origin_key) * voxels.resolution).astype(np.float32).reshape(-1, 3)
    corner = 4 * np.arange(len(squares))[:, None, None]
    return vertices, (corner + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3).astype(np.uint32)


def _squares(occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the corners of the squares between solid and free voxels, [M, 4, 3], in voxel units.

    They are in counter-clockwise order as seen from outside.
    """
    padded, found = np.pad(occupied, 1), []
    for axis in range(3):
        for side, turn in ((1, SQUARE), (-1, SQUARE[::-1])):
            beside = np.roll(padded, -side, axis)[1:-1, 1:-1, 1:-1]
            cells = np.argwhere(occupied & ~beside)
            corners = np.zeros((4, 3), np.int64)
            corners[:, (axis + 1) % 3], corners[:, (axis + 2) % 3] = turn.T
            corners[:, axis] = side > 0
            found.append(cells[:, None] + corners)
    return np.concatenate(found)


def free_places(plan: Plan) -> tuple[Floats, Floats]:
    """Return the places where the body fits, at its height, for at least one heading.

    Returns:
        Places from which the goal can be reached (all, for a task without one), and the others: [N, 3] and [M, 3].
    """
    places = plan.motion.body_to_world(plan.states)[:, :3, 3].cpu().double().round(decimals=4).numpy()
    free, leads = plan.free.cpu().numpy(), (plan.distance != UNREACHABLE).cpu().numpy()
    kept, which = np.unique(places[free], axis=0, return_inverse=True)
    reaches = np.zeros(len(kept), bool)
    np.logical_or.at(reaches, which.reshape(-1), leads[free])
    return kept[reaches].astype(np.float32), kept[~reaches].astype(np.float32)


def box_lines(bounds: Bounds) -> Floats:
    """Return the edges of a box: [12, 2, 3], metres."""
    low, high = np.array(bounds, np.float32)
    bits = np.array([[number >> 2 & 1, number >> 1 & 1, number & 1] for number in range(8)], bool)
    return np.where(bits, high, low)[EDGES].astype(np.float32)


def path_lines(folder: Path, name: str) -> Floats | None:
    """Return the camera path of a capture, image to image: [N, 2, 3], metres; None if the folder has no such file."""
    if not (folder / name).is_file():
        return None
    points = read_points(folder / name)
    return np.stack([points[:-1], points[1:]], 1).astype(np.float32)
