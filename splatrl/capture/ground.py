"""Which way is up in a reconstruction, and where its floor is."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
UpFrom = Literal["recorded", "floor", "cameras"]

LOWEST = 0.12
"""Share of the points, the lowest ones, from which floors are drawn."""
TOLERANCE = 0.025
"""Half the thickness of a floor, in heights of the cameras above it."""
LARGEST_TILT = math.radians(10.0)
"""Between the floor and what the cameras say, twice the error of these: further apart it is a slope, or no floor."""
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
ERROR_DEG: dict[UpFrom, float] = {"recorded": 1.0, "floor": 1.5, "cameras": 5.0}
"""Largest error found in trials, by what told up; a narrow choice of headings makes that of the cameras larger."""


@dataclass(frozen=True, eq=False)
class Ground:
    """The floor of a reconstruction, in its own frame and unit.

    Attributes:
        up: [3] unit vector, away from the earth.
        height: of the floor along ``up``, where its points lie.
        below: how far below that the ground is that a camera's height is measured from; at least 0.
        up_from: what ``up`` comes from.
        inliers: points on the floor.
    """

    up: Floats
    height: float
    below: float
    up_from: UpFrom
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
    up = cameras_up(camera_to_world) if recorded_up is None else recorded_up / np.linalg.norm(recorded_up)
    heights = points @ up
    sample = points[heights <= np.quantile(heights, LOWEST)]
    level, count = lowest_level(sample @ up, centers @ up)
    up_from: UpFrom = "cameras" if recorded_up is None else "recorded"
    above = float(np.median(centers @ up)) - level
    found = _floor(points, sample, up, TOLERANCE * above) if recorded_up is None else None
    if found is not None:
        normal, on_floor = found
        if len(on_floor) >= MIN_INLIERS and _width(on_floor) >= MIN_WIDTH * above:
            up, level, up_from, count = normal, float(np.median(on_floor @ normal)), "floor", len(on_floor)
    return Ground(up, level, _below(points @ up - level, NEAR * above), up_from, count)


def _below(heights: Floats, near: float) -> float:
    """How far below a floor the ground is, by the heights of points above that floor."""
    around = heights[np.abs(heights) <= near]
    return max(0.0, -float(np.quantile(around, LOW))) if len(around) else 0.0


def cameras_up(camera_to_world: Floats) -> Floats:
    """The direction [3] at right angles to the cameras' right axes, on the side of their own up.

    Where all cameras look the same way their right axes agree, and only the mean of their own up is left to decide.
    """
    right, own = camera_to_world[:, :3, 0], -camera_to_world[:, :3, 1].mean(0)
    weights = np.ones(len(right))
    up = own
    for _ in range(10):  # reweighted, for a few cameras held askew
        values, vectors = np.linalg.eigh((right * weights[:, None]).T @ right / weights.sum())
        up = vectors[:, 0]
        if values[1] < 4 * values[0] or values[1] < 0.003:
            side = vectors[:, 2]
            up = own - side * (own @ side)
            break
        weights = 1.0 / np.maximum(np.abs(right @ up), 0.02)
    up = up / np.linalg.norm(up)
    return up if up @ own >= 0 else -up


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


def _floor(points: Floats, sample: Floats, up: Floats, thickness: float) -> tuple[Floats, Floats] | None:
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
    upright = normals @ up >= math.cos(LARGEST_TILT)
    normals, a = normals[upright], a[upright]
    if len(normals) == 0:
        return None
    offsets = (normals * a).sum(1)
    scores = np.array(
        [_score(some @ normal - offset, thickness) for normal, offset in zip(normals, offsets, strict=True)]
    )
    best = int(scores.argmax())
    return _refined(points, normals[best], float(offsets[best]), up, thickness)


def _width(on_floor: Floats) -> float:
    """Second in-plane deviation of a floor's points, by quantiles: a few things far away do not widen a strip."""
    across = np.linalg.eigh(np.cov(on_floor.T))[1][:, 1]
    low, high = np.quantile(on_floor @ across, [0.16, 0.84])
    return 0.5 * float(high - low)


def _score(distances: Floats, thickness: float) -> int:
    return int((np.abs(distances) <= thickness).sum() - (distances < -2 * thickness).sum())


def _refined(
    points: Floats, normal: Floats, offset: float, up: Floats, thickness: float
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
        if fitted @ up < math.cos(LARGEST_TILT):
            return None
        normal, offset = fitted, float(center @ fitted)
    return normal, near
