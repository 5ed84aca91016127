"""``transforms.json`` of nerfstudio, instant-ngp and NeRF: a list of images with OpenGL camera-to-world poses."""

import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.capture.base import CaptureError
from splatrl.capture.lens import Floats, Lens
from splatrl.capture.photo_files import photo_size
from splatrl.capture.recordings.base import (
    OPENGL,
    Recording,
    Shot,
    beside,
    path_within,
    pictures_of,
    read_depth,
    read_json,
    read_text,
    without_pose,
)
from splatrl.files import natural

MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
NAMES = "transforms.json", "transforms_train.json"
"""Names of the file in a folder; the second is that of NeRF's synthetic scenes, beside those for tests."""
FARTHEST = 65_534
"""Maximum depth, millimetres; the largest number of 16 bits stands for no depth, as in 7-Scenes."""


def found(source: Path) -> bool:
    """Return whether a path leads to such a file: the file itself, or its folder."""
    path = _file(source)
    return path.suffix == ".json" and path.is_file()


def read(source: Path) -> Recording:
    """Read ``transforms.json``.

    Depth (``depth_file_path``) is in millimetres, and so nerfstudio's poses are in metres where there is any; depth
    that COLMAP estimated has no scale and is ignored. Where ``orientation_override`` is ``none``, as for Polycam's
    recordings, +z is up. Where the size of the images is not stated, as in NeRF's synthetic scenes, it is that of the
    first.

    Raises:
        CaptureError: where it is broken, or names a camera that is not perspective.
    """
    path = _file(source)
    data = read_json(path, read_text(path))
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not frames:
        raise CaptureError(f"{path}: frames: expected a list of at least one image, got {_shown(frames)}")
    for number, frame in enumerate(frames):
        name = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(name, str):
            raise CaptureError(f"{path}: frames[{number}].file_path: expected the name of an image, got {_shown(name)}")
    named = [(beside(path.parent, frame["file_path"]), frame) for frame in frames]
    named.sort(key=lambda pair: natural(pair[0]))
    paths = [image for image, _ in named]
    if data.get("w") is None and data.get("h") is None:
        data["w"], data["h"] = photo_size(paths[0], upright=False)
    measured = not any("colmap_im_id" in frame for frame in frames)
    shots = []
    for number, (image, frame) in enumerate(named):
        try:
            lens, pose = _lens(data | frame), _pose(frame.get("transform_matrix"))
        except ValueError as error:
            raise CaptureError(f"{path}: {frame['file_path'][:80]}: {error}") from error
        file = _depth_file(path.parent, frame.get("depth_file_path")) if measured else None
        depth = None if file is None else partial(read_depth, file, farthest=FARTHEST)
        shots.append(Shot(frame["file_path"], float(number), lens, pose, image, depth, () if file is None else (file,)))
    wanted = sum(frame.get("depth_file_path") is not None for frame in frames) if measured else 0
    missing = wanted - sum(shot.depth is not None for shot in shots)
    remarks = [*without_pose(paths, (file for shot in shots for file in shot.depth_files))]
    if missing:
        remarks.append(f"{missing} of {wanted} depth images are missing: these images are used without depth.")
    return Recording(
        path,
        shots,
        pictures_of(paths),
        [path, *paths],
        up=np.array([0.0, 0.0, 1.0]) if data.get("orientation_override") == "none" else None,
        metric=wanted > 0,
        prepared=True,
        remarks=tuple(remarks),
    )


def _file(source: Path) -> Path:
    if not source.is_dir():
        return source
    return next((source / name for name in NAMES if (source / name).is_file()), source / NAMES[0])


def _depth_file(folder: Path, name: object) -> Path | None:
    path = None if name is None else path_within(folder, name)
    return path if path is not None and path.is_file() else None


def _pose(matrix: object) -> Floats:
    """Return a pose [4, 4] with OpenCV's camera axes from one with OpenGL's, whose last row may be missing."""
    try:
        rows = np.array(matrix, np.float64)
    except (TypeError, ValueError, OverflowError):
        rows = np.zeros(0)
    if rows.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"transform_matrix: expected 4 rows of 4 numbers, got {_shown(matrix)}")
    return np.concatenate([rows[:3], [[0.0, 0.0, 0.0, 1.0]]]) @ OPENGL


def _lens(known: dict[str, Any]) -> Lens:
    """Return the intrinsics of one frame.

    Args:
        known: the frame's own values, and those shared by all frames.

    Raises:
        ValueError: for a camera that is not perspective, or intrinsics that are missing or no numbers.
    """
    model = str(known.get("camera_model", "OPENCV"))
    if model not in MODELS or known.get("is_fisheye"):
        found = "is_fisheye" if model in MODELS else model[:40]
        raise ValueError(f"camera_model: expected a perspective model, got {found}")
    if _number(known, "k4"):
        raise ValueError(f"k4: expected 0, since only k1, k2, k3, p1 and p2 are supported, got {_number(known, 'k4')}")
    width, height = _number(known, "w"), _number(known, "h")
    if width is None or height is None:
        raise ValueError(f"w and h: expected the size of the image, or neither, got {width} and {height}")
    fx, angle, cx, cy = (_number(known, name) for name in ("fl_x", "camera_angle_x", "cx", "cy"))
    if not fx:
        if angle is None or not 0.0 < angle < math.pi:
            raise ValueError(f"fl_x: expected a focal length in pixels, or camera_angle_x in (0, π), got {angle}")
        fx = width / 2 / math.tan(angle / 2)
    return Lens(
        width,
        height,
        fx,
        _number(known, "fl_y") or fx,
        width / 2 if cx is None else cx,
        height / 2 if cy is None else cy,
        tuple(_number(known, name) or 0.0 for name in ("k1", "k2", "p1", "p2", "k3")),
    )


def _number(known: dict[str, Any], name: str) -> float | None:
    value = known.get(name)
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name}: expected a number, got {_shown(value)}") from None


def _shown(value: object) -> str:
    """Return a value of the file as a message shows it."""
    return json.dumps(value)[:80]
