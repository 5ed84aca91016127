"""The upward direction and the floor of a reconstruction."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.held import cameras_up, if_steeply_down, looks_up
from splatrl.capture.upright import ONE_WAY, Held, straightened

Floats = NDArray[np.float64]
UpFrom = Literal["recorded", "floor", "walls", "cameras"]

LOWEST = 0.12
"""Fraction of the points, the lowest ones, among which floors are looked for."""
TOLERANCE = 0.025
"""Half the thickness of a floor, in heights of the cameras above it."""
LARGEST_TILT = math.radians(10.0)
"""Largest angle between a floor's normal and the cameras' up, twice the error of the latter; beyond it, the plane is a
slope or no floor."""
MIN_INLIERS, SURE = 100, 300
"""Minimum number of points on a floor, and the number from which its normal is off by no more than usual: the fewer
there are, with much noise as in dim films, the more likely the best plane passes through other things, too."""
MIN_WIDTH = 0.15
"""Minimum deviation of a floor's points along its narrower side, in heights of the cameras: a narrower strip says
little about up."""
DRAWS = 1500
NEAR, LOW = 0.06, 0.15
"""Distance from a floor, in heights of the cameras, within which points belong to the ground, and the fraction of these
points that lie below the level from which people measure heights: points lie on the blades of a lawn and the pile of a
carpet, and are off to both sides."""
OVERHEAD, FLAT = 0.5, 0.1
"""Minimum fractions of the points that are above the cameras and that are on a floor there, for a film that is upside
down. At most 0.4 of what people film is above the cameras."""
ERROR_DEG: dict[UpFrom, float] = {"recorded": 1.0, "floor": 1.5, "walls": 4.0, "cameras": 5.0}
"""Largest error found in trials, by the source of up; for cameras that look one way, their lean is added. On ground
that slopes, a floor's normal is off by the slope."""
CLEAR_TILT = math.radians(3.0)
"""Largest angle between a floor's normal and up in a place that is clearly upright: a strip of floor, or a floor with a
bed beside it, may seem tilted."""


@dataclass(frozen=True, eq=False)
class Ground:
    """The floor of a reconstruction, in the reconstruction's frame and unit.

    Attributes:
        up: [3] unit vector, upwards (away from the earth).
        height: height along ``up`` of the points on the floor.
        below: how far below ``height`` the ground lies from which a camera's height is measured; at least 0.
        up_from: source of ``up``.
        error_deg: possible error of ``up``, degrees.
        inliers: number of points on the floor.
        unsure_deg: by how much more than usual what is perpendicular to ``up`` may lean against the floor, degrees.
        slope_deg: by how much the floor slopes at least, degrees, according to cameras that look all around; 0 where
            up is not its normal.
    """

    up: Floats
    height: float
    below: float
    up_from: UpFrom
    error_deg: float
    inliers: int
    unsure_deg: float = 0.0
    slope_deg: float = 0.0


def find_ground(camera_to_world: Floats, points: Floats, recorded_up: Floats | None = None) -> Ground:
    """Find the upward direction and the floor.

    Up is the first of these that is available: what the device recorded; the normal of a floor that is broad and has
    enough points; what walls and floors say in a place that is clearly upright; the direction most nearly perpendicular
    to all cameras' right axes, since people hold cameras level far better than straight ahead.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes.
        points: [P, 3].
        recorded_up: [3], the upward direction where it was recorded.
    """
    centers = camera_to_world[:, :3, 3]
    if recorded_up is not None:
        return _on_level(points, centers, recorded_up / np.linalg.norm(recorded_up), "recorded")
    held = held_by(camera_to_world, points)
    up, clear = straightened(points, held)
    found = _broad_floor(points, centers, up, CLEAR_TILT if clear else LARGEST_TILT)
    if found is not None:
        normal, on_floor = found
        level = float(np.median(on_floor @ normal))
        tilt_deg = math.degrees(math.acos(min(1.0, float(normal @ held.up)))) if held.lean < ONE_WAY else 0.0
        lean_deg = math.degrees(held.lean)
        own_deg = min(lean_deg, ERROR_DEG["cameras"])
        few = max(0.0, (SURE - len(on_floor)) / (SURE - MIN_INLIERS))  # 1 for the fewest
        error_deg = max(ERROR_DEG["floor"], tilt_deg + few * own_deg)
        level_there = _ground(points, centers, normal, level, "floor", error_deg, len(on_floor))
        return replace(level_there, unsure_deg=few * (tilt_deg + own_deg), slope_deg=max(0.0, tilt_deg - lean_deg))
    if clear:
        return _on_level(points, centers, up, "walls")
    return _on_level(points, centers, up, "cameras", math.degrees(held.lean))


