"""Reads and writes ``scene.yaml``, the file that states where a splat lies in the world."""

import difflib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.documents import read_yaml
from splatrl.files import checked_name, replacing
from splatrl.scenes.placement import Frame
from splatrl.scenes.proposals import PROPOSALS, check_proposals
from splatrl.scenes.scene import Bounds

SCENE_FILE = "scene.yaml"
SPLAT, SMALL_SPLAT = "splat.ply", "splat.spz"
"""Names of the splat file in a scene folder that splatrl creates, as PLY and as SPZ."""
PATH = "path.ply"
"""Name of the point cloud in a captured scene's folder: the camera position of each image, in order, world, metres."""
SCENE_KEYS = ("splat", "name", "world_from_splat", "bounds", *PROPOSALS)
COMMENTS = {
    "axes": "axes of the file that become the world's x, y and z (up)",
    "scale": "metres per unit of the file",
    "translation": "metres, added last",
    "matrix": "from file coordinates to world metres: rotation, uniform scale and translation",
    "antialiased": "whether to render antialiased; false: classic 3DGS images, meant for large ones",
    "metric": "whether lengths are metres; false: the scale is unknown or only a guess",
    "robot_height": "height of the robot's camera, metres",
    "walk": "lower and upper corner of the walkable area, x and y in metres",
    "step": "length of a step and spacing of the starts, metres; null keeps the task's value",
    "voxel_size": "edge of the occupancy voxels, metres",
    "cutoff": "minimum fraction of the light that a solid voxel absorbs",
    "free": "centres of voxels that are free although Gaussians fill them",
    "goal": "free pose with something to see: x, y in metres and yaw in degrees",
    "object": "free position for an object to find: x, y, z in metres",
    "object_size": "width of the object drawn there, metres; null keeps the task's value",
    "source": "where the splat is from: author, licence, address",
    "quality": "quality measures of the capture, for people to read",
}


def read_description(folder: Path) -> dict[str, Any]:
    """Read a folder's ``scene.yaml`` and return its non-null ``SCENE_KEYS``, always including ``splat``.

    Raises:
        FileNotFoundError: if the folder has no ``scene.yaml``.
        ValueError: if the file is not YAML, or has unknown keys or values of the wrong type; the message names the file
            and the key.
    """
    path = folder / SCENE_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a scene folder with {SCENE_FILE}, found none")
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected keys and values, got {content!r}")
    check_keys(str(path), content, SCENE_KEYS)
    if content.get("splat") is None:
        raise ValueError(f"{path}: splat: expected the name of a file in this folder, got none")
    stated = {str(key): value for key, value in content.items() if value is not None}
    for key in ("splat", "name"):
        if key in stated:
            checked_name(f"{path}: {key}", stated[key])
    if not isinstance(stated.get("world_from_splat", {}), dict):
        raise ValueError(f"{path}: world_from_splat: expected keys and values, got {stated['world_from_splat']!r}")
    check_proposals(path, stated)
    return stated


def check_keys(where: str, content: Mapping[Any, Any], known: Sequence[str]) -> None:
    """Refuse keys that are not among those known, and name a similar one for each.

    Args:
        where: the file, and the place in it, for the message.
        content: keys and values.
        known: the known keys.

    Raises:
        ValueError: names the unknown keys and those that are known.
    """
    unknown = [str(key) for key in content if key not in known]
    if unknown:
        near = [match for key in unknown for match in difflib.get_close_matches(key, known, 1)]
        hint = f"; did you mean {' and '.join(near)}?" if near else ""
        raise ValueError(f"{where}: expected the keys {', '.join(known)}, got {', '.join(unknown):.80}{hint}")


def write_description(
    folder: Path,
    splat: str,
    name: str,
    frame: Frame,
    bounds: Bounds,
    force: bool = False,
    proposals: Mapping[str, Any] | None = None,
) -> Path:
    """Write a ``scene.yaml`` for ``read_scene`` to read and people to edit, with comments on its keys.

    Args:
        folder: an existing folder to write to.
        splat: name of the splat file, which is in this folder or will be.
        name: name of the scene.
        frame: arguments of ``similarity`` by name.
        bounds: lower and upper corner, world frame, metres.
        force: whether to overwrite an existing file.
        proposals: keys of ``PROPOSALS`` and their values; None proposes nothing.

    Raises:
        FileExistsError: if the file exists and ``force`` is not set.
        ValueError: for proposals that ``read_description`` would refuse.
    """
    path = folder / SCENE_FILE
    check_absent(path, force)
    check_proposals(path, {key: value for key, value in (proposals or {}).items() if value is not None})
    lines = [
        (f"splat: {json.dumps(splat, ensure_ascii=False)}", "the splat file in this folder"),
        (f"name: {json.dumps(name, ensure_ascii=False)}", "for captions and file names"),
        ("world_from_splat:", "from the file to the world, which is z-up and in metres"),
        *((f"  {key}: {json.dumps(value)}", COMMENTS[key]) for key, value in frame.items()),
    ]
    longest = max(high - low for low, high in zip(*bounds, strict=True))
    corners = np.round(bounds, decimals_of(longest)).tolist()
    if (np.array(corners[1]) > np.array(corners[0])).all():
        lines.append((f"bounds: {json.dumps(corners)}", "lower and upper corner of the scene, world frame, metres"))
    else:
        lines.append(("bounds: null", "null: the bounding box of the opaque Gaussians"))
    for key, value in (proposals or {}).items():
        lines += [
            (f"{key}:" if isinstance(value, dict) else f"{key}: {json.dumps(value, ensure_ascii=False)}", COMMENTS[key])
        ]
        if isinstance(value, dict):
            lines += [(f"  {figure}: {json.dumps(each)}", "") for figure, each in value.items()]
    text = "".join(f"{line}  # {comment}\n" if comment else f"{line}\n" for line, comment in lines)
    with replacing(path) as stream:
        stream.write(text.encode())
    return path


def decimals_of(side: float) -> int:
    """Return how many decimals resolve a ten-thousandth of a side, wherever it lies."""
    return 4 - math.floor(math.log10(side)) if side > 0.0 else 0


def scene_folder(out: Path) -> tuple[Path, str]:
    """Return a scene's folder and the name of its splat file for an ``--out``, which may ask for the smaller SPZ.

    Args:
        out: a path such as ``garden`` or ``garden.spz``; the folder is ``garden`` in both cases.
    """
    return (out.with_suffix(""), SMALL_SPLAT) if out.suffix.lower() == ".spz" else (out, SPLAT)


def check_absent(path: Path, force: bool) -> None:
    """Refuse to overwrite an existing file unless ``force`` is set.

    Raises:
        FileExistsError: if the file exists and ``force`` is not set.
    """
    if path.exists() and not force:
        raise FileExistsError(
            f"{path}: already exists; choose another folder with --out, or pass --force to overwrite it"
        )
