"""Derives from a scene what physics sees of it: ground plane and boxes, computed once and kept in the scene's cache."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.collision.occupancy import Occupancy
from splatrl.files import digest_of
from splatrl.native import _core
from splatrl.physics.boxes import merged_boxes, solid_above
from splatrl.physics.ground import Ground, fit_ground
from splatrl.physics.terrain import Terrain
from splatrl.renderers.native import NativeRenderer
from splatrl.scenes.scene import Scene

CODE = [*sorted(Path(__file__).parent.glob("*.py")), Path(_core.__file__)]
"""Code that computes a terrain; any change to it invalidates cached terrains."""


class Surveyed(NamedTuple):
    """A scene as physics sees it.

    Attributes:
        ground: the ground plane, and how well it fits.
        terrain: the same plane, and boxes that cover what is solid above it.
    """

    ground: Ground
    terrain: Terrain


def find_terrain(
    scene: Scene,
    occupancy: Occupancy,
    lower: Sequence[float],
    upper: Sequence[float],
    reach: float,
    top: float,
    antialiased: bool = True,
) -> Surveyed:
    """Find the ground and the boxes of the part of a scene that bodies can be in.

    Args:
        scene: the scene, in the world frame.
        occupancy: the scene's solid voxels, the ground included.
        lower: smallest x and y that robots go to, metres.
        upper: largest x and y, metres.
        reach: how far bodies reach beyond these bounds, metres; anything farther out is left out.
        top: height above the ground that no body reaches, metres; anything higher is left out.
        antialiased: whether the scene is rendered with antialiasing.

    Raises:
        ValueError: for bounds without area, a negative reach, a ``top`` near the ground, or too few places to stand.
    """
    if not reach >= 0.0:
        raise ValueError(f"reach: expected a non-negative number of metres, got {reach}")
    ground = fit_ground(NativeRenderer(scene.gaussians, antialiased), occupancy, lower, upper)
    low, high = [value - reach for value in lower], [value + reach for value in upper]
    return _surveyed(ground, merged_boxes(solid_above(occupancy, ground, low, high, top)))


def survey_terrain(
    scene: Scene,
    occupancy: Occupancy,
    lower: Sequence[float],
    upper: Sequence[float],
    reach: float,
    top: float,
    antialiased: bool = True,
) -> Surveyed:
    """Run ``find_terrain`` through the scene's cache, and warn if the ground is not one plane."""
    settings = {
        "occupancy": occupancy.digest,
        "bounds": [list(map(float, lower)), list(map(float, upper))],
        "reach": float(reach),
        "top": float(top),
        "antialiased": antialiased,
        "code": digest_of(CODE),
    }

    def build() -> dict[str, Any]:
        found = find_terrain(scene, occupancy, lower, upper, reach, top, antialiased)
        return {**found.ground.to_arrays(), "boxes": found.terrain.boxes.numpy()}

    arrays = scene.cached("terrain", settings, build)
    found = _surveyed(Ground.from_arrays(arrays), arrays["boxes"])
    if found.ground.trouble:
        warnings.warn(f"{scene.name}: {found.ground.trouble}", stacklevel=2)
    return found


def _surveyed(ground: Ground, boxes: NDArray[np.float64]) -> Surveyed:
    return Surveyed(ground, Terrain(torch.from_numpy(ground.plane), torch.from_numpy(boxes)))
