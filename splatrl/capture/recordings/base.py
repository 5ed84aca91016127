"""The common form of all recordings: what each knows about its images, whichever app wrote it.

Recordings come from untrusted sources: images are looked for only beside their files, and nothing in them is executed.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from splatrl import images
from splatrl.capture.base import CaptureError
from splatrl.capture.frames import SHARPNESS_WIDTH
from splatrl.capture.lens import Floats, Lens
from splatrl.capture.photo_files import read_photo
from splatrl.capture.videos import shrunk
from splatrl.documents import parsed_json
from splatrl.images import PHOTO_SUFFIXES

Depth = NDArray[np.uint16]
"""[h, w] depth along the camera's axis, millimetres, of any size; 0 where there is none."""

MAX_BYTES = 64 * 2**20
"""Maximum size of a file that is read whole, such as a text file with the poses of all images."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Conversion between OpenCV's camera axes (y down, z forward) and OpenGL's and ARKit's (y up, z backward)."""
ARKIT_UP = np.array([0.0, 1.0, 0.0])
"""Upward direction in a world that ARKit aligned with gravity."""
SUFFIXES = tuple(written for suffix in PHOTO_SUFFIXES for written in (suffix, suffix.upper()))
"""Suffixes to try where a recording names an image without its own."""
FARTHEST = 5000
"""Maximum depth, millimetres: beyond it, an iPhone's depth sensor only guesses (Polycam's data format)."""


class Picture(Protocol):
    """An image that is read only where it is wanted."""

    def grey(self) -> NDArray[np.uint8]:
        """Return its brightness, scaled down: [H, W]."""
        ...

    def image(self) -> Image.Image:
        """Return the whole image, RGB, as the recording's intrinsics describe it."""
        ...


@dataclass(frozen=True)
class Shot:
    """One image of a recording.

    Attributes:
        name: what messages call it, within the recording: its file, or its entry in one.
        seconds: time at which it was taken; its index where that is unknown or says nothing.
        lens: intrinsics of this image alone.
        camera_to_world: [4, 4], OpenCV camera axes.
        path: the image's file, where it has one of its own.
        depth: reads what a sensor measured from the same place with the same field of view; None without a sensor.
        depth_files: files of that measurement, where it has its own: its depth, and its confidence if there is one.
    """

    name: str
    seconds: float
    lens: Lens
    camera_to_world: Floats
    path: Path | None = None
    depth: Callable[[], Depth] | None = None
    depth_files: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Recording:
    """Images with known poses.

    Attributes:
        source: the file or folder that it was read from.
        shots: at least one image.
        pictures: reads the images of the given shots (ascending indices), and yields each with its index.
        files: files whose change makes it another recording, besides the ``depth_files`` of its shots.
        up: [3], the upward direction in the frame of the poses; None where unknown.
        metric: whether that frame's unit is the metre.
        prepared: whether its images were chosen already, so that all are taken, unchanged where possible.
        border: width of the edge of each image that shows nothing, pixels.
        remarks: what the recording lacks although it can be read, one sentence each.
    """

    source: Path
    shots: list[Shot]
    pictures: Callable[[Sequence[int]], Iterator[tuple[int, Picture]]]
    files: list[Path]
    up: Floats | None = None
    metric: bool = False
    prepared: bool = False
    border: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def timed(self) -> bool:
        """Whether the times of the shots are known; otherwise they are only numbered."""
        return any(shot.seconds % 1 for shot in self.shots)


class FilePicture:
    """An image in a file of its own.

    Args:
        path: a PNG, a JPEG or a WebP.
        opened: opens a stream to read instead, such as an entry of an archive; the path is then only a name.
    """

    def __init__(self, path: Path, opened: Callable[[], BinaryIO] | None = None) -> None:
        self.path, self.opened = path, opened

    def grey(self) -> NDArray[np.uint8]:
        """Return its brightness, scaled down: [H, W]."""
        return np.asarray(shrunk(self.image(), SHARPNESS_WIDTH).convert("L"))

    def image(self) -> Image.Image:
        """Return the whole image, RGB, as the recording's intrinsics describe it."""
        return read_photo(self.path, self.opened() if self.opened else None, upright=False)


def pictures_of(paths: Sequence[Path]) -> Callable[[Sequence[int]], Iterator[tuple[int, Picture]]]:
    """Return a ``Recording.pictures`` for images that are files of their own."""
    return lambda numbers: ((number, FilePicture(paths[number])) for number in numbers)


