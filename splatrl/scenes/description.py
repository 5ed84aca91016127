"""``scene.yaml``, the file that says where a splat lies in the world: reading and writing it."""

import json
import math
from collections.abc import Mapping
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
"""Names of the splat file in a folder that splatrl writes whole."""
PATH = "path.ply"
"""Name of a point cloud in a captured folder: where the camera was at each image, in order, world, metres."""
SCENE_KEYS = ("splat", "name", "world_from_splat", "bounds", *PROPOSALS)
COMMENTS = {
    "axes": "the file's axis that becomes the world's x, y and z (up)",
    "scale": "metres per unit of the file",
    "translation": "metres, added last",
    "matrix": "from the file's coordinates to world metres: a rotation times one scale, and a shift",
    "antialiased": "how it is to be drawn, as it was trained; false: classic 3DGS images",
    "metric": "whether a unit is a metre; false: nothing told the scale",
    "robot_height": "of the robot's camera, metres",
    "walk": "lower and upper corner of where robots walk, x and y in metres",
    "step": "of a robot and between its starts, metres; null takes the task's own",
    "voxel_size": "edge of the voxels that say what is solid, metres",
    "cutoff": "share of the light that a solid voxel absorbs, at least",
    "free": "centres of voxels that are free although Gaussians fill them",
    "goal": "x, y in metres and yaw in degrees of a free pose that sees something",
    "object": "x, y, z in metres of a free place for a thing to find",
    "object_size": "metres across, of a thing that is drawn there; null takes the task's own",
    "quality": "figures of the capture, for people to read",
}


def read_description(folder: Path) -> dict[str, Any]:
    """Read a folder's ``scene.yaml``: the ``SCENE_KEYS`` that are not null, always including ``splat``.

    Raises:
        FileNotFoundError: for a folder without a ``scene.yaml``.
        ValueError: for a file that is not YAML, unknown keys or values of another type; names the file and the key.
    """
    path = folder / SCENE_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a scene folder with {SCENE_FILE}, found none")
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected keys and values, got {content!r}")
    unknown = [str(key) for key in content if key not in SCENE_KEYS]
    if unknown:
        raise ValueError(f"{path}: expected the keys {', '.join(SCENE_KEYS)}, got {', '.join(unknown)}")
    stated = {str(key): value for key, value in content.items() if value is not None}
    for key in ("splat", *(key for key in ("name",) if key in stated)):
        checked_name(f"{path}: {key}", stated.get(key))
    if not isinstance(stated.get("world_from_splat", {}), dict):
        raise ValueError(f"{path}: world_from_splat: expected keys and values, got {stated['world_from_splat']!r}")
    check_proposals(path, stated)
    return stated


def write_description(
    folder: Path,
    splat: str,
    name: str,
    frame: Frame,
    bounds: Bounds,
    force: bool = False,
    proposals: Mapping[str, Any] | None = None,
) -> Path:
    """Write a ``scene.yaml`` for ``read_scene`` to read and people to edit, with a comment on every line.

    Args:
        folder: to write to; it exists.
        splat: name of the splat file, which is in this folder or will be.
        name: of the scene.
        frame: arguments of ``similarity``.
        bounds: lower and upper corner, world, metres.
        force: whether to overwrite an existing file.
        proposals: keys of ``PROPOSALS`` and their values; None proposes nothing.

    Raises:
        FileExistsError: for an existing file, without ``force``.
        ValueError: for proposals that ``read_description`` would refuse.
    """
    path = folder / SCENE_FILE
    check_absent(folder, force)
    check_proposals(path, {key: value for key, value in (proposals or {}).items() if value is not None})
    lines = [
        (f"splat: {json.dumps(splat, ensure_ascii=False)}", "the splat file in this folder"),
        (f"name: {json.dumps(name, ensure_ascii=False)}", "for captions and file names"),
        ("world_from_splat:", "the world is z up, in metres"),
        *((f"  {key}: {json.dumps(value)}", COMMENTS[key]) for key, value in frame.items()),
    ]
    corners = np.round(bounds, _decimals(bounds)).tolist()
    if (np.array(corners[1]) > np.array(corners[0])).all():
        lines.append((f"bounds: {json.dumps(corners)}", "lower and upper corner of what counts, world, metres"))
    else:
        lines.append(("bounds: null", "null takes the box around the opaque Gaussians"))
    for key, value in (proposals or {}).items():
        lines += [(f"{key}:" if isinstance(value, dict) else f"{key}: {json.dumps(value)}", COMMENTS[key])]
        if isinstance(value, dict):
            lines += [(f"  {figure}: {json.dumps(each)}", "") for figure, each in value.items()]
    text = "".join(f"{line}  # {comment}\n" if comment else f"{line}\n" for line, comment in lines)
    with replacing(path) as stream:
        stream.write(text.encode())
    return path


def _decimals(bounds: Bounds) -> int:
    """Decimals that tell a ten-thousandth of the longest side, wherever the scene is."""
    longest = max(high - low for low, high in zip(*bounds, strict=True))
    return 4 - math.floor(math.log10(longest)) if longest > 0.0 else 0


def scene_folder(out: Path) -> tuple[Path, str]:
    """The folder of a scene and the name of its splat file, by an ``--out`` that may ask for a small one.

    Args:
        out: such as ``garden`` or ``garden.spz``, for which the folder is ``garden`` too.
    """
    return (out.with_suffix(""), SMALL_SPLAT) if out.suffix == ".spz" else (out, SPLAT)


def check_absent(folder: Path, force: bool) -> None:
    """Refuse to write over a ``scene.yaml`` unless told to.

    Raises:
        FileExistsError: for an existing file, without ``force``.
    """
    if (folder / SCENE_FILE).exists() and not force:
        raise FileExistsError(
            f"{folder / SCENE_FILE}: already exists; keep it, pass another folder as --out, or overwrite it by --force"
        )
