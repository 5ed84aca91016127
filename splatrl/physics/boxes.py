"""Turns the solid voxels above the ground that bodies can meet into few boxes, by merging them greedily."""

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from splatrl.collision.voxels import Voxels
from splatrl.physics.ground import Ground

TURF = 0.1
"""Height up to which anything that stands on the ground counts as ground, rounding to voxels included, metres: grass,
gravel, and the voxels of the floor itself, whose edges would stop a wheel."""
_ORDERS = tuple(permutations(range(3)))


def standing(voxels: Voxels, ground: Ground, turf: float = TURF) -> NDArray[np.bool_]:
    """Return which solid voxels are not part of the ground: [X, Y, Z] bool.

    The ground are those that reach no higher than ``turf`` above the plane and carry nothing solid.
    """
    kept, low = voxels.occupied.copy(), _above(voxels, ground) + voxels.resolution <= turf + _slack(voxels)
    carries = np.zeros(kept.shape[:2], bool)  # whether the voxel above is kept
    for layer in reversed(range(kept.shape[2])):
        kept[:, :, layer] &= ~low[:, :, layer] | carries
        carries = kept[:, :, layer]
    return kept


def solid_above(
    voxels: Voxels, ground: Ground, lower: Sequence[float], upper: Sequence[float], top: float, turf: float = TURF
) -> Voxels:
    """Select the voxels that bodies on the ground can meet.

    This leaves out voxels below the plane, voxels that begin ``top`` or more above it, voxels outside the bounds, and
    voxels that reach no higher than ``turf`` above the plane and carry nothing solid.

    Args:
        voxels: the scene's solid voxels.
        ground: the scene's ground plane.
        lower: smallest x and y that a body can touch, metres.
        upper: largest x and y, metres.
        top: height above the plane below which bodies stay, metres.
        turf: height up to which anything on the ground counts as ground, metres; see ``TURF``.

    Raises:
        ValueError: for a ``top`` that is not above ``turf``.
    """
    if not top > turf >= 0.0:
        raise ValueError(f"top: expected a height above turf ({turf:g} m), got {top}")
    edge, slack, above = voxels.resolution, _slack(voxels), _above(voxels, ground)
    x, y, _ = _lower_faces(voxels)
    beside_x = (x + edge <= lower[0] + slack) | (x >= upper[0] - slack)
    beside_y = (y + edge <= lower[1] + slack) | (y >= upper[1] - slack)
    kept = standing(voxels, ground, turf) & (above + edge > slack) & (above < top - slack)
    kept &= ~(beside_x[:, None, None] | beside_y[None, :, None])
    return Voxels(kept, voxels.origin_key, edge)


def _slack(voxels: Voxels) -> float:
    """Return the tolerance of comparisons, metres."""
    return 1e-6 * voxels.resolution


def _lower_faces(voxels: Voxels) -> list[NDArray[np.float64]]:
    """Return the coordinates of the voxels' lower faces along each axis, metres: [X], [Y] and [Z]."""
    sides = zip(voxels.occupied.shape, voxels.origin_key, strict=True)
    return [(np.arange(count) + key) * voxels.resolution for count, key in sides]


def _above(voxels: Voxels, ground: Ground) -> NDArray[np.float64]:
    """Return the height of the voxels' lower faces over the plane, metres: [X, Y, Z]."""
    x, y, bottom = _lower_faces(voxels)
    middle = np.stack(np.meshgrid(x + 0.5 * voxels.resolution, y + 0.5 * voxels.resolution, indexing="ij"), -1)
    return bottom - ground.height(middle)[:, :, None]


def merged_boxes(voxels: Voxels) -> NDArray[np.float64]:
    """Merge solid voxels into boxes whose union is exactly what is solid; the boxes may overlap.

    From each voxel that no box covers yet, six boxes are grown, one for each order of the axes, as far as everything in
    them is solid; the one that covers the most new voxels is kept.

    Returns:
        [N, 6] float64: centres and half sizes, world, metres.
    """
    solid, left = voxels.occupied, voxels.occupied.copy()
    boxes = []
    for start in np.argwhere(solid):
        if left[tuple(start)]:
            grown = [_grown(solid, start.tolist(), order) for order in _ORDERS]
            best = max(grown, key=lambda box: int(np.count_nonzero(left[box])))
            left[best] = False
            boxes.append([[span.start for span in best], [span.stop for span in best]])
    corners = (np.array(boxes, np.float64).reshape(-1, 2, 3) + voxels.origin_key) * voxels.resolution
    return np.concatenate([corners.mean(1), 0.5 * (corners[:, 1] - corners[:, 0])], 1)


def _grown(solid: NDArray[np.bool_], start: list[int], order: tuple[int, ...]) -> tuple[slice, slice, slice]:
    """Grow a box around a voxel along one axis after the other, in both directions, while all of it is solid."""
    low, high = list(start), [at + 1 for at in start]

    def layer(axis: int, at: int) -> bool:
        spans = [slice(a, b) for a, b in zip(low, high, strict=True)]
        spans[axis] = slice(at, at + 1)
        return bool(solid[tuple(spans)].all())

    for axis in order:
        while high[axis] < solid.shape[axis] and layer(axis, high[axis]):
            high[axis] += 1
        while low[axis] > 0 and layer(axis, low[axis] - 1):
            low[axis] -= 1
    x, y, z = (slice(a, b) for a, b in zip(low, high, strict=True))
    return x, y, z
