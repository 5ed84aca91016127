"""The ground beneath the cameras, where people stood: it may have steps, or lie above a lower place in view."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splatrl.capture.ground import NEAR, TOLERANCE, Ground, depth_below, lowest_level

Floats = NDArray[np.float64]

REACH, UNDER = 0.4, 0.2
"""Horizontal distance from a camera within which points tell on what it stands, and how far below it they lie at least,
in heights of the cameras."""
ON_FLOOR, FAVOURED = 3, 0.25
"""Minimum number of points on the floor near a camera that stands on it, and their minimum ratio to the points on
another level there: furniture and plants beside a path show more points than a bare floor."""
ON_LEVEL, FLAT = 10, 0.5
"""Minimum number of points on another level on which a camera stands, and their minimum fraction of the points near the
camera."""
AROUND = 1.0
"""Distance from the path, in heights of the cameras, beyond which a floor is one that people looked down on, if none of
them stood on it."""
SETTLED, ROUNDS = 0.02, 12
SEEN = 0.1
"""Minimum fraction of the cameras beneath which the ground is seen; with fewer, nothing is known."""
SWAY = 0.02
"""Maximum relative difference between the mean heights of cameras above one floor."""
DEEP, MUCH = 0.1, 0.25
"""Minimum depth of points below a floor, in heights of the cameras, and their ratio to the points on the floor, both
near the path, from which it may be a table."""
LOWEST = 0.1
"""Fraction of the cameras that may stand lower than a new floor."""


class Footing(NamedTuple):
    """On what people stood.

    Attributes:
        ground: the ground; its floor is the lowest on which people stood.
        beneath: [N] heights along up of the ground beneath each camera, interpolated between the cameras before and
            after where it is not seen; the floor's where it is hardly seen at all.
        seen: whether the ground beneath the cameras is seen.
        unsure: relative difference between the mean heights above the ground of all cameras and of those beneath which
            it is seen, from 2 %: people may have stood higher or lower where it is not.
    """

    ground: Ground
    beneath: Floats
    seen: bool
    unsure: float = 0.0

    @property
    def rise(self) -> float:
        """How far the highest ground beneath a camera lies above the lowest."""
        return float(np.ptp(self.beneath))


def stood_on(ground: Ground, centers: Floats, points: Floats) -> Footing:
    """Find the ground beneath each camera, given the lowest broad floor of a place.

    A camera stands on that floor where a few points near it show it, and otherwise on another level that most of the
    points near it show. People raise the camera when they climb a step, but not when they pass a table; so other levels
    count only if they make the cameras' heights more even. If no camera stands on that floor or near it, as on a
    terrace with a view of a garden below, the lowest level on which cameras stand is the floor instead.

    Args:
        ground: up and the lowest broad floor.
        centers: [N, 3] positions of the cameras.
        points: [P, 3].
    """
    cameras, heights = centers @ ground.up, points @ ground.up
    places, flat = _flattened(centers, ground.up), _flattened(points, ground.up)
    beneath, above = _beneath(cKDTree(flat), places, heights, cameras, ground.height)
    known = ~np.isnan(beneath)
    if known.mean() < SEEN:
        return Footing(ground, np.full(len(cameras), ground.height), seen=False)
    if not (beneath == ground.height).any():
        on_floor = flat[np.abs(heights - ground.height) <= NEAR * above]
        if _distances(places, on_floor).min() > AROUND * above:
            low = float(np.quantile(beneath[known], LOWEST))
            level = float(np.median(beneath[np.abs(beneath - low) <= NEAR * above]))
            near = heights - level
            count = int((np.abs(near) <= TOLERANCE * above).sum())
            ground = replace(ground, height=level, below=depth_below(near, above), inliers=count)
            beneath[np.abs(beneath - level) <= NEAR * above] = level
    if np.std((cameras - beneath)[known]) >= np.std(cameras[known]):
        on_floor = beneath == ground.height
        if on_floor.sum() < 0.5 * known.sum():
            return Footing(ground, np.full(len(cameras), ground.height), seen=False)
        known = on_floor
    between = np.interp(np.arange(len(cameras)), np.flatnonzero(known), beneath[known])
    above_ground = cameras - between
    unsure = abs(float(above_ground.mean() / above_ground[known].mean()) - 1.0)
    return Footing(ground, between, seen=True, unsure=unsure if unsure > SWAY else 0.0)


def much_below(ground: Ground, centers: Floats, points: Floats, above: float) -> bool:
    """Return whether much lies below a floor near the path, as where a table hides the floor or is taken for it.

    Args:
        ground: up and the floor on which people seem to have stood.
        centers: [N, 3] positions of the cameras.
        points: [P, 3].
        above: height of the cameras above that floor.
    """
    heights = points @ ground.up - ground.height
    near = from_path(centers, points, ground.up) <= AROUND * above
    below, on_floor = heights < -DEEP * above, np.abs(heights) <= NEAR * above
    return int((below & near).sum()) > MUCH * int((on_floor & near).sum())


def sunk(centers: Floats, points: Floats, up: Floats, floor: float, above: float) -> NDArray[np.bool_]:
    """Return which cameras are below a floor that is seen near them, by more than the floor is thick: none can be.

    Args:
        centers: [N, 3] positions of the cameras.
        points: [P, 3].
        up: [3] unit vector.
        floor: height along ``up`` of the floor on which people seem to have stood.
        above: mean height of the cameras above it.

    Returns:
        [N] bool.
    """
    below = centers @ up < floor - TOLERANCE * above
    on_floor = _flattened(points[np.abs(points @ up - floor) <= NEAR * above], up)
    if len(on_floor) < ON_FLOOR or not below.any():
        return np.zeros(len(centers), bool)
    away = cKDTree(on_floor).query(_flattened(centers, up), ON_FLOOR)[0][:, -1]
    found: NDArray[np.bool_] = below & (away <= REACH * above)
    return found


def from_path(centers: Floats, points: Floats, up: Floats) -> Floats:
    """Return the distances of points from the nearest camera, seen from above.

    Args:
        centers: [N, 3] positions of the cameras.
        points: [P, 3].
        up: [3] unit vector.

    Returns:
        [P], in the unit of the positions.
    """
    return _distances(_flattened(centers, up), _flattened(points, up))


def _distances(places: Floats, points: Floats) -> Floats:
    """Return the distance of each point from the nearest place: [N, D], [P, D] -> [P]."""
    return cKDTree(places).query(points)[0]


def _flattened(places: Floats, up: Floats) -> Floats:
    """Return places moved along up to height 0: [N, 3] -> [N, 3]."""
    return places - (places @ up)[:, None] * up


def _beneath(tree: cKDTree, places: Floats, heights: Floats, cameras: Floats, floor: float) -> tuple[Floats, float]:
    """Return the heights of the ground beneath each camera, NaN where unseen, and the cameras' median height above it.

    Args:
        tree: the points, along up moved to height 0.
        places: [N, 3] the cameras, moved likewise.
        heights: [P] heights of the points.
        cameras: [N] heights of the cameras.
        floor: height of the lowest broad floor.
    """
    above = float(np.median(cameras)) - floor
    found = np.full(len(cameras), np.nan)
    for _ in range(ROUNDS):  # the cameras may be far less above what they stand on than above that floor
        near = (tree.query_ball_point(place, REACH * above) for place in places)  # all at once may need gigabytes
        found = np.array([_level(heights[rows], each, floor, above) for rows, each in zip(near, cameras, strict=True)])
        nearer = 0.5 * above if np.isnan(found).all() else float(np.nanmedian(cameras - found))
        if abs(nearer - above) <= SETTLED * above:
            break
        above = nearer
    return found, above


def _level(heights: Floats, camera: float, floor: float, above: float) -> float:
    """Return the height of the ground beneath a camera, from those of the points near it; NaN where that is unseen."""
    under = heights[heights < camera - UNDER * above]
    on_floor = int((np.abs(under - floor) <= NEAR * above).sum())
    if len(under) < ON_LEVEL:
        return floor if on_floor >= ON_FLOOR else np.nan
    level = lowest_level(under, np.array([camera]))[0]
    count = int((np.abs(under - level) <= NEAR * above).sum())
    flat = count >= max(ON_LEVEL, FLAT * len(under))
    if on_floor >= max(ON_FLOOR, FAVOURED * count * flat):
        return floor
    return level if flat else np.nan
