"""Recordings that know where each image was taken: nerfstudio's and instant-ngp's, and COLMAP's models.

Their files come from strangers: images are looked for beside them only, and nothing in them is run.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch

from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.optional import needed
from splatrl.capture.photo_files import read_photo
from splatrl.capture.progress import Progress, silent
from splatrl.capture.undistort import undistorted
from splatrl.files import natural
from splatrl.images import PHOTO_SUFFIXES

MAX_BYTES = 64 * 2**20
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenCV's camera axes (y down, z forward) to OpenGL's (y up, z backward)."""
COLMAP_FILES = ("cameras.bin", "images.bin", "cameras.txt", "images.txt")


def is_recording(source: Path) -> bool:
    """Whether a path leads to a recording that knows its poses.

    Args:
        source: a file or a folder.
    """
    return _transforms(source) is not None or _colmap_model(source) is not None


def read_recording(source: Path, folder: Path, progress: Progress = silent) -> Photos:
    """Read images with known poses, without lens distortion.

    Args:
        source: ``transforms.json`` or its folder; or a folder with a COLMAP model in it, in ``sparse`` or
            ``sparse/0``, and ``images``.
        folder: of the capture; images whose distortion had to be taken out come into its sub-folder ``recorded``.
        progress: told about every such image.

    Returns:
        Images in the order of their names, with K and camera_to_world; not metric, without a known up.

    Raises:
        CaptureError: where it is no such recording, or is broken.
    """
    if (transforms := _transforms(source)) is not None:
        return _read_transforms(transforms, folder, progress)
    if (model := _colmap_model(source)) is not None:
        return _read_colmap(source, model, folder, progress)
    raise CaptureError(f"{source}: expected transforms.json or a COLMAP model, found neither")


def _transforms(source: Path) -> Path | None:
    path = source / "transforms.json" if source.is_dir() else source
    return path if path.suffix == ".json" and path.is_file() else None


def _colmap_model(source: Path) -> Path | None:
    for folder in (source, source / "sparse", source / "sparse" / "0", source / "colmap" / "sparse" / "0"):
        if any((folder / name).is_file() for name in COLMAP_FILES[:1] + COLMAP_FILES[2:3]):
            return folder
    return None


def _read_transforms(path: Path, folder: Path, progress: Progress) -> Photos:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"more than {MAX_BYTES:,} bytes")
        data = json.loads(path.read_text("utf-8"))
        frames = sorted(data["frames"], key=lambda frame: natural(Path(frame["file_path"])))
        paths = [_beside(path.parent, frame["file_path"]) for frame in frames]
        poses = np.array([frame["transform_matrix"] for frame in frames], np.float64)
        poses = np.concatenate([poses[:, :3], np.tile([[[0.0, 0, 0, 1]]], (len(poses), 1, 1))], 1)
        lenses = {json.dumps(_lens(frame, data)) for frame in frames}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise CaptureError(f"{path}: expected the frames of nerfstudio or instant-ngp: {error!r}") from error
    if len(lenses) != 1:
        raise CaptureError(f"{path}: expected one camera, got {len(lenses)}")
    return _photos(path, paths, poses @ OPENGL, json.loads(lenses.pop()), folder, progress)


def _lens(frame: dict[str, Any], data: dict[str, Any]) -> dict[str, float]:
    """Of one frame: its own values or else those of all frames."""
    model = str(frame.get("camera_model", data.get("camera_model", "OPENCV")))
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        raise ValueError(f"camera_model: expected a perspective one, got {model[:40]!r}")
    given: dict[str, Any] = {
        name: frame.get(name, data.get(name)) for name in ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x")
    }
    width, height = float(given["w"]), float(given["h"])
    angle = given["camera_angle_x"]
    focal = float(given["fl_x"]) if given["fl_x"] else width / 2 / math.tan(float(angle) / 2)
    lens = {
        "width": width,
        "height": height,
        "fx": focal,
        "fy": float(given["fl_y"] or focal),
        "cx": width / 2 if given["cx"] is None else float(given["cx"]),
        "cy": height / 2 if given["cy"] is None else float(given["cy"]),
    }
    return lens | {name: float(frame.get(name, data.get(name, 0)) or 0) for name in ("k1", "k2", "p1", "p2", "k3")}


