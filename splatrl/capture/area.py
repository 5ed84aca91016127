"""Survey of a captured place: its bounds, the area where people walked, and what is solid there."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from splatrl.bodies import Sphere
from splatrl.capture.floaters import hazy_voxels
from splatrl.capture.lattice import Floats, FreeGround, Walk, aligned, free_ground
from splatrl.capture.world import Placed
from splatrl.collision import NativeChecker
from splatrl.collision.density import DensitySettings
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.voxels import Voxels
from splatrl.geometry import rigid
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Bounds

GRID = 0.2
"""Spacing of the robots' lattice, metres; the sides of the walkable area are whole multiples of it."""
BESIDE = 0.3
"""Minimum margin between the walkable area and the bounds of the place, metres."""
LEAST = 1.0
"""Shortest side of the walkable area, metres."""
MOST_STEPS = 40
"""Maximum steps along the longer side of the walkable area; in larger places a robot takes longer steps instead."""
TRIM = 0.01
_VOXELS = (256, 50)
"""Maximum and minimum number of voxels along the diagonal, where ``VOXEL`` does not suit the size of the place."""
VOXEL = 0.05
"""Edge of a voxel in places the size of a room or a garden, metres."""
AROUND = 0.05
"""Radius of the sphere around a camera that must be free where people walked, metres."""
SOLID = DensitySettings(cutoff=0.91)
"""Density settings that decide what counts as solid in a fit. Real surfaces absorb all light within a voxel; what lets
a tenth of it through is matter that the fit could not place well, in front of bare walls and behind edges."""


@dataclass(frozen=True, eq=False)
class Area:
    """A captured place, world frame, metres.

    Attributes:
        bounds: lower and upper corner of the part of the world that counts.
        walk: lower and upper corner [x, y] of the area where people walked.
        step: length of a robot's step; None for the usual step.
        robot_height: height of the robot's camera; in a capture, the median height of its cameras.
        occupancy: what is solid within the bounds and, in a capture, in a margin around them.
        free: voxels that the Gaussians make solid but that are free: cameras see surfaces behind them.
        floor: voxels of the floor on which robots may stand, one layer; None where the path of the cameras tells.
    """

    bounds: Bounds
    walk: Walk
    step: float | None
    robot_height: float
    occupancy: Occupancy
    free: Voxels
    floor: Voxels | None = None

    @property
    def spacing(self) -> float:
        """Length of a robot's step, metres, also where it is the usual one."""
        return self.step or GRID

    def ground(self, path: Floats | None = None) -> FreeGround:
        """Return the free ground around the floor's voxels, or around the path [N, 2] of a capture's cameras."""
        known = path if self.floor is None else self.floor.centers()[:, :2].astype(np.float64)
        assert known is not None, "expected the path of the cameras, since no floor is known"
        return free_ground(self.occupancy, self.robot_height, self.walk, known)


def survey_area(gaussians: Gaussians, placed: Placed, known: Tensor | None = None) -> Area:
    """Find the bounds and the walkable area of a placed capture, and what is solid in it.

    Args:
        gaussians: the fitted Gaussians, world frame.
        placed: the cameras and points.
        known: [N, h, w] depths of the photos' pixels, metres, 0 where unknown; None where no depth is known.
    """
    poses = placed.reconstruction.camera_to_world.numpy()
    walk, step = whole_steps(poses[:, :2, 3])
    dense = dense_voxels(gaussians, placed)
    hazy = hazy_voxels(dense, gaussians, placed.reconstruction, known)
    free = Voxels(hazy, dense.origin_key, dense.resolution)
    solid = dense.without(free)
    height = round(float(np.median(poses[:, 2, 3])), 2)
    area = Area(_bounds(placed, walk), walk, step, height, solid, free)
    walk = aligned(area.ground(poses[:, :2, 3]), walk, area.spacing)
    return replace(area, bounds=_bounds(placed, walk), walk=walk)


def dense_voxels(gaussians: Gaussians, placed: Placed) -> Occupancy:
    """Find what the Gaussians of a placed capture make solid, with voxels that suit the size of the place."""
    lower, upper = np.array(_bounds(placed, whole_steps(placed.reconstruction.camera_to_world[:, :2, 3].numpy())[0]))
    diagonal = float(np.linalg.norm(upper - lower))
    edge = float(f"{np.clip(VOXEL, diagonal / _VOXELS[0], diagonal / _VOXELS[1]):.2g}")
    margin = 0.1 * float((upper - lower).max())
    crop = ((lower - margin).tolist(), (upper + margin).tolist())
    return Occupancy.from_gaussians(gaussians, edge, SOLID, crop)


def path_is_free(occupancy: Occupancy, camera_to_world: Tensor) -> Tensor:
    """Return whether a sphere around each camera touches nothing solid: [N, 4, 4] -> [N] bool."""
    places = camera_to_world[:, :3, 3].float()
    turns = torch.eye(3).expand(len(places), 3, 3)
    return ~NativeChecker(occupancy, Sphere(AROUND)).collides(rigid(turns, places))


def _bounds(placed: Placed, walked: Walk) -> Bounds:
    """Return the box around the cameras, the walkable area and the points near them, without the distant background."""
    cameras, walk = placed.reconstruction.camera_to_world[:, :3, 3].numpy(), np.array(walked)
    points = placed.reconstruction.points.numpy()
    low, high = cameras.min(0), cameras.max(0)
    reach = max(float((high - low)[:2].max()), 2 * float(np.median(cameras[:, 2])))
    near = points[((points >= low - reach) & (points <= high + reach)).all(1)]
    if len(near) >= 20:
        first, last = np.quantile(near, [TRIM, 1 - TRIM], axis=0)
        low, high = np.minimum(low, first), np.maximum(high, last)
    low[:2], high[:2] = np.minimum(low[:2], walk[0] - BESIDE), np.maximum(high[:2], walk[1] + BESIDE)
    low[2] = min(0.0, max(low[2], -0.5 * float(np.median(cameras[:, 2]))))
    lower, upper = ([float(f"{value:.3f}") for value in corner] for corner in (low - 0.01, high + 0.01))
    return (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])


def whole_steps(places: Floats) -> tuple[Walk, float | None]:
    """Return the area around camera positions [N, 2] in whole steps, and the step (None unless the area is large)."""
    low, high = np.quantile(places, [TRIM, 1 - TRIM], axis=0)
    widest = float((high - low).max())
    step = GRID * math.ceil(widest / GRID / MOST_STEPS - 1e-9) if widest > GRID * MOST_STEPS else None
    edge = step or GRID
    sides = edge * np.maximum(np.round((high - low) / edge), math.ceil(LEAST / edge - 1e-9))
    lower = np.round(0.5 * (low + high) - 0.5 * sides, 2)
    upper = np.round(lower + sides, 2)
    corners = lower.tolist(), upper.tolist()
    step = None if step is None else round(step, 2)
    return ((corners[0][0], corners[0][1]), (corners[1][0], corners[1][1])), step
