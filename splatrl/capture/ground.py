"""Which way is up in a reconstruction, and where its floor is."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.upright import Held, straightened

Floats = NDArray[np.float64]
UpFrom = Literal["recorded", "floor", "walls", "cameras"]

LOWEST = 0.12
"""Share of the points, the lowest ones, from which floors are drawn."""
TOLERANCE = 0.025
"""Half the thickness of a floor, in heights of the cameras above it."""
LARGEST_TILT = math.radians(10.0)
"""Between the floor and what the cameras say, twice the error of these: further apart it is a slope, or no floor."""
LARGEST_LEAN = math.radians(35.0)
"""How far people look up or down: by so much is the cameras' own up wrong where all look one way."""
MIN_INLIERS = 100
MIN_WIDTH = 0.15
"""Second in-plane deviation of a floor's points, in heights of the cameras: a narrower strip says little about up."""
DRAWS = 1500
NEAR, LOW = 0.06, 0.15
"""Of the points so near to a floor, in heights of the cameras, this share is below what people measure a height from:
points lie on the blades of a lawn and the pile of a carpet, and are off to both sides."""
LYING = (3.0, 0.1)
"""The cameras' own up spreads in a plane so many times as far as their right axes, and at least so far, where a film
lies on its side; upright films have 0.03 to 0.4 times and up to 0.13."""
LOOKS_UP, OVERHEAD, FLAT = math.radians(5.0), 0.5, 0.1
"""Mean tilt above the horizon, and shares of the points above the cameras and on a floor there, from which on a film is
upside down: people hold cameras level or down, 28° to 0° in trials, and at most 0.4 of what they film is higher."""
ERROR_DEG: dict[UpFrom, float] = {"recorded": 1.0, "floor": 1.5, "walls": 4.0, "cameras": 5.0}
"""Largest error found in trials, by what told up; that of cameras which look one way is larger by how far they lean."""
CLEAR_TILT = math.radians(3.0)
"""Between a floor and up in a place that is clearly upright: a strip of floor, or one with a bed beside it, may seem
tilted."""


@dataclass(frozen=True, eq=False)
class Ground:
    """The floor of a reconstruction, in its own frame and unit.

    Attributes:
        up: [3] unit vector, away from the earth.
        height: of the floor along ``up``, where its points lie.
        below: how far below that the ground is that a camera's height is measured from; at least 0.
        up_from: what ``up`` comes from.
        error_deg: how far off it may be, degrees.
        inliers: points on the floor.
    """

    up: Floats
    height: float
    below: float
    up_from: UpFrom
    error_deg: float
    inliers: int


def find_ground(camera_to_world: Floats, points: Floats, recorded_up: Floats | None = None) -> Ground:
    """Find up and the floor.

    Up is what the device recorded, or else the floor's normal where the floor is broad and has enough points, or else
    the direction in which no camera's right axis points: people hold cameras level far better than straight ahead.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes.
        points: [P, 3].
        recorded_up: [3], the direction away from the earth where it was recorded.
    """
    centers = camera_to_world[:, :3, 3]
    if recorded_up is not None:
        return _on_level(points, centers, recorded_up / np.linalg.norm(recorded_up), "recorded")
    held = cameras_up(camera_to_world)
    up, clear = straightened(points, held)
    found = _broad_floor(points, centers, up, CLEAR_TILT if clear else LARGEST_TILT)
    if found is not None:
        normal, on_floor = found
        level = float(np.median(on_floor @ normal))
        return _ground(points, centers, normal, level, "floor", ERROR_DEG["floor"], len(on_floor))
    if clear:
        return _on_level(points, centers, up, "walls")
    return _on_level(points, centers, up, "cameras", math.degrees(held.lean))


def _on_level(points: Floats, centers: Floats, up: Floats, up_from: UpFrom, more_deg: float = 0.0) -> Ground:
    """The ground at right angles to a direction that is known, which may be wrong by more than usual."""
    level, count = lowest_level(_lowest(points, up) @ up, centers @ up)
    return _ground(points, centers, up, level, up_from, ERROR_DEG[up_from] + more_deg, count)


def _ground(
    points: Floats, centers: Floats, up: Floats, level: float, up_from: UpFrom, error_deg: float, count: int
) -> Ground:
    """The ground at a level, and what is below it."""
    around = points @ up - level
    around = around[np.abs(around) <= NEAR * (float(np.median(centers @ up)) - level)]
    below = max(0.0, -float(np.quantile(around, LOW))) if len(around) else 0.0
    return Ground(up, level, below, up_from, error_deg, count)