def held_by(camera_to_world: Floats, points: Floats) -> Held:
    """Return the upward direction by the cameras alone, or where these leave two, by the one with more of a floor.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes.
        points: [P, 3].
    """
    held, down = cameras_up(camera_to_world), if_steeply_down(camera_to_world)
    if down is None:
        return held
    floors = [_broad_floor(points, camera_to_world[:, :3, 3], each.up, LARGEST_TILT) for each in (held, down)]
    own, other = (0 if floor is None else len(floor[1]) for floor in floors)
    return down if other > own else held


def _on_level(points: Floats, centers: Floats, up: Floats, up_from: UpFrom, more_deg: float = 0.0) -> Ground:
    """Return the ground perpendicular to a given up, which may be off by ``more_deg`` more than usual."""
    level, count = lowest_level(_lowest(points, up) @ up, centers @ up)
    return replace(
        _ground(points, centers, up, level, up_from, ERROR_DEG[up_from] + more_deg, count), unsure_deg=more_deg
    )


def _ground(
    points: Floats, centers: Floats, up: Floats, level: float, up_from: UpFrom, error_deg: float, count: int
) -> Ground:
    """Return the ground at a level, with how far below it people measure heights from."""
    below = depth_below(points @ up - level, float(np.median(centers @ up)) - level)
    return Ground(up, level, below, up_from, error_deg, count)


def leaning(ground: Ground, centers: Floats, points: Floats) -> float:
    """Return by how much more than usual the cameras' height above a floor may be off, relative to it, because up is.

    A floor that is seen on all sides of the cameras tells their height whatever up is; one that is seen only far ahead
    of them does not.

    Args:
        ground: up and the floor.
        centers: [N, 3] positions of the cameras.
        points: [P, 3].
    """
    above = float(np.median(centers @ ground.up)) - ground.height
    on_floor = points[np.abs(points @ ground.up - ground.height) <= TOLERANCE * above]
    if not len(on_floor):
        return 0.0
    ahead = float(np.linalg.norm(np.cross(on_floor.mean(0) - centers.mean(0), ground.up)))
    return math.tan(math.radians(ground.unsure_deg)) * ahead / above


def depth_below(heights: Floats, above: float) -> float:
    """Return how far below a level the ground lies from which people measure heights; at least 0.

    Args:
        heights: [P] heights of the points above the level.
        above: height of the cameras above it.
    """
    around = heights[np.abs(heights) <= NEAR * above]
    return max(0.0, -float(np.quantile(around, LOW))) if len(around) else 0.0


def _lowest(points: Floats, up: Floats) -> Floats:
    """Return the lowest points, among which floors are looked for."""
    heights = points @ up
    return points[heights <= np.quantile(heights, LOWEST)]


def upside_down(camera_to_world: Floats, points: Floats) -> bool:
    """Return whether the images are upside down, like those of a camera that hung from its mount.

    Such images look up, at a place that is mostly above them and whose floor seems to be up there, too. Looking up
    alone proves nothing: people who film trees also look up.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes, in any frame.
        points: [P, 3] in that frame.
    """
    up, centers = held_by(camera_to_world, points).up, camera_to_world[:, :3, 3]
    if not looks_up(camera_to_world, points, up, OVERHEAD):
        return False
    above, below = (_broad_floor(points, centers, way, LARGEST_TILT) for way in (-up, up))
    found = 0 if above is None else len(above[1])
    return found > FLAT * len(points) and (below is None or len(below[1]) < found)


