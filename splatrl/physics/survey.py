"""Derives from a scene what physics sees of it: ground plane and boxes, computed once and kept in the scene's cache."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.collision.occupancy import Occupancy
from splatrl.files import digest_of
from splatrl.native import _core
from splatrl.physics.boxes import merged_boxes, solid_above, standing
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
    _check(reach)
    ground = fit_ground(NativeRenderer(scene.gaussians, antialiased), occupancy, lower, upper)
    return _surveyed(ground, _boxes(occupancy, ground, lower, upper, reach, top))


def survey_ground(
    scene: Scene, occupancy: Occupancy, lower: Sequence[float], upper: Sequence[float], antialiased: bool = True
) -> Ground:
    """Run ``fit_ground`` through the scene's cache; see ``find_terrain``."""

    def build() -> dict[str, Any]:
        return fit_ground(NativeRenderer(scene.gaussians, antialiased), occupancy, lower, upper).to_arrays()

    return Ground.from_arrays(scene.cached("ground", _settings(occupancy, lower, upper, antialiased), build))


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
    _check(reach)
    ground = survey_ground(scene, occupancy, lower, upper, antialiased)
    if ground.trouble:
        warnings.warn(f"{scene.name}: {ground.trouble}", stacklevel=2)
    settings = {**_settings(occupancy, lower, upper, antialiased), "reach": float(reach), "top": float(top)}
    found = scene.cached("boxes", settings, lambda: {"boxes": _boxes(occupancy, ground, lower, upper, reach, top)})
    return _surveyed(ground, found["boxes"])


def without_ground(occupancy: Occupancy, ground: Ground) -> Occupancy:
    """Return the solid voxels that physics does not take as ground: those of which it makes boxes, at any height."""
    return replace(occupancy, occupied=standing(occupancy, ground))


def _check(reach: float) -> None:
    if not reach >= 0.0:
        raise ValueError(f"reach: expected a non-negative number of metres, got {reach}")


def _settings(
    occupancy: Occupancy, lower: Sequence[float], upper: Sequence[float], antialiased: bool
) -> dict[str, Any]:
    """Return what a ground depends on besides the Gaussians, for the cache."""
    return {
        "occupancy": occupancy.digest,
        "bounds": [list(map(float, lower)), list(map(float, upper))],
        "antialiased": antialiased,
        "code": digest_of(CODE),
    }


def _boxes(
    occupancy: Occupancy, ground: Ground, lower: Sequence[float], upper: Sequence[float], reach: float, top: float
) -> NDArray[np.float64]:
    """Return the boxes of ``find_terrain``: [N, 6]."""
    low, high = [value - reach for value in lower], [value + reach for value in upper]
    return merged_boxes(solid_above(occupancy, ground, low, high, top))


def _surveyed(ground: Ground, boxes: NDArray[np.float64]) -> Surveyed:
    return Surveyed(ground, Terrain(torch.from_numpy(ground.plane), torch.from_numpy(boxes)))