def _read_colmap(source: Path, model: Path, folder: Path, progress: Progress) -> Photos:
    pycolmap = needed("pycolmap")
    try:
        read = pycolmap.Reconstruction(model)
    except (ValueError, RuntimeError, OSError) as error:
        raise CaptureError(f"{model}: expected a COLMAP model: {error}") from error
    images = sorted((image for image in read.images.values() if image.has_pose), key=lambda i: natural(Path(i.name)))
    cameras = {image.camera_id for image in images}
    if len(cameras) != 1:
        raise CaptureError(f"{model}: expected images of one camera, got {len(cameras)} cameras")
    camera = read.cameras[cameras.pop()]
    places = [place for place in (source / "images", model / "images", source) if place.is_dir()]
    paths = [_beside_any(places, image.name) for image in images]
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    poses[:, :3] = [image.cam_from_world().inverse().matrix() for image in images]
    return _photos(model, paths, poses, _colmap_lens(model, camera), folder, progress)


def _colmap_lens(model: Path, camera: Any) -> dict[str, float]:
    names = {
        "SIMPLE_PINHOLE": (),
        "PINHOLE": (),
        "SIMPLE_RADIAL": ("k1",),
        "RADIAL": ("k1", "k2"),
        "OPENCV": ("k1", "k2", "p1", "p2"),
    }
    if camera.model.name not in names:
        raise CaptureError(f"{model}: expected a camera among {', '.join(names)}, got {camera.model.name}")
    distortion = names[camera.model.name]
    values = camera.params[len(camera.params) - len(distortion) :]
    lens = dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0) | dict(zip(distortion, map(float, values), strict=True))
    return lens | {
        "width": float(camera.width),
        "height": float(camera.height),
        "fx": float(camera.focal_length_x),
        "fy": float(camera.focal_length_y),
        "cx": float(camera.principal_point_x),
        "cy": float(camera.principal_point_y),
    }


def _photos(
    source: Path, paths: list[Path], poses: np.ndarray, lens: dict[str, float], folder: Path, progress: Progress
) -> Photos:
    turns = poses[:, :3, :3]
    straight = np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-3) if len(paths) else False
    if not straight or not np.isfinite(poses).all() or (np.linalg.det(turns) < 0).any():
        raise CaptureError(f"{source}: expected at least one image, with rotations and finite places as poses")
    width, height = read_photo(paths[0]).size
    across, down = width / lens["width"], height / lens["height"]  # images may have been scaled since
    if abs(across / down - 1) > 0.01:
        raise CaptureError(
            f"{source}: expected images shaped as {lens['width']:.0f} × {lens['height']:.0f}, got {width} × {height}"
        )
    K = torch.tensor(
        [[lens["fx"] * across, 0, lens["cx"] * across], [0, lens["fy"] * down, lens["cy"] * down], [0, 0, 1]]
    ).double()
    distortion = np.array([lens[name] for name in ("k1", "k2", "p1", "p2", "k3")])
    if distortion.any():
        paths, K = undistorted(paths, (width, height), K, distortion, folder / "recorded", progress)
    numbers = torch.arange(len(paths), dtype=torch.float64)
    return Photos(paths, width, height, numbers, K, torch.from_numpy(poses))


def _beside_any(places: list[Path], name: str) -> Path:
    for place in places:
        if (place / name).is_file():
            return _beside(place, name)
    raise CaptureError(f"{name}: expected this image in {' or '.join(map(str, places))}, found none")


def _beside(folder: Path, name: str) -> Path:
    """An image within a folder, and nowhere else."""
    path = folder / name
    if not path.suffix:  # instant-ngp may leave it out
        path = next((path.with_suffix(s) for s in PHOTO_SUFFIXES if path.with_suffix(s).is_file()), path)
    if folder.resolve() not in path.resolve().parents:
        raise CaptureError(f"{name[:80]!r}: expected an image within {folder}")
    if not path.is_file():
        raise CaptureError(f"{path}: expected an image, found none")
    return path