def lowest_level(heights: Floats, cameras: Floats) -> tuple[float, int]:
    """Return the height at which most of the lowest points lie with few below it, and the number of points there.

    Args:
        heights: [P] heights of the lowest points.
        cameras: [N] heights of the cameras above them.
    """
    thickness = TOLERANCE * max(float(np.median(cameras) - np.median(heights)), 1e-9)
    order = np.sort(heights)
    candidates = order[:: max(1, len(order) // 2000)]
    inside = np.searchsorted(order, candidates + thickness) - np.searchsorted(order, candidates - thickness)
    below = np.searchsorted(order, candidates - 2 * thickness)
    best = int((inside - below).argmax())
    near = order[np.abs(order - candidates[best]) <= thickness]
    return float(np.median(near)), len(near)


def _broad_floor(points: Floats, centers: Floats, up: Floats, tilt: float) -> tuple[Floats, Floats] | None:
    """Return the normal of a floor that is broad and has enough points, and the points on it; None without one."""
    sample = _lowest(points, up)
    above = float(np.median(centers @ up)) - lowest_level(sample @ up, centers @ up)[0]
    found = _floor(points, sample, up, tilt, TOLERANCE * above)
    if found is None or len(found[1]) < MIN_INLIERS or _width(found[1]) < MIN_WIDTH * above:
        return None
    return found


def _floor(points: Floats, sample: Floats, up: Floats, tilt: float, thickness: float) -> tuple[Floats, Floats] | None:
    """Return the normal of the plane on which most of the lowest points lie with few below it, and the points on it."""
    if len(sample) < 3:
        return None
    generator = np.random.default_rng(0)
    some = sample[generator.choice(len(sample), min(len(sample), 4000), replace=False)]
    a, b, c = some[generator.integers(len(some), size=(3, DRAWS))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 1e-12] / lengths[lengths > 1e-12, None], a[lengths > 1e-12]
    normals *= np.where(normals @ up < 0, -1.0, 1.0)[:, None]
    upright = normals @ up >= math.cos(tilt)
    normals, a = normals[upright], a[upright]
    if len(normals) == 0:
        return None
    offsets = (normals * a).sum(1)
    scores = np.array(
        [_score(some @ normal - offset, thickness) for normal, offset in zip(normals, offsets, strict=True)]
    )
    best = int(scores.argmax())
    return _refined(points, normals[best], float(offsets[best]), up, tilt, thickness)


def _width(on_floor: Floats) -> float:
    """Return the deviation of a floor's points along its narrower side, by quantiles, so that outliers do not count."""
    across = np.linalg.eigh(np.cov(on_floor.T))[1][:, 1]
    low, high = np.quantile(on_floor @ across, [0.16, 0.84])
    return 0.5 * float(high - low)


def _score(distances: Floats, thickness: float) -> int:
    return int((np.abs(distances) <= thickness).sum() - (distances < -2 * thickness).sum())


def _refined(
    points: Floats, normal: Floats, offset: float, up: Floats, tilt: float, thickness: float
) -> tuple[Floats, Floats] | None:
    """Fit a plane to the points near it, several times over, within an ever narrower band."""
    near = points
    for width in (1.5, 1.0, 1.0, 0.7, 0.7):
        near = points[np.abs(points @ normal - offset) <= width * thickness]
        if len(near) < 3:
            return None
        center = near.mean(0)
        fitted = np.linalg.svd(near - center, full_matrices=False)[2][2]
        fitted = fitted if fitted @ up >= 0 else -fitted
        if fitted @ up < math.cos(tilt):
            return None
        normal, offset = fitted, float(center @ fitted)
    return normal, near