def _lowest(points: Floats, up: Floats) -> Floats:
    """The lowest points, from which floors are drawn."""
    heights = points @ up
    return points[heights <= np.quantile(heights, LOWEST)]


def cameras_up(camera_to_world: Floats) -> Held:
    """The direction at right angles to the cameras' right axes, on the side of their own up.

    Where all cameras look the same way their right axes agree, and only the mean of their own up is left to decide.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes.
    """
    right, own = camera_to_world[:, :3, 0], -camera_to_world[:, :3, 1].mean(0)
    weights, up, side, lean = np.ones(len(right)), own, own, 0.0
    for _ in range(10):  # reweighted, for a few cameras held askew
        values, vectors = np.linalg.eigh((right * weights[:, None]).T @ right / weights.sum())
        up, side = vectors[:, 0], vectors[:, 2]
        if values[1] < 4 * values[0] or values[1] < 0.003:
            up, lean = own - side * (own @ side), LARGEST_LEAN
            break
        lean = math.atan(math.sqrt(max(values[0], 0.0) / values[1]))
        weights = 1.0 / np.maximum(np.abs(right @ up), 0.02)
    up = up / np.linalg.norm(up)
    return Held(up if up @ own >= 0 else -up, side, lean)


def on_its_side(camera_to_world: Floats) -> bool:
    """Whether the images lie on their side, as a phone's film does that was begun while it pointed downwards.

    Who turns around with an upright camera turns its right axis through the horizontal plane, and hardly its up.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes, in any frame.
    """
    right, own = (
        float(np.linalg.eigvalsh(axes.T @ axes / len(axes))[1])
        for axes in (camera_to_world[:, :3, 0], camera_to_world[:, :3, 1])
    )
    return own > max(LYING[0] * right, LYING[1])


def upside_down(camera_to_world: Floats, points: Floats) -> bool:
    """Whether the images are upside down, as those of a camera that hung from its mount.

    They look up, at a place that is mostly above them and whose floor is there, too: who films trees looks up as well.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes, in any frame.
        points: [P, 3] in that frame.
    """
    up, centers = cameras_up(camera_to_world).up, camera_to_world[:, :3, 3]
    looks_up = float((camera_to_world[:, :3, 2] @ up).mean()) > math.sin(LOOKS_UP)
    if not looks_up or float((points @ up > np.median(centers @ up)).mean()) <= OVERHEAD:
        return False
    above, below = (_broad_floor(points, centers, way, LARGEST_TILT) for way in (-up, up))
    found = 0 if above is None else len(above[1])
    return found > FLAT * len(points) and (below is None or len(below[1]) < found)


def lowest_level(heights: Floats, cameras: Floats) -> tuple[float, int]:
    """The height at which most of the lowest points lie with few below it, and how many lie there.

    Args:
        heights: [P] of the lowest points.
        cameras: [N] of the cameras above them.
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
    """Normal of a floor that is broad and has enough points, and the points on it."""
    sample = _lowest(points, up)
    above = float(np.median(centers @ up)) - lowest_level(sample @ up, centers @ up)[0]
    found = _floor(points, sample, up, tilt, TOLERANCE * above)
    if found is None or len(found[1]) < MIN_INLIERS or _width(found[1]) < MIN_WIDTH * above:
        return None
    return found


def _floor(points: Floats, sample: Floats, up: Floats, tilt: float, thickness: float) -> tuple[Floats, Floats] | None:
    """Normal of the plane that most of the lowest points lie on with few below it, and the points on it."""
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
    """Second in-plane deviation of a floor's points, by quantiles: a few things far away do not widen a strip."""
    across = np.linalg.eigh(np.cov(on_floor.T))[1][:, 1]
    low, high = np.quantile(on_floor @ across, [0.16, 0.84])
    return 0.5 * float(high - low)


def _score(distances: Floats, thickness: float) -> int:
    return int((np.abs(distances) <= thickness).sum() - (distances < -2 * thickness).sum())


def _refined(
    points: Floats, normal: Floats, offset: float, up: Floats, tilt: float, thickness: float
) -> tuple[Floats, Floats] | None:
    """Fit a plane to the points near it, several times over and ever closer."""
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
