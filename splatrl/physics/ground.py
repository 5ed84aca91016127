"""Fits the plane that bodies stand on to rendered depth of a scene's floor.

Sums are NumPy's own, without matrix products: BLAS rounds those differently with another number of threads.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision.voxels import Voxels
from splatrl.physics.places import CLEARANCE, standing_heights, widest_part
from splatrl.renderers.base import Renderer

Floats = NDArray[np.float64]

SPACING = 0.2
"""Distance between the places that are viewed, metres, unless that would give more than ``MOST_PLACES``."""
MOST_PLACES = 400
FEWEST_PLACES = 6
"""Minimum number of places for a fit."""
SIDE = 16
"""Width and height of each downward view, pixels."""
OPAQUE = 0.5
"""Minimum alpha of a pixel whose depth counts."""
THICKNESS = 0.03
"""Distance from the plane up to which points are on it, metres. Grass and worn floors lie within."""
LARGEST_TILT = math.radians(15.0)
DRAWS = 2000
LEVEL = 0.005
"""Root mean square difference over the places, metres, up to which a plane is replaced by a level one. Rendered depth
is no more accurate than that, and bodies should not roll on its errors."""
ONE_PLANE = 0.8
"""Minimum fraction of places on the plane for the ground to be one plane: plants and low things lie on it too."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A ground plane, and how well the ground agrees with it.

    Attributes:
        plane: [4] float64, unit normal n (upwards) and offset d, metres: n · p = d on the plane.
        spread: root mean square distance from the plane of the seen points within ``THICKNESS`` of it, metres.
        places: number of places that were viewed.
        on: fraction of these places within ``THICKNESS`` of the plane.
        range: 1st and 99th percentile of these places' signed distances from the plane, metres.
        sunk: fraction of all places to stand that lie more than ``THICKNESS`` plus one voxel below the plane: bodies
            would float above them.
    """

    plane: Floats
    spread: float
    places: int
    on: float
    range: tuple[float, float]
    sunk: float

    @property
    def tilt(self) -> float:
        """Angle between the plane's normal and up, radians."""
        return math.acos(min(1.0, float(self.plane[2])))

    @property
    def is_plane(self) -> bool:
        """Whether nearly all places lie on the plane, and hardly any below it."""
        return self.on >= ONE_PLANE and self.sunk <= 1.0 - ONE_PLANE

    def height(self, xy: Floats) -> Floats:
        """Return z of the plane at places: [..., 2] -> [...], metres."""
        normal, offset = self.plane[:3], self.plane[3]
        return (offset - _along(xy, normal[:2])) / normal[2]

    @property
    def trouble(self) -> str | None:
        """One-line warning to users about a ground that is not a plane; None if it is one."""
        if self.is_plane:
            return None
        below = f", and {self.sunk:.0%} of the places to stand lie below it" if self.sunk > 1.0 - ONE_PLANE else ""
        low, high = self.range
        return (
            f"the ground is not one plane: {1 - self.on:.0%} of {self.places} places lie more than {THICKNESS:g} m off "
            f"the best fit, from {low:+.2f} to {high:+.2f} m{below}; bodies would float or sink there"
        )

    def __str__(self) -> str:
        seen = f"{self.spread * 1000:.1f} mm rms, {self.on:.0%} of {self.places} places within {THICKNESS:g} m"
        where = f"z = {float(self.height(np.zeros(2))) + 0.0:.4f} m at the origin"
        tilt = f"tilted by {math.degrees(self.tilt):.2f}°"
        trouble = f"\n            {self.trouble}" if self.trouble else ""
        return f"ground      {where}, {tilt}\n            {seen}{trouble}"

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays to keep in a cache."""
        numbers = [self.spread, self.places, self.on, *self.range, self.sunk]
        return {"plane": self.plane, "numbers": np.array(numbers, np.float64)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "Ground":
        """Rebuild a ground from the arrays of ``to_arrays``."""
        spread, places, on, low, high, sunk = arrays["numbers"].tolist()
        return cls(arrays["plane"], spread, int(places), on, (low, high), sunk)


def fit_ground(renderer: Renderer, voxels: Voxels, lower: Sequence[float], upper: Sequence[float]) -> Ground:
    """Fit a plane to the floor within bounds.

    Places to stand are found in the voxels, whose tops are up to two voxels off. From 0.3 m above a grid of connected
    places, a camera looks straight down, and the plane is fitted to what it sees: first from random triples of places,
    as in RANSAC, then by iteratively reweighted least squares (Tukey's biweight) over all pixels, which ignores grass
    and objects that lie around. If a level plane is as good within ``LEVEL``, that is taken.

    Args:
        renderer: renders depth of the scene.
        voxels: the scene's solid voxels, the ground included.
        lower: smallest x and y where bodies can be, metres.
        upper: largest x and y, metres.

    Raises:
        ValueError: for bounds without area, or if there are too few free places from which to see a ground.
    """
    if not all(low < high for low, high in zip(lower, upper, strict=True)):
        raise ValueError(f"ground: expected lower < upper in x and y, got {list(lower)} and {list(upper)}")
    centers, heights = standing_heights(voxels, lower, upper)
    floor = widest_part(heights)
    spacing = max(SPACING, math.sqrt((upper[0] - lower[0]) * (upper[1] - lower[1]) / MOST_PLACES))
    eyes = _eyes(centers, np.where(floor, heights, np.nan), spacing)
    points, place = _looked_down(renderer, eyes, spacing)
    medians = np.array([np.median(points[place == one], 0) for one in np.unique(place)]).reshape(-1, 3)
    if len(medians) < FEWEST_PLACES:
        raise ValueError(
            f"ground: expected at least {FEWEST_PLACES} places with {CLEARANCE:g} m of free space above a floor from "
            f"{list(lower)} to {list(upper)}, got {len(medians)}; bodies need ground to stand on"
        )
    plane = _levelled(points, medians, _refined(points, _rough(medians)))
    off, seen = (_along(each, plane[:3]) - plane[3] for each in (medians, points))
    near = seen[np.abs(seen) <= THICKNESS]
    stands = ~np.isnan(heights)
    above = _along(np.append(centers[stands], heights[stands, None], 1), plane[:3]) - plane[3]
    low, high = np.quantile(off, [0.01, 0.99]).tolist()
    return Ground(
        plane=plane,
        spread=float(np.sqrt((near**2).mean())) if len(near) else float("inf"),
        places=len(medians),
        on=float((np.abs(off) <= THICKNESS).mean()),
        range=(low, high),
        sunk=float((above < -THICKNESS - voxels.resolution).mean()),
    )


def _eyes(centers: Floats, heights: Floats, spacing: float) -> Floats:
    """Return a camera position above the floor for each grid cell, at the place nearest to its middle: [E, 3]."""
    known = ~np.isnan(heights)
    xy, z = centers[known], heights[known]
    cell = np.floor(xy / spacing)
    away = np.linalg.norm(xy - (cell + 0.5) * spacing, axis=1)
    order = np.lexsort((away, cell[:, 1], cell[:, 0]))
    cell = cell[order]
    first = np.ones(len(cell), bool)
    first[1:] = (cell[1:] != cell[:-1]).any(1)
    chosen = order[first]
    return np.append(xy[chosen], z[chosen, None] + CLEARANCE, 1)


def _looked_down(renderer: Renderer, eyes: Floats, spacing: float) -> tuple[Floats, NDArray[np.int64]]:
    """Render straight down from each eye, and return the points seen [P, 3] and the eye that saw each [P]."""
    if len(eyes) == 0:
        return np.zeros((0, 3)), np.zeros(0, np.int64)
    position = torch.from_numpy(eyes).float()
    camera_to_world = look_at(position, position - torch.tensor([0.0, 0.0, 1.0]))
    K = intrinsics(2 * math.atan(0.5 * spacing / CLEARANCE), SIDE, SIDE)
    _, depth, alpha = renderer.render(Cameras(camera_to_world, K, SIDE, SIDE))
    pixel = torch.arange(SIDE, dtype=torch.float64) + 0.5
    right, down = ((pixel - K[axis, 2].double()) / K[axis, axis].double() for axis in range(2))
    rays = torch.stack([right.expand(SIDE, SIDE), down[:, None].expand(SIDE, SIDE), torch.ones(SIDE, SIDE)], -1)
    local = rays.double() * depth.double().unsqueeze(-1)
    turned = (camera_to_world[:, None, None, :3, :3].double() * local.unsqueeze(-2)).sum(-1)
    points = turned + torch.from_numpy(eyes)[:, None, None]
    seen = (alpha >= OPAQUE) & (depth > 0)
    return points[seen].numpy(), seen.nonzero()[:, 0].numpy()


def _rough(places: Floats) -> Floats:
    """Find the plane through three of the places, or a level one, that is near to the most places: [4]."""
    generator = np.random.default_rng(0)
    a, b, c = places[generator.integers(len(places), size=(3, DRAWS))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    kept = lengths > 1e-9
    normals = normals[kept] / lengths[kept, None]
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    upright = normals[:, 2] >= math.cos(LARGEST_TILT)
    level = np.array([[0.0, 0.0, 1.0]])  # level planes through some places are always candidates
    count = min(len(places), 50)
    normals = np.concatenate([normals[upright], np.repeat(level, count, 0)])
    through = np.concatenate([a[kept][upright], places[np.linspace(0, len(places) - 1, count).astype(int)]])
    offsets = (normals * through).sum(1)
    away = np.abs(_along(normals[:, None], places) - offsets[:, None])
    near = (1.0 - np.minimum(away / THICKNESS, 1.0) ** 2).sum(1)
    best = int(near.argmax())
    return np.append(normals[best], offsets[best])


def _levelled(points: Floats, places: Floats, plane: Floats) -> Floats:
    """Return a level plane [4] for the points if it is within ``LEVEL`` of ``plane`` at the places, else ``plane``."""
    z = (plane[3] - _along(places[:, :2], plane[:2])) / plane[2]
    height = float(np.median(z))
    for _ in range(12):
        weight = _biweight(points[:, 2] - height, THICKNESS)
        height = float((weight * points[:, 2]).sum() / weight.sum()) if weight.any() else height
    level = np.sqrt(((z - height) ** 2).mean()) <= LEVEL
    return np.array([0.0, 0.0, 1.0, height]) if level else plane


def _along(points: Floats, direction: Floats) -> Floats:
    """Return how far points lie along directions: the scalar products of [..., k] and [..., k]."""
    return (points * direction).sum(-1)


def _biweight(distance: Floats, width: float) -> Floats:
    """Return Tukey's biweights: 1 at distance 0, and 0 from ``width`` on."""
    return np.where(np.abs(distance) < width, (1.0 - (distance / width) ** 2) ** 2, 0.0)


def _refined(points: Floats, plane: Floats) -> Floats:
    """Refine a rough plane by iteratively reweighted least squares: [4]."""
    for width in (*[2 * THICKNESS] * 3, *[THICKNESS] * 12):
        weight = _biweight(_along(points, plane[:3]) - plane[3], width)
        if (weight > 0).sum() < 3:
            return plane
        center = (weight * points.T).sum(1) / weight.sum()
        moved = (points - center).T
        normal = np.linalg.eigh((weight * moved[:, None] * moved).sum(2))[1][:, 0]
        normal = normal if normal[2] >= 0 else -normal
        if normal[2] < math.cos(LARGEST_TILT):
            return plane
        plane = np.append(normal, _along(center, normal))
    return plane
