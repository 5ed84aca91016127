"""Writing ``scene.yaml``, the file that says where a splat lies in the world."""

import json
from pathlib import Path

import numpy as np

from splatrl.files import replacing
from splatrl.scenes.placement import Frame
from splatrl.scenes.scene import SCENE_FILE, Bounds

COMMENTS = {
    "axes": "the file's axis that becomes the world's x, y and z (up)",
    "scale": "metres a unit of the file",
    "translation": "metres, added last",
    "matrix": "from the file's coordinates to world metres: a rotation times one scale, and a shift",
}


def write_description(folder: Path, splat: str, name: str, frame: Frame, bounds: Bounds, force: bool = False) -> Path:
    """Write a ``scene.yaml`` that ``load_scene`` reads and people edit: a comment on every line.

    Args:
        folder: where to; exists.
        splat: name of the splat file, which lies in this folder or will.
        name: of the scene.
        frame: arguments of ``similarity``.
        bounds: lower and upper corner, world, metres.
        force: whether to replace one that is there.

    Raises:
        FileExistsError: for one that is there, without ``force``.
    """
    path = folder / SCENE_FILE
    check_absent(folder, force)
    lines = [
        (f"splat: {json.dumps(splat, ensure_ascii=False)}", "the splat file in this folder"),
        (f"name: {json.dumps(name, ensure_ascii=False)}", "for captions and file names"),
        ("world_from_splat:", "the world is z up, in metres"),
        *((f"  {key}: {json.dumps(value)}", COMMENTS[key]) for key, value in frame.items()),
    ]
    corners = [[float(f"{value:.4g}") for value in corner] for corner in bounds]
    if (np.array(corners[1]) > np.array(corners[0])).all():
        lines.append((f"bounds: {json.dumps(corners)}", "lower and upper corner of what counts, world, metres"))
    else:
        lines.append(("bounds: null", "null takes where the opaque Gaussians are"))
    text = "".join(f"{line}  # {comment}\n" for line, comment in lines)
    with replacing(path) as stream:
        stream.write(text.encode())
    return path


def check_absent(folder: Path, force: bool) -> None:
    """Refuse to write over a ``scene.yaml`` unless told to.

    Raises:
        FileExistsError: for one that is there, without ``force``.
    """
    if (folder / SCENE_FILE).exists() and not force:
        raise FileExistsError(
            f"{folder / SCENE_FILE}: is there already; keep it, give another folder by --out, or replace it by --force"
        )
