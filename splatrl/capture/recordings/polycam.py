"""Raw data of Polycam: a folder ``keyframes`` with images, cameras, and what the depth sensor measured.

Documented in https://github.com/PolyCam/polyform: ``t_ij`` is row i and column j of camera-to-world, in ARKit's axes
and aligned with gravity (+y up), metres; depth is in millimetres, confidence is 0, 127 or 255, and both have the
sensor's own size.
"""

from functools import partial
from pathlib import Path

import numpy as np

from splatrl.capture.base import CaptureError
from splatrl.capture.lens import Lens
from splatrl.capture.recordings.base import (
    ARKIT_UP,
    OPENGL,
    Recording,
    Shot,
    depth_files,
    pictures_of,
    read_depth,
    read_json,
    read_text,
)
from splatrl.files import natural
from splatrl.images import PHOTO_SUFFIXES

MEDIUM = 127
"""Minimum confidence of the depths that are kept; Polycam calls anything below it quite unreliable."""
BORDER = 15.0
"""Pixels along the edges of corrected images that may be black, and that nerfstudio crops as well."""
CORRECTED = ("corrected_images", "corrected_cameras")
PLAIN = ("images", "cameras")
"""Folders to read where loop closure did not run: images with their slight distortion, and ARKit's own poses."""


def found(source: Path) -> bool:
    """Return whether a folder is such an export."""
    return any((source / "keyframes" / cameras).is_dir() for cameras in ("cameras", "corrected_cameras"))


def read(source: Path) -> Recording:
    """Read an export: its corrected images where there are any, or else the plain ones.

    Raises:
        CaptureError: where it is broken, or no image has a camera.
    """
    folder = source / "keyframes"
    for names in (CORRECTED, PLAIN):
        images, cameras = (folder / name for name in names)
        paths = _with_cameras(images, cameras)
        if paths:
            files = [cameras / f"{path.stem}.json" for path in paths]
            shots = [_shot(number, path, files[number]) for number, path in enumerate(paths)]
            border = BORDER if names == CORRECTED else 0.0
            return Recording(
                source, shots, pictures_of(paths), [*files, *paths], up=ARKIT_UP, metric=True, border=border
            )
    raise CaptureError(f"{folder}: expected images that each have a camera file of the same name, found none")


def _with_cameras(images: Path, cameras: Path) -> list[Path]:
    if not images.is_dir():
        return []
    files = [path for path in images.iterdir() if path.suffix.lower() in PHOTO_SUFFIXES]
    posed = [path for path in files if (cameras / f"{path.stem}.json").is_file()]
    return sorted((path for path in posed if not path.name.startswith(".")), key=natural)  # macOS writes ._1.jpg


def _shot(number: int, path: Path, file: Path) -> Shot:
    camera = read_json(file, read_text(file))
    try:
        pose = np.eye(4)
        pose[:3] = [[float(camera[f"t_{row}{column}"]) for column in range(4)] for row in range(3)]
        width, height, fx, fy, cx, cy = (float(camera[name]) for name in ("width", "height", "fx", "fy", "cx", "cy"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise CaptureError(f"{file}: expected a camera file of Polycam: {error!r}") from error
    measured = depth_files(*(path.parents[1] / name / f"{path.stem}.png" for name in ("depth", "confidence")))
    depth = partial(read_depth, *measured, least=MEDIUM) if measured else None
    lens, name = Lens(width, height, fx, fy, cx, cy), f"{file.parent.name}/{file.name}"
    return Shot(name, float(number), lens, pose @ OPENGL, path, depth, measured)