def without_pose(paths: Sequence[Path], others: Iterable[Path] = ()) -> tuple[str, ...]:
    """Return a remark on the photos beside a recording's images that have no pose; none where there are none.

    Args:
        paths: the images that have one.
        others: further files, such as depth, that may lie beside them.
    """
    folders = {path.parent for path in paths}
    files = [file for folder in folders for file in folder.iterdir() if not file.name.startswith(".")]
    count = sum(file.suffix.lower() in PHOTO_SUFFIXES for file in files)
    missing = count - sum(path.parent in folders for path in {*paths, *others})
    if missing <= 0:
        return ()
    where = f"{len(folders)} folders" if len(folders) > 1 else str(min(folders))
    return (f"{missing} of the {count} images in {where} have no pose, and are not used.",)


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
    """Parse a JSON text.

    Raises:
        CaptureError: for anything else; names the source.
    """
    try:
        return parsed_json(str(source), text)
    except ValueError as error:
        raise CaptureError(str(error)) from error


def quaternion_poses(source: object, names: Sequence[str], xyzw: Floats, places: Floats) -> Floats:
    """Return poses [N, 4, 4] from quaternions [N, 4], x, y, z, w, and positions [N, 3].

    Args:
        source: the file, for messages.
        names: N names of the poses in it, for messages.
        xyzw: the quaternions, of any length above 0.
        places: the positions.

    Raises:
        CaptureError: for numbers that are not finite, or a quaternion of length 0; names the first.
    """
    norms = np.linalg.norm(xyzw, axis=1, keepdims=True)
    wrong = ~(np.isfinite(xyzw).all(1) & np.isfinite(places).all(1) & (norms[:, 0] > 1e-6))
    if wrong.any():
        first = int(wrong.argmax())
        raise CaptureError(
            f"{source}: {names[first]}: expected a finite position and a non-zero quaternion x, y, z, w, got "
            f"{places[first].tolist()} and {xyzw[first].tolist()}"
        )
    x, y, z, w = (xyzw / norms).T
    poses = np.tile(np.eye(4), (len(xyzw), 1, 1))
    poses[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1)
    poses[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1)
    poses[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1)
    poses[:, :3, 3] = places
    return poses


def depth_files(depth: Path, confidence: Path) -> tuple[Path, ...]:
    """Return the files of a measurement that exist, the depth first; none where there is no depth."""
    return tuple(path for path in (depth, confidence) if path.is_file()) if depth.is_file() else ()


def read_depth(path: Path, confidence: Path | None = None, *, least: int = 0, farthest: int | None = FARTHEST) -> Depth:
    """Read depth that a sensor measured.

    Args:
        path: a PNG of 16 bits, millimetres.
        confidence: a PNG of the same size with the confidence of each depth; None trusts all.
        least: minimum confidence of the depths that are kept.
        farthest: maximum depth that is kept, millimetres; None keeps all.

    Raises:
        CaptureError: for files that are broken, of another kind, too large, or not of one size.
    """
    try:
        depth = images.read_grey(path)
        trust = None if confidence is None else images.read_grey(confidence)
    except ValueError as error:
        raise CaptureError(str(error)) from error
    if depth.dtype != np.uint16:
        raise CaptureError(f"{path}: expected 16-bit depth, got {depth.dtype}")
    return filtered(path, depth, trust, least, farthest)


def filtered(
    source: object, depth: Depth, trust: NDArray[Any] | None, least: int, farthest: int | None = FARTHEST
) -> Depth:
    """Return depth without what the sensor itself does not trust; arguments as for ``read_depth``."""
    if trust is not None and trust.shape != depth.shape:
        raise CaptureError(f"{source}: expected depth as large as its confidence, {trust.shape}, got {depth.shape}")
    kept = np.ones(depth.shape, bool) if trust is None else trust >= least
    if farthest is not None:
        kept &= depth <= farthest
    return np.where(kept, depth, 0).astype(np.uint16)


def beside(folder: Path, name: object) -> Path:
    """Return a file within a folder and nowhere else.

    Raises:
        CaptureError: for a name that leads elsewhere, or to no file.
    """
    path = path_within(folder, name)
    if not path.is_file():
        raise CaptureError(f"{path}: expected an image, found none")
    return path


def path_within(folder: Path, name: object) -> Path:
    """Return the path within a folder that a recording names, whether or not there is a file.

    Where there is none of exactly that name, separators may be Windows' backslashes, and the suffix of an image may be
    missing, as instant-ngp leaves it out, or be written in the other case.

    Raises:
        CaptureError: for a name that leads elsewhere.
    """
    path = folder / str(name)
    if not path.is_file():
        given = folder / str(name).replace("\\", "/")
        others = [given, *(Path(f"{given}{suffix}") for suffix in SUFFIXES)]
        if given.suffix.lower() in PHOTO_SUFFIXES:
            others += [given.with_suffix(suffix) for suffix in (given.suffix.lower(), given.suffix.upper())]
        path = next((other for other in others if other.is_file()), path)
    if "\0" in str(name) or folder.resolve() not in path.resolve().parents:
        raise CaptureError(f"{str(name)[:80]!r}: expected an image within {folder}, got a path outside it")
    return path
