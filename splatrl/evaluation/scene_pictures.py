"""Pictures for judging a captured scene: what is free, what is solid, and a view from inside."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatrl.collision.density import DensitySettings
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.pictures import draw_blocks, draw_maps
from splatrl.evaluation.viewpoint import eye_view, open_corner
from splatrl.files import replacing
from splatrl.scenes.scene import Scene

EYE = 1.6
"""Height of a person's eye, metres."""
FLAT = 0.15
"""A scene whose height is below this fraction of its width is viewed from above."""
_SMALLEST_PIECE = 64
"""Connected components with fewer voxels are floaters, whatever the scene's units."""


def survey_occupancy(scene: Scene, resolution: float | None = None) -> Occupancy:
    """Compute the occupancy of a scene whose units may still be wrong, without using the cache.

    Args:
        scene: the scene, in the world frame.
        resolution: edge of a voxel, metres; None takes 0.05, clamped to between 1/256 and 1/50 of the scene's diagonal.

    Raises:
        ValueError: for a scene without extent, or a grid that becomes too large.
    """
    lower, upper = np.array(scene.bounds)
    diagonal = float(np.linalg.norm(upper - lower))
    if diagonal == 0.0:
        raise ValueError(f"{scene.name}: expected a scene with a spatial extent, got a single point")
    edge = resolution or float(np.clip(0.05, diagonal / 256, diagonal / 50))
    margin = 0.1 * diagonal
    crop = ((lower - margin).tolist(), (upper + margin).tolist())
    return Occupancy.from_gaussians(scene.gaussians, edge, DensitySettings(min_volume=_SMALLEST_PIECE * edge**3), crop)


def stated_occupancy(scene: Scene, stated: Mapping[str, Any], resolution: float | None = None) -> Occupancy:
    """Compute the occupancy that training uses in a scene whose folder states its settings, before it is filled.

    Args:
        scene: the scene, in the world frame.
        stated: keys and values of its ``scene.yaml``; none is null.
        resolution: edge of a voxel, metres; None takes the ``voxel_size`` that is stated, or training's default.

    Raises:
        ValueError: for a grid that becomes too large, or damaged free space.
    """
    edge = resolution or stated.get("voxel_size")
    settings: dict[str, Any] = {} if edge is None else {"resolution": edge}
    density = DensitySettings(cutoff=stated.get("cutoff", DensitySettings.cutoff))
    return Occupancy.from_scene(scene, density=density, **settings)


def draw_scene(
    scene: Scene, occupancy: Occupancy, floor: float, height: float, folder: Path, antialiased: bool = True
) -> list[Path]:
    """Draw free space at a robot's height, the occupancy, and a view from eye height.

    Args:
        scene: the scene, in the world frame.
        occupancy: what is solid in it.
        floor: height of the floor, metres.
        height: height of the robot, metres; capped at half the scene's height, since its units may be wrong.
        folder: folder for the pictures, created if necessary.
        antialiased: whether to render the view antialiased; False gives the classic 3DGS image.

    Returns:
        The files: ``<name>-free.png``, ``<name>-occupancy.png`` and ``<name>-view.png``.
    """
    lower, upper = np.array(scene.bounds)
    room = max(float(upper[2]) - floor, 4 * occupancy.resolution)
    body = min(height, 0.5 * room)
    eye = min(EYE, 0.65 * room)
    across = float(np.hypot(*(upper - lower)[:2]))
    if room < FLAT * across:  # an aerial capture: from eye height one would see only ground
        eye = 0.4 * across
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{scene.name}-{kind}.png" for kind in ("free", "occupancy", "view")]
    draw_maps(occupancy, files[0], round(floor + 0.5 * body, 3), round(floor + body, 3))
    draw_blocks(occupancy, files[1], below=floor + 0.85 * room, quarter_turns=open_corner(occupancy))
    view = eye_view(scene.gaussians, occupancy, scene.bounds, floor, floor + eye, antialiased=antialiased)
    image = Image.fromarray(view.numpy())
    with replacing(files[2]) as stream:
        image.save(stream, "PNG")
    return files
