"""What a recording knows of each of its images, whatever wrote it.

Files of recordings come from strangers: images are looked for beside them only, and nothing in them is run.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from splatrl import images
from splatrl.capture.base import CaptureError
from splatrl.capture.frames import SHARPNESS_WIDTH
from splatrl.capture.photo_files import read_photo
from splatrl.capture.videos import shrunk
from splatrl.documents import parsed_json
from splatrl.images import PHOTO_SUFFIXES

Floats = NDArray[np.float64]
Depth = NDArray[np.uint16]
"""[h, w] millimetres along the camera's axis, of any size; 0 where there is none."""

MAX_BYTES = 64 * 2**20
"""Of a text file with the poses of all images."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenCV's camera axes (y down, z forward) to OpenGL's and ARKit's (y up, z backward)."""
ARKIT_UP = np.array([0.0, 1.0, 0.0])
"""Away from the earth in a world that ARKit aligned with gravity."""
FARTHEST = 5000
"""Millimetres: what an iPhone's depth sensor says beyond is a guess (Polycam's data format)."""


class Picture(Protocol):
    """An image that is read only where it is wanted."""

    def grey(self) -> NDArray[np.uint8]:
        """Its brightness, small: [H, W]."""
        ...

    def image(self) -> Image.Image:
        """The whole image, RGB, as the recording's intrinsics describe it."""
        ...


@dataclass(frozen=True)
class Lens:
    """Intrinsics of an image of a stated size, pixels.

    Attributes:
        width: of the image for which the others hold.
        height: of it.
        fx: focal length.
        fy: the same, down.
        cx: principal point, from the left edge.
        cy: the same, from the upper edge.
        distortion: OpenCV's k1, k2, p1, p2, k3.
    """

    width: float
    height: float
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0,) * 5


@dataclass(frozen=True)
class Shot:
    """One image of a recording.

    Attributes:
        seconds: when it was taken; its number where that is unknown or says nothing.
        lens: the camera, of this image alone.
        camera_to_world: [4, 4], OpenCV camera axes.
        path: of its file, where it has one of its own.
        depth: reads what a sensor measured from the same place, for the same field of view; None without.
    """

    seconds: float
    lens: Lens
    camera_to_world: Floats
    path: Path | None = None
    depth: Callable[[], Depth] | None = None


@dataclass(frozen=True)
class Recording:
    """Images with known poses.

    Attributes:
        source: what it was read from.
        shots: at least one.
        pictures: reads some of the images, by ascending numbers of shots; yields the number with each.
        files: whose change makes it another recording.
        up: [3], away from the earth, in the frame of the poses; None where unknown.
        metric: whether that frame's unit is the metre.
        prepared: whether somebody has chosen its images, so that all are taken, as they are where that is possible.
        border: pixels along the edges of each image that show nothing.
    """

    source: Path
    shots: list[Shot]
    pictures: Callable[[Sequence[int]], Iterator[tuple[int, Picture]]]
    files: list[Path]
    up: Floats | None = None
    metric: bool = False
    prepared: bool = False
    border: float = 0.0


class FilePicture:
    """An image in a file of its own.

    Args:
        path: of a PNG, a JPEG or a WebP.
        opened: opens what to read instead, such as an entry of an archive, which the path then only names.
    """

    def __init__(self, path: Path, opened: Callable[[], BinaryIO] | None = None) -> None:
        self.path, self.opened = path, opened

    def grey(self) -> NDArray[np.uint8]:
        """Its brightness, small: [H, W]."""
        return np.asarray(shrunk(self.image(), SHARPNESS_WIDTH).convert("L"))

    def image(self) -> Image.Image:
        """The whole image, RGB, as the recording's intrinsics describe it."""
        return read_photo(self.path, self.opened() if self.opened else None, upright=False)


def pictures_of(paths: Sequence[Path]) -> Callable[[Sequence[int]], Iterator[tuple[int, Picture]]]:
    """Reads some of the images that are files of their own, as ``Recording.pictures``."""
    return lambda numbers: ((number, FilePicture(paths[number])) for number in numbers)


def read_text(path: Path) -> str:
    """Read a small text file.

    Raises:
        CaptureError: for a file that is missing, too large, or not text.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"more than {MAX_BYTES:,} bytes")
        return path.read_text("utf-8")
    except (OSError, ValueError) as error:
        raise CaptureError(f"{path}: expected a text file: {error}") from error


def read_json(source: object, text: str | bytes) -> Any:
    """The values that a JSON text holds.

    Raises:
        CaptureError: for anything else; names the source.
    """
    try:
        return parsed_json(str(source), text)
    except ValueError as error:
        raise CaptureError(str(error)) from error


def quaternion_poses(source: object, xyzw: Floats, places: Floats) -> Floats:
    """Poses [N, 4, 4] of quaternions [N, 4], x, y, z, w, and places [N, 3].

    Raises:
        CaptureError: for numbers that are not finite, or a quaternion of length 0.
    """
    norms = np.linalg.norm(xyzw, axis=1, keepdims=True)
    if not (np.isfinite(xyzw).all() and np.isfinite(places).all() and (norms > 1e-6).all()):
        raise CaptureError(f"{source}: expected finite places and quaternions as poses")
    x, y, z, w = (xyzw / norms).T
    poses = np.tile(np.eye(4), (len(xyzw), 1, 1))
    poses[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1)
    poses[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1)
    poses[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1)
    poses[:, :3, 3] = places
    return poses


def read_depth(path: Path, confidence: Path | None = None, least: int = 0, farthest: int | None = FARTHEST) -> Depth:
    """Read depth that a sensor measured.

    Args:
        path: of a PNG of 16 bits, millimetres.
        confidence: of a PNG of the same size; None trusts everything.
        least: confidence below which a depth is left out.
        farthest: millimetres beyond which it is left out; None leaves nothing out.

    Raises:
        CaptureError: for files that are broken, of another kind, too large, or not of one size.
    """
    try:
        depth = images.read_grey(path)
        trust = None if confidence is None else images.read_grey(confidence)
    except ValueError as error:
        raise CaptureError(str(error)) from error
    if depth.dtype != np.uint16:
        raise CaptureError(f"{path}: expected depth in 16 bits, got {depth.dtype}")
    return filtered(path, depth, trust, least, farthest)


def filtered(
    source: object, depth: Depth, trust: NDArray[Any] | None, least: int, farthest: int | None = FARTHEST
) -> Depth:
    """Depth without what the sensor itself does not trust; arguments as for ``read_depth``."""
    if trust is not None and trust.shape != depth.shape:
        raise CaptureError(f"{source}: expected depth of the size {trust.shape} of its confidence, got {depth.shape}")
    kept = np.ones(depth.shape, bool) if trust is None else trust >= least
    if farthest is not None:
        kept &= depth <= farthest
    return np.where(kept, depth, 0).astype(np.uint16)


def beside(folder: Path, name: object) -> Path:
    """A file within a folder, and nowhere else; an ending that instant-ngp left out is found.

    Raises:
        CaptureError: for a name that leads elsewhere, or to no file.
    """
    path = folder / str(name)
    if not path.suffix:
        path = next((path.with_suffix(s) for s in PHOTO_SUFFIXES if path.with_suffix(s).is_file()), path)
    if folder.resolve() not in path.resolve().parents:
        raise CaptureError(f"{str(name)[:80]!r}: expected an image within {folder}")
    if not path.is_file():
        raise CaptureError(f"{path}: expected an image, found none")
    return path
