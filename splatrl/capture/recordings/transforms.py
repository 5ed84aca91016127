"""``transforms.json`` of nerfstudio and instant-ngp: a list of images with OpenGL camera-to-world poses."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.capture.base import CaptureError
from splatrl.capture.recordings.base import (
    OPENGL,
    Depth,
    Lens,
    Recording,
    Shot,
    beside,
    pictures_of,
    read_depth,
    read_json,
    read_text,
)
from splatrl.files import natural

MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")


def found(source: Path) -> bool:
    """Return whether a path leads to such a file: the file itself, or its folder."""
    path = _file(source)
    return path.suffix == ".json" and path.is_file()


def read(source: Path) -> Recording:
    """Read ``transforms.json``.

    Depth (``depth_file_path``) is in millimetres, and so nerfstudio's poses are in metres where there is any; depth
    that COLMAP estimated has no scale and is ignored. Where ``orientation_override`` is ``none``, as for Polycam's
    recordings, +z is up.

    Raises:
        CaptureError: where it is broken, or names a camera that is not perspective.
    """
    path = _file(source)
    data = read_json(path, read_text(path))
    try:
        frames = sorted(data["frames"], key=lambda frame: natural(Path(frame["file_path"])))
        paths = [beside(path.parent, frame["file_path"]) for frame in frames]
        poses = np.array([frame["transform_matrix"] for frame in frames], np.float64)
        poses = np.concatenate([poses[:, :3], np.tile([[[0.0, 0, 0, 1]]], (len(poses), 1, 1))], 1) @ OPENGL
        lenses = [_lens(frame, data) for frame in frames]
        measured = not any("colmap_im_id" in frame for frame in frames)
        depths = [_depth(path.parent, frame) if measured else None for frame in frames]
        up = np.array([0.0, 0.0, 1.0]) if data.get("orientation_override") == "none" else None
    except CaptureError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError, ZeroDivisionError) as error:
        raise CaptureError(f"{path}: expected frames as nerfstudio or instant-ngp writes them: {error!r}") from error
    shots = [Shot(float(n), *known) for n, known in enumerate(zip(lenses, poses, paths, depths, strict=True))]
    metric = any(depth is not None for depth in depths)
    return Recording(path, shots, pictures_of(paths), [path, *paths], up, metric, prepared=True)


def _file(source: Path) -> Path:
    return source / "transforms.json" if source.is_dir() else source


def _depth(folder: Path, frame: dict[str, Any]) -> Callable[[], Depth] | None:
    name = frame.get("depth_file_path")
    return None if name is None else partial(read_depth, beside(folder, name), farthest=None)


def _lens(frame: dict[str, Any], data: dict[str, Any]) -> Lens:
    """Return the intrinsics of one frame: its own values, or else those shared by all frames."""
    model = str(frame.get("camera_model", data.get("camera_model", "OPENCV")))
    if model not in MODELS:
        raise ValueError(f"camera_model: expected a perspective model, got {model[:40]!r}")
    given: dict[str, Any] = {
        name: frame.get(name, data.get(name)) for name in ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x")
    }
    width, height = float(given["w"]), float(given["h"])
    angle = given["camera_angle_x"]
    focal = float(given["fl_x"]) if given["fl_x"] else width / 2 / math.tan(float(angle) / 2)
    return Lens(
        width,
        height,
        focal,
        float(given["fl_y"] or focal),
        width / 2 if given["cx"] is None else float(given["cx"]),
        height / 2 if given["cy"] is None else float(given["cy"]),
        tuple(float(frame.get(name, data.get(name, 0)) or 0) for name in ("k1", "k2", "p1", "p2", "k3")),
    )
