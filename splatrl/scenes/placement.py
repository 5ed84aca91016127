"""Places a splat file in the world: from a guess, from nerfstudio's transform, or from a known distance."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from splatrl.documents import read_json
from splatrl.scenes.frame import AXES, checked_similarity, similarity
from splatrl.scenes.upright import Upright, axis_name
from splatrl.values import require_number

MOST_BYTES = 2**20
"""Maximum size of nerfstudio's file in bytes; it holds 13 numbers."""
Frame = dict[str, Any]
"""Arguments of ``similarity`` by name, in types that YAML can write."""

STRAIGHT = math.radians(2.0)
"""Angle between walls and the axes below which they count as parallel; that of a captured wall is known to 1° or 2°."""
STANDING = {
    "x": ["y", "z", "x"],
    "-x": ["z", "y", "-x"],
    "y": ["x", "-z", "y"],
    "-y": ["x", "z", "-y"],
    "z": ["x", "y", "z"],
    "-z": ["x", "-y", "-z"],
}
"""For each signed axis that is up in the file, the axes that stand the file upright."""


def upright_frame(
    upright: Upright,
    axes: Sequence[str] | None = None,
    scale: float | None = None,
    translation: Sequence[float] | None = None,
) -> Frame:
    """Return the frame that stands a file upright with its floor at z = 0 and its walls along x and y.

    Where up is an axis of the file, walls that are parallel to its other axes to within ``STRAIGHT`` turn nothing.

    Args:
        upright: how the file lies; the other arguments override it.
        axes: signed axes of the file that become the world's, as for ``similarity``.
        scale: metres per unit of the file.
        translation: [3] metres, added last.
    """
    scale = _rounded(upright.metres_per_unit) if scale is None else scale
    name = axis_name(upright.up)
    standing = _standing(upright.up)
    turn = 0.0 if upright.walls is None else _oblique(standing @ upright.walls)
    if axes is None and (name is None or abs(turn) > STRAIGHT):
        along, across = math.cos(turn), math.sin(turn)
        transform = np.eye(4)
        transform[:3, :3] = scale * np.array([[along, across, 0.0], [-across, along, 0.0], [0.0, 0.0, 1.0]]) @ standing
        frame = matrix_frame(transform)
    else:
        frame = {"axes": list(axes or STANDING[str(name)]), "scale": scale}
    turned = similarity(**frame)[:3, :3].numpy()  # already rounded, so that a far origin is moved exactly
    moved = [0.0, 0.0, _rounded(-upright.floor * scale)] - turned @ upright.origin
    shift = [_rounded(value, 12) for value in moved] if translation is None else list(translation)
    if "matrix" not in frame:
        return {**frame, "translation": shift}
    return {"matrix": [[*row[:3], at] for row, at in zip(frame["matrix"], [*shift, 1.0], strict=True)]}


def matrix_frame(transform: Tensor | ArrayLike) -> Frame:
    """Return the frame of a similarity [4, 4], from splat coordinates to world metres, with rounded numbers."""
    matrix = checked_similarity(torch.as_tensor(np.asarray(transform, np.float64)))
    rows = [[*(_rounded(value, 8) for value in row[:3]), _rounded(row[3], 12)] for row in matrix.tolist()]
    return {"matrix": rows}


def nerfstudio_transform(path: Path) -> Tensor:
    """Read ``world_from_splat`` of a scene trained by nerfstudio: the transform back to the frame of its input cameras.

    The file ``dataparser_transforms.json`` beside a trained model holds ``transform`` [R | t] (3×4, a rotation and a
    shift) and ``scale`` s. Nerfstudio moved the cameras, and with them everything that it trained, by
    x_splat = s · (R x + t), so x = Rᵀ (x_splat / s − t). The result is metric and z-up if the cameras' frame was. The
    frames of phones are metric, and Polycam's is z-up as well, but Record3D's is not; COLMAP's has a scale and an up
    direction of its own.

    Args:
        path: the JSON file.

    Returns:
        [4, 4] float64.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is not JSON or lacks a valid transform and scale.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected nerfstudio's dataparser_transforms.json, found no file")
    content = read_json(path, MOST_BYTES)
    if not isinstance(content, dict) or not {"transform", "scale"} <= content.keys():
        keys = list(content) if isinstance(content, dict) else type(content).__name__
        raise ValueError(f"{path}: expected the keys transform and scale, got {keys}")
    try:
        moved = np.array(content["transform"], np.float64)
        scale = float(content["scale"])
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: expected numbers for transform and scale, got {error}") from error
    if moved.shape not in ((3, 4), (4, 4)) or not np.isfinite(moved).all():
        raise ValueError(f"{path}: transform: expected 3 rows of 4 finite numbers, got shape {list(moved.shape)}")
    require_number(f"{path}: scale", scale, above=0.0)
    rotation, shift = moved[:3, :3], moved[:3, 3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
        raise ValueError(f"{path}: transform: expected a rotation and a shift, got {moved.tolist()}")
    inverse = np.eye(4)
    inverse[:3, :3] = rotation.T / scale
    inverse[:3, 3] = -rotation.T @ shift
    return torch.from_numpy(inverse)


def metres_per_unit(start: Sequence[float], end: Sequence[float], metres: float) -> float:
    """Return the scale that a measured distance implies.

    Args:
        start: [3] a point in the file's coordinates.
        end: [3] another point in the file's coordinates.
        metres: measured distance between the two points.

    Raises:
        ValueError: for points that coincide, values that are not finite, or a distance that is not above 0.
    """
    apart = float(np.linalg.norm(np.subtract(end, start)))
    if not np.isfinite(apart) or apart == 0.0:
        raise ValueError(f"distance: expected two different points, got {list(start)} and {list(end)}")
    require_number("distance", metres, above=0.0, unit="metres")
    return metres / apart


def rescaled(transform: Tensor, scale: float) -> Tensor:
    """Rescale a similarity about the world's origin.

    Args:
        transform: [4, 4], from file coordinates to world metres.
        scale: metres per file unit in the result.
    """
    result = transform.clone()
    result[:3] *= scale / float(transform[:3, 0].norm())
    return result


def floor_height(upright: Upright, world_from_splat: Tensor) -> float:
    """Return the height of the floor once the file has been placed.

    Args:
        upright: how the file lies.
        world_from_splat: [4, 4] float64.

    Returns:
        Metres, along world z.
    """
    on_floor = torch.from_numpy(upright.origin + upright.up * upright.floor)
    return float(world_from_splat[2, :3] @ on_floor + world_from_splat[2, 3])


def _standing(up: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation that turns ``up`` to +z: the one for the nearest axis, then the smallest remaining one."""
    direction = np.asarray(up, np.float64)
    nearest = min(AXES, key=lambda name: -direction[AXES[name][0]] * AXES[name][1])
    coarse = similarity(STANDING[nearest])[:3, :3].numpy()
    x, y, z = coarse @ direction
    # Rodrigues' formula for the rotation from (x, y, z) to (0, 0, 1); z > 0.5 here.
    slant = -x * y / (1 + z)
    turn = np.array([[1 - x * x / (1 + z), slant, -x], [slant, 1 - y * y / (1 + z), -y], [x, y, z]])
    return turn @ coarse


def _oblique(walls: NDArray[np.float64]) -> float:
    """Return the angle from the nearest of ±x and ±y to walls [3], radians in ±π/4."""
    return (math.atan2(walls[1], walls[0]) + 0.25 * math.pi) % (0.5 * math.pi) - 0.25 * math.pi


def _rounded(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}") + 0.0  # no −0
