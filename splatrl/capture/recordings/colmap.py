"""A COLMAP model beside its images."""

from pathlib import Path
from typing import Any

import numpy as np

from splatrl.capture.base import CaptureError
from splatrl.capture.optional import needed
from splatrl.capture.recordings.base import Lens, Recording, Shot, beside, pictures_of
from splatrl.files import natural

FILES = ("cameras.bin", "images.bin", "cameras.txt", "images.txt")
DISTORTION: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("k1",),
    "RADIAL": ("k1", "k2"),
    "OPENCV": ("k1", "k2", "p1", "p2"),
}
"""Camera models, and what the last of their parameters are."""


def found(source: Path) -> bool:
    """Whether a folder holds a model, itself or in ``sparse``, ``sparse/0`` or ``colmap/sparse/0``."""
    return _folder(source) is not None


def read(source: Path) -> Recording:
    """Read a model; its images are in ``images``, or beside it.

    Raises:
        CaptureError: where it is broken, lacks images, or has a camera that is not perspective.
        ImportError: without the extra ``capture``.
    """
    pycolmap = needed("pycolmap")
    model = _folder(source)
    assert model is not None
    try:
        read = pycolmap.Reconstruction(model)
    except (ValueError, RuntimeError, OSError) as error:
        raise CaptureError(f"{model}: expected a COLMAP model: {error}") from error
    images = sorted((image for image in read.images.values() if image.has_pose), key=lambda i: natural(Path(i.name)))
    places = [place for place in (source / "images", model / "images", source) if place.is_dir()]
    paths = [_beside_any(places, image.name) for image in images]
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    if images:
        poses[:, :3] = [image.cam_from_world().inverse().matrix() for image in images]
    lenses = [_lens(model, read.cameras[image.camera_id]) for image in images]
    shots = [Shot(float(n), *known) for n, known in enumerate(zip(lenses, poses, paths, strict=True))]
    files = [model / name for name in FILES if (model / name).is_file()]
    return Recording(model, shots, pictures_of(paths), [*files, *paths], prepared=True)


def _folder(source: Path) -> Path | None:
    for folder in (source, source / "sparse", source / "sparse" / "0", source / "colmap" / "sparse" / "0"):
        if any((folder / name).is_file() for name in ("cameras.bin", "cameras.txt")):
            return folder
    return None


def _lens(model: Path, camera: Any) -> Lens:
    if camera.model.name not in DISTORTION:
        raise CaptureError(f"{model}: expected a camera among {', '.join(DISTORTION)}, got {camera.model.name}")
    names = DISTORTION[camera.model.name]
    given = dict(zip(names, map(float, camera.params[len(camera.params) - len(names) :]), strict=True))
    return Lens(
        float(camera.width),
        float(camera.height),
        float(camera.focal_length_x),
        float(camera.focal_length_y),
        float(camera.principal_point_x),
        float(camera.principal_point_y),
        tuple(given.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")),
    )


def _beside_any(places: list[Path], name: str) -> Path:
    for place in places:
        if (place / name).is_file():
            return beside(place, name)
    raise CaptureError(f"{name}: expected this image in {' or '.join(map(str, places))}, found none")
